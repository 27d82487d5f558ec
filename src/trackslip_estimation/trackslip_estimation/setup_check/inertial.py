# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The inertial unit: a wrong mounting, unit or scale, or a large bias, by tracks, headings and fixes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check import remedies
from trackslip_estimation.setup_check.drive import DISTANCES, HEADING_NOISE, Drive
from trackslip_estimation.setup_check.finding import PRIOR, Cause, Finding, OpenQuestion, odds_of
from trackslip_estimation.setup_check.fit import Lever
from trackslip_estimation.setup_check.grid import WINDOW, window_sums
from trackslip_estimation.setup_check.heading import turn_logs
from trackslip_estimation.setup_check.log import Gyro
from trackslip_estimation.setup_check.turning import (
    LEAST_TURNS,
    PATTERNS,
    count_turns,
    fit_turns,
    has_standstill,
    known_windows,
    log_mixture_density,
    median_bias,
    robust_stddev,
    standstill_windows,
    turn_scale,
)
from trackslip_estimation.setup_check.unmoved import frozen_cause, frozen_share

UNITS = {  # reading per rad/s, by true and declared unit
    "deg/s, declared rad/s": np.degrees(1.0),
    "rad/s, declared deg/s": np.radians(1.0),
    "mrad/s, declared rad/s": 1e3,
    "rad/s, declared mrad/s": 1e-3,
    "deg/h, declared deg/s": 3600.0,
    "deg/s, declared deg/h": 1.0 / 3600.0,
    "deg/h, declared rad/s": 3600.0 * np.degrees(1.0),
    "rad/s, declared deg/h": np.radians(1.0) / 3600.0,
    "rpm, declared rad/s": 60.0 / (2.0 * np.pi),
    "rad/s, declared rpm": 2.0 * np.pi / 60.0,
    "mdeg/s, declared deg/s": 1e3,
}
EFFICIENCY = (0.08, 1.5)  # turn by the gyro over turn by the tracks, of any machine on any ground
_USUAL_EFFICIENCY = 0.6
_LARGE_BIAS, _LARGEST_BIAS = np.radians(2.0), np.radians(15.0)  # rad/s; a larger one is a wrong unit
_LEAST_COMPARED = 10  # windows
_LEAST_GAIN = 5.0  # ln likelihood ratio over no relation
_TRACK_GAIN = 3.0  # the same, of turns by the tracks
_UNIT_ERROR = 0.35  # of the ln of a scale by headings
_AXIS_GAIN = 8.0  # ln likelihood ratio of another axis over z
_MOST_TILT = np.radians(60.0)  # largest difference of roll or pitch of two places, on any hill
_TILT_NOISE = np.radians(12.0)  # error of that difference by accelerations
_GRAVITY = (7.5, 12.0)  # m/s²
_LEAST_CORRELATION = 0.85  # correlation of turns of one machine
_MOST_TURN = 3.0  # turn by the gyro over turn by the tracks, of any machine
_FASTEST = 8.0  # rad/s, yaw rate beyond any machine
_AXES = "xyz"
_MOST_FROZEN_SHARE = 0.5  # share of the recording
_LEAST_AXIS = 5  # windows in which an axis was recorded

_SCALES = (np.geomspace(0.42, 1 / 0.42, 19), np.geomspace(0.08, 1 / 0.08, 53))  # near ones first
_MOST_LOG_SCALE = np.log(1.11)  # largest magnitude of the ln scale of a gyro without a fault
_LEAST_SEGMENTS = 3  # of the path


@dataclass(frozen=True)
class GyroResult:
    """Findings, and the drive with their causes undone."""

    drive: Drive  # without a gyro where that shows no turns
    findings: tuple[Finding, ...] = ()
    unit: float = 1.0  # reading per rad/s, undone in ``drive``
    is_upside_down: bool = False
    is_contradicted: bool = False  # the unit of gyro or tracks is wrong; the log does not show which


