# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Where each field is in a serialized (CDR) message, and in which other messages it is there too.

Messages of a type mostly differ in their numbers alone. Two of the same length whose strings and lengths of
sequences are the same, byte by byte (their *frame*), have every number at the same place.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from trackslip_bags.types import CDR_HEADER, CDR_SLACK, field_parts
from trackslip_common.message_fields import At, Filled, Joint, Place, Stamp, Text

Bytes = NDArray[np.uint8]
IntArray = NDArray[np.int64]

_NUMBERS = {"bool": "?", "byte": "u1", "char": "u1", "octet": "u1", "float32": "<f4", "float64": "<f8"}
_NUMBERS |= {f"int{8 * size}": f"<i{size}" for size in (1, 2, 4, 8)}
_NUMBERS |= {f"uint{8 * size}": f"<u{size}" for size in (1, 2, 4, 8)}
_NS_PER_S = 1_000_000_000


class IrregularError(ValueError):
    """The message has no layout that others could share; it must be read by itself."""


class _Leaf(NamedTuple):
    """A field that holds numbers, or text."""

    kind: str  # numpy's, or "text"
    offset: int  # from the message's first byte
    length: int | None  # None for one value alone
    texts: tuple[str, ...] = ()


class Layout:
    """That of one message, which is little-endian CDR.

    Raises:
        IrregularError: it is not, or the type holds sequences of messages.
    """

    def __init__(self, store: Typestore, type_name: str, raw: bytes) -> None:
        if len(raw) < CDR_HEADER or raw[0] != 0 or raw[1] != 1:
            raise IrregularError(f"{type_name} of another form")
        self._leaves: dict[str, _Leaf] = {}
        self._places = [np.arange(CDR_HEADER)]  # of strings and lengths
        self._store, self._raw, self._at = store, raw, 0
        self._message(type_name, "")
        if not 0 <= len(raw) - CDR_HEADER - self._at <= CDR_SLACK:
            raise IrregularError(f"{type_name} of {len(raw)} bytes")
        self._frame = np.concatenate(self._places)
        self._frame_bytes = np.frombuffer(raw, np.uint8)[self._frame]

    def matches(self, buffer: Bytes, starts: IntArray) -> NDArray[np.bool_]:
        """(n,) which of the messages, of the same length, that begin at ``starts`` have this layout."""
        found: NDArray[np.bool_] = (buffer[starts[:, np.newaxis] + self._frame] == self._frame_bytes).all(
            axis=1
        )
        return found

    def offset(self, path: str) -> int:
        """Where the first number of a field is, from the message's first byte.

        Raises:
            KeyError: the type has no such field.
        """
        return self._leaves[path].offset

    def column(
        self, place: Place, buffer: Bytes, starts: IntArray, number_of: Callable[[str], int]
    ) -> NDArray[Any] | int | float | bool:
        """(n, …) values at a place, or the one value of all; ``number_of`` numbers texts.

        Raises:
            KeyError: the type has no such field.
        """
        match place:
            case Stamp(path):
                seconds = self._values(self._leaves[f"{path}.sec"], buffer, starts).astype(np.int64)
                nanoseconds = self._values(self._leaves[f"{path}.nanosec"], buffer, starts)
                return np.asarray(seconds * _NS_PER_S + nanoseconds)
            case Filled(path):
                return self._leaves[path].length != 0
            case Text(path):
                return number_of(self._leaves[path].texts[0])
            case Joint(path, name):
                leaf, names = self._leaves[path], self._leaves["name"].texts
                at = names.index(name) if name in names else leaf.length or 0
                return self._values(leaf, buffer, starts, at) if at < (leaf.length or 0) else np.nan
            case At(path, items, shape):
                leaf = self._leaves[path]
                if not shape:
                    return self._values(leaf, buffer, starts, *items)
                if max(items) >= (leaf.length or 0):
                    raise KeyError(path)
                whole = self._values(leaf, buffer, starts, 0, leaf.length or 1)
                return whole[:, items].reshape(len(starts), *shape)

    def _values(
        self, leaf: _Leaf, buffer: Bytes, starts: IntArray, first: int = 0, count: int = 1
    ) -> NDArray[Any]:
        """(n,) or, of several in a row, (n, count)."""
        if leaf.kind == "text" or first + count > (1 if leaf.length is None else leaf.length):
            raise KeyError
        size = np.dtype(leaf.kind).itemsize
        begin = leaf.offset + first * size
        found = buffer[starts[:, np.newaxis] + np.arange(begin, begin + count * size)].view(leaf.kind)
        return np.asarray(found[:, 0] if count == 1 else found)

    def _message(self, type_name: str, prefix: str) -> None:
        for name, description in self._store.fielddefs[type_name][1]:
            kind, detail = field_parts(description)
            if kind == Nodetype.NAME:
                self._message(str(detail), f"{prefix}{name}.")
            elif kind == Nodetype.BASE:
                self._field(prefix + name, detail[0], None)
            else:
                (inner, inner_detail), count = detail
                if inner != Nodetype.BASE:
                    raise IrregularError(f"{prefix}{name} holds messages")
                if kind == Nodetype.SEQUENCE:
                    count = self._length()
                self._field(prefix + name, inner_detail[0], count)

    def _field(self, name: str, kind: str, count: int | None) -> None:
        if kind == "string":
            texts = tuple(self._text() for _ in range(1 if count is None else count))
            self._leaves[name] = _Leaf("text", 0, count, texts)
            return
        if kind not in _NUMBERS:
            raise IrregularError(f"{name} is a {kind}")
        size = np.dtype(_NUMBERS[kind]).itemsize
        if count != 0:
            self._at += -self._at % size
        self._leaves[name] = _Leaf(_NUMBERS[kind], CDR_HEADER + self._at, count)
        self._at += size * (1 if count is None else count)

    def _length(self) -> int:
        self._at += -self._at % 4
        begin = CDR_HEADER + self._at
        if begin + 4 > len(self._raw):
            raise IrregularError("a length beyond its message")
        self._places.append(np.arange(begin, begin + 4))
        self._at += 4
        return int.from_bytes(self._raw[begin : begin + 4], "little")

    def _text(self) -> str:
        length = self._length()
        begin = CDR_HEADER + self._at
        if begin + length > len(self._raw):
            raise IrregularError("a text goes on beyond its message")
        self._places.append(np.arange(begin, begin + length))
        self._at += length
        return bytes(self._raw[begin : begin + max(length - 1, 0)]).decode(errors="replace")
