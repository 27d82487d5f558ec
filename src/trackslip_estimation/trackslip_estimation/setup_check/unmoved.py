# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sources that do not follow the motion: frozen fixes or gyro, unrelated turns, unsigned encoders."""

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_estimation.setup_check import remedies
from trackslip_estimation.setup_check.drive import HEADING_NOISE, USUAL_EFFICIENCY, Drive
from trackslip_estimation.setup_check.equal_runs import equal_runs
from trackslip_estimation.setup_check.finding import LEAST_LOG, READ_OFF, Cause, Finding, OpenQuestion
from trackslip_estimation.setup_check.grid import WINDOW, running_sum, window_sums
from trackslip_estimation.setup_check.log import Fixes, Gyro, Log
from trackslip_estimation.setup_check.path import thin_fixes
from trackslip_estimation.setup_check.quantities import explained_distance, explained_share
from trackslip_estimation.setup_check.sides import FASTEST
from trackslip_estimation.setup_check.speeds import MOST_TURN
from trackslip_estimation.setup_check.turning import LEAST_TURNS, count_turns

_LEAST_DISTANCE = 10.0  # m, by the tracks
_LEAST_EXTENT = 5e-3  # m, extent of the fixes of any receiver within minutes
_ERRORS, _SPACING = 10.0, 1.0  # standard deviations of wandering fixes; s between those that show motion
_STILL = 1e-4  # extent of the fixes, share of the distance: no path is so narrow
_LEAST_PLACES = 10
_REPEATED = 0.5  # share of the distance
_LONGEST_HOLD = 5.0  # s for which a log may hold the last fix
_LEAST_RATIO = 0.018  # share of the distance: radians taken for degrees are 0.0175, less by slip
_RELATED, _UNRELATED = 0.8, 0.2  # R²
_LEAST_WINDOWS = 20
_ROUNDING = 1e-9  # m
_TURNING, _LEAST_TURNING = 0.1, 5  # rad in a window, and in how many

_LEAST_EQUAL = 50  # equal readings in a span
_MOST_SPANS = 10  # spans that are examined
_LEAST_HIDDEN_TURN = np.radians(40.0)  # of the machine, which the gyro does not show
_EFFICIENCIES = (-0.9, -0.7, -0.5, 0.5, 0.7, 0.9)  # turning efficiencies that are tried, of either sign
_LEAST_EFFICIENCY = 0.25  # turning efficiency of the tracks, low as on ice


def judge_fixes(drive: Drive) -> list[Finding]:
    """Fixes that repeat, stay at one place, or move far too little while the tracks move."""
    fixes = drive.fixes
    if fixes is None or len(fixes.t) < _LEAST_PLACES:
        return []
    name, repeated = fixes.name, _repeated_distance(drive, fixes)
    distance = float(np.nansum(np.abs(drive.grid.tracks).max(axis=1)))
    if distance < _LEAST_DISTANCE:
        return []
    if repeated > max(_REPEATED * distance, _LEAST_DISTANCE):
        what = f"{name} repeats its positions while the tracks drive {repeated:.0f} m: "
        what += "a receiver that is frozen, or another column"
        needed = "watch the live positions while the machine drives"
        return [OpenQuestion(what, needed, is_wrong=True)]
    if (axis := _constant_axis(drive, fixes)) is not None:
        what = f"{axis} of {name} never changes while the machine drives {distance:.0f} m, and turns"
        return [OpenQuestion(what, f"name the column of {axis} in the mapping", is_wrong=True)]
    if (ratio := _wrong_unit_ratio(drive)) > 0.0:
        evidence = (
            f"its positions move as the tracks do, but {ratio:.2g} times as far: no machine slips so evenly"
        )
        remedy = (
            "State the unit of the positions in the mapping: x and y: unit (km), latitude and longitude: "
            "unit (rad), or their frame"
        )
        return [Cause("frame", name, evidence, READ_OFF, remedy)]
    extent = float(np.ptp(fixes.places, axis=0).max())
    if extent > min(_LEAST_EXTENT, _STILL * distance):
        return []
    evidence = (
        f"its positions differ by {extent:.2g} m while the tracks drive {distance:.0f} m: every receiver has "
        "more noise, so they are in another unit"
    )
    remedy = "Call the columns latitude and longitude in the mapping, or state the unit of x and y"
    return [Cause("frame", name, evidence, READ_OFF, remedy)]


def _constant_axis(drive: Drive, fixes: Fixes) -> str | None:
    """The axis whose coordinates are all the same, though the machine turns."""
    left, right = drive.tracks_over_tread.T
    turn = USUAL_EFFICIENCY * (right - left) if drive.gyro is None else drive.unbiased_turn
    is_constant = np.ptp(fixes.places, axis=0) == 0.0
    if is_constant.sum() != 1 or count_turns(turn) < LEAST_TURNS:
        return None
    return "xy"[int(np.argmax(is_constant))]


