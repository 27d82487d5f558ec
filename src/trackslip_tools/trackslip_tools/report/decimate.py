# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Thins long curves without losing a peak: what a screen can show, and no more."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def extremes(columns: Sequence[FloatArray], limit: int) -> NDArray[np.intp]:
    """Indices to keep of curves over the same abscissa, rising, at most ``limit`` of them.

    The curves are cut into equal pieces; of each piece stay where a curve is lowest and highest, and one
    sample that is not a number, so that breaks stay breaks. First and last sample always stay.

    Args:
        columns: the curves, each (n,).
        limit: at least 2 + 1 + 2 len(columns).
    """
    size = len(columns[0])
    if size <= limit:
        return np.arange(size)
    pieces = (limit - 2) // (2 * len(columns) + 1)
    width = -(-size // pieces)
    starts = np.arange(0, size, width)
    padded = [np.append(column, np.full(-size % width, np.nan)).reshape(-1, width) for column in columns]
    kept = [np.array((0, size - 1))]
    for rows in padded:
        kept.append(starts + np.argmin(np.where(np.isnan(rows), np.inf, rows), axis=1))
        kept.append(starts + np.argmax(np.where(np.isnan(rows), -np.inf, rows), axis=1))
    broken = np.isnan(np.stack(padded)).any(axis=0)
    kept.append((starts + np.argmax(broken, axis=1))[broken.any(axis=1)])
    indices = np.unique(np.concatenate(kept))
    return indices[indices < size]
