# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Specification of one parameter, and the check of its values."""

import math
import sys
import typing
from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from trackslip_common.errors import InputError

# In any unit; its inverse is the least value of what must be above 0, so squares and inverses stay finite.
_MAX_MAGNITUDE = 1e30
_SCALARS: Mapping[type, str] = MappingProxyType(
    {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
)

# Words that YAML 1.1 reads as true or false if unquoted, such as the parity N.
_YAML_WORDS: Mapping[bool, tuple[str, ...]] = MappingProxyType(
    {True: ("y", "yes", "on", "true"), False: ("n", "no", "off", "false")}
)


@dataclass(frozen=True)
class Spec:
    """Specification of one parameter, beside its type. A bound is None if there is none."""

    description: str
    unit: str = ""
    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None
    choices: tuple[str | int, ...] = ()
    read_only: bool = True
    basic: bool = False  # describes a machine or what is connected to it; all others are for experts

    def accepts(self, value: object) -> bool:
        """Whether one scalar is in range (its type is checked elsewhere)."""
        if self.choices or isinstance(value, str):
            return not self.choices or value in self.choices
        if not isinstance(value, (int, float)) or (isinstance(value, float) and not math.isfinite(value)):
            return False
        return (
            (self.gt is None or value > self.gt)
            and (self.ge is None or value >= self.ge)
            and (self.lt is None or value < self.lt)
            and (self.le is None or value <= self.le)
        )

    def accepted_range(self) -> str:
        """The range as text, for messages."""
        if self.choices:
            return "one of " + ", ".join(map(str, self.choices))
        bounds = [
            f"{sign} {bound:g}"
            for sign, bound in ((">", self.gt), (">=", self.ge), ("<", self.lt), ("<=", self.le))
            if bound is not None
        ]
        text = " and ".join(bounds) if bounds else "finite"
        return f"{text} {self.unit}".rstrip()


def convert_value(name: str, value: Any, kind: Any, spec: Spec) -> Any:
    """A value from YAML, ROS or a command line, converted to its declared type and checked."""
    if typing.get_origin(kind) is tuple and isinstance(value, (list, tuple, array)):  # ROS: array
        item_kind = typing.get_args(kind)[0]
        value = tuple(_to_float(item) if item_kind is float else item for item in value)
    elif kind is float:
        value = _to_float(value)
    elif kind is str and type(value) is bool:
        value = next((c for c in spec.choices if str(c).lower() in _YAML_WORDS[value]), value)
    check_value(name, value, kind, spec)
    return value


def _to_float(value: Any) -> Any:
    """An integer as a float, unless it exceeds all floats; any other value unchanged."""
    return float(value) if type(value) is int and abs(value) <= sys.float_info.max else value


def check_value(name: str, value: Any, kind: Any, spec: Spec) -> None:
    """Raise ``InputError`` unless ``value`` is of ``kind`` and in range."""
    if typing.get_origin(kind) is tuple:
        item_kind = typing.get_args(kind)[0]
        if not isinstance(value, tuple):
            raise InputError(f"{name}: {value!r} is not a list of {_SCALARS[item_kind]}")
        for index, item in enumerate(value):
            check_value(f"{name}[{index}]", item, item_kind, spec)
        return
    if type(value) is not kind:
        accepted = f"; accepted: {spec.accepted_range()}" if kind in (int, float) or spec.choices else ""
        raise InputError(f"{name}: {value!r} is not {_SCALARS[kind]}{accepted}")
    if kind is not bool and not spec.accepts(value):
        raise InputError(f"{name}: {value!r} is out of range; accepted: {spec.accepted_range()}")
    least = 1.0 / _MAX_MAGNITUDE if spec.gt == 0.0 else -_MAX_MAGNITUDE
    if kind is float and not least <= value <= _MAX_MAGNITUDE:
        raise InputError(
            f"{name}: {value!r} is beyond any physical value; accepted: {least:g} to {_MAX_MAGNITUDE:g}"
        )
