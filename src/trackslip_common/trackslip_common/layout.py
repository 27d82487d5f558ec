# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The place of each field in a serialized (CDR) message, and which other messages have the same places.

For tables of many messages (``column``), for live messages one by one (``reader``), and for messages that are
sent or made in large numbers (``dtype``).

Messages of a type mostly differ in their numbers alone. Two messages of the same length whose strings and
sequence lengths (their *frame*) are equal byte by byte have every number at the same place.
"""

import math
from collections.abc import Callable, Iterable
from operator import itemgetter
from struct import Struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import BoolArray, IntArray
from trackslip_common.message_reading import (
    FieldPath,
    HasItems,
    JointItem,
    RecordClass,
    Selector,
    Stamp,
    Text,
    selectors_of,
)
from trackslip_common.units import NS_PER_S

CDR_HEADER = 4  # bytes: 0, then 1 if little-endian, then two of options
CDR_SLACK = 64  # bytes accepted after a message
ANY_LENGTH = -1  # length of a sequence

Bytes = NDArray[np.uint8]

_NUMBERS = {"bool": "?", "byte": "u1", "char": "u1", "octet": "u1", "float32": "<f4", "float64": "<f8"}
_NUMBERS |= {f"int{8 * size}": f"<i{size}" for size in (1, 2, 4, 8)}
_NUMBERS |= {f"uint{8 * size}": f"<u{size}" for size in (1, 2, 4, 8)}
_STRUCT_FORMATS = {"<i8": "q", "<u8": "Q"}  # numpy formats that have another letter in ``struct``


class Field(NamedTuple):
    """One field of a message type's definition."""

    name: str
    type: str  # a number type, ``string``, or ``package/msg/Name``
    length: int | None = None  # of an array; ``ANY_LENGTH`` of a sequence; None: one value


FieldsOf = Callable[[str], Iterable[Field]]
"""``package/msg/Name`` → what it is made of, in this order."""


class IrregularError(ValueError):
    """The message has no layout that other messages share; it must be deserialized."""


class _Leaf(NamedTuple):
    """A field of numbers or text."""

    kind: str  # numpy format, or "text"
    offset: int  # from the message's first byte
    length: int | None  # None: a single value
    texts: tuple[str, ...] = ()


