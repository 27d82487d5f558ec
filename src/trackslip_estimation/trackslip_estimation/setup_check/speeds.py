# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Distance by tracks against distance by fixes: units of speed, rolling radius, gear of the drive.

    ρ = distance by fixes / distance by tracks = (1 − i) / f       i slip, f factor of the mistake

Slip seldom exceeds one half on a whole drive; downhill, it is negative by some per cent at most. Slip does
not explain ρ above 1.1. A wrong factor of 2 shows on the best ground of the log too.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_estimation.setup_check.drive import Drive
from trackslip_estimation.setup_check.finding import LEAST_LOG, PRIOR, Cause, Finding, OpenQuestion, odds_of
from trackslip_estimation.setup_check.fit import Scales
from trackslip_estimation.setup_check.log import Log, Machine
from trackslip_estimation.setup_check.turning import robust_stddev

_UNITS = {
    "rpm, declared rad/s": 60.0 / (2.0 * np.pi),
    "rad/s, declared rpm": 2.0 * np.pi / 60.0,
    "rev/s, declared rad/s": 1.0 / (2.0 * np.pi),
    "rad/s, declared rev/s": 2.0 * np.pi,
    "deg/s, declared rad/s": np.degrees(1.0),
    "rad/s, declared deg/s": np.radians(1.0),
    "rpm, declared rev/s": 60.0,
    "km/h, declared m/s": 3.6,
    "m/s, declared km/h": 1.0 / 3.6,
    "the diameter instead of the radius": 2.0,
    "half of the radius": 0.5,
    "mm/s, declared m/s": 1e3,
    "m/s, declared mm/s": 1e-3,
    "mph, declared m/s": 2.237,
    "cm/s, declared m/s": 1e2,
    "m/s, declared cm/s": 1e-2,
}
_FEET = 1.0 / 0.3048  # fixes in feet, declared m
_USUAL_TURN, _TURN_SPREAD = 0.6, 0.45  # κ of most machines and grounds, standard deviation of its ln
MOST_TURN, _TURN_NOISE = 1.15, 0.1  # κ that no machine exceeds, standard deviation of its error
_LEAST_WINDOWS = 5
_STRAIGHT = 0.9  # chord over path
_ENOUGH_PIECES = 20  # straight pieces
_RADIUS_RANGE = (1.10, 1.55)  # ρ, if the stated radius is too small
_MEAN_SLIP = 0.08  # mean of the exponential prior of the slip of a drive
_NEGATIVE_SLIP_STDDEV = 0.04  # standard deviation of negative slip
_LEAST_DISTANCE = 5.0  # m
_MOST_BEST_RATIO = 0.56  # ρ on the best ground; below it, the median counts too
_LEAST_WORST_RATIO = 1.05  # ρ on the worst ground, exceeded if a wrong unit makes ρ larger than 1
_GEAR = (1.4, 3.0)  # ratio of displacements
_LEAST_IN_GEAR = 4  # pieces
_LEAST_AHEAD = 3  # pieces with ρ that slip does not explain
_LEAST_HARD = 0.9  # ρ on the best ground; below it, slip or a wrong factor is possible
_EQUAL_LOG = float(np.log(10.0))  # ln likelihood ratio of units that slip does not distinguish
_BEST_PERCENTILE = 80.0  # percentile of ρ: the best ground of the drive


def rough_scale(drive: Drive) -> float:
    """ρ on the fastest straights, whatever the signs of the tracks; nan: too little motion."""
    distance, tracks = drive.fix_distances, drive.tracks_over_tread * drive.machine.tread
    is_finite = np.isfinite(distance) & np.isfinite(tracks).all(axis=1)
    if is_finite.sum() < _LEAST_WINDOWS:
        return float("nan")
    distance, tracks = distance[is_finite], tracks[is_finite]
    track_distance = np.maximum(np.abs(tracks.sum(axis=1)), np.abs(tracks[:, 1] - tracks[:, 0])) / 2.0
    is_fast = track_distance > 0.6 * np.percentile(track_distance, 95)
    is_fast &= track_distance > 0.0
    noise = 0.0 if drive.fixes is None else drive.fixes.noise
    if is_fast.sum() < 3 or float(np.median(distance[is_fast])) < max(3.0 * noise, 0.05):
        return float("nan")
    return float(np.percentile(distance[is_fast] / track_distance[is_fast], 70))


