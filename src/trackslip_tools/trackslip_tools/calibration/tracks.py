# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Calibrates the tracks against poses and gyro: distance per sprocket angle, turn per angle difference.

θ̄, Δ     mean of both sprocket angles, right less left                  rad
r, i₀    rolling radius, slip common to both tracks                     m, 1
B, κ     tread, turning efficiency                                      m, 1
ε        side asymmetry                                                 rad/m
s, Ψ     distance along the heading, turn (of the gyro, less its bias)  m, rad

    straight    ds = r (1 − i₀) dθ̄            turning    dΨ = (r κ/B) dΔ + ε r dθ̄

Straights cannot separate r from slip, and turns cannot separate κ from 1/B: tracks turn by sliding, on hard
ground too (dry clay: κ about 0.5). The tread is therefore not estimated here. B is measured with a tape; B/κ
is the effective tread for plain dead reckoning on this ground.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_estimation.slip.motion import Motion
from trackslip_tools.calibration.finding import Finding, empty_finding, make_finding
from trackslip_tools.calibration.recording import Recording
from trackslip_tools.calibration.regression import Increments, fit_clustered, fit_increments
from trackslip_tools.calibration.spans import Span, are_covered, motion_spans

LEAST_DISTANCE = 3.0  # m, all straights together
LEAST_TURNS = 3
_SHORTEST_STRAIGHT, _SHORTEST_TURN = 2.0, 1.5  # s
_LEAST_FIXES = 4  # per straight
_MIN_POSITION_STDDEV = 1e-3  # m, least standard deviation of a fix
_COMPLEX = np.array((1.0, 1.0j))


class Gyro(NamedTuple):
    """Scale and bias of the gyro."""

    scale: float  # negative if mounted upside down
    bias: float  # rad/s

    def headings(self, recording: Recording, t: FloatArray) -> FloatArray:
        """(n,) angles turned at these times, up to a common constant, rad; needs a recorded gyro."""
        angles = np.interp(t, recording.gyro.t, recording.gyro_angle)
        return np.asarray((angles - self.bias * t) / self.scale)


class TurningGain(NamedTuple):
    """Turning of the machine per sprocket angle."""

    gain: Finding  # r κ/B, 1
    stddev: float  # standard deviation of r κ/B from turn to turn


def distance_per_radian(recordings: Sequence[Recording], gyro: Gyro) -> Finding:
    """r (1 − i₀), from the straights."""
    parts = []
    for recording in recordings:
        straights = motion_spans(recording, Motion.STRAIGHT, _SHORTEST_STRAIGHT)
        for span, has_gyro in zip(straights, _has_gyro(recording, straights), strict=True):
            part = _straight_increments(recording, span, gyro if has_gyro else None)
            parts += [] if part is None else [part]
    distance = sum(float(np.abs(data.z.sum())) for data, _ in parts)
    if distance < LEAST_DISTANCE:
        return empty_finding(
            f"straights with fixes of {distance:.1f} m in all; needed: {LEAST_DISTANCE:g} m", "m"
        )
    data = Increments.of_parts([part for part, _ in parts])
    fit = fit_increments(np.concatenate([angles for _, angles in parts])[:, np.newaxis], data)
    if fit is None:
        return empty_finding("too few fixes on the straights", "m")
    return make_finding(fit.values[0], fit.half_width(), "m", f"{len(parts)} straights, {distance:.1f} m")


