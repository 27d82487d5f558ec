# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A bag as arrays for calibration, by stamp, in seconds from the bag's first message."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from trackslip_bags.input_filters import relative_name
from trackslip_bags.reader import Bag
from trackslip_common.arrays import FloatArray, IntArray, Rows
from trackslip_common.compiled import compiled
from trackslip_common.errors import InputError
from trackslip_common.message_fields import (
    ABSENT,
    RECORDS,
    HydraulicsFields,
    ImuFields,
    OdometryFields,
    OrientationFields,
    PoseFields,
    QuaternionFields,
    SprocketFields,
)
from trackslip_common.message_reading import RecordClass, dtype_of
from trackslip_common.orientations import headings_of, poses_of
from trackslip_common.record_types import Table, make_table
from trackslip_estimation.slip.motion import (
    MOTION,
    SPEEDS,
    LimitsRecord,
    Motion,
    MotionParameters,
    MotionRecord,
    SpeedsRecord,
    limits_record,
    update_motion,
)
from trackslip_estimation.slip.sources import HEADING_MESSAGES, HeadingSource
from trackslip_tools.replay.inputs import SPROCKETS, Batch

HYDRAULICS = "hydraulics"

_Readings = tuple[IntArray, FloatArray]  # (n,) stamps, (n, k) values


class _Request(NamedTuple):
    """A topic to read, with the conversion and limits of its values."""

    topic: str  # "" for none
    kind: RecordClass
    values_of: Callable[[Rows], FloatArray]
    limits: tuple[float, ...]  # limits of the first columns; further columns may be missing

    def valid_readings(self, rows: Rows) -> _Readings:
        """Stamps and values of the readings within the limits."""
        with np.errstate(all="ignore"):  # overflow of squares
            values = self.values_of(rows)
        is_valid = (np.abs(values[:, : len(self.limits)]) <= self.limits).all(axis=1)
        return rows["stamp_ns"][is_valid], values[is_valid]


_MAX_SPROCKET_SPEED = 1e3  # rad/s, of a sprocket
_MAX_GYRO_RATE = 100.0  # rad/s, of a gyro
_MAX_COORDINATE, _LARGEST_VARIANCE = 1e8, 1e12  # m, m²
_MAX_PRESSURE = 1e9  # Pa
_MAX_SPROCKET_ANGLE = 1e9  # rad, of a sprocket since the first reading
_MAX_CLOCK_DIFFERENCE_NS = 100 * 86_400 * 1_000_000_000  # from the median stamp; beyond: another clock


class Series(NamedTuple):
    """Readings in the order of their stamps."""

    t: FloatArray  # (n,) s
    values: FloatArray  # (n, k)

    def slice_between(self, begin: float, end: float) -> slice:
        """Slice of the readings from begin to end, s, both included."""
        return slice(int(np.searchsorted(self.t, begin)), int(np.searchsorted(self.t, end, side="right")))


@dataclass(frozen=True, eq=False)
class Recording:
    """One drive; series without messages in the bag are empty."""

    sprockets: Series  # left, right: rad, continuous
    gyro: Series  # about x, y, z of the unit: rad/s, uncorrected
    poses: Series  # x m, y m, heading rad (continuous); their variances
    hydraulics: Series  # left, right: Pa; left, right spool (nan if unknown)
    motion: IntArray  # (n,) Motion at each sprocket sample
    compass: Series | None = None  # of a heading source: heading rad (continuous), its variance
    left_out: Mapping[str, int] = field(default_factory=dict)  # topic → number of invalid readings

    @property
    def headings(self) -> Series:
        """(k, 2) heading and its variance: of the heading source if there is one, else of the poses."""
        return self.compass or Series(self.poses.t, self.poses.values[:, (2, 5)])

    @cached_property
    def gyro_angle(self) -> FloatArray:
        """(n,) integral of the gyro's z rate at its stamps, rad, bias included."""
        t, rates = self.gyro
        steps = np.diff(t) * (rates[1:, 2] + rates[:-1, 2]) / 2.0
        return np.concatenate(([0.0], np.cumsum(steps)))[: len(t)]

    @cached_property
    def mean_angle(self) -> FloatArray:
        """(n,) mean angle of both sprockets, rad."""
        return np.asarray(self.sprockets.values.mean(axis=1))

    @cached_property
    def angle_difference(self) -> FloatArray:
        """(n,) angle of the right sprocket less that of the left, rad."""
        return np.asarray(self.sprockets.values[:, 1] - self.sprockets.values[:, 0])


