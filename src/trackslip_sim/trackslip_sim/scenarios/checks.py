# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads records from YAML mappings, with one-line errors."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from trackslip_common.config_files import config_directory, read_yaml
from trackslip_common.errors import InputError, suggestion

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
        if not isinstance(entry, Mapping):
            raise InputError(f"{key}[{index}] = {entry!r} is refused; accepted: names and values")
        try:
            yield build(entry)
        except InputError as error:
            raise InputError(f"{key}[{index}]: {error}") from error


def check_keys(tree: Mapping[str, Any], keys: tuple[str, ...]) -> None:
    """Raise ``InputError`` for a key that is not among ``keys``."""
    for key in tree:
        if key not in keys:
            raise InputError(f"unknown key '{key}'{suggestion(str(key), keys)}")


def read_number(tree: Mapping[str, Any], key: str) -> float:
    """The number under ``key``; ``InputError`` without one."""
    value = tree.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{key} = {value!r} is {_defect(tree, key)}; accepted: a number")
    return float(value)


def read_text(tree: Mapping[str, Any], key: str) -> str:
    """The text under ``key``; ``InputError`` without one."""
    value = tree.get(key)
    if not isinstance(value, str) or not value:
        raise InputError(f"{key} = {value!r} is {_defect(tree, key)}; accepted: a name")
    return value


def _defect(tree: Mapping[str, Any], key: str) -> str:
    return "refused" if key in tree else "missing"
