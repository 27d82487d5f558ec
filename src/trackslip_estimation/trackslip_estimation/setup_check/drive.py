# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A drive with tracks, one gyro, one source of fixes, one of headings, and quantities derived from them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_estimation.setup_check.grid import WINDOW, Grid, make_grid, window_sums
from trackslip_estimation.setup_check.heading import (
    Courses,
    heading_at,
    straight_courses,
    window_displacements,
)
from trackslip_estimation.setup_check.log import Compass, Fixes, Gyro, Log, Machine
from trackslip_estimation.setup_check.path import Path, PathFits, compare_paths, dead_reckoning, thin_fixes
from trackslip_estimation.setup_check.turning import TurnFit, fit_turns

DISTANCES = (np.array((1.0, 1.0)), np.array((1.0, -1.0)))  # signs of both tracks, up to a common one
USUAL_EFFICIENCY = 0.7  # κ, turning efficiency, where the turns do not show it
HEADING_NOISE = np.radians(5.0)  # rad, in a window
_FIX_SPACING = 0.5  # s, between fixes that are compared with paths


@dataclass(frozen=True)
class Drive:
    """A log with one source of each kind at most; windows are of ``grid.WINDOW`` s."""

    log: Log

    @classmethod
    def from_sources(
        cls, log: Log, gyro: Gyro | None, fixes: Fixes | None, compass: Compass | None
    ) -> "Drive":
        """A drive of the tracks of a log with these sources."""
        gyros, fix_sources = () if gyro is None else (gyro,), () if fixes is None else (fixes,)
        return cls(
            replace(log, gyros=gyros, fixes=fix_sources, compasses=() if compass is None else (compass,))
        )

    def with_gyro(self, gyro: Gyro | None) -> "Drive":
        """The drive with another version of the gyro, or none."""
        return Drive.from_sources(self.log, gyro, self.fixes, self.compass)

    @property
    def machine(self) -> Machine:
        """Geometry that the parameters state."""
        return self.log.machine

    @property
    def gyro(self) -> Gyro | None:
        """The gyro; None where there is none, or where its z axis shows no turns."""
        return next(iter(self.log.gyros), None)

    @property
    def is_swing_unknown(self) -> bool:
        """Whether the gyro is on an upper structure whose swing was not recorded."""
        return self.gyro is not None and self.gyro.is_above and self.log.swing is None

    @property
    def fixes(self) -> Fixes | None:
        """The source of positions, or None."""
        return next(iter(self.log.fixes), None)

    @property
    def compass(self) -> Compass | None:
        """The source of headings, or None."""
        return next(iter(self.log.compasses), None)

    @cached_property
    def grid(self) -> Grid:
        """Increments of tracks and gyro."""
        grid = make_grid(self.log, self.gyro)
        assert grid is not None  # callers check the length of the log first
        return grid

    @cached_property
    def tracks_over_tread(self) -> FloatArray:
        """(w, 2) distances of the tracks in windows over the tread, rad; nan where not recorded."""
        tracks = np.where(self.grid.is_driven[:, np.newaxis], self.grid.tracks, np.nan)
        return window_sums(self.grid, tracks) / self.machine.tread

    @cached_property
    def turn(self) -> FloatArray:
        """(w,) turn of the gyro, with its bias, rad."""
        return window_sums(self.grid, self.grid.turns[:, 2])

    @cached_property
    def unbiased_turn(self) -> FloatArray:
        """(w,) turn of the gyro, rad, less its bias."""
        return self.turn - self.turn_fit.bias * WINDOW

    @cached_property
    def headings(self) -> FloatArray:
        """(m + 1,) stated headings at the edges of the grid, rad; nan where there is none."""
        edges = self.grid.edges
        return np.full(len(edges), np.nan) if self.compass is None else heading_at(self.compass, edges)

    @cached_property
    def heading_turn(self) -> FloatArray:
        """(w,) turn of the stated headings, rad."""
        return np.diff(self.headings[:: self.grid.cells_per_window])

    @cached_property
    def fix_distances(self) -> FloatArray:
        """(w,) distance by the fixes, m; nan where there is none."""
        if self.fixes is None:
            return np.full(len(self.tracks_over_tread), np.nan)
        return np.asarray(np.abs(window_displacements(self.fixes, self.grid)))

    @property
    def distance_by_fixes(self) -> float:
        """Distance by the fixes, in steps that exceed their noise, m; 0 without fixes."""
        if self.fixes is None:
            return 0.0
        return float(np.nansum(self.fix_distances[self.exceeds_noise(self.fix_distances)]))

    def exceeds_noise(self, distances: FloatArray) -> BoolArray:
        """(w,) whether distances in windows, m, exceed the noise of the fixes; none does without fixes."""
        return np.asarray(distances > (np.inf if self.fixes is None else 3.0 * self.fixes.noise))

    @cached_property
    def turn_fit(self) -> TurnFit:
        """Fit of the turns of the gyro by the tracks."""
        return fit_turns(self.turn, self.tracks_over_tread)

    @cached_property
    def gyro_turn(self) -> FloatArray:
        """(m,) turn of the gyro in the cells, without its bias, rad; zeros without a gyro."""
        if self.gyro is None:
            return np.zeros(len(self.grid.tracks))
        return np.asarray(self.grid.turns[:, 2] - self.turn_fit.bias * self.grid.cell)

    @cached_property
    def path(self) -> Path:
        """Dead reckoning by tracks and gyro; by the tracks alone without a gyro."""
        if self.gyro is None:
            return self.track_path
        return dead_reckoning(self.grid, self.grid.tracks.mean(axis=1), self.gyro_turn)

    @cached_property
    def track_path(self) -> Path:
        """Dead reckoning by the tracks alone, with the turning efficiency by the gyro, or the usual one."""
        efficiency = float(self.turn_fit.efficiencies[0]) if self.turn_fit.logs[0] > 0.0 else USUAL_EFFICIENCY
        left, right = self.grid.tracks.T
        turn = efficiency * (right - left) / self.machine.tread
        return dead_reckoning(self.grid, (left + right) / 2.0, turn)

    def path_fits(self, motions: Sequence[tuple[FloatArray, FloatArray]]) -> PathFits:
        """Likelihoods of dead reckoning by each motion, given the path of the fixes; zeros without fixes.

        A motion: signs of both tracks (2,), whose mean is the distance; turns (m,) of the cells, rad.
        """
        if self.fixes is None:
            return PathFits(np.zeros(len(motions)), 0)
        tracks = self.grid.tracks
        paths = [dead_reckoning(self.grid, tracks @ signs / 2.0, turn) for signs, turn in motions]
        return compare_paths(paths, thin_fixes(self.fixes, _FIX_SPACING))

    @cached_property
    def courses(self) -> Courses:
        """Straight steps of the fixes with a heading."""
        if self.fixes is None or self.compass is None:
            return Courses(np.empty(0), np.empty(0), np.empty(0, np.int64), np.empty(0))
        return straight_courses(self.grid, self.fixes, self.compass)
