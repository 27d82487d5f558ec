# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters as frozen dataclasses: each field states its meaning, unit and range once.

The check at construction, the reader of YAML files and the parameter descriptors of the nodes use this one
statement. A bad value is rejected with one line, never repaired.

    @dataclass(frozen=True, kw_only=True)
    class Vehicle(Parameters):
        tread: float = parameter("distance between the track centre lines", unit="m", gt=0.0)

A field of type ``Parameters`` is a group. An optional group is given completely, or not at all. A field of
type ``Mapping`` has a group for each name that other parameters give; see ``groups_of``.
"""

import dataclasses
import functools
import typing
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any, ClassVar, NamedTuple, TypeVar

from trackslip_common.errors import InputError, joined_names
from trackslip_common.parameter_spec import Spec, check_value, convert_value

T = TypeVar("T", bound="Parameters")

_METADATA_KEY = "trackslip"


def parameter(
    description: str,
    *,
    unit: str = "",
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
    choices: tuple[str | int, ...] = (),
    read_only: bool = True,
    basic: bool = False,
) -> Any:
    """A dataclass field with its ``Spec``; it has no default, as all defaults are in ``config/``."""
    spec = Spec(description, unit, gt, ge, lt, le, choices, read_only, basic)
    return dataclasses.field(metadata={_METADATA_KEY: spec})


class Group(NamedTuple):
    """Class and defaults of one of several groups of a kind."""

    kind: "type[Parameters]"
    defaults: Mapping[str, Any]  # by name within the group


class Parameters:
    """Base of the frozen parameter dataclasses; rejects bad values at construction."""

    EXTRA_NAMES: ClassVar[frozenset[str]] = frozenset()  # names that ``overlay`` accepts beside the fields

    @classmethod
    def groups_of(cls, values: Mapping[str, Any], where: str) -> Mapping[str, Mapping[str, Group]]:
        """Field of type ``Mapping`` → name → group, as the values (dotted names) require; none by default.

        Raises:
            InputError: the values that name the groups are rejected.
        """
        return {}

    @classmethod
    def overlay(cls, below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
        """Values by dotted name: ``below``, overridden by ``above``."""
        return {**below, **above}

    def __post_init__(self) -> None:
        """Check each field against its ``Spec``.

        Raises:
            InputError: a value has the wrong type or lies outside its range.
        """
        for name, kind, spec in own_fields(type(self)):
            if spec is not None:
                check_value(f"{type(self).__name__}.{name}", getattr(self, name), kind, spec)


def own_fields(cls: type) -> tuple[tuple[str, Any, Spec | None], ...]:
    """(name, type, spec) of each field; spec is None for a nested group of parameters, or several."""
    return _fields_of(cls)


@functools.cache
def _fields_of(cls: Any) -> tuple[tuple[str, Any, Spec | None], ...]:
    hints = typing.get_type_hints(cls)
    fields = dataclasses.fields(cls)
    return tuple((field.name, hints[field.name], field.metadata.get(_METADATA_KEY)) for field in fields)


def flat_fields(source: type[Parameters] | Parameters, prefix: str = "") -> Iterator[tuple[str, Any, Spec]]:
    """(dotted name, type, spec) of every parameter of a record, as a node declares them.

    For a class, groups that depend on values are left out.
    """
    record, cls = (None, source) if isinstance(source, type) else (source, type(source))
    for name, kind, spec in own_fields(cls):
        value = getattr(record, name, None)
        if spec is not None:
            yield prefix + name, kind, spec
        elif not _has_groups(kind):
            group = value if record is not None else _group_class(kind)
            yield from flat_fields(group, f"{prefix}{name}.") if group is not None else ()
        else:
            for key, group in (value or {}).items():
                yield from flat_fields(group, f"{prefix}{name}.{key}.")


def to_flat(record: Parameters, prefix: str = "") -> dict[str, Any]:
    """Dotted name → value; tuples become lists, as in YAML and ROS parameters."""
    flat: dict[str, Any] = {}
    for name, kind, spec in own_fields(type(record)):
        value = getattr(record, name)
        if spec is not None:
            flat[prefix + name] = list(value) if isinstance(value, tuple) else value
        elif not _has_groups(kind):
            flat |= to_flat(value, f"{prefix}{name}.") if value is not None else {}
        else:
            for key, group in value.items():
                flat |= to_flat(group, f"{prefix}{name}.{key}.")
    return flat


def reloadable_names(source: type[Parameters] | Parameters) -> frozenset[str]:
    """Dotted names of the parameters that may change at run time."""
    return frozenset(name for name, _, spec in flat_fields(source) if not spec.read_only)


def known_names(cls: type[Parameters], values: Mapping[str, Any], where: str) -> list[str]:
    """Every dotted name of ``cls`` with these values.

    Raises:
        InputError: the values that name groups are rejected.
    """
    names = [name for name, _, _ in flat_fields(cls)]
    for field, groups in cls.groups_of(values, where).items():
        names += [
            f"{field}.{key}.{n}" for key, group in groups.items() for n, _, _ in flat_fields(group.kind)
        ]
    return names


def from_flat(cls: type[T], values: Mapping[str, Any], where: str, prefix: str = "") -> T:
    """Build ``cls`` from dotted names; ``where`` (name of a file or node) begins each message.

    Raises:
        InputError: a name is unknown or missing, or a value is rejected.
    """
    known = dict.fromkeys(prefix + name for name in known_names(cls, values, where))
    for unknown in (str(name) for name in values if name not in known):
        raise InputError(f"{where}: unknown parameter '{unknown}'{_hint(unknown, list(known))}")
    groups = cls.groups_of(values, where)
    arguments: dict[str, Any] = {}
    for name, kind, spec in own_fields(cls):
        full = prefix + name
        if spec is not None:
            if full not in values:
                raise InputError(f"{where}: parameter '{full}' is missing ({spec.description})")
            arguments[name] = convert_value(f"{where}: {full}", values[full], kind, spec)
        elif not _has_groups(kind):
            inside, group = _values_in_group(values, f"{full}."), _group_class(kind)
            left_out = not inside and group is not kind
            arguments[name] = None if left_out else from_flat(group, inside, where, f"{full}.")
        else:
            arguments[name] = {
                key: _make_group(group, values, where, f"{full}.{key}.")
                for key, group in groups[name].items()
            }
    return cls(**arguments)


def checked_value(cls: type[Parameters], name: str, value: Any, where: str) -> Any:
    """The value of one field of ``cls``, converted and checked.

    Raises:
        InputError: the value is rejected.
    """
    kind, spec = next((kind, spec) for field, kind, spec in own_fields(cls) if field == name)
    return convert_value(f"{where}: {name}", value, kind, spec or Spec(""))


def _make_group(group: Group, values: Mapping[str, Any], where: str, prefix: str) -> Parameters:
    """One of several groups: its defaults, overridden by the given values."""
    defaults = {prefix + name: value for name, value in group.defaults.items()}
    return from_flat(group.kind, defaults | _values_in_group(values, prefix), where, prefix)


def _values_in_group(values: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    return {name: value for name, value in values.items() if name.startswith(prefix)}


def _has_groups(kind: Any) -> bool:
    """Whether a field has groups by name, not one group."""
    return typing.get_origin(kind) is Mapping


def _group_class(kind: Any) -> Any:
    """Class of a field that is a group, which may be optional."""
    return next((k for k in typing.get_args(kind) if k is not type(None)), kind)


def _hint(unknown: str, known: list[str]) -> str:
    """Hint for the first unknown part of a dotted name: a similar name, its group, or the accepted ones."""
    parts = unknown.split(".")
    for depth, part in enumerate(parts):
        before = "".join(f"{p}." for p in parts[:depth])
        accepted = dict.fromkeys(
            n.removeprefix(before).partition(".")[0] for n in known if n.startswith(before)
        )
        if part not in accepted:
            similar = get_close_matches(part, list(accepted), n=1, cutoff=0.8)
            elsewhere = [name for name in known if name.rpartition(".")[2] == parts[-1]]
            if similar or len(elsewhere) == 1:
                return f", did you mean '{before + similar[0] if similar else elsewhere[0]}'?"
            return f"; accepted: {joined_names(before + name for name in accepted) or 'a value, no group'}"
    return f"; accepted: {joined_names(name for name in known if name.startswith(f'{unknown}.'))}"


def flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings → dotted names."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat
