# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads fields of a message: from an object (rclpy's or a bag's), and as a column of a numpy record.

    FieldPath  a field by its dotted path; with ``items``, an array of these items of it, in this order
    JointItem  item of an array that belongs to a joint, by the message's names; nan if it is missing
    HasItems   whether an array has any items
    Text       a string; in tables, its number among the texts of the topic
    Stamp      time of the header

The record classes of ``message_fields`` annotate their fields with these.
"""

import math
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from operator import attrgetter
from typing import Any, NamedTuple, TypeVar, get_args, get_type_hints

import numpy as np

from trackslip_common.units import NS_PER_S

R = TypeVar("R")
RecordClass = Any  # a NamedTuple class of ``message_fields``; mypy takes no type[Any] as a key of a cache

_JOINT_NAMES = "name"  # of joints


class FieldPath(NamedTuple):
    """See the top of the module."""

    path: str
    items: tuple[int, ...] = ()
    shape: tuple[int, ...] = ()  # of the items


class JointItem(NamedTuple):
    """See the top of the module."""

    path: str
    name: str


class HasItems(NamedTuple):
    """See the top of the module."""

    path: str


class Text(NamedTuple):
    """See the top of the module."""

    path: str


class Stamp(NamedTuple):
    """Time of the header, ns."""

    path: str = "header.stamp"


Selector = FieldPath | JointItem | HasItems | Text | Stamp


@cache
def selectors_of(kind: RecordClass) -> dict[str, tuple[type, Selector]]:
    """Name → Python type and selector of each field of a record class."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: (get_args(hint)[0], hint.__metadata__[0]) for name, hint in hints.items()}


@cache
def dtype_of(kind: RecordClass) -> np.dtype[np.void]:
    """The numpy record of a record class: float64, int64, bool; the number of a text is int64."""
    fields = []
    for name, (python, selector) in selectors_of(kind).items():
        dtype = {int: np.int64, bool: np.bool_, str: np.int64}.get(python, np.float64)
        fields.append((name, dtype, selector.shape if isinstance(selector, FieldPath) else ()))
    return np.dtype(fields, align=True)


@cache
def _reader(kind: RecordClass) -> Callable[[Any], Any]:
    """The function that ``read`` uses for a record class."""
    steps = [
        (attrgetter(selector.path), _converter(python, selector))
        for python, selector in selectors_of(kind).values()
    ]

    def read_one(message: Any) -> Any:
        return kind(*[convert(get(message), message) for get, convert in steps])

    return read_one


def _converter(python: type, selector: Selector) -> Callable[[Any, Any], Any]:
    """(value at the path, message) → value of the field."""
    match selector:
        case Stamp():
            return lambda stamp, _: int(stamp.sec) * NS_PER_S + int(stamp.nanosec)
        case HasItems():
            return lambda values, _: len(values) > 0
        case JointItem(_, name):
            return lambda values, message: _joint_value(values, list(getattr(message, _JOINT_NAMES)), name)
        case FieldPath(_, items, shape) if shape:
            chosen = np.array(items)
            return lambda values, _: np.asarray(values, dtype=np.float64)[chosen].reshape(shape)
        case FieldPath(_, items, _) if items:
            return lambda values, _: python(values[items[0]])
        case _:
            return lambda value, _: python(value)


def _joint_value(values: Any, names: list[str], joint: str) -> float:
    index = names.index(joint) if joint in names else len(values)
    return float(values[index]) if index < len(values) else math.nan


class SerializedMessage(ABC):
    """A message that has not been deserialized."""

    __slots__ = ()

    @abstractmethod
    def record(self, kind: RecordClass) -> Any:
        """The record that ``read`` would make from the message object."""


def read(kind: Callable[..., R], message: Any) -> R:
    """The record of a message, which is an object or packed.

    Raises:
        AttributeError: the message is of another type.
    """
    record: R = message.record(kind) if isinstance(message, SerializedMessage) else _reader(kind)(message)
    return record


def frame_number(text: str) -> int:
    """Number of a frame_id, the same in every process."""
    return zlib.crc32(text.encode())
