# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Likelihoods of all relations between tracks, gyro, fixes and headings of one drive."""

import itertools

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check.drive import USUAL_EFFICIENCY, Drive
from trackslip_estimation.setup_check.finding import PRIOR
from trackslip_estimation.setup_check.grid import WINDOW, window_sums
from trackslip_estimation.setup_check.heading import Courses, direction_log, turn_logs
from trackslip_estimation.setup_check.signs import ASSIGNMENTS, DISTANCES, Evidence
from trackslip_estimation.setup_check.turning import fit_turns

_LEAST_COURSES = 3


def gather_evidence(drive: Drive) -> Evidence:
    """All ln likelihoods, those of the gyro at least that of one without turns; zeros for missing sensors."""
    heading_turn, has_gyro = drive.heading_turn, drive.gyro is not None
    has_heading = int(np.isfinite(heading_turn).sum()) >= 3
    return Evidence(
        np.maximum(drive.turn_fit.logs, -PRIOR) if has_gyro else np.zeros(4),
        _gyro_path_logs(drive),
        _track_path_logs(drive),
        _heading_logs(drive),
        fit_turns(heading_turn, drive.tracks_over_tread).logs
        if has_heading and not has_gyro
        else np.zeros(4),
        _course_log_table(drive) if has_heading else np.zeros((len(ASSIGNMENTS), 2, 2)),
        forward_shares(drive.grid.tracks),
        has_gyro,
        drive.fixes is not None,
        has_heading,
    )


def _heading_logs(drive: Drive) -> FloatArray:
    """(2,) ln likelihood that headings turn with the gyro, or against it."""
    if drive.gyro is None:
        return np.zeros(2)
    logs = turn_logs(drive.heading_turn, drive.turn - drive.turn_fit.bias * WINDOW)
    return np.asarray(np.maximum(logs[:2] - logs[2], -PRIOR))


def _gyro_path_logs(drive: Drive) -> FloatArray:
    if drive.gyro is None:
        return np.zeros((2, 2))
    signs = (1.0, -1.0, 0.0)
    logs = drive.path_fits([(d, s * drive.gyro_turn) for d in DISTANCES for s in signs]).logs.reshape(2, 3)
    return np.asarray(np.maximum(logs[:, :2], logs[:, 2:] - PRIOR))


def _track_path_logs(drive: Drive) -> FloatArray:
    """(2, 2) ln likelihood of the path by turns of the tracks; zeros with a gyro."""
    if drive.gyro is not None:
        return np.zeros((2, 2))
    efficiency = USUAL_EFFICIENCY / drive.machine.tread
    turns = [efficiency * (drive.grid.tracks @ np.array((-d[1], d[0]))) for d in DISTANCES]
    motions = [(d, s * turn) for d, turn in zip(DISTANCES, turns, strict=True) for s in (1.0, -1.0)]
    return drive.path_fits(motions).logs.reshape(2, 2)


def _course_log_table(drive: Drive) -> FloatArray:
    """(8, 2, 2) ln likelihood: assignments, map as it is or mirrored, heading as it is or inverted."""
    table, steps = np.zeros((len(ASSIGNMENTS), 2, 2)), drive.courses
    if len(steps.courses) < _LEAST_COURSES:
        return table
    distances = window_sums(drive.grid, drive.grid.tracks)[steps.windows]
    logs_by_distance: dict[tuple[float, ...], FloatArray] = {}  # pairs of assignments share one
    for a, assignment in enumerate(ASSIGNMENTS):
        key = tuple(assignment.distance.tolist())
        if key not in logs_by_distance:
            reverse = np.where(distances @ assignment.distance < 0.0, np.pi, 0.0)
            logs_by_distance[key] = _course_logs(steps, reverse)
        table[a] = logs_by_distance[key]
    return table


def _course_logs(steps: Courses, reverse: FloatArray) -> FloatArray:
    """(2, 2) ln likelihood: map as it is or mirrored, heading as it is or inverted."""
    logs = np.zeros((2, 2))
    for p, h in itertools.product((0, 1), repeat=2):
        logs[p, h] = max(
            direction_log(course - heading - reverse)
            for course in course_alternatives(steps, is_mirrored=bool(p))
            for heading in heading_alternatives(steps, is_inverted=bool(h))
        )
    return logs


def course_alternatives(steps: Courses, *, is_mirrored: bool) -> list[FloatArray]:
    """Courses as they are, or with x and y swapped, y negated, x negated."""
    course = steps.courses
    return [np.pi / 2.0 - course, -course, np.pi - course] if is_mirrored else [course]


def heading_alternatives(steps: Courses, *, is_inverted: bool) -> list[FloatArray]:
    """Headings as they are, or from north clockwise, or clockwise."""
    heading = steps.headings
    return [np.pi / 2.0 - heading, -heading] if is_inverted else [heading]


def forward_shares(tracks: FloatArray) -> FloatArray:
    """(8,) share of the distance that is forward, by each assignment; near one half for a few metres."""
    driven = tracks[np.isfinite(tracks).all(axis=1)]
    shares = []
    for assignment in ASSIGNMENTS:
        distance = driven @ assignment.distance / 2.0
        ahead, back = float(distance[distance > 0.0].sum()), float(-distance[distance < 0.0].sum())
        shares.append((ahead + 1.0) / (ahead + back + 2.0))
    return np.array(shares)
