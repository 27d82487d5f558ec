# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Builds and serializes ROS messages without importable message packages."""

from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc

from trackslip_bags.types import decode, ensure_type, field_parts
from trackslip_common.make import header as common_header

_DTYPES = {"bool": "bool", "byte": "uint8", "char": "uint8", "octet": "uint8"}
_TEXT = ("string", "wstring")


def make(type_name: str, **fields: Any) -> Any:
    """A message; fields not given are zero, empty or false, as in ROS.

    Lists given for numeric arrays become arrays of the declared type.

    Raises:
        InputError: the type is unknown.
        TypeError: the type has no such field.
    """
    store = ensure_type(type_name)
    values = dict(fields)
    for name, description in store.fielddefs[type_name][1]:
        values[name] = (
            _typed_value(values[name], description) if name in values else _default_value(description)
        )
    return store.types[type_name](**values)


def serialize(message: Any) -> bytes:
    """A message made here → CDR bytes, little-endian, as on the wire."""
    type_name = message.__msgtype__
    return bytes(ensure_type(type_name).serialize_cdr(message, type_name, little_endian=True))


def deserialize(raw: bytes | memoryview, type_name: str) -> Any:
    """CDR bytes → message, by the definition known here (``Bag.deserialize`` uses that of the bag)."""
    return decode(ensure_type(type_name), raw, type_name)


def header(stamp_ns: int, frame_id: str) -> Any:
    """std_msgs/Header of a stamp (ns) and a frame."""
    return common_header(make, stamp_ns, frame_id)


def _default_value(description: FieldDesc) -> Any:
    """Default value of a field."""
    kind, detail = field_parts(description)
    if kind == Nodetype.NAME:
        return make(str(detail))
    if kind == Nodetype.BASE:
        return _default_scalar(str(detail[0]))
    (item_kind, item), size = detail
    count = int(size) if kind == Nodetype.ARRAY else 0
    if item_kind == Nodetype.NAME or item[0] in _TEXT:
        return [_default_value((item_kind, item)) for _ in range(count)]
    return np.zeros(count, dtype=_dtype(str(item[0])))


def _default_scalar(name: str) -> Any:
    if name in _TEXT:
        return ""
    if name == "bool":
        return False
    return 0.0 if name.startswith("float") else 0


def _typed_value(value: Any, description: FieldDesc) -> Any:
    """A given value for the serializer: numeric arrays typed, lists copied, all else unchanged."""
    kind, detail = field_parts(description)
    if kind not in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return value
    item_kind, item = detail[0]
    if item_kind == Nodetype.NAME or item[0] in _TEXT:
        return list(value)
    return np.asarray(value, dtype=_dtype(str(item[0])))


def _dtype(name: str) -> np.dtype[Any]:
    return np.dtype(_DTYPES.get(name, name))