def examine_gyro(drive: Drive, gyro: Gyro, *, is_unit_known: bool) -> GyroResult:
    """Frozen readings, axis, unit and bias of the gyro, not its sign; ``is_unit_known``: of the tracks."""
    drive = drive.with_gyro(gyro)
    gravity = gravity_direction(drive, gyro)
    frozen = frozen_cause(drive, gyro)
    if frozen is not None:
        return GyroResult(drive.with_gyro(None), (frozen,))
    gyro, found = _find_vertical_axis(drive, gyro, gravity)
    drive = drive.with_gyro(gyro)
    factor, unit_findings = _judge_unit(drive, gyro, is_unit_known=is_unit_known)
    found += unit_findings
    gyro = replace(gyro, rates=gyro.rates / factor)
    drive = drive.with_gyro(gyro)
    turn, tracks = drive.turn, drive.tracks_over_tread
    scale, ratio = turn_scale(turn, tracks), turn_ratio(turn, tracks)
    if scale > EFFICIENCY[1] or ratio > _MOST_TURN:
        times = f"{max(np.nan_to_num(scale), ratio):.3g} times as much as"
        also = _confirming_odometer(drive, scale) if is_unit_known else ""
        if also:
            what = f"machine that turns {times} its tracks, by gyro and {also}: the tread is too large"
            needed = (
                "measure vehicle.kinematics.tread (m): outer edge of one track to inner edge of the other"
            )
        else:
            what = f"gyro that turns {times} the tracks: unit of the gyro, or of the speeds, or the tread"
            needed = "turn left and right by 90° once each, with fixes"
        found.append(OpenQuestion(what, needed, is_wrong=True))
        return GyroResult(drive.with_gyro(None), tuple(found), is_contradicted=not is_unit_known)
    if (
        factor == 1.0
        and not drive.is_swing_unknown
        and frozen_share(gyro) < _MOST_FROZEN_SHARE
        and _is_unit_confirmed(drive)
    ):
        found += _judge_bias(drive, gyro)
    has_rates = bool(np.isfinite(gyro.rates).all(axis=1).mean() > 0.5)
    is_upside_down = gravity is not None and gravity[2] < -0.8 and has_rates
    return GyroResult(drive, tuple(found), factor, is_upside_down)


def _confirming_odometer(drive: Drive, scale: float) -> str:
    """The odometer that confirms a gyro turning ``scale`` times as much as the tracks; '' if none does."""
    by_heading = _scale_by_heading(drive)
    if by_heading is not None:
        return "heading" if abs(np.log(by_heading)) < _UNIT_ERROR else ""
    by_path = _unit_log_ratio(drive, scale / _USUAL_EFFICIENCY) if scale > 0.0 else None
    return "path of the fixes" if by_path is not None and by_path < -_LEAST_GAIN else ""


def gravity_direction(drive: Drive, gyro: Gyro) -> FloatArray | None:
    """(3,) unit vector of the specific force at standstill, or of the whole log; None: unknown."""
    force = force_at_rest(drive, gyro)
    size = 0.0 if force is None else float(np.linalg.norm(force))
    return force / size if force is not None and _GRAVITY[0] < size < _GRAVITY[1] else None


def force_at_rest(drive: Drive, gyro: Gyro) -> FloatArray | None:
    """(3,) median specific force at standstill, or of the whole log, as recorded; None: there is none."""
    is_finite = np.isfinite(gyro.accelerations).all(axis=1)
    if is_finite.sum() < 10:
        return None
    still = standstill_windows(drive.tracks_over_tread)
    window = np.searchsorted(drive.grid.window_edges, gyro.t, side="right") - 1
    inside = is_finite & (window >= 0) & (window < len(still))
    at_rest = inside.copy()
    at_rest[inside] = still[window[inside]]
    chosen = at_rest if at_rest.sum() >= 10 else is_finite
    return np.asarray(np.median(gyro.accelerations[chosen], axis=0))


