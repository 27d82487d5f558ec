# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the estimated roll, pitch, height and swing."""

import math

import numpy as np

from trackslip_common.arrays import Rows
from trackslip_common.orientations import tilts_of, wrap_angles
from trackslip_tools.replay.errors import TruthPairing


class TiltErrors:
    """Errors of tilt against true odometry that is logged with the estimates; both come in pieces."""

    def __init__(self) -> None:
        self._pairs = TruthPairing()
        self._tilt = self._height = 0.0  # sums of squares
        self._count = 0

    def add(self, estimates: Rows, truth: Rows | None) -> None:
        """Add records of ``ESTIMATE``, and rows of odometry."""
        known = estimates[estimates["tilt"]["known"] == 1]
        rows = np.zeros(len(known), [("stamp_ns", np.int64), ("tilt", np.float64, (3,))])
        rows["stamp_ns"], rows["tilt"] = known["stamp_ns"], known["tilt"]["tilt"]
        pairs = self._pairs.add(rows, truth)
        if pairs is None:
            return
        estimated, truth_rows = pairs
        expected = (*tilts_of(truth_rows).T, truth_rows["z"])
        errors = np.column_stack(
            [
                estimated["tilt"][:, k] - np.interp(estimated["stamp_ns"], truth_rows["stamp_ns"], values)
                for k, values in enumerate(expected)
            ]
        )
        self._tilt += float(np.sum(errors[:, :2] ** 2)) / 2.0
        self._height += float(np.sum(errors[:, 2] ** 2))
        self._count += len(estimated)

    @property
    def attitude(self) -> float | None:
        """RMS error of roll and pitch, rad; None without compared samples."""
        return math.sqrt(self._tilt / self._count) if self._count else None

    @property
    def height(self) -> float | None:
        """RMS error of the height, m; None without compared samples."""
        return math.sqrt(self._height / self._count) if self._count else None


class SwingErrors:
    """Errors of the swing angle against a true one that is logged with the estimates; both in pieces."""

    def __init__(self) -> None:
        self._pairs = TruthPairing()
        self._sum, self._count = 0.0, 0

    def add(self, estimates: Rows, truth: Rows | None) -> None:
        """Add records of ``ESTIMATE``, and rows of ``SwingFields``."""
        known = estimates[estimates["swing"]["known"] == 1]
        rows = np.zeros(len(known), [("stamp_ns", np.int64), ("angle", np.float64)])
        rows["stamp_ns"], rows["angle"] = known["stamp_ns"], known["swing"]["angle"]
        pairs = self._pairs.add(rows, truth)
        if pairs is None:
            return
        estimated, truth_rows = pairs
        expected = np.interp(estimated["stamp_ns"], truth_rows["stamp_ns"], np.unwrap(truth_rows["angle"]))
        errors = wrap_angles(estimated["angle"] - expected)
        self._sum, self._count = self._sum + float(np.sum(errors**2)), self._count + len(estimated)

    @property
    def rmse(self) -> float | None:
        """RMS error of the swing angle, rad; None without compared samples."""
        return math.sqrt(self._sum / self._count) if self._count else None
