# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of readings that are bit for bit the same: frozen or held sensors, placeholders of missing values."""

from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_estimation.setup_check.log import ComplexArray


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
