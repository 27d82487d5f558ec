# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Many messages of one type at once: columns of numbers to CDR, or one row of them to a live message.

Messages of a topic differ in their numbers alone. Strings and the lengths of sequences are those of a blank
message, so each field has one place in the bytes of all.
"""

import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from trackslip_bags.messages import serialize
from trackslip_bags.types import ensure, field_parts
from trackslip_common.layout import CDR_HEADER

Columns = Mapping[str, NDArray[Any]]
"""Dotted name of a field → (n,) its values, or (n, k) where it holds k of them."""

_NS_PER_S = 1_000_000_000
_NUMBERS = {"bool": "?", "byte": "u1", "char": "u1", "octet": "u1", "float32": "<f4", "float64": "<f8"}
_NUMBERS |= {f"{sign}{8 * size}": f"<{sign[0]}{size}" for sign in ("int", "uint") for size in (1, 2, 4, 8)}


def stamp_columns(stamps_ns: Sequence[int]) -> Columns:
    """The stamp of a header."""
    sec, nanosec = np.divmod(np.array(stamps_ns, dtype=np.int64), _NS_PER_S)
    return {"header.stamp.sec": sec, "header.stamp.nanosec": nanosec}


def set_fields(message: Any, columns: Columns) -> None:
    """Put the first row of each column into a message; numbers, not arrays of them."""
    for name, column in columns.items():
        *path, field = name.split(".")
        setattr(functools.reduce(getattr, path, message), field, column[0].item())


class MessageColumns:
    """Messages like ``blank``, which was made by ``trackslip_bags.messages.make``."""

    def __init__(self, blank: Any) -> None:
        self._blank = serialize(blank)
        names, formats, offsets = zip(*_Layout(blank).fields, strict=True)
        self._fields = np.dtype(
            {"names": names, "formats": formats, "offsets": offsets, "itemsize": len(self._blank)}
        )

    def serialize(self, columns: Columns) -> list[bytes]:
        """CDR of the blank with these values in it, a message for each row."""
        (count,) = {len(column) for column in columns.values()}
        size = len(self._blank)
        rows = np.frombuffer(self._blank * count, dtype=np.uint8).copy()
        fields = rows.view(self._fields)
        for name, column in columns.items():
            fields[name] = column
        whole = rows.tobytes()
        return [whole[begin : begin + size] for begin in range(0, len(whole), size)]


class _Layout:
    """Name, kind and place of each field of numbers."""

    def __init__(self, message: Any) -> None:
        self._at = 0
        self.fields = list(self._message(message, ""))

    def _message(self, message: Any, prefix: str) -> Iterator[tuple[str, Any, int]]:
        type_name = message.__msgtype__
        for name, description in ensure(type_name).fielddefs[type_name][1]:
            kind, detail = field_parts(description)
            value = getattr(message, name)
            if kind == Nodetype.NAME:
                yield from self._message(value, f"{prefix}{name}.")
            elif kind == Nodetype.BASE:
                yield from self._values(prefix + name, detail[0], value, ())
            else:
                (_, (inner, _)), _ = detail
                if kind == Nodetype.SEQUENCE:
                    self._skip(4, 4)
                yield from self._values(prefix + name, inner, value, (len(value),))

    def _values(
        self, name: str, kind: str, value: Any, shape: tuple[int, ...]
    ) -> Iterator[tuple[str, Any, int]]:
        if kind == "string":
            for text in value if shape else (value,):
                self._skip(4, 4)
                self._skip(len(text.encode()) + 1, 1)
        elif shape != (0,):
            dtype = np.dtype(_NUMBERS[kind])
            begin = self._skip(dtype.itemsize * (shape[0] if shape else 1), dtype.itemsize)
            yield name, (dtype, shape), CDR_HEADER + begin

    def _skip(self, size: int, alignment: int) -> int:
        """Where the next ``size`` bytes begin."""
        begin = self._at + -self._at % alignment
        self._at = begin + size
        return begin
