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
from trackslip_tools.calibration.finding import Finding, found, refused
from trackslip_tools.calibration.recording import Recording, Series
from trackslip_tools.calibration.regression import Fit, Increments, clustered, of_increments
from trackslip_tools.calibration.spans import blocks, spans, unbroken

LEAST_TURN = 1.0  # rad, all turns together; fewer are not enough
_LARGEST_DELAY = 1.0  # s
_WIDEST_DELAY = 0.1  # s, half-width beyond which a delay is not reported
_LARGEST_HEADING_STDDEV = 0.3  # rad, stated standard deviation beyond which a heading is left out
_OUTLIER = 5.0  # robust standard deviations
_FLOOR = 5e-4  # rad, least standard deviation of a heading
_SHORTEST = 0.5  # s, of a turn
_MEAN_OF = 2.0  # s, block of headings that are averaged for the scale
_ROUNDS = 5  # Gauss–Newton steps, for the delay


class _Pair(NamedTuple):
    """Headings of a recording within the time of its gyro."""

    t: FloatArray  # (k,) s
    headings: FloatArray  # (k,) rad
    variances: FloatArray  # (k,)
    follows: BoolArray  # (k − 1,) whether the next heading is consistent with the gyro
    gyro: Series
    angle: CubicHermiteSpline  # Θ
    first: IntArray  # (n,) index of the first heading of each block

    def averaged(self) -> "_Pair":
        """The same, with headings in blocks of up to ``_MEAN_OF``."""
        first = [0]
        for k in range(1, len(self.t)):
            if self.t[k] - self.t[first[-1]] >= _MEAN_OF or not self.follows[k - 1]:
                first.append(k)
        return self._replace(first=np.array(first))

    def increments(self) -> Increments:
        """Increments of heading between block means, where ``kept``."""
        kept = self.kept
        joined = kept & np.concatenate(([False], kept[:-1]))
        variances = self._means(self.variances) / self._counts
        z, walk = np.diff(self._means(self.headings)), np.diff(self._means(self.t))
        return Increments(z[kept], variances[:-1][kept], variances[1:][kept], walk[kept], joined[kept])

    @property
    def kept(self) -> BoolArray:
        """(n − 1,) whether the heading increment is consistent, and the gyro has no gap."""
        last = np.append(self.first[2:], len(self.t)) - 1
        margins = self.t[self.first[:-1]] - _LARGEST_DELAY, self.t[last] + _LARGEST_DELAY
        return self.follows[self.first[1:] - 1] & unbroken(self.gyro.t, *margins)

    def design(self, delay: float) -> FloatArray:
        """(n, 3) increments of gyro angle, gyro rate and time between block means, where ``kept``."""
        at = self.t - delay
        columns = (self.angle(at), self.angle(at, 1), self.t)
        return np.column_stack([np.diff(self._means(column)) for column in columns])[self.kept]

    @property
    def _counts(self) -> IntArray:
        return np.diff(np.append(self.first, len(self.t)))

    def _means(self, values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values, self.first) / self._counts)


def mounting(recordings: Sequence[Recording]) -> dict[str, Finding]:
    """Roll and pitch that rotate the frame of the unit onto the machine's."""
    rows, clusters = [np.empty((0, 3))], [np.empty(0, dtype=np.int64)]
    for k, recording in enumerate(recordings):
        t, rates = recording.gyro
        for span in spans(recording, Motion.TURNING, _SHORTEST, settling=0.0):
            inside = recording.gyro.between(*span)
            rows.append(rates[inside])
            clusters.append(blocks(t[inside], 1.0, k))
    rates, cluster, turned = np.concatenate(rows), np.concatenate(clusters), _turned(recordings)
    if turned < LEAST_TURN:
        return dict.fromkeys(("imu_roll", "imu_pitch"), _too_little(turned, "rad"))
    X = np.column_stack((rates[:, 2], np.ones(len(rates))))
    findings = {}
    for name, leaning in (("imu_roll", rates[:, 1]), ("imu_pitch", -rates[:, 0])):
        fit = clustered(X, leaning, cluster)
        if fit is None:
            findings[name] = refused("one turn only", "rad")
        else:
            findings[name] = found(math.atan(fit.values[0]), fit.spread(), "rad", f"{turned:.1f} rad turned")
    return findings