def _find_vertical_axis(drive: Drive, gyro: Gyro, gravity: FloatArray | None) -> tuple[Gyro, list[Finding]]:
    """The gyro with its vertical axis as z, and the cause if that is another axis.

    No machine lies on its side: gravity along x or y is proof, unless z turns as the tracks do. Else an
    axis must turn by more than the machine tilts: on a hill, pitch is correlated with the tracks too.
    """
    turns, x = window_sums(drive.grid, drive.grid.turns), drive.tracks_over_tread
    axes = _axis_gains(turns, x, drive.heading_turn)
    best = int(np.argmax(axes.gains))
    is_known = np.isfinite(axes.gains).any() and frozen_share(gyro) <= _MOST_FROZEN_SHARE
    if not is_known or best == 2 or axes.by_tracks[2] > _LEAST_GAIN:
        return gyro, []
    vertical = None if gravity is None else int(np.argmax(np.abs(gravity)))
    if gravity is not None and vertical in (0, 1) and np.isfinite(turns[:, vertical]).sum() >= _LEAST_AXIS:
        log_ratio = max(float(axes.gains[vertical] - max(axes.gains[2], 0.0)), 0.0) + _AXIS_GAIN
        evidence = (
            f"gravity lies along its {_AXES[vertical]} axis, and it does not turn about z as the tracks do"
        )
        correction = rotation_to_vertical(vertical, float(np.sign(gravity[vertical])))
        return _remount(gyro, correction, "imu_mounting", evidence, log_ratio)
    log_ratio = float(axes.gains[best] - max(axes.gains[2], 0.0))
    spans = [_heading_range(turns[:, axis] / axes.units[best], x) for axis in (best, 2)]
    most = _MOST_TILT if gravity is None else min(2.0 * _tilt_range(gyro) + _TILT_NOISE, _MOST_TILT)
    if log_ratio < _AXIS_GAIN or spans[0] < most or spans[1] > min(most, 0.5 * spans[0]):
        return gyro, []
    evidence = f"the unit turns about its {_AXES[best]} axis as the tracks do, and not about z"
    return _remount(gyro, rotation_to_vertical(best, 1.0), "gyro_axis", evidence, log_ratio)


class _AxisGains(NamedTuple):
    """Evidence that x, y or z is vertical; −∞ where an axis shows no turns."""

    gains: FloatArray  # (3,) ln likelihood ratio by tracks and headings
    by_tracks: FloatArray  # (3,) the same by tracks alone
    units: FloatArray  # (3,) readings per rad/s


def _axis_gains(turns: FloatArray, x: FloatArray, heading_turn: FloatArray) -> _AxisGains:
    """Evidence for each axis, of turns (w, 3) in windows."""
    axes = _AxisGains(np.full(3, -np.inf), np.full(3, -np.inf), np.ones(3))
    for axis in range(3):
        scale = turn_scale(turns[:, axis], x)
        if np.isfinite(turns[:, axis]).sum() < _LEAST_AXIS or not scale > 0.0:
            continue
        axes.units[axis] = max(_fitting_unit(scale)[1], 1.0)  # a small turn is a tilt, no other unit
        axes.by_tracks[axis] = fit_turns(turns[:, axis], x, axes.units[axis]).logs.max()
        by_heading = turn_logs(heading_turn, turns[:, axis] / axes.units[axis])
        axes.gains[axis] = axes.by_tracks[axis] + max(by_heading[:2].max() - by_heading[2], 0.0)
    return axes


def _remount(
    gyro: Gyro, correction: FloatArray, name: str, evidence: str, log_ratio: float
) -> tuple[Gyro, list[Finding]]:
    """The gyro with ``correction`` (3, 3) applied, and the cause."""
    rates, accelerations = gyro.rates @ correction.T, gyro.accelerations @ correction.T
    remedy = remedies.mounting(gyro, correction)
    cause = Cause(name, gyro.name, evidence, odds_of(log_ratio), remedy)
    return replace(gyro, rates=rates, accelerations=accelerations), [cause]


def _heading_range(turn: FloatArray, x: FloatArray) -> float:
    """Range of the heading by turns (w,) in windows, less their bias, rad."""
    y, x = known_windows(turn, x)
    y = y - median_bias(y, x) * WINDOW
    return float(np.ptp(np.cumsum(y))) if len(y) else 0.0


