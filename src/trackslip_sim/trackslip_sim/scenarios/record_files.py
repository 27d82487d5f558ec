# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Records from YAML files: by their names in ``config/`` or from a user's file, and lists of them."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from trackslip_common.config_files import config_directory, read_yaml
from trackslip_common.errors import InputError, suggestion
from trackslip_common.yaml_tree import section

T = TypeVar("T")


def record_names(kind: str) -> list[str]:
    """Names of the records of a kind: files in its folder of ``config/``."""
    return sorted(path.stem for path in (config_directory() / f"{kind}s").glob("*.yaml"))


def load_record(
    kind: str, name_or_file: str, known: Iterable[str], parse: Callable[[Mapping[str, Any]], T]
) -> T:
    """A record by its name in the folder of its kind in ``config/``, or from a user's file.

    Raises:
        InputError: the name is not in ``known``, or its file is refused.
    """
    for path in (config_directory() / f"{kind}s" / f"{name_or_file}.yaml", Path(name_or_file)):
        if path.is_file():
            tree = read_yaml(path)
            try:
                return parse(tree)
            except InputError as error:
                raise InputError(f"{path}: {error}") from error
    like = suggestion(str(name_or_file), known, ", or a YAML file")
    raise InputError(f"{kind}: '{name_or_file}' is unknown{like}")


def read_list(tree: Mapping[str, Any], key: str, build: Callable[[Mapping[str, Any]], T]) -> Iterator[T]:
    """The records listed under ``key``; none if it is absent.

    Raises:
        InputError: the value is not a list of mappings, or ``build`` refuses one of them.
    """
    listed = tree.get(key, [])
    if not isinstance(listed, list):
        raise InputError(f"{key} = {listed!r} is refused; accepted: a list")
    for index, entry in enumerate(listed):
        try:
            yield build(section("entry", entry))
        except InputError as error:
            raise InputError(f"{key}[{index}]: {error}") from error
