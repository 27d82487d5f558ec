# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Calibrates the gyro against the headings of poses and the axis of turns: scale, sign, delay, mounting.

z, ω     rates of the unit about its axes, turn of the machine about the vertical   rad/s
n        vertical in the frame of the unit, z = s₀ ω n + b                          1
s, b     scale about the unit's z axis, s₀ n_z, and bias                            1, rad/s
ψ_k, δ   headings of the poses, and the delay of their stamps                       rad, s
Θ(t)     integral of z about the unit's z axis                                      rad

    ψ_k − ψ_{k−1} = [Θ(t_k − δ) − Θ(t_{k−1} − δ) − b (t_k − t_{k−1})] / s + noise

A machine on a plane turns about the plane's normal, so n is the mounting on any slope. A tilt of n from z
reduces s by its cosine. Turns cannot show the rotation of the unit about z.

The noise of z and the delay of headings make short increments of Θ larger than the turn: s would be too
large by a per cent at 10 Hz. Therefore s is found from means over two seconds, and δ from all increments.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_estimation.slip.motion import Motion
from trackslip_tools.calibration.finding import Finding, empty_finding, empty_findings, make_finding
from trackslip_tools.calibration.recording import Recording, Series
from trackslip_tools.calibration.regression import Fit, Increments, fit_clustered, fit_increments
from trackslip_tools.calibration.spans import are_covered, block_numbers, motion_spans

LEAST_TURN = 1.0  # rad, all turns together; fewer are not enough
_LARGEST_DELAY = 1.0  # s
_LARGEST_DELAY_UNCERTAINTY = 0.1  # s, half-width beyond which a delay is not reported
_LARGEST_HEADING_STDDEV = 0.3  # rad, stated standard deviation beyond which a heading is left out
_OUTLIER_SIGMAS = 5.0  # robust standard deviations
_MIN_HEADING_STDDEV = 5e-4  # rad, least standard deviation of a heading
_SHORTEST_TURN = 0.5  # s, of a turn
_BLOCK_LENGTH = 2.0  # s, block of headings that are averaged for the scale
_ITERATIONS = 5  # Gauss–Newton steps, for the delay
_MOUNTING_UNITS = {"imu_roll": "rad", "imu_pitch": "rad"}


class _HeadingsWithGyro(NamedTuple):
    """Headings of a recording within the time of its gyro."""

    t: FloatArray  # (k,) s
    headings: FloatArray  # (k,) rad
    variances: FloatArray  # (k,)
    is_consistent: BoolArray  # (k − 1,) whether the next heading is consistent with the gyro
    gyro: Series
    angle: CubicHermiteSpline  # Θ
    first: IntArray  # (n,) index of the first heading of each block

    def with_block_means(self) -> "_HeadingsWithGyro":
        """The same, with headings in blocks of up to ``_BLOCK_LENGTH``."""
        first = [0]
        for k in range(1, len(self.t)):
            if self.t[k] - self.t[first[-1]] >= _BLOCK_LENGTH or not self.is_consistent[k - 1]:
                first.append(k)
        return self._replace(first=np.array(first))

    def increments(self) -> Increments:
        """Increments of heading between block means, where ``is_usable``."""
        usable = self.is_usable
        joined = usable & np.concatenate(([False], usable[:-1]))
        variances = self._block_means(self.variances) / self._block_sizes
        z, walk = np.diff(self._block_means(self.headings)), np.diff(self._block_means(self.t))
        return Increments(
            z[usable], variances[:-1][usable], variances[1:][usable], walk[usable], joined[usable]
        )

    @property
    def is_usable(self) -> BoolArray:
        """(n − 1,) whether the heading increment is consistent, and the gyro has no gap."""
        last = np.append(self.first[2:], len(self.t)) - 1
        margins = self.t[self.first[:-1]] - _LARGEST_DELAY, self.t[last] + _LARGEST_DELAY
        return self.is_consistent[self.first[1:] - 1] & are_covered(self.gyro.t, *margins)

    def design_matrix(self, delay: float) -> FloatArray:
        """(n, 3) increments of gyro angle, gyro rate and time between block means, where ``is_usable``."""
        gyro_times = self.t - delay
        columns = (self.angle(gyro_times), self.angle(gyro_times, 1), self.t)
        return np.column_stack([np.diff(self._block_means(column)) for column in columns])[self.is_usable]

    @property
    def _block_sizes(self) -> IntArray:
        return np.diff(np.append(self.first, len(self.t)))

    def _block_means(self, values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values, self.first) / self._block_sizes)


def mounting_angles(recordings: Sequence[Recording]) -> dict[str, Finding]:
    """Roll and pitch that rotate the frame of the unit onto the machine's."""
    rows, clusters = [np.empty((0, 3))], [np.empty(0, dtype=np.int64)]
    for k, recording in enumerate(recordings):
        t, rates = recording.gyro
        for span in motion_spans(recording, Motion.TURNING, _SHORTEST_TURN, settling=0.0):
            inside = recording.gyro.slice_between(*span)
            rows.append(rates[inside])
            clusters.append(block_numbers(t[inside], 1.0, k))
    rates, cluster, total = np.concatenate(rows), np.concatenate(clusters), _total_turn(recordings)
    if total < LEAST_TURN:
        return empty_findings(_insufficient_turn(total), _MOUNTING_UNITS)
    if not np.ptp(rates[:, :2], axis=0).all():
        return empty_findings(
            "the gyro measures one axis: its rates about x or y never change", _MOUNTING_UNITS
        )
    X = np.column_stack((rates[:, 2], np.ones(len(rates))))
    findings = {}
    for name, rate in (("imu_roll", rates[:, 1]), ("imu_pitch", -rates[:, 0])):
        fit = fit_clustered(X, rate, cluster)
        if fit is None:
            findings[name] = empty_finding("one turn only", "rad")
        else:
            findings[name] = make_finding(
                math.atan(fit.values[0]), fit.half_width(), "rad", f"{total:.1f} rad turned"
            )
    return findings


