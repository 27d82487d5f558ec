# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A node's parameters: from ``config/`` and the user's overrides to a frozen record, and on to ROS."""

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from trackslip_common.config_files import ROS_PARAMETERS, config_directory, node_defaults, read_yaml
from trackslip_common.errors import InputError
from trackslip_common.parameter_spec import Spec
from trackslip_common.parameters import (
    Parameters,
    flat_fields,
    flatten,
    from_flat,
    known_names,
    parameter,
    to_flat,
)

P = TypeVar("P", bound=Parameters)

_SIMILARITY = 0.8  # of the names of a section and of the node that it is meant for


@dataclass(frozen=True, kw_only=True)
class CommonParameters(Parameters):
    """Parameters of every node."""

    autostart: bool = parameter("whether the node configures and activates itself")
    realtime_priority: int = parameter("SCHED_FIFO priority, if allowed; 0: normal scheduling", ge=0, le=99)


def read_overrides(
    node: Node, what: str, common: CommonParameters, kind: type[P], default_files: tuple[str, ...]
) -> tuple[CommonParameters, P]:
    """The records of ``common`` and of ``kind``: defaults of ``config/`` with the user's overrides.

    The overrides are undeclared. ``what`` is the kind of node, which names its section, whatever the node is
    called. Parameters of other nodes in a section for many nodes are ignored.

    Raises:
        InputError: a parameter is unknown, of a wrong type or out of range.
    """
    overrides = {
        key: entry.value
        for key, entry in node.get_parameters_by_prefix("").items()
        if not key.startswith(ROS_PARAMETERS)
    }
    for key in overrides:
        node.undeclare_parameter(key)
    for note in unapplied_sections(sys.argv, node.get_fully_qualified_name()):
        node.get_logger().warning(note)
    shared = to_flat(common)
    shared |= {key: overrides.pop(key) for key in shared.keys() & overrides.keys()}
    name, defaults = node.get_name(), node_defaults(what, *default_files)
    shared_names = names_in_shared_sections(sys.argv)
    if shared_names & overrides.keys():
        known = {*known_names(kind, kind.overlay(defaults, overrides), name), *kind.EXTRA_NAMES}
        for key in sorted(shared_names & overrides.keys() - known):
            node.get_logger().info(
                f"parameter '{key}' is set for many nodes, and ignored: this node has none of that name"
            )
            del overrides[key]
    return from_flat(CommonParameters, shared, name), from_flat(kind, kind.overlay(defaults, overrides), name)


def names_in_shared_sections(arguments: Sequence[str]) -> frozenset[str]:
    """Dotted names in sections such as ``/**`` of the parameter files of a command line."""
    names: set[str] = set()
    for _, tree in _parameter_files(arguments):
        sections = [body for name, body in tree.items() if "*" in str(name)]
        names.update(*(flatten(body.get("ros__parameters", {})) for body in sections))
    return frozenset(names)


def unapplied_sections(arguments: Sequence[str], node: str) -> list[str]:
    """A line for each parameter file that seems to have a section for this node, which ROS does not apply.

    ROS ignores such a section without a word: it is of another namespace, or its name is misspelled.
    ``node``: fully qualified name.
    """
    from difflib import get_close_matches  # seldom needed elsewhere

    known = {path.stem for path in config_directory().glob("*.yaml")}
    own, notes = node.rpartition("/")[2], []
    for file, tree in _parameter_files(arguments):
        names = {path.rpartition("/")[2]: path for path in _section_paths(tree)}
        if any(_applies(path, node) for name, path in names.items() if "*" not in name):
            continue
        others = [name for name in names if name == own or name not in known]
        if similar := get_close_matches(own, others, n=1, cutoff=_SIMILARITY):
            fault = f"section {names[similar[0]]} is ignored: this node is {node}"
            notes.append(f"{file}: {fault}; name it so, if it is meant")
    return notes


def _parameter_files(arguments: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The parameter files of a command line, with their contents."""
    for flag, file in pairwise(arguments):
        if flag == "--params-file":
            with suppress(InputError):  # rcl has read or rejected the file
                yield file, read_yaml(Path(file))


def _section_paths(tree: Mapping[str, Any], above: str = "") -> Iterator[str]:
    """Full names of the sections of a parameter file, whose namespaces may be nested."""
    for name, body in tree.items():
        path = f"{above}/{str(name).strip('/')}"
        if isinstance(body, Mapping):
            yield from [path] if "ros__parameters" in body else _section_paths(body, path)


def _applies(path: str, node: str) -> bool:
    """Whether ROS applies the section of this full name to a node; ** stands for any namespaces."""
    pattern = re.escape(path).replace(r"/\*\*", "(/[^/]+)*").replace(r"\*", "[^/]+")
    return re.fullmatch(pattern, node) is not None


def declare_parameters(node: Node, record: Parameters) -> None:
    """Declare each parameter to ROS with its value, unit and range."""
    values = to_flat(record)
    for key, kind, spec in flat_fields(record):
        node.declare_parameter(key, values[key], _descriptor(kind, spec), ignore_override=True)


def changed_record(record: P, values: Mapping[str, Any], where: str) -> P:
    """The record with changed values, by dotted name.

    Raises:
        InputError: a value is rejected.
    """
    return from_flat(type(record), record.overlay(to_flat(record), values), where)


def differences(before: Parameters, after: Parameters) -> dict[str, Any]:
    """Dotted name → value in ``after`` for each parameter that differs between two records of a class."""
    old = to_flat(before)
    return {name: value for name, value in to_flat(after).items() if value != old[name]}


def _descriptor(kind: Any, spec: Spec) -> ParameterDescriptor:
    """The descriptor that ``ros2 param describe`` shows."""
    unit = f" [{spec.unit}]" if spec.unit else ""
    descriptor = ParameterDescriptor(description=spec.description + unit, read_only=spec.read_only)
    descriptor.additional_constraints = spec.accepted_range()
    low = spec.ge if spec.ge is not None else spec.gt
    high = spec.le if spec.le is not None else spec.lt
    if kind is float and (low is not None or high is not None):
        low, high = (-1e300 if low is None else low), (1e300 if high is None else high)
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    if kind is int and (low is not None or high is not None):
        first, last = (-(2**62) if low is None else int(low)), (2**62 if high is None else int(high))
        descriptor.integer_range = [IntegerRange(from_value=first, to_value=last)]
    return descriptor
