# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Message classes by name, so that conversions need not import them."""

import importlib
import re
from functools import cache
from typing import Any

from rclpy.serialization import deserialize_message

from trackslip_common.layout import ANY_LENGTH, Field
from trackslip_common.packed import PackedTopic
from trackslip_common.topics import TOPICS

_FIELD = re.compile(r"(?:sequence<)?([\w/]+)(?:<\d+>)?(?:, \d+)?(>|\[(\d+)\])?")
_NUMBERS = {"boolean": "bool", "double": "float64", "float": "float32", "octet": "uint8"}


@cache
def message_class(type_name: str) -> type:
    """The class of ``package/msg/Name``."""
    package, kind, name = type_name.split("/")
    cls: type = getattr(importlib.import_module(f"{package}.{kind}"), name)
    return cls


def make(type_name: str, **fields: Any) -> Any:
    """An rclpy message of that type with these fields."""
    return message_class(type_name)(**fields)


def topic_class(name: str) -> type:
    """The message class of one of the project's topics."""
    return message_class(TOPICS[name].type_name)


def type_name_of(kind: type) -> str:
    """``package/msg/Name`` of a message class."""
    package, _, _ = kind.__module__.partition(".")
    return f"{package}/msg/{kind.__name__}"


@cache
def fields_of(type_name: str) -> tuple[Field, ...]:
    """Fields of a message type."""
    texts: dict[str, str] = message_class(type_name)._fields_and_field_types  # type: ignore[attr-defined]
    return tuple(_parse_field(name, text) for name, text in texts.items())


def packed_topic(kind: type) -> PackedTopic:
    """Layouts of messages of a class that are subscribed to ``raw``."""
    return PackedTopic(type_name_of(kind), fields_of, lambda raw: deserialize_message(raw, kind))


def _parse_field(name: str, text: str) -> Field:
    """A field from rclpy's text: ``double``, ``double[9]``, ``sequence<string>``, ``std_msgs/Header`` etc."""
    match = _FIELD.fullmatch(text)
    assert match is not None, text
    kind, suffix, count = match.groups()
    kind = kind.replace("/", "/msg/") if "/" in kind else _NUMBERS.get(kind, kind)
    return Field(name, kind, int(count) if count else ANY_LENGTH if suffix else None)
