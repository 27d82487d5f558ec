# SPDX-License-Identifier: Apache-2.0
"""Parameters as frozen dataclasses: each field states once its meaning, unit and range.

From that one statement come the check at construction, the reader of YAML files, and the
parameter descriptors of the nodes. A bad value is refused with one line, never repaired.

    @dataclass(frozen=True, kw_only=True)
    class Vehicle(Parameters):
        tread: float = parameter("distance between the track centre lines", unit="m", gt=0.0)
"""

import dataclasses
import math
import sys
import typing
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeVar

from trackslip_common.errors import InputError

T = TypeVar("T", bound="Parameters")

_METADATA_KEY = "trackslip"
_SCALARS: Mapping[type, str] = MappingProxyType(
    {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
)


@dataclass(frozen=True)
class Spec:
    """What is known of one parameter, beside its type. Bounds are None where there is none."""

    description: str
    unit: str = ""
    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = True

    def accepts(self, value: object) -> bool:
        """Whether one scalar lies in the range (its type is checked elsewhere)."""
        if isinstance(value, str):
            return not self.choices or value in self.choices
        if not isinstance(value, (int, float)) or (isinstance(value, float) and not math.isfinite(value)):
            return False
        return (
            (self.gt is None or value > self.gt)
            and (self.ge is None or value >= self.ge)
            and (self.lt is None or value < self.lt)
            and (self.le is None or value <= self.le)
        )

    def accepted(self) -> str:
        """The range as text, for messages."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        bounds = [
            f"{sign} {bound:g}"
            for sign, bound in ((">", self.gt), (">=", self.ge), ("<", self.lt), ("<=", self.le))
            if bound is not None
        ]
        text = " and ".join(bounds) if bounds else "finite"
        return f"{text} {self.unit}".rstrip()


def parameter(
    description: str,
    *,
    unit: str = "",
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
    choices: tuple[str, ...] = (),
    read_only: bool = True,
) -> Any:
    """A dataclass field with its ``Spec``; it has no default: defaults live in ``config/``."""
    spec = Spec(description, unit, gt, ge, lt, le, choices, read_only)
    return dataclasses.field(metadata={_METADATA_KEY: spec})


class Parameters:
    """Base of the frozen parameter dataclasses: refuses bad values when constructed."""

    def __post_init__(self) -> None:
        """Check each field against its ``Spec``.

        Raises:
            InputError: a value has the wrong type or lies outside its range.
        """
        for name, kind, spec in own_fields(type(self)):
            if spec is not None:
                _check(f"{type(self).__name__}.{name}", getattr(self, name), kind, spec)


def own_fields(cls: type) -> Iterator[tuple[str, Any, Spec | None]]:
    """(name, type, spec) of each field; spec is None for a nested group of parameters."""
    hints = typing.get_type_hints(cls)
    for field in dataclasses.fields(cls):
        yield field.name, hints[field.name], field.metadata.get(_METADATA_KEY)


def flat_fields(cls: type, prefix: str = "") -> Iterator[tuple[str, Any, Spec]]:
    """(dotted name, type, spec) of every parameter below ``cls``, as a node declares them."""
    for name, kind, spec in own_fields(cls):
        if spec is None:
            yield from flat_fields(kind, f"{prefix}{name}.")
        else:
            yield prefix + name, kind, spec


def to_flat(record: Parameters, prefix: str = "") -> dict[str, Any]:
    """Dotted name → value; tuples become lists, as YAML and ROS parameters hold them."""
    flat: dict[str, Any] = {}
    for name, _, spec in own_fields(type(record)):
        value = getattr(record, name)
        if spec is None:
            flat |= to_flat(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = list(value) if isinstance(value, tuple) else value
    return flat


def from_flat(cls: type[T], values: Mapping[str, Any], where: str, prefix: str = "") -> T:
    """Build ``cls`` from dotted names; ``where`` opens each message (a file's or a node's name).

    Raises:
        InputError: a name is unknown or missing, or a value is refused.
    """
    known = {name: (kind, spec) for name, kind, spec in flat_fields(cls, prefix)}
    for name in values:
        if name not in known:
            raise InputError(f"{where}: unknown parameter '{name}'; accepted: {', '.join(known)}")
    arguments: dict[str, Any] = {}
    for name, kind, spec in own_fields(cls):
        full = prefix + name
        if spec is None:
            inside = {k: v for k, v in values.items() if k.startswith(f"{full}.")}
            arguments[name] = from_flat(kind, inside, where, f"{full}.")
        elif full not in values:
            raise InputError(f"{where}: parameter '{full}' is missing ({spec.description})")
        else:
            arguments[name] = _coerce(f"{where}: {full}", values[full], kind, spec)
    return cls(**arguments)


def flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings → dotted names."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def _coerce(name: str, value: Any, kind: Any, spec: Spec) -> Any:
    """Give a value read from YAML, ROS or a command line its declared type, then check it."""
    if typing.get_origin(kind) is tuple and isinstance(value, (list, tuple, array)):  # ROS: array
        item_kind = typing.get_args(kind)[0]
        value = tuple(_floated(item) if item_kind is float else item for item in value)
    elif kind is float:
        value = _floated(value)
    _check(name, value, kind, spec)
    return value


def _floated(value: Any) -> Any:
    """A whole number as a float, unless it is beyond all floats."""
    return float(value) if type(value) is int and abs(value) <= sys.float_info.max else value


def _check(name: str, value: Any, kind: Any, spec: Spec) -> None:
    """Raise ``InputError`` unless ``value`` is of ``kind`` and in range."""
    if typing.get_origin(kind) is tuple:
        item_kind = typing.get_args(kind)[0]
        if not isinstance(value, tuple):
            raise InputError(f"{name}: {value!r} is not a list of {_SCALARS[item_kind]}")
        for index, item in enumerate(value):
            _check(f"{name}[{index}]", item, item_kind, spec)
        return
    if type(value) is not kind:
        accepted = f"; accepted: {spec.accepted()}" if kind in (int, float) or spec.choices else ""
        raise InputError(f"{name}: {value!r} is not {_SCALARS[kind]}{accepted}")
    if kind is not bool and not spec.accepts(value):
        raise InputError(f"{name}: {value!r} is out of range; accepted: {spec.accepted()}")
