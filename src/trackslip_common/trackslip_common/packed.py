# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Serialized messages (CDR), of which only the requested fields are decoded.

rclpy makes an object of a message and of each nested one, and sets every field. For odometry this takes ten
times as long as decoding the numbers that are used.
"""

from collections.abc import Callable
from typing import Any

from trackslip_common.layout import FieldsOf, IrregularError, Layout
from trackslip_common.message_reading import RecordClass, SerializedMessage, read

_MAX_LAYOUTS = 16  # of one topic, most recent first; usually one, unless frame_id keeps changing


class PackedMessage(SerializedMessage):
    """One serialized message, with the layouts of its topic."""

    __slots__ = ("_raw", "_topic")

    def __init__(self, raw: bytes, topic: "PackedTopic") -> None:
        self._raw, self._topic = raw, topic

    def record(self, kind: RecordClass) -> Any:
        """The record that ``read`` makes from the message object."""
        return self._topic.record(self._raw, kind)


class PackedTopic:
    """The layouts of a topic's messages.

    Args:
        type_name: ``package/msg/Name``.
        fields_of: fields of each message type.
        unpack: deserializes a message that has no layout.
    """

    def __init__(self, type_name: str, fields_of: FieldsOf, unpack: Callable[[bytes], Any]) -> None:
        self._type_name, self._fields_of, self._unpack = type_name, fields_of, unpack
        self._layouts: list[tuple[Layout, dict[RecordClass, Callable[[bytes], Any]]]] = []

    def record(self, raw: bytes, kind: RecordClass) -> Any:
        """The record of a message.

        Raises:
            AttributeError, IndexError: the message has no such field.
        """
        for layout, readers in self._layouts:
            if layout.is_layout_of(raw):
                if kind not in readers:
                    readers[kind] = self._reader(layout, kind)
                return readers[kind](raw)
        try:
            self._layouts = [
                (Layout(self._fields_of, self._type_name, raw), {}),
                *self._layouts[: _MAX_LAYOUTS - 1],
            ]
        except IrregularError:
            return read(kind, self._unpack(raw))
        return self.record(raw, kind)

    def _reader(self, layout: Layout, kind: RecordClass) -> Callable[[bytes], Any]:
        try:
            return layout.reader(kind)
        except KeyError:
            return lambda raw: read(kind, self._unpack(raw))
