# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads a bag's topics as tables, in stretches of log time: each field is a named column.

    for stretch in read_tables(bag, ["/sprockets", "/odometry"]):
        rows = stretch["/sprockets"].rows(SprocketFields)   # (n,) record of these names

A record class of ``trackslip_common.message_fields`` names the fields to read. Numbers are read directly from
the bytes: in messages with equal strings and lengths of sequences, each number has the same position
(``layout``). Messages of irregular layout are read one by one.
"""

from collections.abc import Collection, Iterator
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_bags import chunks
from trackslip_bags.reader import Bag
from trackslip_bags.types import fields_by
from trackslip_common.arrays import BoolArray, IntArray
from trackslip_common.errors import InputError
from trackslip_common.layout import FieldsOf, IrregularError, Layout
from trackslip_common.message_reading import RecordClass, dtype_of, read, selectors_of

_LAYOUTS = 64  # per topic; messages of further layouts are read one by one


class Stretch(dict[str, "TopicTable"]):
    """The messages of some seconds, by topic as in the bag; topics without messages are absent.

    ``until_ns``: every message logged before this time is in this or an earlier stretch. ``passed_twice``: as
    in ``chunks.Stretch``.
    """

    def __init__(self, until_ns: int, passed_twice: chunks.Span | None) -> None:
        super().__init__()
        self.until_ns, self.passed_twice = until_ns, passed_twice


class TopicTable:
    """Messages of one topic in log order.

    ``order`` (n,): positions among all messages of the stretch; ``log_times_ns`` (n,): log times.
    """

    def __init__(self, topic: "_Topic", order: IntArray, stretch: chunks.Stretch) -> None:
        self.order, self.log_times_ns = order, stretch.log_times_ns[order]
        self._topic, self._buffer = topic, stretch.buffer
        self._starts, self._lengths = stretch.starts[order], stretch.lengths[order]

    def __len__(self) -> int:
        return len(self.order)

    @property
    def type_name(self) -> str:
        """``package/msg/Name``."""
        return self._topic.type_name

    @property
    def texts(self) -> list[str]:
        """Texts by their number in a text column; the list grows during reading."""
        return self._topic.texts

    def raw(self, k: int) -> bytes:
        """The bytes of message ``k`` (CDR)."""
        start = int(self._starts[k])
        return self._buffer[start : start + int(self._lengths[k])].tobytes()

    def message(self, k: int) -> Any:
        """Message ``k`` as an object.

        Raises:
            InputError: its bytes do not match its type.
        """
        return self._topic.bag.deserialize(self.raw(k), self.type_name)

    def rows(self, kind: RecordClass) -> NDArray[np.void]:
        """(n,) records of ``dtype_of(kind)``.

        Raises:
            InputError: a message does not match its type, or the type lacks a field.
        """
        rows = np.zeros(len(self), dtype_of(kind))
        for length in np.unique(self._lengths).tolist():
            remaining = np.flatnonzero(self._lengths == length)
            for layout in self._topic.layouts(length):
                remaining = remaining[~self._fill_matching(rows, kind, layout, remaining)]
            while remaining.size:
                layout_of_first = self._topic.layout_of(self.raw(int(remaining[0])))
                if layout_of_first is None:
                    self._fill_row(rows, kind, int(remaining[0]))
                    remaining = remaining[1:]
                else:
                    remaining = remaining[~self._fill_matching(rows, kind, layout_of_first, remaining)]
        return rows

    def _fill_matching(
        self, rows: NDArray[np.void], kind: RecordClass, layout: Layout, candidates: IntArray
    ) -> BoolArray:
        """Fill the rows of messages ``candidates`` (m,) that have this layout; returns their mask (m,)."""
        starts = self._starts[candidates]
        matching = layout.matches(self._buffer, starts)
        members, starts = candidates[matching], starts[matching]
        if members.size:
            for name, (_, place) in selectors_of(kind).items():
                try:
                    rows[name][members] = layout.column(place, self._buffer, starts, self._topic.number_of)
                except KeyError:
                    raise self._topic.missing_field_error(place.path) from None
        return matching

    def _fill_row(self, rows: NDArray[np.void], kind: RecordClass, k: int) -> None:
        message = self.message(k)
        try:
            values = read(kind, message)
        except (AttributeError, IndexError) as error:
            raise self._topic.missing_field_error(str(error)) from error
        for name, value in zip(selectors_of(kind), values, strict=True):
            rows[name][k] = self._topic.number_of(value) if isinstance(value, str) else value


class _Topic:
    """Data common to the tables of one topic."""

    def __init__(self, bag: Bag, topic: str) -> None:
        self.bag, self.topic = bag, topic
        self.type_name = bag.topics[topic].type_name
        self.texts: list[str] = []
        self._numbers: dict[str, int] = {}
        self._layouts: dict[int, list[Layout]] = {}  # by length of the message

    def layouts(self, length: int) -> list[Layout]:
        """The known layouts of messages of a length in bytes."""
        return list(self._layouts.get(length, ()))

    def layout_of(self, raw: bytes) -> Layout | None:
        """A new layout from a message; None if the message must be read by itself."""
        if sum(map(len, self._layouts.values())) >= _LAYOUTS:
            return None
        try:
            layout = Layout(self._fields_of, self.type_name, raw)
        except IrregularError:
            return None
        self._layouts.setdefault(len(raw), []).append(layout)
        return layout

    def number_of(self, text: str) -> int:
        """Number of a text in text columns."""
        if text not in self._numbers:
            self._numbers[text] = len(self.texts)
            self.texts.append(text)
        return self._numbers[text]

    def missing_field_error(self, field: str) -> InputError:
        """The error for a field missing in the type."""
        return InputError(f"bag '{self.bag.path}': {self.topic} is a {self.type_name} without {field}")

    @cached_property
    def _fields_of(self) -> FieldsOf:
        return fields_by(self.bag.store(self.type_name))


def read_tables(
    bag: Bag, topics: Collection[str], start_ns: int | None = None, stop_ns: int | None = None
) -> Iterator[Stretch]:
    """Yield the topics' messages, logged from ``start_ns`` on and before ``stop_ns``, in log order.

    Raises:
        InputError: the bag is damaged inside.
    """
    requested = [_Topic(bag, topic) for topic in bag.matching_topics(topics)]
    for stretch in chunks.read_stretches(bag, topics, start_ns, stop_ns):
        tables = Stretch(stretch.until_ns, stretch.passed_twice)
        for number, topic in enumerate(requested):
            order = np.flatnonzero(stretch.topics == number)
            if order.size:
                tables[topic.topic] = TopicTable(topic, order, stretch)
        yield tables
