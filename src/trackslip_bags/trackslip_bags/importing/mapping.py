# SPDX-License-Identifier: Apache-2.0
"""The mapping file of ``trackslip import``: which column of a CSV log is what, in which unit.

    time: {column: t, unit: s}
    start: 0.0                       # s since the epoch, added to every time; optional
    topics:
      sprockets:
        left_velocity: {column: wl, unit: deg/s, scale: -1.0}
        right_velocity: {column: wr, unit: deg/s}
        new_when_changes: seq        # other rows repeat the last message; optional
        time_offset: -0.02           # s, added to the stamps; optional
        frame: base_link             # optional
      reference_pose: {x: ..., y: ..., yaw: ..., stddev: {x: 0.02, y: 0.02, yaw: 0.01}}
    vehicle: warthog                 # a name of config/vehicles, or a file; optional
    parameters: {...}                # of slip_estimator, kept in the bag; optional

``scale`` multiplies before the unit is converted; it carries signs, gear ratios and the like.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trackslip_common.config_files import read_yaml
from trackslip_common.errors import InputError
from trackslip_common.vehicle import GRAVITY, VehicleParameters, load_vehicle

# Quantity → unit → factor to SI
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_ANGLE = {"rad": 1.0, "deg": math.pi / 180.0, "rev": 2.0 * math.pi}
_ANGULAR_RATE = {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0}
_ACCELERATION = {"m/s^2": 1.0, "g": GRAVITY}
_PRESSURE = {"Pa": 1.0, "kPa": 1e3, "bar": 1e5, "MPa": 1e6}
_RATIO = {"1": 1.0, "%": 1e-2}

_COMMON_KEYS = ("time_offset", "frame", "new_when_changes")


@dataclass(frozen=True)
class TopicKind:
    """A topic that a log can fill: field → its units, and the frame where the mapping names none."""

    required: Mapping[str, Mapping[str, float]]
    optional: Mapping[str, Mapping[str, float]]
    frame: str
    stddev: tuple[str, ...] = ()
    optional_together: bool = True  # the optional fields are there all or none


KINDS: Mapping[str, TopicKind] = {
    "sprockets": TopicKind(
        required={"left_velocity": _ANGULAR_RATE, "right_velocity": _ANGULAR_RATE},
        optional={"left_position": _ANGLE, "right_position": _ANGLE},
        frame="base_link",
    ),
    "imu/data_raw": TopicKind(
        required={f"angular_velocity_{axis}": _ANGULAR_RATE for axis in "xyz"},
        optional={f"linear_acceleration_{axis}": _ACCELERATION for axis in "xyz"},
        frame="imu_link",
    ),
    "reference_pose": TopicKind(
        required={"x": _LENGTH, "y": _LENGTH, "yaw": _ANGLE},
        optional={},
        frame="odom",
        stddev=("x", "y", "yaw"),
    ),
    "hydraulics": TopicKind(
        required={"left_pressure": _PRESSURE, "right_pressure": _PRESSURE},
        optional={"left_spool": _RATIO, "right_spool": _RATIO, "supply_pressure": _PRESSURE},
        frame="",
        optional_together=False,
    ),
}


@dataclass(frozen=True)
class Column:
    """A column of the log, and the factor that makes its numbers SI."""

    name: str
    factor: float


@dataclass(frozen=True)
class TopicMapping:
    """How one topic's messages are made; ``stddev`` in m and rad, of the reference alone."""

    columns: Mapping[str, Column]
    frame: str
    time_offset_ns: int
    new_when_changes: str | None
    stddev: Mapping[str, float]


@dataclass(frozen=True)
class LogMapping:
    """A whole mapping file."""

    path: Path
    time: Column
    start_ns: int
    topics: Mapping[str, TopicMapping]
    vehicle: VehicleParameters | None
    parameters: Mapping[str, Any]

    def column_names(self) -> list[str]:
        """Every column the mapping uses, once, in the order of the file."""
        names = [self.time.name]
        for topic in self.topics.values():
            names += [column.name for column in topic.columns.values()]
            names += [topic.new_when_changes] if topic.new_when_changes else []
        return list(dict.fromkeys(names))


