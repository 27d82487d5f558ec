# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Messages as they come (CDR), of which only what is asked for is unpacked.

rclpy makes an object of a message and of each one inside it, and sets them field by field: of odometry that
takes ten times what the numbers take that are read of it.
"""

from collections.abc import Callable
from typing import Any

from trackslip_common.layout import FieldsOf, IrregularError, Layout
from trackslip_common.message_reading import Packed, RecordClass, read

_LAYOUTS = 16  # of one topic, of the last ones; there is one, unless somebody plays tricks with frame_id


class PackedMessage(Packed):
    """One, and what its topic has."""

    __slots__ = ("_raw", "_topic")

    def __init__(self, raw: bytes, topic: "PackedTopic") -> None:
        self._raw, self._topic = raw, topic

    def record(self, kind: RecordClass) -> Any:
        """What ``read`` takes of its object."""
        return self._topic.record(self._raw, kind)


class PackedTopic:
    """The layouts that messages of a topic have.

    Args:
        type_name: ``package/msg/Name``.
        fields_of: what types are made of.
        unpack: makes the object of a message, where it has no layout.
    """

    def __init__(self, type_name: str, fields_of: FieldsOf, unpack: Callable[[bytes], Any]) -> None:
        self._type_name, self._fields_of, self._unpack = type_name, fields_of, unpack
        self._known: list[tuple[Layout, dict[RecordClass, Callable[[bytes], Any]]]] = []

    def record(self, raw: bytes, kind: RecordClass) -> Any:
        """What a record class names of a message.

        Raises:
            AttributeError, IndexError: the message has no such field.
        """
        for layout, readers in self._known:
            if layout.fits(raw):
                if kind not in readers:
                    readers[kind] = self._reader(layout, kind)
                return readers[kind](raw)
        try:
            self._known = [(Layout(self._fields_of, self._type_name, raw), {}), *self._known[: _LAYOUTS - 1]]
        except IrregularError:
            return read(kind, self._unpack(raw))
        return self.record(raw, kind)

    def _reader(self, layout: Layout, kind: RecordClass) -> Callable[[bytes], Any]:
        try:
            return layout.reader(kind)
        except KeyError:
            return lambda raw: read(kind, self._unpack(raw))
