# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Delay of one turn rate after another, with its standard deviation: cross-correlation in pieces."""

from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray

LARGEST_DELAY = 2.0  # s, largest delay that is tried
_PIECE = 15.0  # s, length of a piece
_LEAST_PIECES = 3
_LEAST_CORRELATION = 0.5


class Delay(NamedTuple):
    """Delay of the second rate after the first."""

    value: float  # s
    stddev: float  # s


def correlate_rates(first: FloatArray, second: FloatArray, cell: float) -> Delay | None:
    """Delay between two rates (m,) on cells of ``cell`` s; None where they are not correlated."""
    steps = round(LARGEST_DELAY / cell)
    usable = np.isfinite(first) & np.isfinite(second)
    a, b = (_clip_spikes(np.where(usable, rates, 0.0)) for rates in (first, second))
    size = round(_PIECE / cell)
    count = (len(a) - 2 * steps) // size
    if count < _LEAST_PIECES:
        size = max((len(a) - 2 * steps) // _LEAST_PIECES, 1)
        count = _LEAST_PIECES if size * cell > 3.0 else 0
    if count < _LEAST_PIECES:
        return None
    shifts: IntArray = np.arange(-steps, steps + 1)
    cross = np.zeros((count, len(shifts)))
    energies = np.zeros((count, 2, len(shifts)))
    for k in range(count):
        at = steps + k * size + np.arange(size)
        reference = a[at] - a[at].mean()
        windows = b[at[:, np.newaxis] + shifts[np.newaxis, :]]
        windows = windows - windows.mean(axis=0)
        cross[k] = reference @ windows
        energies[k, 0], energies[k, 1] = reference @ reference, np.sum(windows**2, axis=0)
    total = _correlation_peak(cross.sum(axis=0), energies.sum(axis=0), shifts, cell)
    if total is None or total[1] < _LEAST_CORRELATION or abs(total[0]) >= LARGEST_DELAY:  # maximum at an end
        return None
    strong = energies[:, 0, 0] > 0.02 * energies[:, 0, 0].sum()
    if strong.sum() < 2:
        return None
    deviations: list[float] = []
    for k in np.flatnonzero(strong).tolist():
        others = np.arange(count) != k
        peak = _correlation_peak(cross[others].sum(axis=0), energies[others].sum(axis=0), shifts, cell)
        if peak is not None:
            deviations.append(peak[0] - total[0])
    n = len(deviations)
    stddev = float(np.sqrt((n - 1) / n * np.sum(np.square(deviations)))) if n > 1 else LARGEST_DELAY
    return Delay(total[0], max(stddev, 0.02))


def _clip_spikes(rates: FloatArray) -> FloatArray:
    """Rates, clipped so that jumps of poses do not dominate the correlation."""
    most = 1.5 * float(np.percentile(np.abs(rates), 98))
    return np.clip(rates, -most, most)


def _correlation_peak(
    cross: FloatArray, energy: FloatArray, shifts: IntArray, cell: float
) -> tuple[float, float] | None:
    """Shift of the maximum, s, interpolated between cells, and the correlation there; None without motion."""
    scale = np.sqrt(energy[0] * energy[1])
    if (scale <= 0.0).any():
        return None
    correlation = cross / scale
    k = int(np.argmax(correlation))
    part = 0.0 if k in (0, len(shifts) - 1) else maximum_between_steps(correlation, k)
    return (float(shifts[k]) + part) * cell, float(correlation[k])


def maximum_between_steps(values: FloatArray, k: int) -> float:
    """Offset, steps, from the largest of the values (n,), at ``k``, to the top of the parabola through it."""
    before, top, after = values[k - 1 : k + 2].tolist()
    curvature = before - 2.0 * top + after
    return float(0.5 * (before - after) / curvature) if curvature < 0.0 else 0.0
