# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""File of finished results, from which an interrupted study or tuning resumes.

A result is reused only while its inputs are unchanged: the parts of its key, and the source files of
estimators, truth and study. Lines may be truncated, edited, or of another version: their results are computed
again.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import GenericAlias, ModuleType, NoneType, UnionType
from typing import Any, Generic, TypeVar, get_args, get_origin, get_type_hints

from trackslip_common.errors import InputError

R = TypeVar("R")

_MAX_FILE_SIZE = 2**28  # bytes of a file; ours have about a hundred per line


class ResultCache(dict[str, R], Generic[R]):
    """Results by key; one JSON line per result, appended as soon as it is finished."""

    def __init__(self, path: Path, kind: type[R], name: str, *, fresh: bool = False) -> None:
        """Read the file, unless ``fresh``; ``kind``: a dataclass or NamedTuple; ``name`` begins an error.

        Raises:
            InputError: the file cannot be read or created, or holds something else.
        """
        super().__init__()
        self._path, self._kind = path, kind
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
            is_own = not path.is_fifo() and path.stat().st_size <= _MAX_FILE_SIZE
            text = path.read_text(encoding="utf-8", errors="replace") if is_own else ""
        except OSError as error:
            raise InputError(f"{name}: '{path}' cannot be used ({error.strerror})") from error
        if not is_own or (text.strip() and not text.lstrip().startswith("{")):
            raise InputError(
                f"{name}: '{path}' holds something else; accepted: a new file, or an earlier one"
            )
        for line in () if fresh else text.splitlines():
            self._add_line(line)

    def add(self, key: str, result: R) -> None:
        """Store a result in memory and in the file."""
        self[key] = result
        row = {name: getattr(result, name) for name in get_type_hints(type(result))}
        with self._path.open("a", encoding="utf-8") as file:
            file.write("\n" * bool(file.tell()) + json.dumps({"key": key, "row": row}))

    def _add_line(self, line: str) -> None:
        with suppress(ValueError, RecursionError, TypeError, KeyError):
            entry = json.loads(line)
            self[str(entry["key"])] = make_record(self._kind, entry["row"])


def key_of(parts: Mapping[str, Any], *modules: ModuleType) -> str:
    """Hash of the inputs of a result: the parts, and the source files in the folders of the modules."""
    named = {**parts, "sources": _sources(modules)}
    return hashlib.sha256(json.dumps(named, sort_keys=True).encode()).hexdigest()


@cache
def _sources(modules: tuple[ModuleType, ...]) -> str:
    digest = hashlib.sha256()
    for path in source_files(modules):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def source_files(modules: Sequence[ModuleType]) -> list[Path]:
    """The source files in the folders of the modules, at any depth."""
    return [path for m in modules for path in sorted(Path(str(m.__file__)).parent.rglob("*.py"))]


def make_record(kind: type[R], entry: Any) -> R:
    """A dataclass or NamedTuple from its fields by name.

    Raises:
        TypeError: a field is missing, unknown, or of another type.
    """
    hints = get_type_hints(kind)
    if not isinstance(entry, dict) or entry.keys() != hints.keys():
        raise TypeError(kind.__name__)
    return kind(**{name: _convert_value(hints[name], value) for name, value in entry.items()})


def _convert_value(hint: Any, value: Any) -> Any:
    """A number, text, bool, tuple of this length, or mapping by name, as hinted; int counts as float.

    None is accepted if the hint is a union with it.
    """
    if isinstance(hint, UnionType):
        kinds = [kind for kind in get_args(hint) if kind is not NoneType]
        return None if value is None and len(kinds) < len(get_args(hint)) else _convert_value(kinds[0], value)
    if isinstance(hint, GenericAlias):
        origin, inner = get_origin(hint), get_args(hint)
        if origin is dict and isinstance(value, dict):
            return {key: _convert_value(inner[1], of_key) for key, of_key in value.items()}
        if origin is tuple and isinstance(value, list) and len(value) == len(inner):
            return tuple(_convert_value(kind, part) for kind, part in zip(inner, value, strict=True))
        raise TypeError(str(hint))
    if hint is float and type(value) is int:
        value = float(value) if abs(value) < 2**63 else None
    if type(value) is not hint:
        raise TypeError(str(hint))
    return value
