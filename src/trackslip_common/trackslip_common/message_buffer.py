# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A serialized (CDR) message whose numbers are set in its bytes.

For messages that are sent often and differ in their numbers alone. A function that fills a message object
also fills this one, whose fields have the same names. rclpy would read each field and each nested message.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.layout import FieldsOf, Layout


class MessageBuffer:
    """The bytes of one message, with its fields as attributes.

    Args:
        type_name: ``package/msg/Name``.
        fields_of: fields of each message type.
        raw: the message; its strings and lengths of lists stay, its numbers can be set.

    Attributes:
        message: has the fields of the message. Numbers can be set, arrays set or changed in place; nothing
            else can be changed.

    Raises:
        IrregularError: the bytes are no message of this type in little-endian CDR.
    """

    def __init__(self, type_name: str, fields_of: FieldsOf, raw: bytes) -> None:
        layout = Layout(fields_of, type_name, raw, lists=True)
        dtype = layout.dtype
        self._raw = layout.blank()  # serializers leave padding uninitialised
        record, original = np.frombuffer(self._raw, dtype).reshape(()), np.frombuffer(raw, dtype, 1)[0]
        fields: dict[str, Any] = {}
        for path in dtype.names or ():
            *inside, name = path.split(".")
            part = fields
            for group in inside:
                part = part.setdefault(group, {})
            part[name] = _NumberField(record[path])
            record[path] = original[path]
        self.message = _make_part(fields)

    def __bytes__(self) -> bytes:
        """The present bytes."""
        return bytes(self._raw)


class _NumberField:
    """Descriptor of a field in the bytes: a number, or an array of numbers."""

    __slots__ = ("_view",)

    def __init__(self, view: NDArray[Any]) -> None:
        self._view = view

    def __get__(self, message: Any, _: type) -> Any:
        return self._view if self._view.shape else self._view.item()

    def __set__(self, message: Any, value: Any) -> None:
        self._view[...] = value


def _make_part(fields: dict[str, Any]) -> Any:
    """An object with these fields; for a list of messages, a list."""
    inner = {name: _make_part(field) if isinstance(field, dict) else field for name, field in fields.items()}
    return list(inner.values()) if "0" in inner else type("Part", (), {"__slots__": (), **inner})()
