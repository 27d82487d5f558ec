# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How much of a turn the gyro shows: by headings, and by the shape of the path of the fixes.

Tracks cannot show it, since they slip. What looks like a unit beside them is undone before (``inertial``).
"""

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check import remedies
from trackslip_estimation.setup_check.drive import HEADING_NOISE, Drive
from trackslip_estimation.setup_check.finding import PRIOR, Cause, odds_of
from trackslip_estimation.setup_check.grid import WINDOW
from trackslip_estimation.setup_check.log import Gyro
from trackslip_estimation.setup_check.path import compare, dead_reckoning, thinned
from trackslip_estimation.setup_check.turning import LEAST_TURNS, mixture, turns_of

_SCALES = (np.geomspace(0.42, 1 / 0.42, 19), np.geomspace(0.08, 1 / 0.08, 53))  # far ones hide what is near 1
_RIGHT = np.log(1.11)  # by which the logarithm of the scale of a sound gyro differs from 0 at the most
_SPACING = 0.5  # s of fixes


def judge_scale(drive: Drive, unit: float) -> Cause | None:
    """Of a drive with all signs undone, and ``unit``: what the gyro showed of 1 rad/s."""
    if drive.gyro is None:
        return None
    causes = (_judge(drive, drive.gyro, scales, unit) for scales in _SCALES)
    return next((cause for cause in causes if cause is not None), None)


def _judge(drive: Drive, gyro: Gyro, scales: FloatArray, unit: float) -> Cause | None:
    both = {"its headings": _by_headings(drive, scales), "the path of the fixes": _by_path(drive, scales)}
    witnesses = {name: logs for name, logs in both.items() if logs is not None}
    if not witnesses:
        return None
    is_right = np.abs(np.log(scales)) <= _RIGHT
    total = np.sum(list(witnesses.values()), axis=0)
    best = int(np.argmax(total))
    gain = float(total[best] - total[is_right].max())
    if best in (0, len(scales) - 1) or gain < PRIOR:  # at an end none makes it show the turns
        return None
    turns = turns_of((drive.turn - drive.fit.bias * WINDOW) / scales[best])
    if turns < LEAST_TURNS or any(logs[best] < logs[is_right].max() for logs in witnesses.values()):
        return None
    shown = unit * float(scales[best])
    evidence = f"the gyro shows {shown:.2g} times what the machine turns by {' and '.join(witnesses)}"
    return Cause("gyro_unit", gyro.name, evidence, odds_of(gain), remedies.gyro_scale(gyro, shown))


def _by_headings(drive: Drive, scales: FloatArray) -> FloatArray | None:
    """(s,) ln likelihood of each scale; None without headings."""
    of_heading, turn = drive.heading_turn, drive.turn - drive.fit.bias * WINDOW
    usable = np.isfinite(of_heading) & np.isfinite(turn)
    if usable.sum() < 3:
        return None
    h, y = of_heading[usable], turn[usable]
    width = 2.0 * max(float(np.abs(h).max()), 1.0)
    variance = HEADING_NOISE**2 + (0.1 * h) ** 2
    return np.array([mixture(h - y / scale, variance, width).sum() for scale in scales])


def _by_path(drive: Drive, scales: FloatArray) -> FloatArray | None:
    """(s,) ln likelihood of each scale; None without fixes that tell the paths apart."""
    if drive.fixes is None:
        return None
    way = drive.grid.tracks.mean(axis=1)
    paths = [dead_reckoning(drive.grid, way, drive.gyro_turn / scale) for scale in scales]
    shapes = compare(paths, thinned(drive.fixes, _SPACING))
    return shapes.logs if shapes.segments >= 3 else None
