# SPDX-License-Identifier: Apache-2.0
"""All messages of a topic at once: each field a column of an array, straight from CDR.

Messages of a topic mostly differ in their numbers alone. Where strings and the lengths of sequences are the
same, each number is at the same place in all of them, and numpy reads it from all of them in one view. Such
messages are found by their *frame*: their bytes where a string or a length stands.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from trackslip_bags.types import CDR_HEADER, CDR_SLACK, field_parts

Columns = Mapping[str, NDArray[Any]]
"""Dotted name of a field → (n,) its values, or (n, k) where it holds k of them."""

_NUMBERS = {"bool": "?", "byte": "u1", "char": "u1", "octet": "u1", "float32": "<f4", "float64": "<f8"}
_NUMBERS |= {f"int{8 * size}": f"<i{size}" for size in (1, 2, 4, 8)}
_NUMBERS |= {f"uint{8 * size}": f"<u{size}" for size in (1, 2, 4, 8)}
_FRAMES = 64  # of one topic; more are no columns


class IrregularError(ValueError):
    """The messages do not make columns; they must be read one by one."""


class _Leaf(NamedTuple):
    """A field that holds numbers, or text."""

    kind: str  # numpy's, or "text"
    offset: int  # from the message's first byte
    length: int | None  # None for one value alone
    texts: tuple[str, ...] = ()


class _Layout:
    """Where each field is in a message, and which bytes make it so."""

    def __init__(self, store: Typestore, type_name: str, raw: bytes) -> None:
        self.leaves: dict[str, _Leaf] = {}
        self.frame = [np.arange(CDR_HEADER)]  # places of strings and lengths
        self._store, self._raw, self._at = store, raw, 0
        self._message(type_name, "")
        if not 0 <= len(raw) - CDR_HEADER - self._at <= CDR_SLACK:
            raise IrregularError(f"{type_name} of {len(raw)} bytes")

    def _message(self, type_name: str, prefix: str) -> None:
        for name, description in self._store.fielddefs[type_name][1]:
            kind, detail = field_parts(description)
            if kind == Nodetype.NAME:
                self._message(str(detail), f"{prefix}{name}.")
            elif kind == Nodetype.BASE:
                self._values(prefix + name, detail[0], None)
            else:
                (inner, inner_detail), count = detail
                if inner != Nodetype.BASE:
                    raise IrregularError(f"{prefix}{name} holds messages")
                if kind == Nodetype.SEQUENCE:
                    count = self._length()
                self._values(prefix + name, inner_detail[0], count)

    def _values(self, name: str, kind: str, count: int | None) -> None:
        if kind == "string":
            texts = tuple(self._text() for _ in range(1 if count is None else count))
            self.leaves[name] = _Leaf("text", 0, count, texts)
            return
        if kind not in _NUMBERS:
            raise IrregularError(f"{name} is a {kind}")
        size = np.dtype(_NUMBERS[kind]).itemsize
        if count != 0:
            self._at += -self._at % size
        self.leaves[name] = _Leaf(_NUMBERS[kind], CDR_HEADER + self._at, count)
        self._at += size * (1 if count is None else count)

    def _length(self) -> int:
        self._at += -self._at % 4
        begin = CDR_HEADER + self._at
        self.frame.append(np.arange(begin, begin + 4))
        self._at += 4
        return int.from_bytes(self._raw[begin : begin + 4], "little")

    def _text(self) -> str:
        length = self._length()
        begin = CDR_HEADER + self._at
        if begin + length > len(self._raw):
            raise IrregularError("a text goes on beyond its message")
        self.frame.append(np.arange(begin, begin + length))
        self._at += length
        return bytes(self._raw[begin : begin + max(length - 1, 0)]).decode(errors="replace")


def columns_of(store: Typestore, type_name: str, raws: Sequence[bytes]) -> Columns:
    """The fields of messages of one type, in the order of the messages.

    Raises:
        IrregularError: lengths of sequences differ, or the type holds sequences of messages.
    """
    groups = list(_groups(store, type_name, raws))
    columns: dict[str, NDArray[Any]] = {}
    for name, first in groups[0][0].leaves.items() if groups else ():
        leaves = [layout.leaves[name] for layout, _, _ in groups]
        if any(leaf.length != first.length for leaf in leaves):
            raise IrregularError(f"{name} differs in length")
        parts = [_column(leaf, block) for leaf, (_, _, block) in zip(leaves, groups, strict=True)]
        column = np.empty((len(raws), *parts[0].shape[1:]), np.result_type(*parts))
        for part, (_, members, _) in zip(parts, groups, strict=True):
            column[members] = part
        columns[name] = column
    return columns


def _groups(
    store: Typestore, type_name: str, raws: Sequence[bytes]
) -> Iterator[tuple[_Layout, NDArray[np.int64], NDArray[np.uint8]]]:
    """Layout, numbers and bytes (m, length) of the messages that have the same frame."""
    lengths = np.array([len(raw) for raw in raws])
    found = 0
    for length in np.unique(lengths):
        members = np.flatnonzero(lengths == length)
        block = np.frombuffer(b"".join(raws[k] for k in members.tolist()), np.uint8).reshape(
            members.size, length
        )
        while members.size:
            found += 1
            first = raws[int(members[0])]
            if found > _FRAMES or length < CDR_HEADER or first[0] != 0 or first[1] != 1:
                raise IrregularError(f"{type_name} in other forms")
            layout = _Layout(store, type_name, first)
            frame = np.concatenate(layout.frame)
            alike = (block[:, frame] == block[0, frame]).all(axis=1)
            yield layout, members[alike], block[alike]
            members, block = members[~alike], block[~alike]


def _column(leaf: _Leaf, block: NDArray[np.uint8]) -> NDArray[Any]:
    n = len(block)
    if leaf.kind == "text":
        texts = np.array(leaf.texts, dtype=np.str_)
        return np.repeat(texts, n) if leaf.length is None else np.tile(texts, (n, 1))
    count = 1 if leaf.length is None else leaf.length
    size = np.dtype(leaf.kind).itemsize * count
    values = np.ascontiguousarray(block[:, leaf.offset : leaf.offset + size])
    if leaf.length is None:
        return values.view(leaf.kind).reshape(n)
    return values.view(leaf.kind).reshape(n, count) if count else np.empty((n, 0), leaf.kind)
