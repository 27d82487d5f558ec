# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Message classes by name, so that conversions need not import them."""

import importlib
from functools import cache
from typing import Any

from trackslip_common.topics import TOPICS


@cache
def message_class(type_name: str) -> type:
    """The class of ``package/msg/Name``."""
    package, kind, name = type_name.split("/")
    found: type = getattr(importlib.import_module(f"{package}.{kind}"), name)
    return found


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