def turning_gain(recordings: Sequence[Recording], gyro: Gyro) -> TurningGain:
    """r κ/B, from the turns."""
    turned, differences = np.empty(0), np.empty(0)
    for recording in recordings:
        edges = _edges_with_gyro(recording, Motion.TURNING, _SHORTEST_TURN)
        if len(edges):
            angles = np.interp(edges, recording.sprockets.t, recording.angle_difference)
            differences = np.append(differences, np.diff(angles))
            turned = np.append(turned, np.diff(gyro.headings(recording, edges)))
    if len(turned) < LEAST_TURNS:
        reason = f"{len(turned)} turns of {_SHORTEST_TURN:g} s with the gyro recorded; needed: {LEAST_TURNS}"
        return TurningGain(empty_finding(reason, "1"), float("nan"))
    fit = fit_clustered(differences[:, np.newaxis], turned, np.arange(len(turned)))
    if fit is None or not fit.values[0]:
        return TurningGain(empty_finding("a single turn determines the result", "1"), float("nan"))
    basis = f"{len(turned)} turns, {np.abs(turned).sum():.1f} rad"
    return TurningGain(
        make_finding(fit.values[0], fit.half_width(), "1", basis), float(np.std(turned / differences, ddof=1))
    )


def asymmetry(recordings: Sequence[Recording], gyro: Gyro, gain: Finding, radius: float) -> Finding:
    """ε, from the straights; ``gain`` is r κ/B."""
    if gain.value is None:
        return empty_finding(gain.reason, "rad/m")
    turned, distances = np.empty(0), np.empty(0)
    for recording in recordings:
        edges = _edges_with_gyro(recording, Motion.STRAIGHT, _SHORTEST_STRAIGHT)
        if len(edges):
            t = recording.sprockets.t
            distances = np.append(distances, radius * np.diff(np.interp(edges, t, recording.mean_angle)))
            steered = gain.value * np.diff(np.interp(edges, t, recording.angle_difference))
            turned = np.append(turned, np.diff(gyro.headings(recording, edges)) - steered)
    distance = float(np.abs(distances).sum())
    is_enough, numbers = distance >= LEAST_DISTANCE, np.arange(len(turned))
    fit = fit_clustered(distances[:, np.newaxis], turned, numbers) if is_enough else None
    if fit is None:
        return empty_finding(
            f"straights with the gyro of {distance:.1f} m; needed: {LEAST_DISTANCE:g} m", "rad/m"
        )
    return make_finding(
        fit.values[0], fit.half_width(), "rad/m", f"{len(distances)} straights, {distance:.1f} m"
    )


def _edges_with_gyro(recording: Recording, motion: Motion, least: float) -> FloatArray:
    """(n, 2) begin and end of the spans of ``motion``, ≥ ``least`` s, with the gyro recorded."""
    spans = motion_spans(recording, motion, least)
    edges: FloatArray = np.array(spans).reshape(-1, 2)[_has_gyro(recording, spans)]
    return edges


def _has_gyro(recording: Recording, stretches: Sequence[Span]) -> BoolArray:
    """(n,) whether the gyro was recorded throughout each span."""
    begins, ends = np.array(stretches).reshape(-1, 2).T
    return are_covered(recording.gyro.t, begins, ends)


def _straight_increments(
    recording: Recording, span: Span, gyro: Gyro | None
) -> tuple[Increments, FloatArray] | None:
    """Distances between fixes along the heading, and sprocket angles; None with few fixes or no motion.

    The recorded gyro gives the heading within the straight. The track of fixes is rotated so that its end
    lies straight ahead of its start.
    """
    inside = recording.poses.slice_between(*span)
    t, fixes = recording.poses.t[inside], recording.poses.values[inside]
    if len(t) < _LEAST_FIXES:
        return None
    steps = np.diff(fixes[:, :2], axis=0) @ _COMPLEX
    if gyro is not None:
        steps = steps * np.exp(-1j * gyro.headings(recording, (t[1:] + t[:-1]) / 2.0))
    angles = np.diff(np.interp(t, recording.sprockets.t, recording.mean_angle))
    total = np.sum(steps) * np.sign(np.sum(angles))
    if total == 0.0:
        return None
    along = np.real(steps * np.conj(total) / abs(total))
    variances = np.maximum(fixes[:, 3:5].mean(axis=1), _MIN_POSITION_STDDEV**2)
    joined = np.arange(len(along)) > 0
    return Increments(along, variances[:-1], variances[1:], np.abs(angles), joined), angles