class RecordingReader:
    """Collects sprockets, gyro, poses (topics by name, '' for none) and hydraulics from the inputs of a bag.

    ``compass``: a heading source and its parameters.

    Raises:
        InputError: a topic has an unsupported type.
    """

    def __init__(self, bag: Bag, gyro: str, poses: str, compass: tuple[str, HeadingSource] | None) -> None:
        types = {relative_name(topic): info.type_name for topic, info in bag.topics.items()}
        pressures_and_spools = _columns("left_pressure", "right_pressure", "left_spool", "right_spool")
        pose_limits = (*(_MAX_COORDINATE,) * 3, *(_LARGEST_VARIANCE,) * 2)
        self._requests = (
            _Request(SPROCKETS, SprocketFields, _sprockets, (_MAX_SPROCKET_SPEED,) * 2),
            _Request(gyro, ImuFields, _columns("rate_x", "rate_y", "rate_z"), (_MAX_GYRO_RATE,) * 3),
            _Request(poses, PoseFields, _poses, pose_limits),
            _Request(HYDRAULICS, HydraulicsFields, pressures_and_spools, (_MAX_PRESSURE,) * 2),
            _compass_request(types, *compass) if compass else _Request("", PoseFields, _poses, pose_limits),
        )
        self.topics = {request.topic for request in self._requests if request.topic in types}
        self._start_ns, self._counts = bag.start_ns, Counter[str]()
        self._parts: list[list[_Readings]] = []
        for request in self._requests:
            accepted = _ACCEPTED_TYPES[request.kind]
            type_name = types.get(request.topic)
            if type_name is not None and RECORDS.get(type_name) not in accepted:
                names = " or ".join(name for name, kind in RECORDS.items() if kind in accepted)
                raise InputError(f"bag '{bag.path}': {request.topic} is a {type_name}; accepted: {names}")
            self._parts.append([request.valid_readings(np.empty(0, dtype_of(request.kind)))])

    def add(self, batch: Batch) -> None:
        """Add the tables of a batch."""
        for request, part in zip(self._requests, self._parts, strict=True):
            if request.topic in batch.tables:
                table = batch.tables[request.topic].table
                part.append(request.valid_readings(table.rows(request.kind)))
                self._counts[request.topic] += len(table) - len(part[-1][0])

    def recording(self, limits: MotionParameters) -> Recording:
        """The recording of all batches: by stamp, the first reading of each stamp.

        Readings are invalid outside their limits, and far from the median stamp of the sprockets (another
        clock).
        """
        series, median_ns = [], None
        for request, part in zip(self._requests, self._parts, strict=True):
            stamps_ns, values = (np.concatenate(columns) for columns in zip(*part, strict=True))
            if median_ns is None and len(stamps_ns):
                median_ns = int(np.median(stamps_ns))
            is_near = np.abs((stamps_ns - (median_ns or 0)).astype(np.float64)) <= _MAX_CLOCK_DIFFERENCE_NS
            self._counts[request.topic] += int((~is_near).sum())
            series.append(_sorted_series(stamps_ns[is_near], values[is_near], self._start_ns))
        sprockets, rates, poses, hydraulics, headings = _sprocket_angles(series[0]), *series[1:]
        poses.values[:, 2] = np.unwrap(poses.values[:, 2])
        headings.values[:, 0] = np.unwrap(headings.values[:, 0])
        motion, compass = motion_states(sprockets, limits), headings if len(headings.t) else None
        left_out = {topic: count for topic, count in self._counts.items() if count}
        return Recording(sprockets, rates, poses, hydraulics, motion, compass, left_out)


