# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Builds and serializes ROS messages without importable message packages."""

from typing import Any

import numpy as np

from trackslip_bags.types import decode, ensure_type, fields_by, is_message
from trackslip_common.layout import Field
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
    for field in fields_by(store)(type_name):
        is_given = field.name in values
        values[field.name] = _typed_value(values[field.name], field) if is_given else _default_value(field)
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


def _default_value(field: Field) -> Any:
    """Default value of a field."""
    if field.length is None:
        return _default_item(field.type)
    count = max(field.length, 0)  # a sequence is empty
    if _is_number(field.type):
        return np.zeros(count, dtype=_dtype(field.type))
    return [_default_item(field.type) for _ in range(count)]


def _default_item(type_name: str) -> Any:
    if is_message(type_name):
        return make(type_name)
    if type_name in _TEXT:
        return ""
    if type_name == "bool":
        return False
    return 0.0 if type_name.startswith("float") else 0


def _typed_value(value: Any, field: Field) -> Any:
    """A given value for the serializer: numeric arrays typed, lists copied, all else unchanged."""
    if field.length is None:
        return value
    return np.asarray(value, dtype=_dtype(field.type)) if _is_number(field.type) else list(value)


def _is_number(type_name: str) -> bool:
    return not is_message(type_name) and type_name not in _TEXT


def _dtype(name: str) -> np.dtype[Any]:
    return np.dtype(_DTYPES.get(name, name))
