# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Measurements of the slip estimator, as it is given them, become the columns that the setup check compares."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.setup_check.grid import angles_of
from trackslip_estimation.setup_check.log import Compass, Fixes, FloatArray, Gyro, Log, Machine, Tracks
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import HEADING, ON_SWING, POSE, SPROCKETS, YAW_RATE

Rows = NDArray[np.void]  # of at least the fields of ``records.MEASUREMENT``

_NO_HEADING = 0.3**2  # rad², variance of a heading that is none
_NO_RATE = 1e3  # (rad/s)², variance of an axis that is unknown
_LARGEST = 1e12  # of any number
_OTHER_CLOCK = 40 * 365 * 86_400 * 1_000_000_000  # ns from most stamps; less may be a wrong unit
_WIDTHS = {SPROCKETS: 4, YAW_RATE: 6, POSE: 5, HEADING: 1, ON_SWING: 1}


class _Columns(NamedTuple):
    stamps_ns: NDArray[np.int64]  # (n,)
    values: FloatArray  # (n, k)


@dataclass
class Collector:
    """Columns of each source, part by part."""

    parameters: SlipEstimatorParameters
    parts: dict[tuple[int, str], list[_Columns]] = field(default_factory=dict)

    def add(self, rows: Rows, sources: Sequence[str]) -> None:
        """Of (n,) measurements; ``sources``: names by their numbers. Kinds that are not compared are left out."""
        for kind, width in _WIDTHS.items():
            of_kind = rows[rows["kind"] == kind]
            for number in np.unique(of_kind["source"]).tolist() if len(of_kind) else ():
                own = of_kind[of_kind["source"] == number]
                found = _Columns(own["stamp_ns"].astype(np.int64), _values(kind, own))
                assert found.values.shape[1] == width
                self.parts.setdefault((kind, sources[number]), []).append(found)

    def log(self) -> Log | None:
        """All columns on one clock; None without sprockets."""
        left_out: dict[str, int] = {}
        whole = {key: _joined(parts) for key, parts in self.parts.items()}
        tracks = next((c for (kind, _), c in whole.items() if kind == SPROCKETS), None)
        if tracks is None or not len(tracks.stamps_ns):
            return None
        usual = int(np.median(tracks.stamps_ns))
        start = int(tracks.stamps_ns.min())
        ready: dict[tuple[int, str], tuple[FloatArray, FloatArray]] = {}
        for key, columns in whole.items():
            t, values, lost = _sound(columns, usual, start, key[0])
            left_out |= {key[1]: lost} if lost else {}
            if len(t):
                ready[key] = t, values
        if not any(kind == SPROCKETS for kind, _ in ready):
            return None
        return _log(ready, self.parameters, left_out)


def _values(kind: int, rows: Rows) -> FloatArray:
    """(n, k) of one source."""
    if kind == SPROCKETS:
        names = ("left_speed", "right_speed", "left_angle", "right_angle")
        return np.column_stack([rows[name] for name in names])
    if kind == YAW_RATE:
        noise = np.diagonal(rows["noise"], axis1=1, axis2=2)
        rates = np.where(noise > _NO_RATE, np.nan, rows["value"])[:, [1, 2, 0]]
        return np.column_stack((rates, rows["acceleration"]))
    if kind == POSE:
        noise = np.diagonal(rows["noise"], axis1=1, axis2=2)
        heading = np.where(noise[:, 2] < _NO_HEADING, rows["value"][:, 2], np.nan)
        return np.column_stack((rows["value"][:, :2], heading, noise[:, :2]))
    return rows["value"][:, :1].copy()


def _joined(parts: Sequence[_Columns]) -> _Columns:
    return _Columns(np.concatenate([p.stamps_ns for p in parts]), np.concatenate([p.values for p in parts]))


_NEEDED = {SPROCKETS: slice(0, 2), YAW_RATE: slice(2, 3), POSE: slice(0, 2), HEADING: slice(0, 1)}


def _sound(columns: _Columns, usual_ns: int, start_ns: int, kind: int) -> tuple[FloatArray, FloatArray, int]:
    """By stamp, the first of each; how many were no numbers or of another clock."""
    needed = columns.values[:, _NEEDED.get(kind, slice(0, 1))]
    with np.errstate(invalid="ignore"):
        sound = (np.abs(needed) < _LARGEST).all(axis=1)
    sound &= np.abs((columns.stamps_ns - usual_ns).astype(np.float64)) < _OTHER_CLOCK
    t, first = np.unique((columns.stamps_ns[sound] - start_ns) * 1e-9, return_index=True)
    return t, columns.values[sound][first], int((~sound).sum())


def _log(
    ready: Mapping[tuple[int, str], tuple[FloatArray, FloatArray]],
    p: SlipEstimatorParameters,
    left_out: dict[str, int],
) -> Log:
    machine = p.vehicle.kinematics
    gyros, fixes, compasses, swing = [], [], [], None
    tracks = Tracks(np.empty(0), np.empty((0, 2)), np.empty((0, 2)))
    poses, stated, headings, angles = p.poses(), p.gyros(), p.compasses(), p.angles()
    for (kind, name), (t, values) in ready.items():
        if kind == SPROCKETS:
            tracks = Tracks(t, values[:, :2], angles_of(t, values[:, :2], values[:, 2:4]))
        elif kind == YAW_RATE and name in stated:
            imu = stated[name]
            rates = values[:, :3].copy()
            rates[:, 2] *= imu.sign / imu.scale
            turned = imu.mounting_roll, imu.mounting_pitch, imu.mounting_yaw
            stated_as = (imu.above, float(imu.sign), imu.scale, turned)
            gyros.append(Gyro(name, t, rates, values[:, 3:6], *stated_as))
        elif kind == POSE and name in poses:
            pose = poses[name]
            stddevs = np.sqrt(np.maximum(values[:, 3:5].mean(axis=1), pose.position_floor**2))
            lever = (0.0, 0.0) if pose.above else pose.lever[:2]
            fixes.append(Fixes(name, t, values[:, :2], stddevs, lever, pose.above))
            if np.isfinite(values[:, 2]).sum() > 2:
                compasses.append(Compass(name, t, values[:, 2], pose.use_heading, is_above=pose.above))
        elif kind == HEADING and name in headings:
            own = headings[name]
            compasses.append(Compass(name, t, values[:, 0] - own.offset, True, False, own.offset, own.above))
        elif kind == ON_SWING and name in angles:
            swing = t, values[:, 0] - angles[name].offset
    if swing is not None:
        compasses = [_of_undercarriage(one, swing) for one in compasses]
    geometry = Machine(machine.rolling_radius, machine.tread, machine.contact_length)
    return Log(geometry, tracks, tuple(gyros), tuple(fixes), tuple(compasses), swing, left_out)


def _of_undercarriage(compass: Compass, swing: tuple[FloatArray, FloatArray]) -> Compass:
    """Its headings less the swing, where it sits above."""
    if not compass.is_above or len(swing[0]) < 2:
        return compass
    angle = np.interp(compass.t, swing[0], np.unwrap(swing[1]))
    return replace(compass, headings=compass.headings - angle, is_above=False)
