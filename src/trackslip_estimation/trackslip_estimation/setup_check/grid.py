# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Tracks and gyro on one time grid: increments in each cell, and their sums over windows."""

from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_estimation.setup_check.log import Array, Gyro, Log, Tracks

CELL = 0.1  # s
WINDOW = 2.0  # s: longer than delays of sensors, shorter than a turn
LONGEST_GAP = 1.0  # s between readings; motion in longer gaps is unknown
_LEAST_SWING_RATE = 0.02  # rad/s, swing rate above which a gyro on the upper structure is not used
_SWING_MARGIN = 1.0  # s, before and after a swing
MOST_CELLS = 400_000  # eleven hours; longer logs have longer cells


@dataclass(frozen=True)
class Grid:
    """Increments of m cells."""

    edges: FloatArray  # (m + 1,) s
    tracks: FloatArray  # (m, 2) left, right: radius times turn of the sprocket, m
    turns: FloatArray  # (m, 3) of the gyro about x, y, z, rad; nan where it was not recorded
    is_driven: BoolArray  # (m,) whether the tracks were recorded

    @property
    def cell(self) -> float:
        """Length of a cell, s."""
        return float(self.edges[1] - self.edges[0])

    @property
    def window_edges(self) -> FloatArray:
        """(w + 1,) edges of the windows of ``WINDOW`` s, s."""
        return self.edges[:: self.cells_per_window]

    @property
    def cells_per_window(self) -> int:
        """Number of cells in a window."""
        return max(round(WINDOW / self.cell), 1)


def make_grid(log: Log, gyro: Gyro | None) -> Grid | None:
    """Grid from the first to the last reading of the tracks; None where there are hardly any."""
    t = log.tracks.t
    if len(t) < 3 or t[-1] - t[0] < 2.0 * WINDOW:
        return None
    cells = max(int((t[-1] - t[0]) / CELL), 1)
    cell = CELL * max(1.0, cells / MOST_CELLS)
    edges = t[0] + cell * np.arange(int((t[-1] - t[0]) / cell) + 1)
    tracks = log.machine.radius * increments(t, log.tracks.angles, edges)
    turns = np.full((len(edges) - 1, 3), np.nan)
    if gyro is not None and len(gyro.t) > 2:
        turns = increments(gyro.t, integral(gyro.t, gyro.rates), edges)
        turns[~covered_cells(gyro.t, edges)] = np.nan
        if gyro.is_above and log.swing is not None and len(log.swing[0]) > 2:
            turns[_swinging_cells(log.swing, edges)] = np.nan
    return Grid(edges, tracks, turns, covered_cells(t, edges))


def _swinging_cells(swing: tuple[FloatArray, FloatArray], edges: FloatArray) -> BoolArray:
    """(m,) cells in which, or within a second of which, the upper structure swings."""
    angle, middle = np.unwrap(swing[1]), (edges[1:] + edges[:-1]) / 2.0
    after = np.interp(middle + _SWING_MARGIN, swing[0], angle)
    before = np.interp(middle - _SWING_MARGIN, swing[0], angle)
    return np.asarray(np.abs(after - before) > 2.0 * _SWING_MARGIN * _LEAST_SWING_RATE)


def integral(t: FloatArray, rates: FloatArray) -> FloatArray:
    """(n, k) integral from the first of n readings on, by trapezoids; gaps add zero."""
    steps = np.where(np.diff(t) <= LONGEST_GAP, np.diff(t), 0.0)[:, np.newaxis]
    means = (rates[1:] + rates[:-1]) / 2.0
    return np.concatenate((np.zeros((1, rates.shape[1])), np.cumsum(means * steps, axis=0)))


def running_sum(values: Array) -> Array:
    """(n + 1,) sums of the first 0 to n of (n,) values."""
    return np.concatenate(([0.0], np.cumsum(values)))


def tracks_of_speeds(t: FloatArray, speeds: FloatArray) -> Tracks:
    """The sprockets with speeds (n, 2), rad/s, and their integral as angles."""
    return Tracks(t, speeds, integral(t, speeds))


def increments(t: FloatArray, values: FloatArray, edges: FloatArray) -> FloatArray:
    """(m, k) increments of (n, k) values between m + 1 edges, linear between readings."""
    return np.diff(np.column_stack([np.interp(edges, t, column) for column in values.T]), axis=0)


def covered_cells(t: FloatArray, edges: FloatArray) -> BoolArray:
    """(m,) whether readings cover each cell without a gap."""
    after = np.clip(np.searchsorted(t, edges[1:]), 1, len(t) - 1)
    before = np.clip(np.searchsorted(t, edges[:-1], side="right") - 1, 0, len(t) - 2)
    is_covered: BoolArray = (t[after] - t[before] <= LONGEST_GAP + edges[1] - edges[0]) & (
        edges[:-1] >= t[0] - 1e-9
    )
    return np.asarray(is_covered & (edges[1:] <= t[-1] + 1e-9))


def window_sums(grid: Grid, values: FloatArray) -> FloatArray:
    """(w, …) sums of (m, …) values over windows of ``WINDOW`` s."""
    size = grid.cells_per_window
    count = len(values) // size
    shaped = values[: count * size].reshape(count, size, *values.shape[1:])
    return np.asarray(shaped.sum(axis=1))
