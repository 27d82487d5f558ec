# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The angle of one count of the encoders: the smallest change of positions, against the stated angle.

Without positions, speeds show it if a driver computes them from differences of counts: the sprockets turn by
whole counts over its period, which is constant or the time between two stamps.
"""

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check import remedies
from trackslip_estimation.setup_check.finding import READ_OFF, Cause, Finding
from trackslip_estimation.setup_check.log import Counts

_ROUNDING_SHARE = 1e-9  # of the largest change: floating-point rounding
_WHOLE_TOLERANCE = 0.15  # of a count, about a whole number
_WHOLE_SHARE = 0.95  # of the changes, within this tolerance
_MOST_COUNTS = 5.5  # counts in a change; the digits of a log may hide counts in larger ones
_LEAST_CHANGES = 5
_ROUNDED_SHARE = 0.1  # share of readings whose change differs from that before
_LEAST_COUNT_ANGLE = 5e-3  # rad; a finer count is below the noise of any speed
_LEAST_ANGLE_RATIO = 5.0  # ratio of the measured to the stated angle
_LEAST_STEP = 1e-6  # m, resolution of a place on the earth in 64 bit floats
LEAST_ROUNDING_RATIO = 2.0  # to the stated standard deviation; steps of such a rounding count as motion
MORE_DIGITS = "more digits (of degrees 8, no 32 bit floats)"


def angle_of_count(t: FloatArray, speeds: FloatArray, positions: FloatArray) -> float:
    """Angle of one count, rad, of the coarser side; 0 where the values show no counts.

    Times (n,) in s, positions (n, 2) in rad; speeds (n, 2) in rad/s are used where no position is a number.
    """
    if np.isfinite(positions).any():
        return max(least_change(np.diff(side[np.isfinite(side)])) for side in positions.T)
    periods = np.diff(t)
    evenly = np.full_like(periods, np.median(periods)) if len(periods) else periods
    return max(least_change(side[1:] * dt) for side in speeds.T for dt in (evenly, periods))


def least_change(changes: FloatArray) -> float:
    """Smallest of the changes (n,) of a position, if other small ones are multiples of it; else 0.

    Constant speeds give whole multiples too, but the number of true counts varies between readings.
    """
    changes = np.abs(changes)
    moves = changes > _ROUNDING_SHARE * changes.max(initial=0.0)
    if not moves.any():
        return 0.0
    multiples = changes / changes[moves].min()
    counts, small = np.round(multiples), multiples < _MOST_COUNTS
    is_small_move = moves & small
    is_whole = np.abs(multiples - counts)[is_small_move] < _WHOLE_TOLERANCE
    are_neighbours = small[1:] & small[:-1] & (moves[1:] | moves[:-1])
    different_counts = np.count_nonzero((counts[1:] != counts[:-1])[are_neighbours])
    are_counts = (
        np.count_nonzero(is_whole) > _WHOLE_SHARE * len(is_whole)
        and different_counts > _ROUNDED_SHARE * are_neighbours.sum()
    )
    is_known = len(is_whole) >= _LEAST_CHANGES and are_counts
    return float(np.median(changes[is_small_move] / counts[is_small_move])) if is_known else 0.0


def rounding_of(places: FloatArray, stated: float) -> float:
    """Standard deviation of the rounding of places (n,), m; 0 where their changes show no last digit.

    Changes below a tenth of ``stated``, a standard deviation, are ignored: degrees converted to m have some.
    """
    least = max(0.1 * stated, _LEAST_STEP)
    return least_change(np.diff(least * np.round(places / least))) / float(np.sqrt(12.0))


def judge_counts(counts: Counts) -> list[Finding]:
    """A count that is stated far too small: the estimator takes single counts for jumps then."""
    if counts.measured < _LEAST_COUNT_ANGLE or counts.stated * _LEAST_ANGLE_RATIO > counts.measured:
        return []
    evidence = (
        f"the sprockets turn by {counts.measured:.3g} rad at the least, and a count is stated to be "
        f"{counts.stated:.3g} rad"
    )
    remedy = f"Set {remedies.parameter('encoder_resolution', counts.measured)}"
    return [Cause("encoder_resolution", "sprockets", evidence, READ_OFF, remedy)]
