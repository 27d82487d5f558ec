# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Records from lines of JSON that may be truncated, edited, or of another version."""

import json
from pathlib import Path
from types import GenericAlias, NoneType, UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

R = TypeVar("R")

_MAX_FILE_SIZE = 2**28  # bytes of a file; ours have about a hundred per line


def read_lines(path: Path) -> list[str]:
    """The lines of a file of JSON mappings; none if the file is missing or empty.

    Raises:
        OSError: the file cannot be read.
        TypeError: the file is a pipe, too large, or does not begin with a mapping.
    """
    if not path.exists():
        return []
    if path.is_fifo() or path.stat().st_size > _MAX_FILE_SIZE:
        raise TypeError("no file of ours")
    text = path.read_text(encoding="utf-8", errors="replace")
    if text.strip() and not text.lstrip().startswith("{"):
        raise TypeError("no line of ours")
    return text.splitlines()


def parse_line(line: str) -> dict[str, Any] | None:
    """The mapping in a line; None if there is none."""
    try:
        value = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) else None


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
