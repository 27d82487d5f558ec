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
from dataclasses import dataclass, replace

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_estimation.setup_check import inertial, remedies
from trackslip_estimation.setup_check.drive import DISTANCES, USUAL_EFFICIENCY, Drive
from trackslip_estimation.setup_check.finding import LEAST_LOG, PRIOR, Cause, Finding, OpenQuestion, odds_of
from trackslip_estimation.setup_check.grid import WINDOW, window_sums
from trackslip_estimation.setup_check.heading import Courses, direction_log, turn_logs
from trackslip_estimation.setup_check.turning import LEAST_TURNS, count_turns, fit_turns

SWAPPED = "tracks_swapped"
LEFT, RIGHT, BOTH = "left_track_sign", "right_track_sign", "both_tracks_sign"
GYRO, MIRROR, HEADING = "gyro_sign", "position_axes_swapped", "heading_convention"
_FRONT_AND_REAR = frozenset((BOTH, SWAPPED))  # exchanged: the machine turns as recorded
_FORWARD_WEIGHT = 3.0  # ln odds for each e-fold of the share of the distance that is forward
_SHARES = (0.12, 0.88)  # range that this share is clipped to: some machines only reverse
_LEAST_COURSES = 3
_CLEAR_LOG_ODDS = float(np.log(1e4))  # ln odds at which fewer than three turns suffice
_LEAST_TURNED = np.radians(25.0)  # in all, for these odds
_TURNING = np.radians(2.0)  # in a window
_LEAST_DISTANCE = 2.0  # m per m of the tread
MIRRORS = ("position_axes_swapped", "position_sign", "position_sign")
_TURN_REQUEST = "turn left and right by 90° once each, and drive 10 m straight"


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
    exchanged, right = sets.index(_FRONT_AND_REAR), sets.index(frozenset())
    if scores[exchanged] - scores[right] < LEAST_LOG:  # lever arm and headings show it
        scores[exchanged] = -np.inf
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


@dataclass(frozen=True)
class Directions:
    """Corrections of the signs, and the findings with the causes that they undo."""

    decision: Decision
    mirror: int  # 0: x and y swapped, 1: y negated, 2: x negated
    convention: int  # 0: from north, clockwise; 1: clockwise
    is_decided: bool
    findings: tuple[Finding, ...] = ()

    def correct_signs(self, drive: Drive) -> Drive:
        """The drive without these mistakes."""
        decision, gyro, fixes, compass = self.decision, drive.gyro, drive.fixes, drive.compass
        if gyro is not None:
            gyro = replace(gyro, rates=gyro.rates * np.array((1.0, 1.0, decision.gyro)))
        if fixes is not None and decision.is_mirrored:
            x, y = fixes.places.T
            fixes = replace(fixes, places=np.column_stack(((y, x), (x, -y), (-x, y))[self.mirror]))
        if compass is not None and decision.heading < 0.0:
            headings = compass.headings
            compass = replace(compass, headings=-headings if self.convention else np.pi / 2.0 - headings)
        return Drive.from_sources(drive.log.with_tracks(decision.assignment.matrix), gyro, fixes, compass)


def decide_signs(drive: Drive, *, is_upside_down: bool) -> Directions:
    """Signs of tracks, gyro, map and headings, decided together."""
    evidence, gyro = gather_evidence(drive), drive.gyro
    decision = decide(evidence)
    mirror, convention = _best_conventions(drive, decision)
    needs = _missing_motion(drive, decision)
    if needs:
        return Directions(decision, mirror, convention, decision.any_odds < 0.0, tuple(needs))
    likely = {name: log for name, log in decision.log_odds.items() if log >= LEAST_LOG}
    found: list[Finding] = [
        inertial.upside_down_cause(gyro, log)
        if is_upside_down and name == GYRO and gyro is not None
        else _sign_cause(name, log, drive, mirror, convention)
        for name, log in likely.items()
    ]
    is_open = decision.any_odds > 0.0 and not likely
    if is_open:
        sets = [decision.causes, *decision.rivals]
        what = " or ".join(" and ".join(sorted(one)) or "none" for one in sets)
        found.append(OpenQuestion(what, _missing_sensor(evidence), decision.any_odds > LEAST_LOG))
    untested = set(decision.untested) if not likely and not is_open else set()
    if untested:
        what = f"{', '.join(sorted(untested))}: neither shown nor excluded"
        needed = _TURN_REQUEST if untested != {BOTH} else _missing_sensor(evidence)
        found.append(OpenQuestion(what, needed))
    return Directions(decision, mirror, convention, not is_open, tuple(found))