def read_mapping(path: Path) -> LogMapping:
    """Read a mapping file.

    Raises:
        InputError: it cannot be read, or a key, unit or value in it is not accepted.
    """
    tree = read_yaml(path)
    where = str(path)
    _check_keys(where, tree, required=("time", "topics"), optional=("start", "vehicle", "parameters"))
    topics = _section(f"{where}: topics", tree["topics"])
    if not topics:
        raise InputError(f"{where}: topics is empty; accepted: {', '.join(KINDS)}")
    _check_keys(f"{where}: topics", topics, optional=tuple(KINDS))
    parameters = _section(f"{where}: parameters", tree.get("parameters", {}))
    if "vehicle" in parameters:
        raise InputError(f"{where}: parameters.vehicle: accepted: vehicle: NAME or FILE, beside parameters")
    vehicle = tree.get("vehicle")
    return LogMapping(
        path=path,
        time=_column(f"{where}: time", tree["time"], _TIME),
        start_ns=_nanoseconds(f"{where}: start", tree.get("start", 0.0)),
        topics={name: _topic(f"{where}: {name}", topic, KINDS[name]) for name, topic in topics.items()},
        vehicle=None if vehicle is None else _vehicle(where, vehicle),
        parameters=parameters,
    )


def _vehicle(where: str, value: Any) -> VehicleParameters:
    try:
        return load_vehicle(_text("vehicle", value))
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _topic(where: str, value: Any, kind: TopicKind) -> TopicMapping:
    tree = _section(where, value)
    extra = ("stddev",) if kind.stddev else ()
    _check_keys(where, tree, required=(*kind.required, *extra), optional=(*kind.optional, *_COMMON_KEYS))
    if kind.optional_together and any(name in tree for name in kind.optional):
        _check_keys(where, tree, required=(*kind.required, *extra, *kind.optional), optional=_COMMON_KEYS)
    fields = {**kind.required, **kind.optional}
    marker = tree.get("new_when_changes")
    return TopicMapping(
        columns={
            name: _column(f"{where}.{name}", tree[name], fields[name]) for name in fields if name in tree
        },
        frame=_text(f"{where}.frame", tree.get("frame", kind.frame)),
        time_offset_ns=_nanoseconds(f"{where}.time_offset", tree.get("time_offset", 0.0)),
        new_when_changes=None if marker is None else _text(f"{where}.new_when_changes", marker),
        stddev=_stddev(f"{where}.stddev", tree["stddev"], kind) if kind.stddev else {},
    )


def _stddev(where: str, value: Any, kind: TopicKind) -> dict[str, float]:
    tree = _section(where, value)
    _check_keys(where, tree, required=kind.stddev)
    result = {name: _number(f"{where}.{name}", tree[name]) for name in kind.stddev}
    for name, number in result.items():
        if number <= 0.0:
            raise InputError(f"{where}.{name}: {number:g} is out of range; accepted: > 0")
    return result


def _column(where: str, value: Any, units: Mapping[str, float]) -> Column:
    tree = _section(where, value)
    _check_keys(where, tree, required=("column", "unit"), optional=("scale",))
    unit = str(tree["unit"])
    if unit not in units:
        raise InputError(f"{where}.unit: '{unit}' is unknown; accepted: {', '.join(units)}")
    scale = _number(f"{where}.scale", tree.get("scale", 1.0))
    return Column(_text(f"{where}.column", tree["column"]), scale * units[unit])


def _check_keys(
    where: str, tree: Mapping[str, Any], required: tuple[str, ...] = (), optional: tuple[str, ...] = ()
) -> None:
    accepted = ", ".join((*required, *optional))
    for key in tree:
        if key not in (*required, *optional):
            raise InputError(f"{where}: unknown key '{key}'; accepted: {accepted}")
    for key in required:
        if key not in tree:
            raise InputError(f"{where}: key '{key}' is missing; accepted: {accepted}")


def _section(where: str, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: {value!r} is not accepted; accepted: names and values (a YAML mapping)")
    return value


def _text(where: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"{where}: {value!r} is not accepted; accepted: text")
    return value


def _number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InputError(f"{where}: {value!r} is not accepted; accepted: a finite number")
    return float(value)


def _nanoseconds(where: str, value: Any) -> int:
    return round(_number(where, value) * 1e9)
