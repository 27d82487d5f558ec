# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the angle of an upper structure, of a machine that estimates it."""

import math

import numpy as np

from trackslip_tools.replay.errors import Pairs
from trackslip_tools.replay.growing import Rows


class SwingErrors:
    """Of estimates that come piece by piece, against a true swing that is never behind them."""

    def __init__(self) -> None:
        self._pairs = Pairs()
        self._sum, self._count = 0.0, 0

    def add(self, estimates: Rows, truth: Rows | None) -> None:
        """More of both: records of ``ESTIMATE``, and rows of ``SwingFields``."""
        known = estimates[estimates["swing"]["known"] == 1]
        rows = np.zeros(len(known), [("stamp_ns", np.int64), ("angle", np.float64)])
        rows["stamp_ns"], rows["angle"] = known["stamp_ns"], known["swing"]["angle"]
        pairs = self._pairs.add(rows, truth)
        if pairs is None:
            return
        found, true = pairs
        expected = np.interp(found["stamp_ns"], true["stamp_ns"], np.unwrap(true["angle"]))
        errors = np.angle(np.exp(1j * (found["angle"] - expected)))
        self._sum, self._count = self._sum + float(np.sum(errors**2)), self._count + len(found)

    @property
    def rmse(self) -> float | None:
        """RMS, rad; None where nothing was compared."""
        return math.sqrt(self._sum / self._count) if self._count else None