def _missing_motion(drive: Drive, decision: Decision) -> list[OpenQuestion]:
    """Turns and distance that the drive lacks."""
    turn, (left, right) = drive.turn - drive.turn_fit.bias * WINDOW, drive.tracks_over_tread.T
    count, turned = count_turns(turn), float(np.nansum(np.abs(turn[np.abs(turn) > _TURNING])))
    if drive.gyro is None:
        count = max(count_turns(0.5 * (right - left)), count_turns(0.5 * (right + left)))
        count = min(count, count_turns(drive.heading_turn)) if drive.compass is not None else count
    distances = [np.abs(window_sums(drive.grid, drive.grid.tracks @ one / 2.0)) for one in DISTANCES]
    distance = max(float(np.nansum(one)) for one in distances)
    needs = []
    is_clear = turned > _LEAST_TURNED and max(decision.log_odds.values(), default=-1.0) > _CLEAR_LOG_ODDS
    if count < LEAST_TURNS and not is_clear:
        needs.append(
            OpenQuestion(f"signs of tracks, gyro, fixes and headings ({count} turns of 15°)", _TURN_REQUEST)
        )
    if distance < _LEAST_DISTANCE * max(drive.machine.tread, 0.3):
        needs.append(OpenQuestion(f"signs of the tracks ({distance:.1f} m driven)", _TURN_REQUEST))
    return needs


def _missing_sensor(evidence: Evidence) -> str:
    if not evidence.has_map:
        return (
            "record fixes while you drive 10 m and turn left and right by "
            "90°: they show which of the two is wrong"
        )
    if not evidence.has_gyro:
        return "record a gyro while you turn left and right by 90°: it shows which of the two is wrong"
    return "drive 20 m forward, hardly in reverse, with turns of 90° to both sides"


def _best_conventions(drive: Drive, decision: Decision) -> tuple[int, int]:
    """Index of the mirror image, and of the other convention of headings, that agree best with courses."""
    steps = drive.courses
    if drive.compass is None or not len(steps.courses):
        return 0, 0
    distances = window_sums(drive.grid, drive.grid.tracks)[steps.windows]
    reverse = np.where(distances @ decision.assignment.distance < 0.0, np.pi, 0.0)
    courses = course_alternatives(steps, is_mirrored=decision.is_mirrored)
    is_inverted = decision.heading < 0.0
    twice_offset = 2.0 * drive.compass.offset if is_inverted else 0.0  # the offset that was taken off stays
    headings = [h - twice_offset for h in heading_alternatives(steps, is_inverted=is_inverted)]
    logs = np.array([[direction_log(c - h - reverse) for h in headings] for c in courses])
    mirror, convention = np.unravel_index(int(np.argmax(logs)), logs.shape)
    return int(mirror), int(convention)


def _sign_cause(name: str, log: float, drive: Drive, mirror: int, convention: int) -> Cause:
    gyro, fixes, compass = drive.gyro, drive.fixes, drive.compass
    third = fixes.name if fixes else (compass.name if compass else "")
    also = f"; {third} agrees" if third else ""
    tracks = {
        SWAPPED: (f"turns opposite to its tracks{also} with the gyro", remedies.SWAP_TRACKS),
        BOTH: (
            f"drives and turns opposite to its tracks{also} with the gyro",
            remedies.track_sign("left", "right"),
        ),
        LEFT: (
            "drives and turns as if the left track had the opposite sign",
            remedies.track_sign("left"),
        ),
        RIGHT: (
            "drives and turns as if the right track had the opposite sign",
            remedies.track_sign("right"),
        ),
    }
    if name in tracks:
        motion, remedy = tracks[name]
        return Cause(name, "sprockets", f"the machine {motion}", odds_of(log), remedy)
    if name == GYRO:
        assert gyro is not None
        evidence = f"the gyro turns opposite to the tracks{also} with the tracks"
        return Cause(name, gyro.name, evidence, odds_of(log), remedies.gyro_sign(gyro))
    if name == MIRROR:
        assert fixes is not None
        evidence = "the path of the fixes is a mirror image of the path by tracks and gyro"
        remedy = (
            "Exchange the columns of x and y (of latitude and longitude) in the mapping",
            "Turn the sign of y: in the mapping 'scale: -1' at y",
            "Turn the sign of x: in the mapping 'scale: -1' at x",
        )[mirror]
        return Cause(MIRRORS[mirror], fixes.name, evidence, odds_of(log), remedy)
    assert compass is not None
    counts = ("the heading counts from north, clockwise", "the heading counts clockwise")[convention]
    evidence = f"{counts}: it turns against tracks, gyro and course"
    remedy = remedies.heading_convention(compass, is_from_north=convention == 0)
    return Cause(HEADING, compass.name, evidence, odds_of(log), remedy)