def _wrong_unit_ratio(drive: Drive) -> float:
    """Distance of fixes in another unit over that by the tracks; 0 for fixes in m, and for constant ones."""
    by_tracks = np.abs(drive.tracks_over_tread).max(axis=1) * drive.machine.tread
    share, windows = explained_distance(drive)
    is_fixed = np.isfinite(drive.fix_distances) & np.isfinite(by_tracks)
    if windows < _LEAST_WINDOWS or share < _RELATED or np.nanpercentile(by_tracks, 95) > FASTEST * WINDOW:
        return 0.0
    ratio = float(drive.fix_distances[is_fixed].sum() / by_tracks[is_fixed].sum())
    return ratio if ratio < _LEAST_RATIO else 0.0


def _repeated_distance(drive: Drive, fixes: Fixes) -> float:
    """Distance by the tracks, m, while fixes stayed bit for bit the same, longer than a logger holds one."""
    distances = running_sum(np.nan_to_num(np.abs(drive.grid.tracks).max(axis=1)))
    runs = equal_runs(fixes.centred_places)
    first, last = fixes.t[runs.first], fixes.t[runs.last]
    is_held = last - first > _LONGEST_HOLD
    begin, end = (np.interp(t[is_held], drive.grid.edges, distances) for t in (first, last))
    return float(np.sum(end - begin))


def judge_dead_tracks(log: Log) -> list[Finding]:
    """Fixes that move farther than their errors, or a swing, explain, of tracks that never count."""
    for fixes in log.fixes:
        places = thin_fixes(fixes, _SPACING).places
        if len(places) >= _LEAST_PLACES:
            low, high = np.percentile(places, (5.0, 95.0), axis=0)
            extent = float(np.hypot(*(high - low)))
            if extent > _LEAST_DISTANCE + _ERRORS * fixes.noise:
                what = f"sprockets that never turn while {fixes.name} moves by {extent:.0f} m"
                needed = "record the topic or column that holds their speeds (not moved by a trailer)"
                return [OpenQuestion(what, needed, is_wrong=True)]
    return []


def judge_turns(drive: Drive) -> list[Finding]:
    """A gyro, or used headings, whose turns match neither the tracks nor each other.

    A machine that hardly turns by gyro and fixes is not judged: on clay and slopes, its tracks differ for
    long on straights.
    """
    left, right = drive.tracks_over_tread.T
    turning = np.abs(drive.unbiased_turn) > _TURNING
    is_turning = turning.sum() >= _LEAST_TURNING
    if count_turns(USUAL_EFFICIENCY * (right - left)) < LEAST_TURNS:
        return []
    by_gyro, gyro_windows = explained_share(drive.turn, drive.tracks_over_tread)
    by_heading, heading_windows = explained_share(drive.heading_turn, drive.tracks_over_tread)
    mutual, _ = explained_share(drive.heading_turn, drive.turn[:, np.newaxis])
    gyro, compass, mismatches = drive.gyro, drive.compass, []
    if gyro is None or gyro_windows < _LEAST_WINDOWS or drive.is_swing_unknown:
        return []
    if _is_same_turn(drive, turning):
        return []
    if max(by_gyro, mutual) < _UNRELATED and (is_turning or _turns_as_tracks(drive)):
        mismatches.append(f"turns of {gyro.name} that are not those of tracks or headings: another axis?")
    is_shown = compass is not None and compass.is_used and heading_windows >= _LEAST_WINDOWS and is_turning
    if compass is not None and is_shown and max(by_heading, mutual) < _UNRELATED and by_gyro > _RELATED:
        mismatches.append(f"headings of {compass.name} that do not turn as gyro and tracks do")
    needed = "look at its column as it comes, while the machine turns left and right by 90°"
    return [OpenQuestion(what, needed, is_wrong=True) for what in mismatches]


def _is_same_turn(drive: Drive, turning: BoolArray) -> bool:
    """Whether headings and gyro agree in most windows ``turning`` (n,); an even turn explains no variance."""
    differences = np.abs(drive.heading_turn - drive.unbiased_turn)[turning]
    agree = differences[np.isfinite(differences)] < HEADING_NOISE
    return bool(agree.size and agree.mean() > 0.5)


def _turns_as_tracks(drive: Drive) -> bool:
    """Whether the path of the fixes turns as the tracks do, and not as the gyro of either sign."""
    both, by_tracks = np.ones(2), np.diff(drive.grid.tracks)[:, 0] / drive.machine.tread
    turns = [*(k * by_tracks for k in _EFFICIENCIES), drive.gyro_turn, -drive.gyro_turn]
    logs = drive.path_fits([(both, turn) for turn in turns]).logs
    return float(logs[:-2].max() - logs[-2:].max()) > LEAST_LOG


