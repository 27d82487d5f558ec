# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of readings that are bit for bit the same: frozen or held sensors, placeholders of missing values."""

from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_estimation.setup_check.log import ComplexArray

_LEAST_VALUES = 10  # that a source holds
_LEAST_HOLD = 2.0  # rows of each, by the median, where all coordinates change at once
_LEAST_REGULAR_HOLD = 8.0  # rows of the shortest, where they may not
_LEAST_TOGETHER = 0.5  # share of the changes that all coordinates make at once
_LEAST_CHANGE = 1e-3  # share of the other one; a rounded coordinate of a map that is turned changes by less
_LEAST_MULTIPLES = 0.8  # share of the values that last for a multiple of the shortest


class Runs(NamedTuple):
    """Runs in order; a nan equals no other reading."""

    first: IntArray  # (r,) index of the first reading of each
    last: IntArray  # (r,) index of the last one

    @property
    def lengths(self) -> IntArray:
        """(r,) number of readings."""
        return self.last - self.first + 1


def equal_runs(values: FloatArray | ComplexArray) -> Runs:
    """Runs of equal readings, of (n,)."""
    first = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
    return Runs(first, np.append(first[1:], len(values))[: len(first)] - 1)


def new_readings(values: FloatArray) -> BoolArray:
    """(n,) whether a reading (n, k) is new; all are, unless a logger holds the last one over several rows.

    Held readings change after multiples of one number of rows. All their coordinates change at once, unless
    they are rounded.
    """
    changes = np.abs(np.diff(values, axis=0, prepend=np.nan))
    is_new: BoolArray = (changes != 0.0).any(axis=1)
    first = np.flatnonzero(is_new)
    lengths = np.diff(first, append=len(values))
    if len(first) < _LEAST_VALUES:
        return np.ones_like(is_new)
    least = float(np.percentile(lengths, 10.0))
    is_multiple = np.abs(lengths - least * np.round(lengths / least)) <= 1.0
    is_held = least >= _LEAST_REGULAR_HOLD and is_multiple.mean() >= _LEAST_MULTIPLES
    if values.shape[1] > 1 and np.median(lengths) >= _LEAST_HOLD:
        is_together = changes[first].min(axis=1) > _LEAST_CHANGE * changes[first].max(axis=1)
        is_held |= is_together[1:].mean() >= _LEAST_TOGETHER
    return is_new if is_held else np.ones_like(is_new)