def _tilt_range(gyro: Gyro) -> float:
    """Twice the largest tilt of gravity from its median direction, rad: the range of roll and pitch."""
    is_finite = np.isfinite(gyro.accelerations).all(axis=1)
    seconds = (gyro.t[is_finite] - gyro.t[0]).astype(np.int64)
    begins = np.flatnonzero(np.diff(seconds, prepend=-1))
    parts = np.split(gyro.accelerations[is_finite], begins[1:])
    means = np.array([np.median(part, axis=0) for part in parts])
    means /= np.linalg.norm(means, axis=1)[:, np.newaxis]
    usual = np.median(means, axis=0)
    leans = np.arccos(np.clip(means @ usual / np.linalg.norm(usual), -1.0, 1.0))
    return 2.0 * float(np.percentile(leans, 98))


def turn_ratio(turn: FloatArray, x: FloatArray) -> float:
    """Turn by the gyro over the largest turn that tracks of any signs explain; 0 for half a turn or less."""
    y, x = known_windows(turn, x)
    y = np.abs(y - median_bias(y, x) * WINDOW)
    most = np.maximum(np.abs(x[:, 1] - x[:, 0]), np.abs(x.sum(axis=1)))
    total = float(y.sum())
    return total / (float(most.sum()) + 0.5) if total > np.pi else 0.0


def rotation_to_vertical(axis: int, sign: float) -> FloatArray:
    """(3, 3) rotation that turns an axis of the unit, times ``sign``, upward."""
    if axis == 0:
        return remedies.rotation(0.0, -sign * np.pi / 2.0, 0.0)
    if axis == 1:
        return remedies.rotation(sign * np.pi / 2.0, 0.0, 0.0)
    return remedies.rotation(0.0 if sign > 0.0 else np.pi, 0.0, 0.0)


def _fitting_unit(scale: float, by_heading: float | None = None) -> tuple[str, float]:
    """Name and factor of the unit that makes a scale by the tracks a turning efficiency; '', 1 if it is one.

    Of several units, the nearest to the scale by headings, which do not slip, or to a usual efficiency. Where
    no unit fits the headings, their scale itself.
    """
    units = {"": 1.0, **UNITS}
    fitting = {name: one for name, one in units.items() if _is_usual(scale / one)}
    if by_heading is None and "" in fitting:
        return "", 1.0
    reference = scale / _USUAL_EFFICIENCY if by_heading is None else by_heading
    name, factor = min(fitting.items(), key=lambda item: abs(np.log(reference / item[1])), default=("", 1.0))
    is_none = by_heading is not None and abs(np.log(by_heading / factor)) > _UNIT_ERROR
    if by_heading is not None and is_none and _is_usual(scale / by_heading):
        return f"a scale of {by_heading:.3g}", by_heading
    return name, factor


def _is_usual(efficiency: float) -> bool:
    return EFFICIENCY[0] <= efficiency <= EFFICIENCY[1]


def _judge_unit(drive: Drive, gyro: Gyro, *, is_unit_known: bool) -> tuple[float, list[Finding]]:
    """Factor of the gyro's unit by the tracks, confirmed by headings or the path of the fixes; its finding.

    Without these two: tracks that turn more than the gyro may slip. Tracks that turn less may have a wrong
    unit, unless the distance of the fixes shows theirs, or no machine turns as fast as the gyro.
    """
    turn, x = drive.turn, drive.tracks_over_tread
    scale = turn_scale(turn, x)
    name, factor = _fitting_unit(scale, _scale_by_heading(drive))
    if factor == 1.0:
        return 1.0, []
    gain = float(fit_turns(turn, x, factor).logs.max())
    if count_turns(turn / factor) < LEAST_TURNS:
        return 1.0, []
    log_ratio = _unit_log_ratio(drive, factor)
    if log_ratio is None and factor > 1.0 and not is_unit_known and not _is_too_fast(turn):
        return 1.0, []
    if log_ratio is None and factor < 1.0:
        what = f"gyro that shows {scale:.3g} of what the tracks turn: tracks that slip, or {name}"
        return 1.0, [OpenQuestion(what, "record fixes while you turn left and right by 90° once each")]
    total = gain if log_ratio is None else max(gain, 0.0) + log_ratio
    if gain < _TRACK_GAIN or (log_ratio is not None and log_ratio < _LEAST_GAIN) or total < _LEAST_GAIN:
        return 1.0, []
    evidence = (
        f"the gyro turns {scale:.3g} times as much as the tracks; as {name}, it is {scale / factor:.2f} times"
    )
    remedy = remedies.gyro_scale(gyro, factor)
    return factor, [Cause("gyro_unit", gyro.name, evidence, odds_of(total), remedy)]


