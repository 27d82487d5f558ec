# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The sections of a mapping file, one for each topic: columns of a CSV log, or the topic of a bag."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from trackslip_bags.importing.columns import (
    Column,
    Spread,
    TimeColumn,
    read_column,
    read_spreads,
    read_time,
)
from trackslip_bags.importing.csv_text import Dialect, read_dialect
from trackslip_bags.importing.roles import ROLE_OF_TOPIC, ROLES, Role
from trackslip_common.errors import InputError, did_you_mean
from trackslip_common.yaml_tree import (
    check_keys,
    choice,
    flag,
    nanoseconds,
    number,
    positive_number,
    section,
    text,
    texts,
)

SIDES, JOINT = ("left", "right"), "joint"  # keys of the joints of sprockets, and of a swing
USES = ("both", "positions", "velocities")  # of the joints of sprockets
_COMMON_KEYS = ("role", "frame", "time_offset", "stddev", "covariance", "geometry")
_CSV_KEYS = ("file", "time", "received", "csv", "new_when_changes")
_BAG_KEYS = (*SIDES, JOINT, "use", "stamp", "child_frame", "position_only", "convention", "sign")
_SIDE_PAIRS = (  # pairs of fields that need two columns
    *(tuple(f"{side}_{what}" for side in SIDES) for what in ("velocity", "position")),
    ("x", "y"),
    ("latitude", "longitude"),
    ("east", "north"),
)
CONVENTIONS = ("enu", "compass")  # of headings: from east, counter-clockwise; from north, clockwise
NEEDS_GEOMETRY = (
    "a speed over ground needs a vehicle in the mapping, or geometry: {rolling_radius: …, tread: …}"
)
FROM = "from"  # the key by which a section names a topic of a bag


class Geometry(NamedTuple):
    """Geometry that converts speeds over ground to speeds of sprockets."""

    rolling_radius: float  # m
    tread: float  # m


@dataclass(frozen=True)
class Joints:
    """Joints of a sprocket or swing: its angle is their mean, times the ratio."""

    names: tuple[str, ...]
    ratio: float  # turns of the sprocket per turn of a joint; negative where it turns the other way


@dataclass(frozen=True)
class Topic:
    """Source of one topic of the new bag."""

    name: str
    where: str  # in the mapping file, for messages
    role: str
    frame: str | None  # None: that of the message, or of the role
    time_offset_ns: int
    spreads: Mapping[str, Spread]
    geometry: Geometry | None


@dataclass(frozen=True)
class CsvTopic(Topic):
    """A topic from columns of a CSV log."""

    file: str | None  # pattern of the file's name; None where there is one file
    time: TimeColumn
    received: TimeColumn | None
    columns: Mapping[str, Column]
    new_when_changes: str | None
    dialect: Dialect


@dataclass(frozen=True)
class BagTopic(Topic):
    """A topic from the messages of a bag's topic."""

    source: str
    joints: Mapping[str, Joints]  # of sprockets left and right, of a swing its joint
    uses: str  # of joints: both, positions, velocities
    uses_header: bool  # for stamps; else the log times
    child_frame: str | None  # of transforms
    position_only: bool
    convention: str  # of headings, one of CONVENTIONS
    sign: float  # of headings, 1 or −1, in their convention


def read_topic(
    where: str, name: str, value: Any, common: Mapping[str, Any], geometry: Geometry | None
) -> CsvTopic | BagTopic:
    """A topic of the mapping: from columns of a table, or from topics of a bag.

    Raises:
        InputError: a name, key or value is not accepted.
    """
    place = f"{where}: {text(f'{where}: topics', name)}"
    if name not in ROLE_OF_TOPIC and not (isinstance(value, Mapping) and "role" in value):
        like = did_you_mean(name, ROLE_OF_TOPIC)
        accepted = f"{', '.join(ROLE_OF_TOPIC)}, or any with a role"
        raise InputError(f"{where}: topics: unknown key '{name}'{like}; accepted: {accepted}")
    tree = section(place, value)
    role = choice(f"{place}.role", tree.get("role", ROLE_OF_TOPIC.get(name)), ROLES)
    keys = (FROM, *_keys_of(ROLES[role], _BAG_KEYS)) if FROM in tree else _keys_of(ROLES[role], _CSV_KEYS)
    check_keys(place, tree, (), keys if FROM in tree else (*ROLES[role].fields, *keys))
    of_both = {
        "name": name,
        "where": place,
        "role": role,
        "frame": text(f"{place}.frame", tree["frame"]) if "frame" in tree else None,
        "time_offset_ns": nanoseconds(f"{place}.time_offset", tree.get("time_offset", 0.0)),
        "spreads": read_spreads(place, tree, ROLES[role].axes),
        "geometry": _read_geometry(f"{place}.geometry", tree["geometry"]) if "geometry" in tree else geometry,
    }
    if FROM in tree:
        return _bag_topic(place, tree, ROLES[role], of_both)
    return _csv_topic(place, {**common, **tree}, ROLES[role], of_both)


