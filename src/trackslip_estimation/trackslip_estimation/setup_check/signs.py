# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Signs and swaps, decided together: the few that explain the relations between all sensors.

A hypothesis is one of eight assignments of the tracks (swapped, each sign), a sign of the gyro, a map that is
mirrored or not, and headings that are inverted or not. Its likelihood is that of turns of gyro and tracks, of
the shape of the path, and of headings. Each mistake has a prior of 1 : 300. The odds of a mistake are those
of all hypotheses with it against all without it. Two mistakes that explain a log equally well stay undecided.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_estimation.setup_check.finding import LEAST_LOG, PRIOR

SWAPPED = "tracks_swapped"
LEFT, RIGHT, BOTH = "left_track_sign", "right_track_sign", "both_tracks_sign"
GYRO, MIRROR, HEADING = "gyro_sign", "position_axes_swapped", "heading_convention"
_FORWARD_WEIGHT = 3.0  # ln odds for each e-fold of the share of the distance that is forward
_SHARES = (0.12, 0.88)  # range that this share is clipped to: some machines only reverse


@dataclass(frozen=True)
class Assignment:
    """Correction of the tracks: recorded (left, right) times ``matrix``ᵀ is true (left, right)."""

    causes: frozenset[str]
    matrix: FloatArray  # (2, 2)

    @property
    def distance(self) -> FloatArray:
        """(2,) coefficients of the recorded tracks in the sum of the true ones, twice the distance."""
        return np.asarray(self.matrix.sum(axis=0))

    @property
    def turn(self) -> FloatArray:
        """(2,) coefficients of the recorded tracks in the turn, true right less true left."""
        return np.asarray(self.matrix[1] - self.matrix[0])


def _make_assignments() -> tuple[Assignment, ...]:
    assignments = []
    for swap, (left, right) in itertools.product((False, True), itertools.product((1.0, -1.0), repeat=2)):
        signs = {(1.0, 1.0): set(), (-1.0, 1.0): {LEFT}, (1.0, -1.0): {RIGHT}, (-1.0, -1.0): {BOTH}}
        matrix = np.diag((left, right))
        causes = signs[left, right] | ({SWAPPED} if swap else set())
        assignments.append(Assignment(frozenset(causes), matrix[::-1].copy() if swap else matrix))
    return tuple(assignments)


ASSIGNMENTS = _make_assignments()
DISTANCES = (np.array((1.0, 1.0)), np.array((1.0, -1.0)))  # of recorded tracks, up to a sign


@dataclass(frozen=True)
class Evidence:
    """Ln likelihoods of the relations; zeros where a sensor is missing."""

    turns: FloatArray  # (4,) of gyro and tracks: ``turning.PATTERNS``, with the gyro as it is
    shapes: FloatArray  # (2, 2) of the path by gyro: ``DISTANCES``, equal or opposite turns of gyro and map
    track_shapes: FloatArray  # (2, 2) of the path by tracks: ``DISTANCES``, turns as recorded or opposite
    headings: FloatArray  # (2,) equal or opposite turns of heading and gyro
    track_headings: FloatArray  # (4,) of heading and tracks: ``turning.PATTERNS``
    courses: FloatArray  # (8, 2, 2) of each assignment, map as it is or mirrored, heading as is or inverted
    forward: FloatArray  # (8,) share of the distance that is forward
    has_gyro: bool
    has_map: bool
    has_heading: bool


@dataclass(frozen=True)
class Decision:
    """The most probable hypothesis, and the odds of each mistake."""

    assignment: Assignment
    gyro: float  # 1 or −1, correction
    is_mirrored: bool
    heading: float  # 1 or −1, correction
    causes: frozenset[str]  # mistakes of the hypothesis
    log_odds: Mapping[str, float]  # ln odds of each cause
    any_odds: float  # ln odds of any mistake
    rivals: tuple[frozenset[str], ...]  # other sets of mistakes within 1 : 100
    untested: tuple[str, ...]  # single mistakes that the drive excludes by less than 100 : 1


def decide(e: Evidence) -> Decision:
    """The most probable of all hypotheses, and odds over all of them."""
    hypotheses = list(
        itertools.product(
            range(len(ASSIGNMENTS)),
            (0, 1) if e.has_gyro else (0,),
            (0, 1) if e.has_map else (0,),
            (0, 1) if e.has_heading else (0,),
        )
    )
    scores = np.array([_score(e, *h) for h in hypotheses])
    sets = [_hypothesis_causes(*h) for h in hypotheses]
    best = int(np.argmax(scores))
    weights = np.exp(scores - scores[best])
    names = sorted(set().union(*sets))
    odds = {name: _log_odds(weights, np.array([name in one for one in sets])) for name in names}
    any_odds = _log_odds(weights, np.array([bool(one) for one in sets]))
    near = [k for k in np.argsort(-scores) if scores[best] - scores[k] < LEAST_LOG]
    rivals = tuple(dict.fromkeys(sets[k] for k in near if sets[k] != sets[best]))
    by_set = dict(zip(sets, scores.tolist(), strict=True))
    threshold = by_set[frozenset()] - PRIOR - LEAST_LOG
    untested = tuple(name for name in names if by_set[frozenset((name,))] > threshold)
    a, g, p, h = hypotheses[best]
    return Decision(
        assignment=ASSIGNMENTS[a],
        gyro=1.0 - 2.0 * g,
        is_mirrored=bool(p),
        heading=1.0 - 2.0 * h,
        causes=sets[best],
        log_odds=odds,
        any_odds=any_odds,
        rivals=rivals,
        untested=untested,
    )


def _hypothesis_causes(a: int, g: int, p: int, h: int) -> frozenset[str]:
    others = {name for name, is_present in ((GYRO, g), (MIRROR, p), (HEADING, h)) if is_present}
    return ASSIGNMENTS[a].causes | others


def _score(e: Evidence, a: int, g: int, p: int, h: int) -> float:
    assignment = ASSIGNMENTS[a]
    pattern = turn_pattern(assignment.turn)
    distance_index = 0 if assignment.distance[0] == assignment.distance[1] else 1
    score = -PRIOR * len(_hypothesis_causes(a, g, p, h))
    if e.has_gyro:
        score += float(e.turns[opposite_pattern(pattern) if g else pattern] + e.shapes[distance_index, g ^ p])
        score += float(e.headings[g ^ h])
    else:
        turned = assignment.turn * (-1.0 if p else 1.0)
        score += float(e.track_shapes[distance_index, track_sense(turned)])
        score += float(e.track_headings[opposite_pattern(pattern) if h else pattern])
    score += float(e.courses[a, p, h])
    return score + _FORWARD_WEIGHT * float(np.log(np.clip(e.forward[a], *_SHARES)))


def turn_pattern(turn: FloatArray) -> int:
    """Index in ``turning.PATTERNS`` of the turn (2,) of an assignment."""
    return {(-1.0, 1.0): 0, (1.0, -1.0): 1, (1.0, 1.0): 2, (-1.0, -1.0): 3}[float(turn[0]), float(turn[1])]


def opposite_pattern(pattern: int) -> int:
    """Index of the pattern of opposite turns."""
    return (1, 0, 3, 2)[pattern]


def track_sense(turn: FloatArray) -> int:
    """0 where the turn (2,) is right less left, or, with one inverted track, their sum; 1: the opposite."""
    return 0 if turn[1] > 0.0 else 1


def _log_odds(weights: FloatArray, is_present: BoolArray) -> float:
    present, absent = float(weights[is_present].sum()), float(weights[~is_present].sum())
    return float(np.log(max(present, 1e-300)) - np.log(max(absent, 1e-300)))