def _is_too_fast(turn: FloatArray) -> bool:
    known = np.abs(turn[np.isfinite(turn)])
    return bool(len(known) and np.percentile(known, 95) > _FASTEST * WINDOW)


def _unit_log_ratio(drive: Drive, factor: float) -> float | None:
    """Ln likelihood ratio of a unit over none, by headings or the path of the fixes; None without both."""
    scales, signs = np.array((factor, 1.0)), [(tracks, sign) for tracks in DISTANCES for sign in (1.0, -1.0)]
    if _scale_by_heading(drive) is not None:
        logs = heading_logs(drive, scales, 0.0)
    else:
        logs = path_logs(drive, scales, 0.0, signs)
    best = logs.max(axis=1)
    return float(best[0] - best[1]) if logs.any() else None


def _scale_by_heading(drive: Drive) -> float | None:
    """Turn by the gyro over turn by the headings; None where these do not turn, or are not correlated."""
    usable = np.isfinite(drive.turn) & np.isfinite(drive.heading_turn)
    y, h = drive.turn[usable], drive.heading_turn[usable]
    if (np.abs(h) > 2.0 * HEADING_NOISE).sum() < 3:
        return None
    y, h = y - np.median(y), h - np.median(h)
    correlation = float(np.sum(y * h) / np.sqrt(np.sum(y**2) * np.sum(h**2) + 1e-12))
    return abs(float(np.sum(y * h) / np.sum(h**2))) if abs(correlation) > _LEAST_CORRELATION else None


def _is_unit_confirmed(drive: Drive) -> bool:
    """Whether turns of tracks or headings confirm the unit of the gyro."""
    scale_by_heading = _scale_by_heading(drive)
    if scale_by_heading is not None and 0.6 < scale_by_heading < 1.6:
        return True
    scale = turn_scale(drive.turn, drive.tracks_over_tread)
    return bool(EFFICIENCY[0] < scale < EFFICIENCY[1]) and count_turns(drive.turn) >= LEAST_TURNS


def _judge_bias(drive: Drive, gyro: Gyro) -> list[Finding]:
    """The cause if the bias is large: at standstill and in motion, or against the turn of the headings."""
    result = _standstill_bias(drive.turn, drive.tracks_over_tread)
    result = result or _bias_by_heading(drive.turn, drive.heading_turn)
    if result is None:
        return []
    bias, log_ratio, evidence = result
    remedy = (
        "Let the unit find its bias at standstill, or subtract it: in the mapping "
        f"'origin: {bias:.5g}' (rad/s) at angular_velocity_z"
    )
    evidence = f"the gyro shows {np.degrees(bias):.1f} °/s {evidence}"
    return [Cause("gyro_bias", gyro.name, evidence, odds_of(log_ratio), remedy)]


def _standstill_bias(turn: FloatArray, x: FloatArray) -> tuple[float, float, str] | None:
    y, x = known_windows(turn, x)
    still = standstill_windows(x)
    if not has_standstill(x) or (~still).sum() < 3:
        return None
    bias = median_bias(y, x)
    if not _LARGE_BIAS <= abs(bias) <= _LARGEST_BIAS or robust_stddev(y[still] / WINDOW - bias) > 0.5 * abs(
        bias
    ):
        return None
    fit = fit_turns(y, x)
    best = int(np.argmax(fit.logs))
    residuals = y[~still] - float(fit.efficiencies[best]) * (x[~still] @ PATTERNS[best])
    variance = 0.05**2 + 0.02 * np.sum(x[~still] ** 2, axis=1)
    logs = [float(log_mixture_density(residuals - b * WINDOW, variance, 4.0).sum()) for b in (bias, 0.0)]
    if logs[0] < logs[1]:
        return None
    evidence = (
        f"while the tracks stand ({still.sum() * WINDOW:.0f} s), and so "
        "much more than they turn while they drive"
    )
    return bias, logs[0] - logs[1] + 2.0 * float(still.sum()), evidence