def _csv_topic(where: str, tree: Mapping[str, Any], role: Role, of_both: Mapping[str, Any]) -> CsvTopic:
    stated = [name for name in role.fields if name in tree]
    role.check(where, set(stated))
    if "time" not in tree:
        raise InputError(
            f"{where}: key 'time' is missing, here or for all topics; accepted: {{column, unit}}"
        )
    columns = {name: read_column(f"{where}.{name}", tree[name], role.fields[name]) for name in stated}
    for one, other in _SIDE_PAIRS:
        names = {columns[name].names for name in (one, other) if name in columns}
        if {one, other} <= set(stated) and len(names) == 1 and len(columns[one].names) == 1:
            name = columns[one].names[0]
            raise InputError(f"{where}: {one} and {other} are both of '{name}'; accepted: a column of each")
    _require_spreads(where, role, of_both["spreads"], set(stated))
    _require_geometry(where, columns, of_both["geometry"])
    marker = tree.get("new_when_changes")
    return CsvTopic(
        **of_both,
        file=text(f"{where}.file", tree["file"]) if "file" in tree else None,
        time=read_time(f"{where}.time", tree["time"]),
        received=read_time(f"{where}.received", tree["received"]) if "received" in tree else None,
        columns=columns,
        new_when_changes=None if marker is None else text(f"{where}.new_when_changes", marker),
        dialect=read_dialect(f"{where}.csv", tree.get("csv", {})),
    )


def _bag_topic(where: str, tree: Mapping[str, Any], role: Role, of_both: Mapping[str, Any]) -> BagTopic:
    joints = {key: _read_joints(f"{where}.{key}", tree[key]) for key in (*SIDES, JOINT) if key in tree}
    uses = "positions" if role is ROLES["swing"] else "both"
    columns = [axis for axis, spread in of_both["spreads"].items() if isinstance(spread.value, Column)]
    if columns:
        raise InputError(f"{where}: a column of {columns[0]}, and the log is a bag; accepted: a number, SI")
    if len(joints.keys() & set(SIDES)) == 1:
        raise InputError(f"{where}: only one of left and right; accepted: the joints of both")
    if SIDES[0] in joints and joints[SIDES[0]].names == joints[SIDES[1]].names:
        name = ", ".join(joints[SIDES[0]].names)
        raise InputError(f"{where}: left and right are both of '{name}'; accepted: the joints of each")
    return BagTopic(
        **of_both,
        source=text(f"{where}.{FROM}", tree[FROM]),
        joints=joints,
        uses=choice(f"{where}.use", tree.get("use", uses), USES),
        uses_header=choice(f"{where}.stamp", tree.get("stamp", "header"), ("header", "log")) == "header",
        child_frame=text(f"{where}.child_frame", tree["child_frame"]) if "child_frame" in tree else None,
        position_only=flag(f"{where}.position_only", tree.get("position_only", False)),
        convention=choice(f"{where}.convention", tree.get("convention", CONVENTIONS[0]), CONVENTIONS),
        sign=_read_sign(f"{where}.sign", tree.get("sign", 1)),
    )


def _keys_of(role: Role, keys: tuple[str, ...]) -> tuple[str, ...]:
    """The keys that apply to a topic of a role."""
    without = set() if role.axes else {"stddev", "covariance"}
    if role is not ROLES["sprockets"]:
        without |= {*SIDES, "use", "geometry"}
    if role is not ROLES["swing"]:
        without |= {JOINT}
    if role is not ROLES["pose"]:
        without |= {"child_frame", "position_only"}
    if role is not ROLES["heading"]:
        without |= {"convention", "sign"}
    return tuple(key for key in (*keys, *_COMMON_KEYS) if key not in without)


def _read_joints(where: str, value: Any) -> Joints:
    """A name, a list of names, or ``{joints: …, sign: -1, ratio: 0.1}``."""
    if not isinstance(value, Mapping):
        return Joints(texts(where, value), 1.0)
    check_keys(where, value, ("joints",), ("sign", "ratio"))
    sign = _read_sign(f"{where}.sign", value.get("sign", 1))
    return Joints(
        texts(f"{where}.joints", value["joints"]),
        sign * positive_number(f"{where}.ratio", value.get("ratio", 1.0)),
    )


def _read_sign(where: str, value: Any) -> float:
    sign = number(where, value)
    if abs(sign) != 1.0:
        raise InputError(f"{where}: {sign:g} is not accepted; accepted: 1 or -1")
    return sign


def _require_spreads(where: str, role: Role, spreads: Mapping[str, Spread], given: set[str]) -> None:
    """Require a standard deviation or covariance for each axis of a pose."""
    if role is not ROLES["pose"]:
        return
    yaw_fields = given & {"yaw", "heading", "qz"}
    for axis in ("x", "y", *(("yaw",) if yaw_fields else ())):
        if axis not in spreads:
            raise InputError(
                f"{where}: stddev of {axis} is missing; accepted: {axis} under stddev or covariance"
            )
    if "yaw" in spreads and not yaw_fields:
        raise InputError(f"{where}: stddev of yaw, and no yaw; accepted: yaw, heading, or qx + qy + qz + qw")


def _require_geometry(where: str, columns: Mapping[str, Column], geometry: Geometry | None) -> None:
    """Require the geometry of the vehicle for speeds over ground."""
    over_ground = [name for name, column in columns.items() if column.quantity in ("speed", "length")]
    if ROLES["sprockets"].fields.keys() >= columns.keys() and over_ground and geometry is None:
        raise InputError(f"{where}.{over_ground[0]}: {NEEDS_GEOMETRY}")


def _read_geometry(where: str, value: Any) -> Geometry:
    tree = section(where, value)
    check_keys(where, tree, Geometry._fields, ())
    return Geometry(*(positive_number(f"{where}.{name}", tree[name]) for name in Geometry._fields))