def scale_and_delay(recordings: Sequence[Recording]) -> dict[str, Finding]:
    """Scale of the gyro with its sign, and delay of the headings' stamps against the gyro's."""
    pairs = [pair for pair in map(_match_headings, recordings) if pair is not None]
    delay_name = "heading_delay" if any(recording.compass for recording in recordings) else "pose_delay"
    units = {"gyro_scale": "1", delay_name: "s"}
    if not pairs:
        reason = "no heading of a pose or heading source while the gyro is recorded"
        return empty_findings(reason, units)
    total = _total_turn(recordings)
    if total < LEAST_TURN:
        return empty_findings(_insufficient_turn(total), units)
    fit_of_all, delay = _fit_scale_and_delay(pairs)
    fit, _ = _fit_scale_and_delay([pair.with_block_means() for pair in pairs])
    if fit_of_all is None or fit is None or not (fit_of_all.values[0] and fit.values[0]):
        return empty_findings("headings and gyro do not fit each other", units)
    basis = f"{sum(len(pair.t) for pair in pairs)} headings, {total:.1f} rad turned"
    inverse = float(fit.values[0])
    half_width = fit_of_all.half_width(1) / abs(float(fit_of_all.values[0]))
    delay_finding = make_finding(delay, half_width, "s", basis)
    if half_width > _LARGEST_DELAY_UNCERTAINTY:
        delay_finding = empty_finding(
            f"the rate of turn changes too little to find it better than ±{half_width:.2f} s", "s"
        )
    return {
        "gyro_scale": make_finding(1.0 / inverse, fit.half_width() / inverse**2, "1", basis),
        delay_name: delay_finding,
    }


def _fit_scale_and_delay(pairs: Sequence[_HeadingsWithGyro]) -> tuple[Fit | None, float]:
    """Fit of 1/s, remaining δ/s, and b/s of each recording; and δ."""
    parts = [pair.increments() for pair in pairs]
    data = Increments.of_parts(parts)
    counts, delay, fit = [len(part.z) for part in parts], 0.0, None
    for _ in range(_ITERATIONS):
        designs = [pair.design_matrix(delay) for pair in pairs]
        times = [np.where(np.arange(len(pairs)) == k, design[:, 2:], 0.0) for k, design in enumerate(designs)]
        X = np.column_stack((np.concatenate(designs)[:, :2], np.concatenate(times)))
        fit = fit_increments(X, data)
        if fit is None or not sum(counts) or not fit.values[0]:
            return None, 0.0
        step = -float(fit.values[1] / fit.values[0])
        delay = min(max(delay + step, -_LARGEST_DELAY), _LARGEST_DELAY)
        if abs(step) < 1e-4:
            break
    return fit, delay


def _match_headings(recording: Recording) -> _HeadingsWithGyro | None:
    """Headings and gyro; None if either is missing. Headings with a large variance are left out."""
    gyro, (t, readings) = recording.gyro, recording.headings
    if len(gyro.t) < 4:
        return None
    inside = (t >= gyro.t[0] + _LARGEST_DELAY) & (t <= gyro.t[-1] - _LARGEST_DELAY)
    usable = inside & (readings[:, 1] <= _LARGEST_HEADING_STDDEV**2)
    t, headings = t[usable], readings[usable, 0]
    variances = np.maximum(readings[usable, 1], _MIN_HEADING_STDDEV**2)
    if len(t) < 4:
        return None
    angle = CubicHermiteSpline(gyro.t, recording.gyro_angle, gyro.values[:, 2])
    X = np.column_stack((angle(t), t, np.ones(len(t))))
    predicted = X @ np.linalg.lstsq(X, headings, rcond=None)[0]
    residuals = np.unwrap(headings - predicted)  # removes whole turns, also after missing fixes
    steps = np.abs(np.diff(residuals) - np.median(np.diff(residuals)))
    consistent = steps <= _OUTLIER_SIGMAS * max(1.4826 * float(np.median(steps)), 10.0 * _MIN_HEADING_STDDEV)
    if consistent.sum() < 4:
        return None
    return _HeadingsWithGyro(t, predicted + residuals, variances, consistent, gyro, angle, np.arange(len(t)))


def _total_turn(recordings: Sequence[Recording]) -> float:
    """Sum of the gyro's angles over all turns, rad."""
    total = 0.0
    for recording in recordings:
        for span in motion_spans(recording, Motion.TURNING, _SHORTEST_TURN, settling=0.0):
            within = recording.gyro_angle[recording.gyro.slice_between(*span)]
            total += abs(float(within[-1] - within[0])) if len(within) else 0.0
    return total


def _insufficient_turn(total: float) -> str:
    return f"turns of {total:.2f} rad in all; needed: {LEAST_TURN:g} rad"
