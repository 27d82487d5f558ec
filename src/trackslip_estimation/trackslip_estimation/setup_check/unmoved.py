# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sources that do not follow the motion: constant fixes, unrelated gyro or headings, unsigned encoders."""

import numpy as np

from trackslip_estimation.setup_check.drive import USUAL_EFFICIENCY, Drive
from trackslip_estimation.setup_check.equal_runs import equal_runs
from trackslip_estimation.setup_check.finding import READ_OFF, Cause, OpenQuestion
from trackslip_estimation.setup_check.grid import WINDOW
from trackslip_estimation.setup_check.log import Fixes
from trackslip_estimation.setup_check.quantities import explained_distance, explained_share
from trackslip_estimation.setup_check.sides import FASTEST
from trackslip_estimation.setup_check.speeds import MOST_TURN
from trackslip_estimation.setup_check.turning import LEAST_TURNS, count_turns

_LEAST_DISTANCE = 10.0  # m, by the tracks
_LEAST_EXTENT = 5e-3  # m, extent of the fixes of any receiver within minutes
_STILL = 1e-4  # extent of the fixes, share of the distance: no path is so narrow
_LEAST_PLACES = 10
_REPEATED = 0.5  # share of the distance
_LONGEST_HOLD = 5.0  # s for which a log may hold the last fix
_LEAST_RATIO = 0.01  # share of the distance; with more slip, the motion does not follow the tracks
_RELATED, _UNRELATED = 0.8, 0.2  # R²
_LEAST_WINDOWS = 20
_ROUNDING = 1e-9  # m
_TURNING, _LEAST_TURNING = 0.1, 5  # rad in a window, and in how many


def judge_fixes(drive: Drive) -> tuple[list[Cause], list[OpenQuestion]]:
    """Fixes that repeat, stay at one place, or move far too little while the tracks move."""
    fixes = drive.fixes
    if fixes is None or len(fixes.t) < _LEAST_PLACES:
        return [], []
    name, repeated = fixes.name, _repeated_distance(drive, fixes)
    distance = float(np.nansum(np.abs(drive.grid.tracks).max(axis=1)))
    if distance < _LEAST_DISTANCE:
        return [], []
    if repeated > max(_REPEATED * distance, _LEAST_DISTANCE):
        what = f"{name} repeats its positions while the tracks drive {repeated:.0f} m: "
        what += "a receiver that is frozen, or another column"
        needed = "watch the live positions while the machine drives"
        return [], [OpenQuestion(what, needed, is_wrong=True)]
    if (ratio := _wrong_unit_ratio(drive, distance)) > 0.0:
        evidence = (
            f"its positions move as the tracks do, but {ratio:.2g} times as far: no machine slips so evenly"
        )
        remedy = "State the unit of the positions in the mapping: x and y: unit (km), or their frame"
        return [Cause("frame", name, evidence, READ_OFF, remedy)], []
    extent = float(np.ptp(fixes.places, axis=0).max())
    if extent > min(_LEAST_EXTENT, _STILL * distance):
        return [], []
    evidence = (
        f"its positions differ by {extent:.2g} m while the tracks drive {distance:.0f} m: every receiver has "
        "more noise, so they are in another unit"
    )
    remedy = "Call the columns latitude and longitude in the mapping, or state the unit of x and y"
    return [Cause("frame", name, evidence, READ_OFF, remedy)], []


def _wrong_unit_ratio(drive: Drive, distance: float) -> float:
    """Distance of fixes in another unit over that by the tracks; 0 for fixes in m, and for constant ones."""
    speeds = np.abs(drive.tracks_over_tread).max(axis=1) * drive.machine.tread / WINDOW
    share, windows = explained_distance(drive)
    ratio = float(np.nansum(drive.fix_distances)) / distance
    is_other = ratio < _LEAST_RATIO and share > _RELATED and float(np.nanpercentile(speeds, 95)) < FASTEST
    return ratio if is_other and windows >= _LEAST_WINDOWS else 0.0


def _repeated_distance(drive: Drive, fixes: Fixes) -> float:
    """Distance by the tracks, m, while fixes stayed bit for bit the same, longer than a logger holds one."""
    distances = np.concatenate(([0.0], np.cumsum(np.nan_to_num(np.abs(drive.grid.tracks).max(axis=1)))))
    runs = equal_runs(fixes.centred_places)
    first, last = fixes.t[runs.first], fixes.t[runs.last]
    is_held = last - first > _LONGEST_HOLD
    begin, end = (np.interp(t[is_held], drive.grid.edges, distances) for t in (first, last))
    return float(np.sum(end - begin))


def judge_turns(drive: Drive) -> list[OpenQuestion]:
    """A gyro, or used headings, whose turns match neither the tracks nor each other.

    A machine that hardly turns is not judged: on clay and slopes, its tracks differ for long on straights.
    """
    left, right = drive.tracks_over_tread.T
    by_tracks = count_turns(USUAL_EFFICIENCY * (right - left))
    turning = np.abs(drive.unbiased_turn) > _TURNING
    if by_tracks < LEAST_TURNS or turning.sum() < _LEAST_TURNING:
        return []
    by_gyro, gyro_windows = explained_share(drive.turn, drive.tracks_over_tread)
    by_heading, heading_windows = explained_share(drive.heading_turn, drive.tracks_over_tread)
    mutual, _ = explained_share(drive.heading_turn, drive.turn[:, np.newaxis])
    gyro, compass, mismatches = drive.gyro, drive.compass, []
    if gyro is None or gyro_windows < _LEAST_WINDOWS or drive.is_swing_unknown:
        return []
    if max(by_gyro, mutual) < _UNRELATED:
        mismatches.append(f"turns of {gyro.name} that neither tracks nor headings show")
    is_shown = compass is not None and compass.is_used and heading_windows >= _LEAST_WINDOWS
    if compass is not None and is_shown and max(by_heading, mutual) < _UNRELATED and by_gyro > _RELATED:
        mismatches.append(f"headings of {compass.name} that do not turn as gyro and tracks do")
    needed = "look at its column as it comes, while the machine turns left and right by 90°"
    return [OpenQuestion(what, needed, is_wrong=True) for what in mismatches]


def judge_counting(drive: Drive) -> list[OpenQuestion]:
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
