# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One track against the other on straights, and fixes against the speed that a machine can have.

    q = distance of one track / distance of the other        1 on straights, whatever the slip of both is

A track with q far from 1 on most straights has a wrong number of counts per turn, or a dead encoder. Fixes
show which track is right.
"""

from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check.drive import Drive
from trackslip_estimation.setup_check.finding import Cause, Finding, OpenQuestion, odds_of
from trackslip_estimation.setup_check.grid import WINDOW

_STRAIGHT, _TURNS = 0.06, 0.8  # rad in a window: no turn; sharpest turn that is used
_ROUNDING = 1e-6  # m
_LEAST_TURN = 0.2  # rad in a window, beyond the drift of a gyro
_LEAST_WINDOWS = 5
_LEAST_RATIO, _USUAL_SHARE = 1.5, 0.8  # q, or 1/q, of a wrong track; share of the windows beyond it
_MOST_DEAD_RATIO = 0.02  # q of a track without motion
_RATIO_RANGE = (0.55, 1.1)  # distance of the machine over that of a right track
FASTEST = 15.0  # m/s, of a machine on tracks
_SIDES = ("left", "right")


class TracksResult(NamedTuple):
    """Findings, and the drive with their causes undone; None: the tracks are unusable."""

    drive: Drive | None
    findings: tuple[Finding, ...] = ()
    has_wrong_frame: bool = False  # whether fixes are in another unit


def compare_tracks(drive: Drive, unit: float) -> TracksResult:
    """Compare the tracks with each other and with the fixes; ``unit``: of the speeds, undone before."""
    equal_tracks = _judge_equal_tracks(drive)
    if equal_tracks is not None:
        return TracksResult(None, (equal_tracks,))
    frame = _judge_frame(drive, unit)
    if frame is None:
        return _judge_ratio(drive, unit)
    without_fixes = Drive.from_sources(drive.log, drive.gyro, None, drive.compass)
    return TracksResult(without_fixes, (frame,), has_wrong_frame=True)


def _judge_equal_tracks(drive: Drive) -> Cause | None:
    """The cause if both tracks show the same motion in turns."""
    turn = drive.heading_turn if drive.gyro is None else drive.turn
    tracks = drive.tracks_over_tread
    is_usable = np.isfinite(tracks).all(axis=1) & (np.abs(tracks).max(axis=1) > _ROUNDING) & np.isfinite(turn)
    is_turning = is_usable & (np.abs(turn) > _LEAST_TURN)
    is_equal = np.abs(tracks[:, 1] - tracks[:, 0]) <= _ROUNDING
    if is_turning.sum() < _LEAST_WINDOWS or not is_equal[is_usable].all():
        return None
    turned = f"{np.degrees(np.abs(turn[is_turning]).sum()):.0f}°"
    evidence = f"left and right sprocket show the same, while the machine turns {turned}"
    remedy = "Name the column, joint or signal of each side in the mapping or roles file"
    return Cause("missing_value", "sprockets", evidence, odds_of(2.0 * float(is_turning.sum())), remedy)


def _judge_ratio(drive: Drive, unit: float) -> TracksResult:
    tracks, distance, turn = _driven_windows(drive, unit)
    if len(distance) < _LEAST_WINDOWS or not np.percentile(turn, 20) < _STRAIGHT > -np.percentile(turn, 80):
        return TracksResult(drive)
    logs = np.log((tracks[:, 0] + _ROUNDING) / (tracks[:, 1] + _ROUNDING))
    curve = turn / distance
    centred = curve - curve.mean()
    # less the effect of turns
    logs = logs - np.sum(centred * logs) / max(float(np.sum(centred**2)), 1e-12) * curve
    least = float(np.log(_LEAST_RATIO))
    shares = [float((logs < -least).mean()), float((logs > least).mean())]
    short_side = int(shares[1] > shares[0])  # the side with the shorter distance
    if shares[short_side] < _USUAL_SHARE:
        return TracksResult(drive)
    ratios = np.median(distance[:, np.newaxis] / (tracks + _ROUNDING), axis=0)
    wrong = [k for k, one in enumerate(ratios.tolist()) if not _RATIO_RANGE[0] < one < _RATIO_RANGE[1]]
    q = float(np.exp(-abs(np.median(logs))))
    name, other = _SIDES[short_side], _SIDES[1 - short_side]
    evidence = f"on straights the {name} sprocket turns {q:.3g} times as far as the {other} one"
    if len(wrong) != 1:
        needed = "count the turns of both sprockets by hand"
        return TracksResult(None, (OpenQuestion(evidence, needed, is_wrong=True),))
    side = _SIDES[wrong[0]]
    evidence += f", and fixes agree with the {_SIDES[1 - wrong[0]]} one ({len(distance)} windows)"
    odds = odds_of(2.0 * len(distance))
    if q < _MOST_DEAD_RATIO:
        remedy = f"Check the {name} encoder, and its name in the mapping or roles file"
        return TracksResult(None, (Cause("missing_value", "sprockets", evidence, odds, remedy),))
    factor = 1.0 / q if wrong[0] == short_side else q
    remedy = (
        f"Correct counts_per_turn or ratio of the {side} side, or multiply scale by {factor:.3g} at "
        f"{side}_velocity or {side}_position in the mapping"
    )
    corrected = Drive(drive.log.with_tracks(np.diag((1.0, factor) if wrong[0] else (factor, 1.0))))
    return TracksResult(corrected, (Cause("speed_unit", "sprockets", evidence, odds, remedy),))


def _driven_windows(drive: Drive, unit: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Windows with motion: (w, 2) m of the tracks, (w,) m of the fixes, (w,) rad turned."""
    tracks, distance = np.abs(drive.tracks_over_tread) * drive.machine.tread * unit, drive.fix_distances
    turn = drive.heading_turn if drive.gyro is None else drive.unbiased_turn
    is_usable = np.isfinite(distance) & np.isfinite(turn) & np.isfinite(tracks).all(axis=1)
    is_usable &= np.abs(turn) < _TURNS
    if drive.fixes is not None and is_usable.any():
        is_usable &= distance > max(
            0.3 * float(np.percentile(distance[is_usable], 95)), 3.0 * drive.fixes.noise
        )
    if is_usable.any():
        larger = tracks.max(axis=1)
        is_usable &= larger > 0.3 * float(np.percentile(larger[is_usable], 95))
    return tracks[is_usable], distance[is_usable], turn[is_usable]


