# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Likelihoods of all relations between tracks, gyro, fixes and headings of one drive."""

from dataclasses import dataclass

import numpy as np

from trackslip_estimation.setup_check.finding import PRIOR
from trackslip_estimation.setup_check.grid import WINDOW, Grid, window_edges, window_sums
from trackslip_estimation.setup_check.heading import (
    Courses,
    around_any,
    course_logs,
    heading_at,
    straight_courses,
    turn_logs,
)
from trackslip_estimation.setup_check.log import Compass, Fixes, FloatArray, Machine
from trackslip_estimation.setup_check.path import Path, compare, dead_reckoning, thinned
from trackslip_estimation.setup_check.signs import ASSIGNMENTS, DISTANCES, Evidence
from trackslip_estimation.setup_check.turning import TurnFit, fit_turns

_FIX_SPACING = 0.5  # s
_USUAL_EFFICIENCY = 0.7  # κ where the turns do not show it
_LEAST_COURSES = 3


@dataclass(frozen=True)
class Drive:
    """What the relations are made of."""

    grid: Grid
    machine: Machine
    fixes: Fixes | None = None
    compass: Compass | None = None
    has_gyro: bool = False  # whether its z axis shows turns

    @property
    def x(self) -> FloatArray:
        """(w, 2) distances of the tracks in windows over the tread, rad."""
        return window_sums(self.grid, self.grid.tracks) / self.machine.tread

    @property
    def turn(self) -> FloatArray:
        """(w,) of the gyro, rad."""
        return window_sums(self.grid, self.grid.turns[:, 2])

    def heading_turns(self) -> FloatArray:
        """(w,) of the stated heading, rad."""
        if self.compass is None:
            return np.full(len(self.x), np.nan)
        return np.diff(heading_at(self.compass, window_edges(self.grid)))


def gather(drive: Drive, fit: TurnFit | None = None) -> Evidence:
    """All likelihoods, none below that of a gyro that shows no turns; zeros where a sensor is missing."""
    x, grid = drive.x, drive.grid
    fit = fit or fit_turns(drive.turn, x, WINDOW)
    of_heading = drive.heading_turns()
    has_heading = drive.compass is not None and int(np.isfinite(of_heading).sum()) >= 3
    return Evidence(
        np.maximum(fit.logs, -PRIOR) if drive.has_gyro else np.zeros(4),
        _gyro_shapes(drive, fit),
        _track_shapes(drive, fit),
        turn_logs(of_heading, drive.turn - fit.bias * WINDOW)
        if drive.has_gyro and has_heading
        else np.zeros(2),
        fit_turns(of_heading, x, WINDOW).logs if has_heading and not drive.has_gyro else np.zeros(4),
        _courses(drive, fit) if has_heading else np.zeros((len(ASSIGNMENTS), 2, 2)),
        forward_shares(grid.tracks),
        drive.has_gyro,
        drive.fixes is not None,
        has_heading,
    )


def gyro_turn(drive: Drive, bias: float) -> FloatArray:
    """(m,) of the cells, rad."""
    return np.asarray(drive.grid.turns[:, 2] - bias * drive.grid.cell)


def _gyro_shapes(drive: Drive, fit: TurnFit) -> FloatArray:
    if drive.fixes is None or not drive.has_gyro:
        return np.zeros((2, 2))
    turn = gyro_turn(drive, fit.bias)
    paths = [
        dead_reckoning(drive.grid, drive.grid.tracks @ distance / 2.0, sign * turn)
        for distance in DISTANCES
        for sign in (1.0, -1.0, 0.0)
    ]
    logs = compare(paths, thinned(drive.fixes, _FIX_SPACING)).logs.reshape(2, 3)
    return np.asarray(np.maximum(logs[:, :2], logs[:, 2:] - PRIOR))


def _track_shapes(drive: Drive, fit: TurnFit) -> FloatArray:
    """By turns of the tracks, for a machine without a gyro that turns."""
    if drive.fixes is None or drive.has_gyro:
        return np.zeros((2, 2))
    tracks, fixes = drive.grid.tracks, thinned(drive.fixes, _FIX_SPACING)
    efficiency = _USUAL_EFFICIENCY / drive.machine.tread
    paths: list[Path] = []
    for distance in DISTANCES:
        turn = efficiency * (tracks @ np.array((-distance[1], distance[0])))
        paths += [dead_reckoning(drive.grid, tracks @ distance / 2.0, sign * turn) for sign in (1.0, -1.0)]
    return compare(paths, fixes).logs.reshape(2, 2)


def _courses(drive: Drive, fit: TurnFit) -> FloatArray:
    """(8, 2, 2) of each assignment, map as it is or mirrored, heading as it is or the other way round."""
    found = np.zeros((len(ASSIGNMENTS), 2, 2))
    if drive.fixes is None or drive.compass is None:
        return found
    turn = gyro_turn(drive, fit.bias) if drive.has_gyro else np.zeros(len(drive.grid.tracks))
    steps = straight_courses(drive.grid, turn, drive.fixes, drive.compass)
    if len(steps.courses) < _LEAST_COURSES:
        return found
    ways = window_sums(drive.grid, drive.grid.tracks)[steps.windows.astype(np.int64)]
    for a, assignment in enumerate(ASSIGNMENTS):
        reverse = np.where(ways @ assignment.distance < 0.0, np.pi, 0.0)
        for p in (0, 1):
            for h in (0, 1):
                found[a, p, h] = max(
                    direction_log(course - heading - reverse)
                    for course in unmirrored(steps, is_mirrored=bool(p))
                    for heading in turned_over(steps, is_turned=bool(h))
                )
    return found


def direction_log(differences: FloatArray) -> float:
    """Ln likelihood of course less heading: around 0, or off by an angle that is as likely as a mistake."""
    return float(np.logaddexp(course_logs(differences)[0], around_any(differences) - PRIOR))


def unmirrored(steps: Courses, *, is_mirrored: bool) -> list[FloatArray]:
    """Courses as they are, or with x and y swapped, y the other way round, x the other way round."""
    course = steps.courses
    return [np.pi / 2.0 - course, -course, np.pi - course] if is_mirrored else [course]


def turned_over(steps: Courses, *, is_turned: bool) -> list[FloatArray]:
    """Headings as they are, or from north clockwise, or clockwise."""
    heading = steps.headings
    return [np.pi / 2.0 - heading, -heading] if is_turned else [heading]


def forward_shares(tracks: FloatArray) -> FloatArray:
    """(8,) of the distance, by each assignment; a few metres of it are taken as half."""
    known = tracks[np.isfinite(tracks).all(axis=1)]
    shares = []
    for assignment in ASSIGNMENTS:
        way = known @ assignment.distance / 2.0
        ahead, back = float(way[way > 0.0].sum()), float(-way[way < 0.0].sum())
        shares.append((ahead + 1.0) / (ahead + back + 2.0))
    return np.array(shares)