def judge_counting(drive: Drive) -> list[Finding]:
    """Tracks that never count backwards, while the machine turns by more than their difference.

    Only tracks that run against each other turn a machine like that.
    """
    counted = drive.grid.tracks[drive.grid.is_driven]
    turn = np.abs(drive.heading_turn if drive.gyro is None else drive.unbiased_turn)
    if drive.is_swing_unknown or not len(counted) or float(counted.min()) < -_ROUNDING:
        return []
    left, right = drive.tracks_over_tread.T
    difference, total = np.pad(np.abs(right - left), 1), left + right
    # or in the next window, if delayed
    difference = np.maximum(np.maximum(difference[:-2], difference[2:]), difference[1:-1])
    on_the_spot = (turn > 2.0 * _TURNING) & (turn > 2.0 * MOST_TURN * difference) & (turn < MOST_TURN * total)
    if on_the_spot.sum() < _LEAST_TURNING:
        return []
    what = (
        f"machine that turns by {np.degrees(turn[on_the_spot].sum()):.0f}° while both tracks count forward "
        "by the same: encoders without a direction"
    )
    return [OpenQuestion(what, "turn on the spot: one track must count backwards", is_wrong=True)]


def frozen_cause(drive: Drive, gyro: Gyro) -> Cause | None:
    """The cause if readings stay bit for bit the same while tracks or headings turn differently."""
    causes = (_judge_span(drive, gyro, *span) for span in frozen_spans(gyro))
    return next((cause for cause in causes if cause is not None), None)


def _judge_span(drive: Drive, gyro: Gyro, begin: float, end: float) -> Cause | None:
    grid = drive.grid
    inside = (grid.edges[:-1] >= begin) & (grid.edges[1:] <= end)
    value = float(gyro.rates[np.searchsorted(gyro.t, begin), 2])
    gyro_turn = window_sums(grid, np.where(inside, value * grid.cell, 0.0))
    difference = window_sums(grid, np.where(inside, grid.tracks[:, 1] - grid.tracks[:, 0], 0.0))
    by_tracks = difference / drive.machine.tread
    by_heading = window_sums(grid, np.where(inside, np.diff(drive.headings), 0.0))
    by_heading = np.where(np.abs(by_heading) <= HEADING_NOISE, 0.0, by_heading)  # nan stays: unknown
    is_by_heading = _unexplained_turn(by_heading, gyro_turn) >= _LEAST_HIDDEN_TURN
    if not is_by_heading and _unexplained_turn(by_tracks, gyro_turn) * _LEAST_EFFICIENCY < _LEAST_HIDDEN_TURN:
        return None
    also = f", the heading {np.degrees(np.nansum(np.abs(by_heading))):.0f}°" if is_by_heading else ""
    evidence = (
        f"the gyro shows {value:.4g} rad/s without change for {end - begin:.0f} s, while the tracks turn "
        f"{np.degrees(np.nansum(np.abs(by_tracks))):.0f}°{also}"
    )
    without = remedies.parameter("yaw_rate_sources", "[]")
    remedy = f"Check supply and cable of the unit, or leave it out: {without}"
    return Cause("gyro_frozen", gyro.name, evidence, READ_OFF, remedy)


def _unexplained_turn(turns: FloatArray, gyro_turns: FloatArray) -> float:
    """Part of the turns (n,), rad, that no multiple of ``gyro_turns`` (n,) explains.

    A simulated gyro without noise is constant as long as the machine turns evenly.
    """
    usable = np.isfinite(turns)
    turns, gyro_turns = turns[usable], gyro_turns[usable]
    scale = float(turns @ gyro_turns) / max(float(gyro_turns @ gyro_turns), 1e-12)
    return float(min(np.abs(turns).sum(), np.abs(turns - scale * gyro_turns).sum()))


def frozen_spans(gyro: Gyro) -> list[tuple[float, float]]:
    """Spans, s, in which all readings about z are bit for bit the same; by readings, longest first."""
    runs = equal_runs(gyro.rates[:, 2])
    lengths = runs.lengths
    order = [k for k in np.argsort(-lengths, kind="stable")[:_MOST_SPANS] if lengths[k] >= _LEAST_EQUAL]
    return [(float(gyro.t[runs.first[k]]), float(gyro.t[runs.last[k]])) for k in order]


def frozen_share(gyro: Gyro) -> float:
    """Share of the gyro's recording in the longest frozen span."""
    spans = frozen_spans(gyro)
    return (spans[0][1] - spans[0][0]) / max(float(gyro.t[-1] - gyro.t[0]), 1e-9) if spans else 0.0
