# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the columns of the sprockets are: positions, speeds or increments, whatever they are declared.

Right is what makes the tracks move when the fixes do, and turn when the gyro does; units and signs of all
sensors are free. n windows of which a share R² is explained weigh −n/2 ln(1 − R²).
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trackslip_estimation.setup_check.drive import USUAL_EFFICIENCY, Drive
from trackslip_estimation.setup_check.finding import PRIOR, Cause, odds_of
from trackslip_estimation.setup_check.grid import WINDOW, integral
from trackslip_estimation.setup_check.log import FloatArray, Tracks
from trackslip_estimation.setup_check.speeds import rough_scale
from trackslip_estimation.setup_check.turning import scale_of

_LEAST_EXPLAINED = 0.6  # R², by the quantity that is right
_MOST_EXPLAINED = 0.95  # of any: no sensor decides by its last per cents
_LEAST_WINDOWS = 8


class _Reading(NamedTuple):
    """A way to read the columns, and what to do if it is the right one."""

    what: str
    angles: Callable[[Tracks], FloatArray]  # (n, 2) of the sprockets, rad
    remedy: str


_READINGS = (
    _Reading(
        "speeds, declared positions",
        lambda tracks: integral(tracks.t, tracks.angles),
        "Call the columns left_velocity and right_velocity in the mapping",
    ),
    _Reading(
        "increments, declared positions",
        lambda tracks: np.cumsum(tracks.angles, axis=0),
        "State 'increments: true' at left_position and right_position in the mapping",
    ),
    _Reading(
        "positions, declared speeds",
        lambda tracks: tracks.speeds,
        "Call the columns left_position and right_position in the mapping",
    ),
)


class _Found(NamedTuple):
    """How well a drive explains fixes and gyro."""

    weight: float  # ln likelihood over that of no relation
    explained: float  # largest R² of one of them


def judge_quantity(drive: Drive) -> tuple[Drive, Cause | None]:
    """The drive with the columns read rightly, and the mistake, if they were declared something else."""
    declared, best = _explained(drive), (drive, _Found(0.0, 0.0), _READINGS[0])
    for reading in _READINGS:
        own = drive.log.tracks
        angles = reading.angles(own)
        tracks = Tracks(own.t, np.gradient(angles, own.t, axis=0), angles)
        other = Drive(replace(drive.log, tracks=tracks))
        found = _explained(other)
        gain = found.weight - best[1].weight
        if gain > PRIOR or (gain > -PRIOR and _misfit(other) < _misfit(best[0])):  # but for the distance
            best = other, found, reading
    log_ratio = best[1].weight - declared.weight - PRIOR
    if log_ratio < PRIOR or best[1].explained < _LEAST_EXPLAINED:
        return drive, None
    evidence = (
        f"as {best[2].what}, they explain {best[1].explained:.0%} of what gyro or fixes show of the motion, "
        f"as declared {declared.explained:.0%}"
    )
    return best[0], Cause("speed_unit", "sprockets", evidence, odds_of(log_ratio), best[2].remedy)


def _misfit(drive: Drive) -> float:
    """By which distances of fixes and tracks, or else turns of gyro and tracks, differ from usual ones."""
    distance, turn = rough_scale(drive), scale_of(drive.turn, drive.x, WINDOW)
    ratio = turn / USUAL_EFFICIENCY if np.isnan(distance) else distance
    return float(np.nan_to_num(abs(np.log(ratio)), nan=np.inf))


def _explained(drive: Drive) -> _Found:
    ways = np.abs(drive.x @ np.array(((1.0, 1.0), (1.0, -1.0))))  # with the same sign, or the other
    parts = [_of(drive.fix_ways, ways[:, :1]), _of(drive.fix_ways, ways[:, 1:]), _of(drive.turn, drive.x)]
    by_fixes = max(parts[:2])
    return _Found(by_fixes.weight + parts[2].weight, max(by_fixes.explained, parts[2].explained))


def _of(shown: FloatArray, x: FloatArray) -> _Found:
    """Of what a sensor shows in windows (w,), by a linear relation to x (w, k)."""
    usable = np.isfinite(shown) & np.isfinite(x).all(axis=1)
    if usable.sum() < _LEAST_WINDOWS:
        return _Found(0.0, 0.0)
    y, columns = shown[usable] - shown[usable].mean(), x[usable] - x[usable].mean(axis=0)
    rest = y - columns @ np.linalg.lstsq(columns, y, rcond=1e-9)[0]
    share = min(1.0 - float(rest @ rest) / max(float(y @ y), 1e-12), _MOST_EXPLAINED)
    return _Found(-len(y) / 2.0 * float(np.log1p(-max(share, 0.0))), max(share, 0.0))