def _compass_request(types: Mapping[str, str], topic: str, source: HeadingSource) -> _Request:
    """Request of (n, 2) heading and its variance, for the message type in the bag."""
    is_imu = types.get(topic) == HEADING_MESSAGES["imu"]

    def values(rows: Rows) -> FloatArray:
        variances = np.full(len(rows), source.stddev**2)
        if not is_imu:
            return np.column_stack((source.from_east(headings_of(rows)), variances))
        variances = np.where(rows["variance_z"] != 0.0, rows["variance_z"], variances)
        has_orientation = rows["absent"] != ABSENT
        return np.column_stack(
            (np.where(has_orientation, source.from_east(headings_of(rows)), np.nan), variances)
        )

    return _Request(topic, OrientationFields if is_imu else QuaternionFields, values, (_MAX_COORDINATE,) * 2)


def motion_states(sprockets: Series, limits: MotionParameters) -> IntArray:
    """(n,) motion at each sample: standstill, straight or turning; unknown at the first."""
    states = np.full(len(sprockets.t), int(Motion.UNKNOWN))
    motion, speeds = make_table(MotionRecord, MOTION, 1), make_table(SpeedsRecord, SPEEDS, 1)
    _fill_motion_states(sprockets.t, sprockets.values, motion, speeds, limits_record(limits), states)
    return states


@compiled
def _fill_motion_states(
    t: FloatArray,
    angles: FloatArray,
    motion: Table[MotionRecord],
    speeds: Table[SpeedsRecord],
    limits: Table[LimitsRecord],
    states: IntArray,
) -> None:
    motion[0].changing = True
    for k in range(1, len(t)):
        dt = t[k] - t[k - 1]
        speeds[0].left = (angles[k, 0] - angles[k - 1, 0]) / dt
        speeds[0].right = (angles[k, 1] - angles[k - 1, 1]) / dt
        update_motion(motion[0], speeds[0], dt, limits[0])
        states[k] = motion[0].motion


def _sorted_series(stamps_ns: IntArray, values: FloatArray, start_ns: int) -> Series:
    t: FloatArray = np.asarray((stamps_ns - start_ns) * 1e-9, dtype=np.float64)
    if (np.diff(t) <= 0.0).any():
        t, first = np.unique(t, return_index=True)
        values = values[first]
    return Series(t, values)


def _columns(*names: str) -> Callable[[Rows], FloatArray]:
    """A function that returns (n, k) columns of these names."""
    return lambda rows: np.column_stack([rows[name] for name in names])


def _sprockets(rows: Rows) -> FloatArray:
    """(n, 4) left and right speed, left and right position."""
    positions = np.column_stack((rows["left_position"], rows["right_position"]))
    positions[~rows["has_positions"]] = np.nan
    return np.column_stack((rows["left_speed"], rows["right_speed"], positions))


def _poses(rows: Rows) -> FloatArray:
    """(n, 6) x, y, heading and their variances; that of a missing heading is the largest."""
    poses, variances = poses_of(rows), np.diagonal(rows["covariance"], axis1=1, axis2=2).copy()
    has_none = np.isnan(poses[:, 2])
    poses[has_none, 2], variances[has_none, 2] = 0.0, _LARGEST_VARIANCE
    return np.column_stack((poses, variances))


def _sprocket_angles(readings: Series) -> Series:
    """(n, 2) angles: the positions, or the integral of the speeds if a position is missing."""
    t, values = readings
    if (np.abs(values[:, 2:]) <= _MAX_SPROCKET_ANGLE).all():
        return Series(t, values[:, 2:])
    steps = values[1:, :2] * np.diff(t)[:, np.newaxis]
    return Series(t, np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0))))


_ACCEPTED_TYPES: dict[RecordClass, tuple[RecordClass, ...]] = {
    SprocketFields: (SprocketFields,),
    ImuFields: (ImuFields,),
    OrientationFields: (ImuFields,),
    QuaternionFields: (QuaternionFields,),
    PoseFields: (PoseFields, OdometryFields),  # both have a pose
    HydraulicsFields: (HydraulicsFields,),
}
