# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A serialized (CDR) message whose numbers are set where they are in its bytes.

For messages that are sent often and differ in their numbers alone. What fills the object of a message fills
this too: its fields have the same names. Of an object, rclpy asks for each field and for each message inside.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.layout import FieldsOf, Layout


class MessageBuffer:
    """The bytes of one message, and its fields in them.

    Args:
        type_name: ``package/msg/Name``.
        fields_of: what types are made of.
        raw: the message as it is but for the numbers to be set: its strings and lengths of lists stay.

    Attributes:
        message: has the fields of the message. Numbers are set, arrays set or changed in place; nothing else
            can be.

    Raises:
        IrregularError: the bytes are no message of this type in little-endian CDR.
    """

    def __init__(self, type_name: str, fields_of: FieldsOf, raw: bytes) -> None:
        layout = Layout(fields_of, type_name, raw, lists=True)
        dtype = layout.dtype
        self._raw = layout.blank()  # serializers leave padding as memory happened to be
        record, given = np.frombuffer(self._raw, dtype).reshape(()), np.frombuffer(raw, dtype, 1)[0]
        fields: dict[str, Any] = {}
        for path in dtype.names or ():
            *inside, name = path.split(".")
            part = fields
            for one in inside:
                part = part.setdefault(one, {})
            part[name] = _Numbers(record[path])
            record[path] = given[path]
        self.message = _part(fields)

    def __bytes__(self) -> bytes:
        """As it is now."""
        return bytes(self._raw)


class _Numbers:
    """A field: a number, or an array of them, in the bytes."""

    __slots__ = ("_view",)

    def __init__(self, view: NDArray[Any]) -> None:
        self._view = view

    def __get__(self, message: Any, _: type) -> Any:
        return self._view if self._view.shape else self._view.item()

    def __set__(self, message: Any, value: Any) -> None:
        self._view[...] = value


def _part(fields: dict[str, Any]) -> Any:
    """What has these fields; of a list of messages, all of them."""
    inner = {name: _part(field) if isinstance(field, dict) else field for name, field in fields.items()}
    return list(inner.values()) if "0" in inner else type("Part", (), {"__slots__": (), **inner})()