def scale_and_delay(recordings: Sequence[Recording]) -> dict[str, Finding]:
    """Scale of the gyro with its sign, and delay of the headings' stamps against the gyro's."""
    pairs = [pair for pair in map(_pair, recordings) if pair is not None]
    late_of = "heading_delay" if any(recording.compass for recording in recordings) else "pose_delay"
    if not pairs:
        reason = "no heading of a pose or heading source while the gyro is recorded"
        return {"gyro_scale": refused(reason, "1"), late_of: refused(reason, "s")}
    turned = _turned(recordings)
    if turned < LEAST_TURN:
        return {"gyro_scale": _too_little(turned, "1"), late_of: _too_little(turned, "s")}
    (of_all, delay), (fit, _) = _fitted(pairs), _fitted([pair.averaged() for pair in pairs])
    if of_all is None or fit is None or not (of_all.values[0] and fit.values[0]):
        reason = "headings and gyro do not fit each other"
        return {"gyro_scale": refused(reason, "1"), late_of: refused(reason, "s")}
    basis = f"{sum(len(pair.t) for pair in pairs)} headings, {turned:.1f} rad turned"
    inverse = float(fit.values[0])
    uncertain = of_all.spread(1) / abs(float(of_all.values[0]))
    late = found(delay, uncertain, "s", basis)
    if uncertain > _WIDEST_DELAY:
        late = refused(f"the rate of turn changes too little to find it better than ±{uncertain:.2f} s", "s")
    return {"gyro_scale": found(1.0 / inverse, fit.spread() / inverse**2, "1", basis), late_of: late}


def _fitted(pairs: Sequence[_Pair]) -> tuple[Fit | None, float]:
    """Fit of 1/s, remaining δ/s, and b/s of each recording; and δ."""
    parts = [pair.increments() for pair in pairs]
    data = Increments(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    counts, delay, fit = [len(part.z) for part in parts], 0.0, None
    for _ in range(_ROUNDS):
        designs = [pair.design(delay) for pair in pairs]
        times = [np.where(np.arange(len(pairs)) == k, design[:, 2:], 0.0) for k, design in enumerate(designs)]
        X = np.column_stack((np.concatenate(designs)[:, :2], np.concatenate(times)))
        fit = of_increments(X, data)
        if fit is None or not sum(counts) or not fit.values[0]:
            return None, 0.0
        step = -float(fit.values[1] / fit.values[0])
        delay = min(max(delay + step, -_LARGEST_DELAY), _LARGEST_DELAY)
        if abs(step) < 1e-4:
            break
    return fit, delay


def _pair(recording: Recording) -> _Pair | None:
    """Headings and gyro; None if either is missing. Headings with a large variance are left out."""
    gyro, (t, shown) = recording.gyro, recording.headings
    if len(gyro.t) < 4:
        return None
    inside = (t >= gyro.t[0] + _LARGEST_DELAY) & (t <= gyro.t[-1] - _LARGEST_DELAY)
    certain = inside & (shown[:, 1] <= _LARGEST_HEADING_STDDEV**2)
    t, headings, variances = t[certain], shown[certain, 0], np.maximum(shown[certain, 1], _FLOOR**2)
    if len(t) < 4:
        return None
    angle = CubicHermiteSpline(gyro.t, recording.turned, gyro.values[:, 2])
    X = np.column_stack((angle(t), t, np.ones(len(t))))
    as_turned = X @ np.linalg.lstsq(X, headings, rcond=None)[0]
    rest = np.unwrap(headings - as_turned)  # removes whole turns, also after missing fixes
    steps = np.abs(np.diff(rest) - np.median(np.diff(rest)))
    follows = steps <= _OUTLIER * max(1.4826 * float(np.median(steps)), 10.0 * _FLOOR)
    if follows.sum() < 4:
        return None
    return _Pair(t, as_turned + rest, variances, follows, gyro, angle, np.arange(len(t)))


def _turned(recordings: Sequence[Recording]) -> float:
    """Sum of the gyro's angles over all turns, rad."""
    total = 0.0
    for recording in recordings:
        for span in spans(recording, Motion.TURNING, _SHORTEST, settling=0.0):
            within = recording.turned[recording.gyro.between(*span)]
            total += abs(float(within[-1] - within[0])) if len(within) else 0.0
    return total


def _too_little(turned: float, unit: str) -> Finding:
    return refused(f"turns of {turned:.2f} rad in all; needed: {LEAST_TURN:g} rad", unit)