def speed_units(log: Log) -> Mapping[str, float]:
    """Ratio of the speed by the tracks to the true one, by mistake."""
    return {
        **_UNITS,
        "rad/s, declared m/s": 1.0 / log.machine.radius,
        "m/s, declared rad/s": log.machine.radius,
        "increments, declared speeds": float(np.median(np.diff(log.tracks.t))),
    }


def likely_unit(rho: float, units: Mapping[str, float]) -> float:
    """Factor of ``units`` that explains a rough ρ best; 1 where slip or a wrong radius may explain it."""
    if not np.isfinite(rho) or 0.3 <= rho <= 1.75:
        return 1.0
    return float(min(units.values(), key=lambda f: abs(np.log(rho * f))))


def slip_log(rho: float) -> float:
    """Ln density of ln ρ for right units: positive slip, or some per cent of negative slip."""
    slip = 1.0 - rho
    if slip >= 0.0:
        return -min(slip, 1.0) / _MEAN_SLIP
    return -0.5 * (slip / _NEGATIVE_SLIP_STDDEV) ** 2


def _turn_log(turn_ratio: float) -> float:
    """Ln density of ln κ; 0 where it is unknown."""
    if not np.isfinite(turn_ratio):
        return 0.0
    above = max(turn_ratio - MOST_TURN, 0.0) / _TURN_NOISE
    return -0.5 * ((float(np.log(turn_ratio / _USUAL_TURN)) / _TURN_SPREAD) ** 2 + above**2)


def piece_counts(scales: Scales) -> tuple[int, int]:
    """Number of straight pieces, up to enough of them, and of all pieces."""
    return min(int((scales.straight > _STRAIGHT).sum()), _ENOUGH_PIECES), len(scales.ratios)


class DistanceRatios(NamedTuple):
    """ρ by the recorded speeds, of n straight pieces; where these are too few, of the longer half of all."""

    values: FloatArray  # (n,)
    times: FloatArray  # (n,) s
    is_straight: bool
    worst_ground_ratio: float  # ρ without the lowest tenth of the pieces
    best_ground_ratio: float
    median: float
    robust_stddev: float
    half_interval: float  # half width of the 95 % interval of the median


def _distance_ratios(scales: Scales, factor: float) -> DistanceRatios:
    is_used = scales.straight > _STRAIGHT
    is_straight = bool(is_used.sum() >= _LEAST_WINDOWS)
    if not is_straight:
        is_used = scales.extents >= np.median(scales.extents)
    values, times = scales.ratios[is_used] / factor, scales.times[is_used]
    worst, best = np.percentile(values, (10.0, _BEST_PERCENTILE)).tolist()
    median = float(np.median(values))
    stddev = robust_stddev(values - median)
    half_interval = 2.0 * 1.25 * stddev / float(np.sqrt(len(values))) + 0.01 / factor
    return DistanceRatios(values, times, is_straight, worst, best, median, stddev, half_interval)


