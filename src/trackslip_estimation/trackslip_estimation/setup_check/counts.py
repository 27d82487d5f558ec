# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The angle of one count of the encoders: what positions change by at the least, against what is stated."""

import numpy as np

from trackslip_estimation.setup_check import remedies
from trackslip_estimation.setup_check.finding import Cause, odds_of
from trackslip_estimation.setup_check.log import Counts, FloatArray

_NOTHING = 1e-9  # of the largest change: the rounding of numbers
_WHOLE, _SHARE = 0.15, 0.95  # of a count, by which most changes may miss a whole number of them
_MOST = 5.5  # counts in a change, beyond which the digits of a log may hide them
_LEAST_CHANGES = 5
_COARSE = 5e-3  # rad: a finer count hides in the noise of any speed
_TOO_SMALL = 5.0  # times


def angle_of_count(positions: FloatArray) -> float:
    """Of positions (n, 2), the coarser side, rad; 0: they are not counted, or there are none."""
    return max(_least_change(side) for side in positions.T)


def _least_change(positions: FloatArray) -> float:
    """Of positions (n,), if the other small ones are multiples of it; else 0."""
    changes = np.abs(np.diff(positions[np.isfinite(positions)]))
    changes = changes[changes > _NOTHING * changes.max(initial=0.0)]
    if not len(changes):
        return 0.0
    least = float(changes.min())
    small = changes[changes < _MOST * least]
    counts = np.round(small / least)
    is_whole = np.abs(small / least - counts) < _WHOLE
    is_counted = len(small) >= _LEAST_CHANGES and is_whole.mean() > _SHARE
    return float(np.median(small / counts)) if is_counted else 0.0


def judge_counts(counts: Counts) -> Cause | None:
    """A count that is stated far too small: whole ones are jumps to the estimator then."""
    if counts.shown < _COARSE or counts.stated * _TOO_SMALL > counts.shown:
        return None
    evidence = (
        f"positions change by {counts.shown:.3g} rad at the least, and a count is stated to be "
        f"{counts.stated:.3g} rad"
    )
    remedy = f"Set {remedies.parameter('encoder_resolution', counts.shown)}"
    return Cause("encoder_resolution", "sprockets", evidence, odds_of(20.0), remedy)
