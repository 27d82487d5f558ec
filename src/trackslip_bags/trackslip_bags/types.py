# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Message types without ROS: definitions, hashes, and a store that (de)serializes them.

Standard types come from rosbags for the ROS distribution in use. All other types, including the project's
own, come from ``.msg`` files: installed (``AMENT_PREFIX_PATH``) or in the checkout.
"""

from collections.abc import Iterator
from functools import lru_cache, partial
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from trackslip_bags.definitions import DEFAULT_DISTRO, msg_file, ros_distro
from trackslip_bags.metadata import ROS2MSG, Schema
from trackslip_common.errors import InputError
from trackslip_common.layout import ANY_LENGTH, CDR_HEADER, CDR_SLACK, Field, FieldsOf

_IDL_SEPARATOR = "=" * 80 + "\n"
_MAX_VALUES = 1_000_000  # limit of values of a message with empty lists


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """The process' store of types; ``ensure_type`` adds to it."""
    name = f"ros2_{ros_distro()}"
    is_known = name in {store.value for store in Stores}
    return get_typestore(Stores(name if is_known else f"ros2_{DEFAULT_DISTRO}"))


def ensure_type(type_name: str) -> Typestore:
    """The store, after adding ``type_name`` and its inner types if unknown.

    Raises:
        InputError: the type or one inside it has no ``.msg`` file here, or the file cannot be parsed.
    """
    store = typestore()
    if type_name not in store.fielddefs:
        types: Typesdict = {}
        _collect_types(type_name, store, types)
        store.register(types)
    return store


def known_schema(type_name: str) -> Schema:
    """The MCAP schema of a type in the process' store, with its RIHS01 hash (REP-2016).

    Raises:
        InputError: the type is unknown.
    """
    store = ensure_type(type_name)
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    return Schema(ROS2MSG, text.encode(), store.hash_rihs01(type_name))


@lru_cache(maxsize=64)  # covers several bags; rosbags compiles each store
def store_for(type_name: str, schema: Schema) -> Typestore:
    """The store that reads ``type_name`` by a bag's definition, also of another version of the message.

    Without a definition in the bag it is the process' store.

    Raises:
        InputError: the bag holds no definition of the type and the type is unknown here.
        TypesysError: the bag's definition cannot be parsed.
        ValueError: the definition is recursive or very large.
    """
    if not schema.encoding:
        return ensure_type(type_name)
    defined = _parse(type_name, schema)
    check_finite(defined)
    store = get_typestore(Stores.EMPTY)
    store.register(defined)
    return store


def decode(store: Typestore, raw: bytes | memoryview, type_name: str) -> Any:
    """CDR bytes → message, by the definitions in ``store``.

    A few bytes after the message are accepted, unlike in rosbags' ``deserialize_cdr``. rclpy's
    ``serialize_message`` appends four unset bytes for each empty list of float64, so bags written by Python
    scripts have such messages. Messages received from the network do not.

    Raises:
        ValueError: the bytes are not CDR, or far too many. Too few raise the errors of rosbags.
    """
    if len(raw) < CDR_HEADER or raw[0] != 0 or raw[1] > 1:
        raise ValueError("no CDR header")
    definition = store.get_msgdef(type_name)
    read = definition.deserialize_cdr_le if raw[1] else definition.deserialize_cdr_be
    message, end = read(raw[CDR_HEADER:], 0, definition.cls, store)
    if len(raw) - CDR_HEADER - end > CDR_SLACK:
        raise ValueError("more bytes than the message has")
    return message


def _parse(type_name: str, schema: Schema) -> Typesdict:
    """A bag's schema → field definitions of the type and its inner types."""
    text = schema.data.decode()
    if schema.encoding == ROS2MSG:
        return get_types_from_msg(text, type_name)
    parts = text.split(_IDL_SEPARATOR)
    texts = [part.split("\n", 1)[-1] for part in parts[1:]] or parts
    types: Typesdict = {}
    for text in texts:
        types |= get_types_from_idl(text)
    return types


def check_finite(types: Typesdict) -> None:
    """Refuse recursive types and types with excessive fixed-size arrays.

    An array of a thousand million empty messages takes no byte in a bag, but all memory when read.

    Raises:
        ValueError: a type is recursive or too large.
    """
    counts: dict[str, int] = {}
    for name in types:
        if _count_values(name, types, counts) > _MAX_VALUES:
            raise ValueError(f"type {name}: too large; accepted: up to {_MAX_VALUES} values of fixed number")


def _count_values(name: str, types: Typesdict, counts: dict[str, int], inside: tuple[str, ...] = ()) -> int:
    """Minimum number of values in a message of a type; ``counts`` caches the numbers of other types."""
    if name in inside:
        raise ValueError(f"type {name}: it contains itself; accepted: a type of others")
    if name not in counts:
        values = 1
        for field in _fields(types, name) if name in types else ():
            size = 1 if field.length is None else max(field.length, 0)  # a sequence may be empty
            values += size * _count_values(field.type, types, counts, (*inside, name))
        counts[name] = values
    return counts[name]


def _collect_types(type_name: str, store: Typestore, types: Typesdict) -> None:
    """Add to ``types`` the type and its inner types that are not in ``store``."""
    path = msg_file(type_name)
    if path is None:
        raise InputError(
            f"unknown message type '{type_name}'; accepted: package/msg/Name "
            "with share/package/msg/Name.msg on AMENT_PREFIX_PATH"
        )
    try:
        types |= get_types_from_msg(path.read_text(encoding="utf-8"), type_name)
    except (OSError, UnicodeDecodeError, TypesysError) as error:
        raise InputError(f"{path}: not a message definition ({' '.join(str(error).split())})") from error
    for field in _fields(types, type_name):
        if is_message(field.type) and field.type not in store.fielddefs and field.type not in types:
            _collect_types(field.type, store, types)


def fields_by(store: Typestore) -> FieldsOf:
    """A function that yields the fields of the types of a store."""
    return partial(_fields, store.fielddefs)


def is_message(type_name: str) -> bool:
    """Whether the type of a field is a message, not a number or a text."""
    return "/" in type_name


def _fields(types: Typesdict, type_name: str) -> Iterator[Field]:
    """The fields of a type in the order of its definition."""
    definitions: Any = types[type_name][1]  # the type checker cannot resolve rosbags' union of tuples
    for name, (kind, detail) in definitions:
        length = None
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (item_kind, item), size = detail
            length = int(size) if kind == Nodetype.ARRAY else ANY_LENGTH
            kind, detail = item_kind, item
        yield Field(name, detail if kind == Nodetype.NAME else detail[0], length)