def judge_distance(
    scales: Scales | None, log: Log, factor: float, distance: float, turn_ratio: float
) -> list[Finding]:
    """Unit of the speeds, rolling radius and gear, by ρ; ``distance``: by the fixes, m.

    ``factor``: of the unit, undone in ``scales``. ``turn_ratio``: turn by the gyro over turn by the recorded
    tracks, which distinguishes fixes in feet from a wrong unit of the speeds; or nan.
    """
    if scales is None or len(scales.ratios) < _LEAST_WINDOWS or distance < _LEAST_DISTANCE:
        roughly = f": fixes go about {1.0 / factor:.2g} times as far as the tracks" if factor < 1.0 else ""
        what = f"unit of the speeds and rolling radius{roughly}"
        needed = "drive 10 m straight with fixes"
        return [OpenQuestion(what, needed, is_wrong=factor < 1.0)]  # slip does not explain it
    ratios, machine, units = _distance_ratios(scales, factor), log.machine, speed_units(log)
    best_ratio, middle = ratios.best_ground_ratio, ratios.median
    unit_logs = {name: slip_log(best_ratio * f) for name, f in units.items()}
    best = max(unit_logs, key=lambda name: unit_logs[name])
    gain = unit_logs[best] - max(slip_log(best_ratio), -60.0) - 1.0
    if best_ratio < _MOST_BEST_RATIO:  # on all ground
        gain = max(gain, slip_log(middle * units[best]) - slip_log(middle) - 1.0)
    if ratios.is_straight and (gear := _judge_gear(ratios)) is not None:
        return [gear]
    # slip only lowers ρ
    is_everywhere = ratios.worst_ground_ratio > _LEAST_WORST_RATIO if best_ratio > 1.0 else True
    is_radius = is_everywhere and ratios.is_straight  # in turns a lever arm has the same effect
    if is_radius and _RADIUS_RANGE[0] < middle - ratios.half_interval and middle <= _RADIUS_RANGE[1]:
        return [_radius_cause(ratios, machine)]
    if gain > LEAST_LOG and unit_logs[best] > -4.0 and not 0.55 < best_ratio < 1.3 and is_everywhere:
        value = units[best]
        by_speeds = unit_logs[best] + _turn_log(turn_ratio * value)
        if by_speeds < slip_log(best_ratio / _FEET) + _turn_log(turn_ratio) + LEAST_LOG:
            what = f"fixes go {best_ratio:.3g} times as far as the tracks: fixes in feet, or speeds ({best})"
            needed = "measure 10 m by tape and drive them; turn left and right by 90°"
            return [OpenQuestion(what, needed, is_wrong=True)]
        possible = " or ".join(name for name, log in unit_logs.items() if log > unit_logs[best] - _EQUAL_LOG)
        evidence = f"fixes go {best_ratio:.3g} times as far as the tracks"
        evidence += f"; as {possible}, {best_ratio * value:.2f} times"
        remedy = (
            "State the unit in which the speeds are (mapping: left_velocity and right_velocity: unit; "
            f"roles file: unit), or the gear of the motors (mapping: scale: {1.0 / value:.4g}; roles "
            f"file: ratio), or vehicle.kinematics.rolling_radius: {machine.radius / value:.4g}"
        )
        return [Cause("speed_unit", "sprockets", evidence, odds_of(gain), remedy)]
    gain = -max(slip_log(best_ratio), -60.0) - PRIOR
    if gain > LEAST_LOG and ratios.is_straight and not 1.0 < best_ratio < _GEAR[1]:
        evidence = (
            f"fixes go {best_ratio:.3g} times as far as the tracks: no slip, and no usual unit, does that"
        )
        remedy = (
            f"State the gear (roles file: ratio, counts_per_turn), or scale: {best_ratio:.3g} at "
            "left_velocity and right_velocity in the mapping"
        )
        return [Cause("speed_unit", "sprockets", evidence, odds_of(gain), remedy)]
    if middle - ratios.half_interval > _RADIUS_RANGE[0]:
        what = f"machine that goes {middle:.2f} times as far as its tracks: gear, unit or rolling radius"
        needed = "drive 20 m straight in each gear; a Web Mercator map is larger by 1/cos(latitude)"
        return [OpenQuestion(what, needed, is_wrong=ratios.is_straight)]
    ahead = int((ratios.values > _GEAR[0]).sum())
    if ahead >= max(_LEAST_AHEAD, 0.1 * len(ratios.values)):
        what = f"machine that goes {_GEAR[0]:g} times as far as its tracks, or more, in {ahead} pieces"
        return [OpenQuestion(f"{what}: gear", "drive 20 m straight in each gear")]
    if best_ratio < _LEAST_HARD:
        needed = "drive 10 m straight on hard level ground: there the tracks hardly slip"
        what = (
            f"slip of {1.0 - best_ratio:.0%}, a rolling radius that is too large, or another unit of the "
            "speeds"
        )
        return [OpenQuestion(what, needed)]
    return []


