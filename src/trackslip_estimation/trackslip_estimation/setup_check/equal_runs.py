# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of readings that are bit for bit the same: of what is frozen, held, or stands for a missing value."""

from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_estimation.setup_check.log import ComplexArray


class Runs(NamedTuple):
    """In order; a nan is like no other reading."""

    first: IntArray  # (r,) reading of each
    last: IntArray  # (r,)

    @property
    def lengths(self) -> IntArray:
        """(r,) readings."""
        return self.last - self.first + 1


def equal_runs(values: FloatArray | ComplexArray) -> Runs:
    """Of readings (n,)."""
    first = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
    return Runs(first, np.append(first[1:], len(values))[: len(first)] - 1)
