# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of measurements of the slip estimator to the columns that the setup check compares."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import BoolArray, FloatArray, Rows
from trackslip_estimation.setup_check.clocks import LARGEST_DELAY
from trackslip_estimation.setup_check.count_angle import angle_of_count
from trackslip_estimation.setup_check.grid import tracks_of_speeds
from trackslip_estimation.setup_check.log import Compass, Counts, Fixes, Gyro, Log, Machine, Pressures, Tracks
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import HEADING, ON_SWING, POSE, SPROCKETS, YAW_RATE
from trackslip_estimation.soil.pressure_watch import WatchParameters
from trackslip_estimation.soil.records import HYDRAULICS

_UNMEASURED_HEADING_VARIANCE = 0.3**2  # rad², variance from which a heading counts as unmeasured
_UNMEASURED_RATE_VARIANCE = 1e3  # (rad/s)², variance above which an axis counts as unmeasured
_LARGEST_VALUE = 1e12  # magnitude of any valid number
_OTHER_CLOCK = 86_400 * 1_000_000_000  # ns from the median stamp of a source, with
_SPREADS = 10  # times its interquartile range: a log may have another unit of time
LONG_PAUSE_NS = 3600 * 1_000_000_000  # without any measurement, from which time is taken out
_LEAST_SAMPLES = 10  # of the sprockets before and after a pause, and in an hour: fewer have stray stamps
_KINDS = (SPROCKETS, YAW_RATE, POSE, HEADING, ON_SWING)
_MOST_READINGS = 2_000_000  # readings of a source: hours; later ones are not compared

Key: TypeAlias = tuple[int, str]  # kind of ``slip.records``, source
Columns: TypeAlias = dict[Key, tuple[NDArray[np.int64], FloatArray]]
"""Stamps (n,) ns and values (n, k): of sprockets both speeds, both angles; of an IMU rates about x, y,
z, their variances, specific force along x, y, z; of a pose x, y, heading, their variances; else one angle."""


@dataclass
class Collector:
    """Collects measurements, part by part, as columns of each source."""

    parameters: SlipEstimatorParameters
    watch: WatchParameters
    parts: dict[Key, list[tuple[NDArray[np.int64], FloatArray]]] = field(default_factory=dict)
    counts: dict[Key, int] = field(default_factory=dict)
    arrival_delays: dict[str, list[NDArray[np.int64]]] = field(default_factory=dict)  # ns, by topic
    hydraulics: list[Rows] = field(default_factory=list)

    def add(self, rows: Rows, sources: Sequence[str]) -> None:
        """Append (n,) ``records.MEASUREMENT`` of the compared kinds, with ``log_time_ns``, their arrival.

        ``sources``: names by their numbers.
        """
        for kind in _KINDS:
            of_kind = rows[rows["kind"] == kind]
            for number in np.unique(of_kind["source"]).tolist() if len(of_kind) else ():
                source_rows, key = of_kind[of_kind["source"] == number], (kind, sources[number])
                if self.counts.get(key, 0) < _MOST_READINGS:
                    self.counts[key] = self.counts.get(key, 0) + len(source_rows)
                    part = source_rows["stamp_ns"].astype(np.int64), _column_values(kind, source_rows)
                    self.parts.setdefault(key, []).append(part)
                    delays = source_rows["log_time_ns"] - source_rows["stamp_ns"]
                    self.arrival_delays.setdefault(sources[number], []).append(delays)

    def add_hydraulics(self, rows: Rows) -> None:
        """Append (n,) readings with the fields of ``HydraulicsFields``."""
        if sum(map(len, self.hydraulics)) < _MOST_READINGS:
            self.hydraulics.append(rows[["stamp_ns", "left_pressure", "right_pressure"]])

    def sprocket_times(self) -> NDArray[np.int64]:
        """(n, 2) stamps and log times of the sprockets, ns, in the order of their arrival."""
        for (kind, name), parts in self.parts.items():
            if kind == SPROCKETS:
                stamps = np.concatenate([part for part, _ in parts])
                return np.column_stack((stamps, stamps + np.concatenate(self.arrival_delays[name])))
        return np.empty((0, 2), np.int64)

    def log(self) -> Log | None:
        """The log of all columns, on one clock, without long pauses; None without sprockets."""
        columns: Columns = {}
        for key, parts in self.parts.items():
            stamps, values = zip(*parts, strict=True)
            columns[key] = np.concatenate(stamps), np.concatenate(values)
        pauses = _find_pauses(columns)
        columns = {key: (pauses.close(stamps), values) for key, (stamps, values) in columns.items()}
        log = log_of_columns(columns, self.parameters)
        delays = {name: np.concatenate(parts) for name, parts in self.arrival_delays.items()}
        steady = {name: float(np.median(d)) * 1e-9 for name, d in delays.items() if _is_steady(d)}
        return None if log is None else replace(log, arrival_delays=steady, pressures=self._pressures(pauses))

    def _pressures(self, pauses: "Pauses") -> Pressures | None:
        """The pressures on the clock of the log; None without hydraulics."""
        if not self.hydraulics:
            return None
        rows, p = np.concatenate(self.hydraulics), self.parameters
        start = min(int(s.min()) for (kind, _), ps in self.parts.items() if kind == SPROCKETS for s, _ in ps)
        values = np.column_stack((rows["left_pressure"], rows["right_pressure"]))
        is_valid = np.isfinite(values).all(axis=1)
        t, first = np.unique((pauses.close(rows["stamp_ns"][is_valid]) - start) * 1e-9, return_index=True)
        relief = p.vehicle.whole().relief_pressure
        return Pressures(HYDRAULICS, t, values[is_valid][first], self.watch, relief, p.motion)