class Layout:
    """Layout of one message in little-endian CDR.

    ``lists``: whether it may contain sequences of messages, whose lengths rarely stay the same.

    Raises:
        IrregularError: the message has another form, or its type has such sequences.
    """

    def __init__(self, fields_of: FieldsOf, type_name: str, raw: bytes, *, lists: bool = False) -> None:
        if len(raw) < CDR_HEADER or raw[0] != 0 or raw[1] != 1:
            raise IrregularError(f"{type_name} of another form")
        self._leaves: dict[str, _Leaf] = {}
        self._places = [np.arange(CDR_HEADER)]  # indices of strings and lengths
        self._fields_of, self._raw, self._offset, self._lists = fields_of, raw, 0, lists
        self._parse_message(type_name, "")
        if not 0 <= len(raw) - CDR_HEADER - self._offset <= CDR_SLACK:
            raise IrregularError(f"{type_name} of {len(raw)} bytes")
        self._frame = np.concatenate(self._places)
        self._frame_bytes = np.frombuffer(raw, np.uint8)[self._frame]
        runs = np.split(self._frame, np.flatnonzero(np.diff(self._frame) > 1) + 1)
        spans = [slice(int(run[0]), int(run[-1]) + 1) for run in runs]
        self._pieces = [(span, bytes(raw[span])) for span in spans]

    @property
    def dtype(self) -> np.dtype[np.void]:
        """A numpy record of all numbers; names are the paths of the fields, offsets those in the message."""
        leaves = {p: leaf for p, leaf in self._leaves.items() if leaf.kind != "text" and leaf.length != 0}
        return np.dtype(
            {
                "names": list(leaves),
                "formats": [
                    (leaf.kind, () if leaf.length is None else (leaf.length,)) for leaf in leaves.values()
                ],
                "offsets": [leaf.offset for leaf in leaves.values()],
                "itemsize": CDR_HEADER + self._offset,
            }
        )

    def blank(self) -> bytearray:
        """The message with all numbers zero; strings and lengths are kept."""
        message = bytearray(CDR_HEADER + self._offset)
        for span, piece in self._pieces:
            message[span] = piece
        return message

    def is_layout_of(self, raw: bytes) -> bool:
        """Whether another message has this layout."""
        return len(raw) == len(self._raw) and all(raw[span] == piece for span, piece in self._pieces)

    def reader(self, kind: RecordClass) -> Callable[[bytes], Any]:
        """A function that reads the record of a fitting message, as ``message_reading.read`` of its object.

        Raises:
            KeyError: the type has no such field.
        """
        codes: dict[int, str] = {}  # by offset, formats of the numbers that are read
        for leaf, at in (
            number for _, selector in selectors_of(kind).values() for number in self._numbers(selector)
        ):
            size = np.dtype(leaf.kind).itemsize
            codes[leaf.offset + at * size] = _STRUCT_FORMATS.get(leaf.kind, np.dtype(leaf.kind).char)
        order, end, form = sorted(codes), 0, "<"
        for offset in order:
            form += f"{offset - end}x{codes[offset]}"
            end = offset + Struct(f"<{codes[offset]}").size
        unpack = Struct(form).unpack_from
        getters = [self._make_getter(selector, order.index) for _, selector in selectors_of(kind).values()]

        def read_one(raw: bytes) -> Any:
            numbers = unpack(raw)
            return kind(*[get(numbers) for get in getters])

        return read_one

    def matches(self, buffer: Bytes, starts: IntArray) -> BoolArray:
        """(n,) whether each message at ``starts``, all of the same length, has this layout."""
        is_match: BoolArray = (buffer[starts[:, np.newaxis] + self._frame] == self._frame_bytes).all(axis=1)
        return is_match

    def column(
        self, selector: Selector, buffer: Bytes, starts: IntArray, number_of: Callable[[str], int]
    ) -> NDArray[Any] | int | float | bool:
        """(n, …) selected values, or the one value of all; ``number_of`` maps texts to numbers.

        Raises:
            KeyError: the type has no such field.
        """
        match selector:
            case Stamp(path):
                seconds = self._values(self._leaves[f"{path}.sec"], buffer, starts).astype(np.int64)
                nanoseconds = self._values(self._leaves[f"{path}.nanosec"], buffer, starts)
                return np.asarray(seconds * NS_PER_S + nanoseconds)
            case HasItems(path):
                return self._leaves[path].length != 0
            case Text(path):
                return number_of(self._leaves[path].texts[0])
            case JointItem():
                numbers = self._numbers(selector)
                return self._values(numbers[0][0], buffer, starts, numbers[0][1]) if numbers else np.nan
            case FieldPath(path, items, shape):
                leaf = self._leaves[path]
                if not shape:
                    return self._values(leaf, buffer, starts, *items)
                if max(items) >= (leaf.length or 0):
                    raise KeyError(path)
                whole = self._values(leaf, buffer, starts, 0, leaf.length or 1)
                return whole[:, items].reshape(len(starts), *shape)

    def _numbers(self, selector: Selector) -> list[tuple["_Leaf", int]]:
        """(leaf, index in the leaf) of each number in the selected value."""
        match selector:
            case Stamp(path):
                numbers = [(self._leaves[f"{path}.sec"], 0), (self._leaves[f"{path}.nanosec"], 0)]
            case FieldPath(path, items, _):
                numbers = [(self._leaves[path], item) for item in items or (0,)]
            case JointItem(path, name):
                leaf, names = self._leaves[path], self._leaves["name"].texts
                index = names.index(name) if name in names else leaf.length or 0
                numbers = [(leaf, index)] if index < (leaf.length or 0) else []
            case _:
                numbers = []
        for leaf, index in numbers:
            if leaf.kind == "text" or index >= (1 if leaf.length is None else leaf.length):
                raise KeyError(selector.path)
        return numbers

    def _make_getter(
        self, selector: Selector, number_at: Callable[[int], int]
    ) -> Callable[[tuple[Any, ...]], Any]:
        """(numbers that were read) → selected value; ``number_at``: offset → index of the number."""
        indices = [
            number_at(leaf.offset + at * np.dtype(leaf.kind).itemsize) for leaf, at in self._numbers(selector)
        ]
        match selector:
            case Stamp():
                sec, nanosec = indices
                return lambda numbers: numbers[sec] * NS_PER_S + numbers[nanosec]
            case FieldPath(_, _, shape) if shape:
                chosen = itemgetter(*indices)
                return lambda numbers: np.array(chosen(numbers), np.float64).reshape(shape)
            case FieldPath() | JointItem() if indices:
                return itemgetter(indices[0])
            case HasItems(path):
                is_filled = self._leaves[path].length != 0
                return lambda _: is_filled
            case Text(path):
                text = self._leaves[path].texts[0]
                return lambda _: text
            case _:
                return lambda _: math.nan

    def _values(
        self, leaf: _Leaf, buffer: Bytes, starts: IntArray, first: int = 0, count: int = 1
    ) -> NDArray[Any]:
        """(n,) values, or (n, count) consecutive ones."""
        if leaf.kind == "text" or first + count > (1 if leaf.length is None else leaf.length):
            raise KeyError
        size = np.dtype(leaf.kind).itemsize
        begin = leaf.offset + first * size
        values = buffer[starts[:, np.newaxis] + np.arange(begin, begin + count * size)].view(leaf.kind)
        return np.asarray(values[:, 0] if count == 1 else values)

    def _parse_message(self, type_name: str, prefix: str) -> None:
        for name, kind, count in self._fields_of(type_name):
            if "/" not in kind:
                self._parse_field(prefix + name, kind, self._read_length() if count == ANY_LENGTH else count)
            elif count is None:
                self._parse_message(kind, f"{prefix}{name}.")
            elif not self._lists:
                raise IrregularError(f"{prefix}{name} holds messages")
            else:
                for k in range(self._read_length() if count == ANY_LENGTH else count):
                    self._parse_message(kind, f"{prefix}{name}.{k}.")

    def _parse_field(self, name: str, kind: str, count: int | None) -> None:
        if kind == "string":
            texts = tuple(self._read_text() for _ in range(1 if count is None else count))
            self._leaves[name] = _Leaf("text", 0, count, texts)
            return
        if kind not in _NUMBERS:
            raise IrregularError(f"{name} is a {kind}")
        size = np.dtype(_NUMBERS[kind]).itemsize
        if count != 0:
            self._offset += -self._offset % size
        self._leaves[name] = _Leaf(_NUMBERS[kind], CDR_HEADER + self._offset, count)
        self._offset += size * (1 if count is None else count)

    def _read_length(self) -> int:
        self._offset += -self._offset % 4
        begin = CDR_HEADER + self._offset
        if begin + 4 > len(self._raw):
            raise IrregularError("a length beyond its message")
        self._places.append(np.arange(begin, begin + 4))
        self._offset += 4
        return int.from_bytes(self._raw[begin : begin + 4], "little")

    def _read_text(self) -> str:
        length = self._read_length()
        begin = CDR_HEADER + self._offset
        if begin + length > len(self._raw):
            raise IrregularError("a text goes on beyond its message")
        self._places.append(np.arange(begin, begin + length))
        self._offset += length
        return bytes(self._raw[begin : begin + max(length - 1, 0)]).decode(errors="replace")
