# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Scale of the gyro, by headings and by the shape of the path of the fixes.

Tracks cannot show it, since they slip. ``inertial`` has undone scales that are wrong units by the tracks.
"""

from collections.abc import Sequence

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check import remedies
from trackslip_estimation.setup_check.drive import Drive
from trackslip_estimation.setup_check.finding import PRIOR, Cause, odds_of
from trackslip_estimation.setup_check.fit import Lever
from trackslip_estimation.setup_check.grid import WINDOW
from trackslip_estimation.setup_check.heading import turn_logs
from trackslip_estimation.setup_check.log import Gyro
from trackslip_estimation.setup_check.turning import LEAST_TURNS, count_turns

_SCALES = (np.geomspace(0.42, 1 / 0.42, 19), np.geomspace(0.08, 1 / 0.08, 53))  # near ones first
_MOST_LOG_SCALE = np.log(1.11)  # largest magnitude of the ln scale of a gyro without a fault
_LEAST_SEGMENTS = 3  # of the path


def judge_scale(drive: Drive, unit: float, lever: Lever | None) -> Cause | None:
    """The cause if the scale is wrong, of a drive with right signs; ``unit``: undone readings per rad/s.

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
