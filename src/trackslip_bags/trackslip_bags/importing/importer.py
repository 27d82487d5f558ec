# SPDX-License-Identifier: Apache-2.0
"""Turns a CSV log into a bag, by a mapping file (see ``mapping``).

Each message is logged at its own stamp, so that the bag is in the order of the stamps. Motion is planar:
of the reference, z, roll and pitch are zero.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.importing.csv_log import FloatArray, read_columns
from trackslip_bags.importing.mapping import LogMapping, TopicMapping
from trackslip_bags.messages import header, make, serialize
from trackslip_bags.parameters import PARAMETERS_TOPIC, PARAMETERS_TYPE
from trackslip_bags.reader import absolute
from trackslip_bags.writer import BagWriter
from trackslip_common.config_files import parameters_text
from trackslip_common.errors import InputError
from trackslip_common.vehicle import TOPIC as VEHICLE
from trackslip_common.vehicle import vehicle_text
from trackslip_estimation.slip.parameters import NODE as SLIP_NODE

IntArray = NDArray[np.int64]
Values = Mapping[str, float]  # field → value, SI

_UNKNOWN = -1.0  # first element of a covariance whose quantity was not measured


class _Entry(NamedTuple):
    """One message to be written."""

    stamp_ns: int
    topic: str
    type_name: str
    data: bytes


class Imported(NamedTuple):
    """What became of a log."""

    counts: dict[str, int]  # messages in the bag, by topic
    left_out: dict[str, int]  # messages whose stamps an offset makes negative: no bag can hold them


def import_log(log: Path, mapping: LogMapping, output: Path) -> Imported:
    """Write the bag; what a ``time_offset`` moves to before 0 is left out and counted.

    Raises:
        InputError: the log cannot be read or does not fit the mapping, or the bag exists already.
    """
    columns = read_columns(log, mapping.column_names())
    stamps_ns = _stamps(log, columns[mapping.time.name], mapping)
    begin_ns = int(stamps_ns[0])
    if begin_ns < 0:
        raise InputError(
            f"{mapping.path}: the log begins at {begin_ns * 1e-9:.3f} s; "
            "accepted: a 'start' that makes it 0 or later"
        )
    found = [
        entry
        for name, topic in mapping.topics.items()
        for entry in _entries(log, name, topic, columns, stamps_ns)
    ]
    entries = sorted((e for e in found if e.stamp_ns >= 0), key=lambda entry: entry.stamp_ns)
    left_out = Counter(entry.topic for entry in found if entry.stamp_ns < 0)
    with BagWriter(output) as bag:
        if mapping.vehicle is not None:
            text = serialize(make(PARAMETERS_TYPE, data=vehicle_text(mapping.vehicle)))
            bag.write(absolute(VEHICLE), PARAMETERS_TYPE, text, entries[0].stamp_ns)
        if mapping.parameters:
            text = serialize(make(PARAMETERS_TYPE, data=parameters_text(mapping.parameters, SLIP_NODE)))
            bag.write(absolute(PARAMETERS_TOPIC), PARAMETERS_TYPE, text, entries[0].stamp_ns)
        for entry in entries:
            bag.write(entry.topic, entry.type_name, entry.data, entry.stamp_ns)
    return Imported(bag.counts, dict(left_out))


def _stamps(log: Path, times: FloatArray, mapping: LogMapping) -> IntArray:
    """Stamp of each row in ns, before the offset of a topic; (rows,)."""
    back = np.flatnonzero(np.diff(times) < 0.0)
    if back.size:
        before, after = times[back[0]], times[back[0] + 1]
        raise InputError(
            f"{log}: column '{mapping.time.name}' goes back from {before:g} to {after:g}; "
            "accepted: times that never decrease"
        )
    nanoseconds: IntArray = np.rint(times * (mapping.time.factor * 1e9)).astype(np.int64)
    return nanoseconds + mapping.start_ns


def _entries(
    log: Path, name: str, topic: TopicMapping, columns: Mapping[str, FloatArray], stamps_ns: IntArray
) -> Iterator[_Entry]:
    """The messages of one topic, in the order of the rows."""
    type_name, build = _BUILDERS[name]
    rows = _new_rows(log, topic.new_when_changes, columns, len(stamps_ns))
    values = {field: columns[column.name][rows] * column.factor for field, column in topic.columns.items()}
    for i, stamp_ns in enumerate((stamps_ns[rows] + topic.time_offset_ns).tolist()):
        fields = build({field: float(array[i]) for field, array in values.items()}, topic)
        message = make(type_name, header=header(stamp_ns, topic.frame), **fields)
        yield _Entry(stamp_ns, absolute(name), type_name, serialize(message))


def _new_rows(log: Path, marker: str | None, columns: Mapping[str, FloatArray], count: int) -> IntArray:
    """The rows that hold a new message: all, or those where the marking column changes.

    The first row is none of the latter: since when its value has been held is unknown.
    """
    if marker is None:
        return np.arange(count)
    changed: IntArray = np.flatnonzero(np.diff(columns[marker])) + 1
    if not changed.size:
        raise InputError(
            f"{log}: column '{marker}' never changes; accepted as new_when_changes: one that does"
        )
    return changed


def _sprockets(values: Values, topic: TopicMapping) -> dict[str, Any]:
    positions = [values[name] for name in ("left_position", "right_position") if name in values]
    velocities = [values["left_velocity"], values["right_velocity"]]
    return {"name": ["left_sprocket", "right_sprocket"], "position": positions, "velocity": velocities}


def _imu(values: Values, topic: TopicMapping) -> dict[str, Any]:
    fields = {
        "orientation": make("geometry_msgs/msg/Quaternion", w=1.0),
        "orientation_covariance": [_UNKNOWN] + [0.0] * 8,
        "angular_velocity": _vector(values, "angular_velocity"),
    }
    if "linear_acceleration_x" in values:
        return {**fields, "linear_acceleration": _vector(values, "linear_acceleration")}
    return {**fields, "linear_acceleration_covariance": [_UNKNOWN] + [0.0] * 8}


def _vector(values: Values, name: str) -> Any:
    return make("geometry_msgs/msg/Vector3", **{axis: values[f"{name}_{axis}"] for axis in "xyz"})


def _reference_pose(values: Values, topic: TopicMapping) -> dict[str, Any]:
    half = values["yaw"] / 2.0
    pose = make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", x=values["x"], y=values["y"]),
        orientation=make("geometry_msgs/msg/Quaternion", z=math.sin(half), w=math.cos(half)),
    )
    covariance = np.zeros((6, 6))  # of x, y, z and the rotations about them
    covariance[0, 0], covariance[1, 1], covariance[5, 5] = (topic.stddev[k] ** 2 for k in ("x", "y", "yaw"))
    return {"pose": make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance.ravel())}


def _hydraulics(values: Values, topic: TopicMapping) -> dict[str, Any]:
    absent = dict.fromkeys(("left_spool", "right_spool", "supply_pressure"), math.nan)
    return {**absent, **values}


_BUILDERS: Mapping[str, tuple[str, Callable[[Values, TopicMapping], dict[str, Any]]]] = {
    "sprockets": ("sensor_msgs/msg/JointState", _sprockets),
    "imu/data_raw": ("sensor_msgs/msg/Imu", _imu),
    "reference_pose": ("geometry_msgs/msg/PoseWithCovarianceStamped", _reference_pose),
    "hydraulics": ("trackslip_msgs/msg/TrackHydraulics", _hydraulics),
}
