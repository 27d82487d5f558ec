# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Quantities of the columns of sprockets and gyro: positions, speeds or increments, whatever is declared.

With the right quantity, the tracks move when the fixes do, and turn when gyro and headings do. Units and
signs of all sensors are free. n windows with an explained share R² have a weight of −n/2 ln(1 − R²), which is
their ln likelihood ratio over no relation.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check.drive import DISTANCES, USUAL_EFFICIENCY, Drive
from trackslip_estimation.setup_check.finding import PRIOR, Cause, Finding, odds_of
from trackslip_estimation.setup_check.grid import integral
from trackslip_estimation.setup_check.log import Log, Tracks
from trackslip_estimation.setup_check.speeds import rough_scale
from trackslip_estimation.setup_check.turning import known_windows, turn_scale

_LEAST_EXPLAINED = 0.6  # R², by the right quantity
_MOST_EXPLAINED = 0.95  # cap of any R²: the last per cents do not decide
_LEAST_WINDOWS = 8


class _Interpretation(NamedTuple):
    """One interpretation of the columns, and the remedy if it is right."""

    cause: str
    what: str
    change: Callable[[Log], Log]
    remedy: str


def _replace_angles(angles: Callable[[Tracks], FloatArray]) -> Callable[[Log], Log]:
    """A change of a log to ``angles`` (n, 2) of the sprockets, rad, and their derivatives."""

    def change(log: Log) -> Log:
        t, new_angles = log.tracks.t, angles(log.tracks)
        return replace(log, tracks=Tracks(t, np.gradient(new_angles, t, axis=0), new_angles))

    return change


def _differentiate_gyro(log: Log) -> Log:
    gyros = (replace(g, rates=np.gradient(np.unwrap(g.rates, axis=0), g.t, axis=0)) for g in log.gyros)
    return replace(log, gyros=tuple(gyros))


_INTERPRETATIONS = (
    _Interpretation(
        "speed_unit",
        "speeds, declared positions",
        _replace_angles(lambda tracks: integral(tracks.t, tracks.angles)),
        "Call the columns left_velocity and right_velocity in the mapping",
    ),
    _Interpretation(
        "speed_unit",
        "increments, declared positions",
        _replace_angles(lambda tracks: np.cumsum(tracks.angles, axis=0)),
        "State 'increments: true' at left_position and right_position in the mapping",
    ),
    _Interpretation(
        "speed_unit",
        "positions, declared speeds",
        _replace_angles(lambda tracks: tracks.speeds),
        "Call the columns left_position and right_position in the mapping",
    ),
    _Interpretation(
        "gyro_unit",
        "angles, declared rates",
        _differentiate_gyro,
        "Name the column of the yaw rate, not of the yaw angle, at angular_velocity_z in the mapping",
    ),
)


class _Relations(NamedTuple):
    """Relations between pairs of sensors of a drive."""

    weight: float  # ln likelihood ratio over no relation
    shares: FloatArray  # (4,) R²


def judge_quantity(drive: Drive) -> tuple[Drive, list[Finding]]:
    """The drive with its columns as the right quantity, and the cause if another quantity was declared."""
    declared, best = _fit_relations(drive), (drive, _Relations(0.0, np.zeros(4)), _INTERPRETATIONS[0])
    for interpretation in _INTERPRETATIONS:
        other = Drive(interpretation.change(drive.log))
        relations = _fit_relations(other)
        gain = relations.weight - best[1].weight
        if gain > PRIOR or (gain > -PRIOR and _misfit(other) < _misfit(best[0])):  # a tie: by misfit
            best = other, relations, interpretation
    corrected, relations, interpretation = best
    pair = int(np.argmax(relations.shares - declared.shares))  # that gains most
    log_ratio = relations.weight - declared.weight - PRIOR
    if log_ratio < PRIOR or relations.shares[pair] < _LEAST_EXPLAINED:
        return drive, []
    source = "sprockets" if interpretation.cause == "speed_unit" or drive.gyro is None else drive.gyro.name
    evidence = (
        f"the columns are {interpretation.what}: so they explain {relations.shares[pair]:.0%} of what "
        f"another sensor shows of the motion, as declared {declared.shares[pair]:.0%}"
    )
    odds = odds_of(log_ratio)
    return corrected, [Cause(interpretation.cause, source, evidence, odds, interpretation.remedy)]


def _misfit(drive: Drive) -> float:
    """|ln| of the ratio of fixes to track distances, or else of gyro to track turns, over the usual ratio."""
    distance, turn = rough_scale(drive), turn_scale(drive.turn, drive.tracks_over_tread)
    ratio = turn / USUAL_EFFICIENCY if np.isnan(distance) else distance
    return float(np.nan_to_num(abs(np.log(ratio)), nan=np.inf))


def _fit_relations(drive: Drive) -> _Relations:
    pairs = (
        explained_distance(drive),
        explained_share(drive.turn, drive.tracks_over_tread),
        explained_share(drive.heading_turn, drive.tracks_over_tread),
        explained_share(drive.heading_turn, drive.turn[:, np.newaxis]),
    )
    weight = sum(-count / 2.0 * float(np.log1p(-share)) for share, count in pairs)
    return _Relations(weight, np.array([share for share, _ in pairs]))


def explained_distance(drive: Drive) -> tuple[float, int]:
    """``explained_share`` of the distance by fixes, by tracks of equal signs or of opposite ones."""
    distances = np.abs(drive.tracks_over_tread @ np.column_stack(DISTANCES))
    return max(explained_share(drive.fix_distances, distances[:, k : k + 1]) for k in (0, 1))


def explained_share(observed: FloatArray, x: FloatArray) -> tuple[float, int]:
    """R² of a linear relation of ``observed`` (w,) in windows to x (w, k), and the number of usable ones."""
    y, columns = known_windows(observed, x)
    if len(y) < _LEAST_WINDOWS:
        return 0.0, 0
    y, columns = y - y.mean(), columns - columns.mean(axis=0)
    residuals = y - columns @ np.linalg.lstsq(columns, y, rcond=1e-9)[0]
    total = float(y @ y)
    share = 1.0 - float(residuals @ residuals) / total if total > 1e-12 else 0.0
    return min(max(share, 0.0), _MOST_EXPLAINED), len(y)