def _radius_cause(ratios: DistanceRatios, machine: Machine) -> Cause:
    rho, spread = ratios.median, ratios.half_interval
    low, high = (machine.radius * (rho + sign * spread) for sign in (-1.0, 1.0))
    evidence = f"the machine goes {rho:.3f} ± {spread:.3f} times as far as its tracks: no slip does that"
    remedy = f"Set vehicle.kinematics.rolling_radius: {machine.radius * rho:.3g} (m, {low:.3g} to {high:.3g})"
    log_ratio = 0.5 * ((rho - 1.0) / float(np.hypot(_NEGATIVE_SLIP_STDDEV, ratios.robust_stddev))) ** 2
    return Cause("rolling_radius", "sprockets", evidence, odds_of(log_ratio), remedy)


def _judge_gear(ratios: DistanceRatios) -> Cause | None:
    """The cause if ρ has two levels over time, the upper of which slip does not explain."""
    order = np.argsort(ratios.times)
    values = np.log(np.maximum(ratios.values[order], 1e-3))
    count = len(values)
    if count < 2 * _LEAST_IN_GEAR:
        return None
    is_high, scatter = _two_levels(values)
    low, high = values[~is_high], values[is_high]
    if min(len(low), len(high)) < _LEAST_IN_GEAR or (np.diff(is_high.astype(np.int64)) != 0).sum() > 3:
        return None
    low_ratio, high_ratio = float(np.exp(np.median(low))), float(np.exp(np.median(high)))
    ratio = high_ratio / low_ratio
    is_unusual = not 0.55 < low_ratio < 1.1
    if not _GEAR[0] < ratio < _GEAR[1] or high_ratio < 1.2 or is_unusual or scatter > 0.25 * np.log(ratio):
        return None
    evidence = (
        f"the machine goes {low_ratio:.2f} times as far as its tracks in {len(low)} pieces of the drive, and "
        f"{high_ratio:.2f} times in {len(high)}: a travel motor of another displacement"
    )
    remedy = (
        f"State the gear: speeds from flows are {ratio:.3g} times as large in the high gear; use "
        "left_position and right_position of the sprockets in the roles file, or record each gear by itself"
    )
    odds = odds_of(len(high) * 0.5 * ((high_ratio - 1.0) / 0.15) ** 2)
    return Cause("travel_gear", "sprockets", evidence, odds, remedy)


def _two_levels(values: FloatArray) -> tuple[BoolArray, float]:
    """(n,) smoothed flags of values at the high level, in time order; deviation of most from their level."""
    low, high = float(np.percentile(values, 10)), float(np.percentile(values, 90))
    is_high = values > (low + high) / 2.0
    for _ in range(5):
        smooth = majority_of_three(is_high)
        if smooth.all() or not smooth.any():
            break
        low, high = float(np.median(values[~smooth])), float(np.median(values[smooth]))
        is_high = values > (low + high) / 2.0
    smooth = majority_of_three(is_high)
    deviations = np.abs(values - np.where(smooth, high, low))
    return smooth, float(np.percentile(deviations, 80))


def majority_of_three(flags: BoolArray) -> BoolArray:
    """(n,) flags after a majority filter over each flag and its neighbours, twice."""
    for _ in range(2):
        padded = np.concatenate((flags[:1], flags, flags[-1:])).astype(np.int64)
        flags = padded[:-2] + padded[1:-1] + padded[2:] >= 2
    return flags