class Pauses(NamedTuple):
    """Long times without any measurement: the recorder paused, or the clock of the machine was set."""

    ends_ns: NDArray[np.int64]  # (n,) ascending
    taken_out_ns: NDArray[np.int64]  # (n + 1,) before the first end, and from each on

    def close(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Stamps (m,) with one to three hours left of each pause."""
        closed: NDArray[np.int64] = (
            stamps_ns - self.taken_out_ns[np.searchsorted(self.ends_ns, stamps_ns, side="right")]
        )
        return closed


def _find_pauses(columns: Columns) -> Pauses:
    """The long pauses of all columns that have sprockets before and after."""
    of_sprockets = [stamps for (kind, _), (stamps, _) in columns.items() if kind == SPROCKETS]
    sprockets = np.unique(np.concatenate([np.empty(0, np.int64), *of_sprockets]))
    by_column = [np.unique(stamps // LONG_PAUSE_NS) for stamps, _ in columns.values()]
    hours = np.unique(np.concatenate([np.empty(0, np.int64), *by_column]))
    empty, ends = np.diff(hours) - 2, hours[1:] * LONG_PAUSE_NS
    before = np.searchsorted(sprockets, ends)
    is_long = (empty > 0) & (np.minimum(before, len(sprockets) - before) >= _LEAST_SAMPLES)
    is_long &= len(sprockets) >= _LEAST_SAMPLES * len(hours)  # else each step is one: another unit of time
    taken_out = np.cumsum(empty[is_long]) * LONG_PAUSE_NS
    return Pauses(ends[is_long], np.concatenate((np.zeros(1, np.int64), taken_out)))


def _is_steady(delays_ns: NDArray[np.int64]) -> bool:
    """Whether delays (n,) hardly change; those of a recorded playback at another rate do."""
    low, high = np.quantile(delays_ns, (0.05, 0.95))
    return bool(high - low < LARGEST_DELAY * 1e9)


def log_of_columns(columns: Columns, p: SlipEstimatorParameters) -> Log | None:
    """The log of all columns, on one clock, with the stated parameters applied; None without sprockets."""
    tracks = next((stamps for (kind, _), (stamps, _) in columns.items() if kind == SPROCKETS), None)
    if tracks is None or not len(tracks):
        return None
    start = int(tracks.min())
    per_stamp: dict[str, float] = {}
    unusable: dict[str, int] = {}
    ready: dict[Key, tuple[FloatArray, FloatArray]] = {}
    with_headings = {name for name, pose in p.poses().items() if pose.use_heading}
    for key, (stamps, values) in columns.items():
        has_variances = _has_variances(key[0], values, 3 if key[1] in with_headings else 2)
        stamps, values = stamps[has_variances], _mask_unmeasured(key[0], values[has_variances])
        t, readings, count = _valid_readings(stamps, values, start, key[0])
        if len(t):
            ready[key] = t, readings
            per_stamp[key[1]] = count / len(t)
        else:
            unusable[key[1]] = len(has_variances)
    if not any(kind == SPROCKETS for kind, _ in ready):
        return None
    return replace(_make_log(ready, p), per_stamp=per_stamp, unusable=unusable)


def _column_values(kind: int, rows: Rows) -> FloatArray:
    """(n, k) values of one source, in the order of ``Columns``."""
    if kind == SPROCKETS:
        names = ("left_speed", "right_speed", "left_angle", "right_angle")
        return np.column_stack([rows[name] for name in names])
    noise = np.diagonal(rows["noise"], axis1=1, axis2=2)
    if kind == YAW_RATE:
        return np.column_stack((rows["value"][:, [1, 2, 0]], noise[:, [1, 2, 0]], rows["acceleration"]))
    if kind == POSE:
        return np.column_stack((rows["value"], noise))
    return rows["value"][:, :1].copy()


def _mask_unmeasured(kind: int, values: FloatArray) -> FloatArray:
    """Values without the variances of rates and headings; nan where a variance marks them as unmeasured."""
    if kind == YAW_RATE:
        return np.column_stack(
            (np.where(values[:, 3:6] > _UNMEASURED_RATE_VARIANCE, np.nan, values[:, :3]), values[:, 6:])
        )
    if kind == POSE:
        heading = np.where(values[:, 5] < _UNMEASURED_HEADING_VARIANCE, values[:, 2], np.nan)
        return np.column_stack((values[:, :2], heading, values[:, 3:5]))
    return values


def _has_variances(kind: int, values: FloatArray, rows: int) -> BoolArray:
    """(n,) whether the variances of the first ``rows`` values of a pose are above 0; other kinds: true."""
    result: BoolArray = np.ones(len(values), np.bool_)
    if kind == POSE:
        result &= (values[:, 3 : 3 + rows] > 0.0).all(axis=1)
    return result


_NEEDED = {SPROCKETS: slice(0, 2), YAW_RATE: slice(2, 3), POSE: slice(0, 2), HEADING: slice(0, 1)}


def _valid_readings(
    stamps: NDArray[np.int64], values: FloatArray, start_ns: int, kind: int
) -> tuple[FloatArray, FloatArray, int]:
    """Times (n,), s, ascending, and the first valid values at each; the number of readings, copies apart.

    A reading is valid if its needed values are numbers and its stamp is on the clock of most.
    """
    if not len(stamps):
        return np.empty(0), values, 0
    needed = values[:, _NEEDED.get(kind, slice(0, 1))]
    with np.errstate(invalid="ignore"):
        is_valid = (np.abs(needed) < _LARGEST_VALUE).all(axis=1)
    is_valid &= _is_on_clock_of_most(stamps)
    stamps, values = stamps[is_valid], values[is_valid]
    t, first = np.unique((stamps - start_ns) * 1e-9, return_index=True)
    order = np.argsort(stamps, kind="stable")
    same = np.diff(values[order], axis=0) == 0.0
    is_copy = (np.diff(stamps[order]) == 0) & (same | np.isnan(values[order][1:])).all(axis=1)
    return t, values[first], len(stamps) - int(is_copy.sum())


def _is_on_clock_of_most(stamps: NDArray[np.int64]) -> BoolArray:
    """(n,) whether stamps are near their median: one of another decade would stretch the whole log."""
    low, median, high = np.quantile(stamps.astype(np.float64), (0.25, 0.5, 0.75))
    return np.asarray(np.abs(stamps - median) < max(_OTHER_CLOCK, _SPREADS * (high - low)))


def _make_log(
    ready: Mapping[tuple[int, str], tuple[FloatArray, FloatArray]],
    p: SlipEstimatorParameters,
) -> Log:
    machine = p.vehicle.kinematics
    gyros, fixes, compasses, swing = [], [], [], None
    tracks, counts = Tracks(np.empty(0), np.empty((0, 2)), np.empty((0, 2))), Counts()
    poses, stated, headings, angles = p.poses(), p.gyros(), p.compasses(), p.swing_encoders()
    for (kind, name), (t, values) in ready.items():
        if kind == SPROCKETS:
            speeds, positions = values[:, :2], values[:, 2:4]
            has_positions = bool(np.isfinite(positions).all())
            tracks = Tracks(t, speeds, positions) if has_positions else tracks_of_speeds(t, speeds)
            counts = Counts(angle_of_count(t, speeds, positions), p.encoder_resolution)
        elif kind == YAW_RATE and name in stated:
            imu = stated[name]
            rates = values[:, :3].copy()
            rates[:, 2] *= imu.sign / imu.scale
            mounting = imu.mounting_roll, imu.mounting_pitch, imu.mounting_yaw
            mounted = (imu.above, float(imu.sign), imu.scale, mounting)
            gyros.append(Gyro(name, t, rates, values[:, 3:6], *mounted))
        elif kind == POSE and name in poses:
            pose = poses[name]
            stddevs = np.sqrt(np.maximum(values[:, 3:5].mean(axis=1), pose.position_floor**2))
            lever = (0.0, 0.0) if pose.above else pose.lever[:2]
            fixes.append(Fixes(name, t, values[:, :2], stddevs, lever, pose.above))
            if np.isfinite(values[:, 2]).sum() > 2:
                compasses.append(Compass(name, t, values[:, 2], pose.use_heading, is_above=pose.above))
        elif kind == HEADING and name in headings:
            heading = headings[name]
            applied = (heading.offset, heading.convention, heading.sign)
            compasses.append(
                Compass(name, t, values[:, 0] - heading.offset, True, False, *applied, heading.above)
            )
        elif kind == ON_SWING and name in angles:
            swing = t, values[:, 0] - angles[name].offset
    if swing is not None:
        compasses = [_undercarriage_compass(compass, swing) for compass in compasses]
    geometry = Machine(machine.rolling_radius, machine.tread, machine.contact_length)
    return Log(geometry, tracks, tuple(gyros), tuple(fixes), tuple(compasses), swing, counts)


def _undercarriage_compass(compass: Compass, swing: tuple[FloatArray, FloatArray]) -> Compass:
    """The compass with headings of the undercarriage: the swing is taken off those of the upper structure."""
    if not compass.is_above or len(swing[0]) < 2:
        return compass
    angle = np.interp(compass.t, swing[0], np.unwrap(swing[1]))
    return replace(compass, headings=compass.headings - angle, is_above=False)