def _judge_frame(drive: Drive, unit: float) -> Cause | None:
    """The cause if fixes show a speed that no machine has, and the tracks a possible one."""
    if drive.fixes is None:
        return None
    tracks = np.abs(drive.tracks_over_tread).max(axis=1) * drive.machine.tread * unit / WINDOW
    distance = drive.fix_distances / WINDOW
    driven = tracks[np.isfinite(tracks)]
    fastest = float(np.percentile(driven, 95)) if len(driven) else np.inf
    is_fast = (tracks > 0.3 * fastest) & np.isfinite(distance)
    if int(is_fast.sum()) < _LEAST_WINDOWS:
        return None
    fix_speed, track_speed = float(np.median(distance[is_fast])), float(np.median(tracks[is_fast]))
    is_steady = float(np.percentile(distance[is_fast], 20)) > fix_speed / 3.0  # jumps of fixes are not
    if fix_speed < FASTEST or track_speed > FASTEST or not is_steady:
        return None
    evidence = (
        f"fixes go {fix_speed / track_speed:.3g} times as far as the tracks, {fix_speed:.3g} m/s: no machine "
        "does"
    )
    remedy = "State the unit of the positions in the mapping: x and y: unit (cm, mm, ft), or their frame"
    return Cause("frame", drive.fixes.name, evidence, odds_of(float(is_fast.sum())), remedy)