def _bias_by_heading(turn: FloatArray, heading_turn: FloatArray) -> tuple[float, float, str] | None:
    usable = np.isfinite(turn) & np.isfinite(heading_turn)
    if usable.sum() < _LEAST_COMPARED:
        return None
    excess = (turn - heading_turn)[usable] / WINDOW
    bias = float(np.median(excess))
    stddev = 1.25 * robust_stddev(excess - bias) / float(np.sqrt(len(excess))) + 1e-4
    if (
        abs(bias) - 3.0 * stddev < _LARGE_BIAS
        or abs(bias) > _LARGEST_BIAS
        or (np.sign(excess) == np.sign(bias)).mean() < 0.8
    ):
        return None
    evidence = f"more than the headings turn, in {len(excess)} pieces of {WINDOW:g} s"
    return bias, 0.5 * (bias / stddev) ** 2, evidence


def upside_down_cause(gyro: Gyro, log_odds: float) -> Cause:
    """The cause if turns and gravity are both inverted."""
    evidence = "turns about z and gravity along z are both the other way round: the unit hangs upside down"
    remedy = remedies.mounting(gyro, rotation_to_vertical(2, -1.0))
    return Cause("imu_mounting", gyro.name, evidence, odds_of(log_odds), remedy)


def judge_scale(drive: Drive, unit: float, lever: Lever | None) -> Cause | None:
    """The cause if the scale is wrong, of a drive with right signs; ``unit``: undone readings per rad/s.

    By headings and the path of the fixes: tracks slip. Scales that are wrong units are undone before.
    ``lever``: correction of the lever arm of the fixes, which may explain their path instead.
    """
    if drive.gyro is None:
        return None
    by_lever = 0.0 if lever is None else lever.log_ratio
    causes = (_judge_scales(drive, drive.gyro, scales, unit, by_lever) for scales in _SCALES)
    return next((cause for cause in causes if cause is not None), None)


def _judge_scales(drive: Drive, gyro: Gyro, scales: FloatArray, unit: float, by_lever: float) -> Cause | None:
    bias = drive.turn_fit.bias
    logs_by_reference = {
        "its headings": heading_logs(drive, scales, bias)[:, 0],
        "the path of the fixes": path_logs(drive, scales, bias, [(np.ones(2), 1.0)])[:, 0],
    }
    references = {name: logs for name, logs in logs_by_reference.items() if logs.any()}
    if not references:
        return None
    is_right = np.abs(np.log(scales)) <= _MOST_LOG_SCALE
    total = np.sum(list(references.values()), axis=0)
    best = int(np.argmax(total))
    gain = float(total[best] - total[is_right].max())
    if best in (0, len(scales) - 1) or gain < PRIOR + by_lever:  # at an end: no maximum
        return None
    turns = count_turns((drive.turn - bias * WINDOW) / scales[best])
    if turns < LEAST_TURNS or any(logs[best] < logs[is_right].max() for logs in references.values()):
        return None
    scale = unit * float(scales[best])
    evidence = f"the gyro shows {scale:.2g} times what the machine turns by {' and '.join(references)}"
    return Cause("gyro_unit", gyro.name, evidence, odds_of(gain), remedies.gyro_scale(gyro, scale))


def heading_logs(drive: Drive, scales: FloatArray, bias: float) -> FloatArray:
    """(s, 2) ln likelihood of each scale: headings with the gyro, or against it; zeros without headings."""
    turn = drive.turn - bias * WINDOW
    return np.array([turn_logs(drive.heading_turn, turn / scale)[:2] for scale in scales])


def path_logs(
    drive: Drive, scales: FloatArray, bias: float, signs: Sequence[tuple[FloatArray, float]]
) -> FloatArray:
    """(s, k) ln likelihood of each scale by the path of the fixes; zeros where too little of it was recorded.

    ``signs``: k pairs, of both tracks (2,) and of the gyro.
    """
    turn = drive.grid.turns[:, 2] - bias * drive.grid.cell
    fits = drive.path_fits([(tracks, sign * turn / scale) for scale in scales for tracks, sign in signs])
    logs = fits.logs.reshape(len(scales), len(signs))
    return logs if fits.segments >= _LEAST_SEGMENTS else np.zeros_like(logs)
