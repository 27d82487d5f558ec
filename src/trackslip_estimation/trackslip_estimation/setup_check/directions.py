# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Causes and evidence of wrong signs, if the drive holds enough turns and distance to decide them."""

from dataclasses import dataclass, replace

import numpy as np

from trackslip_estimation.setup_check import inertial, remedies, signs
from trackslip_estimation.setup_check.drive import Drive
from trackslip_estimation.setup_check.evidence import (
    course_alternatives,
    gather_evidence,
    heading_alternatives,
)
from trackslip_estimation.setup_check.finding import LEAST_LOG, Cause, OpenQuestion, odds_of
from trackslip_estimation.setup_check.grid import WINDOW, window_sums
from trackslip_estimation.setup_check.heading import direction_log
from trackslip_estimation.setup_check.log import Gyro
from trackslip_estimation.setup_check.signs import Decision, Evidence, decide
from trackslip_estimation.setup_check.turning import LEAST_TURNS, count_turns

_CLEAR_LOG_ODDS = float(np.log(1e4))  # ln odds at which fewer than three turns suffice
_LEAST_TURNED = np.radians(25.0)  # in all, for these odds
_TURNING = np.radians(2.0)  # in a window
_LEAST_DISTANCE = 2.0  # m per m of the tread
MIRRORS = ("position_axes_swapped", "position_sign", "position_sign")
_TURN_REQUEST = "turn left and right by 90° once each, and drive 10 m straight"


@dataclass(frozen=True)
class Directions:
    """Corrections of the signs, and the causes they undo."""

    decision: Decision
    mirror: int  # 0: x and y swapped, 1: y negated, 2: x negated
    convention: int  # 0: from north, clockwise; 1: clockwise
    is_decided: bool
    causes: tuple[Cause, ...] = ()
    undetermined: tuple[OpenQuestion, ...] = ()

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
        return Directions(decision, mirror, convention, decision.any_odds < 0.0, undetermined=tuple(needs))
    likely = {name: log for name, log in decision.log_odds.items() if log >= LEAST_LOG}
    causes = [_sign_cause(name, log, drive, gyro, mirror, convention) for name, log in likely.items()]
    if is_upside_down and signs.GYRO in likely and gyro is not None:
        causes = [c for c in causes if c.cause != signs.GYRO]
        causes.append(inertial.upside_down_cause(gyro, likely[signs.GYRO]))
    questions = []
    is_open = decision.any_odds > 0.0 and not likely
    if is_open:
        sets = [decision.causes, *decision.rivals]
        what = " or ".join(" and ".join(sorted(one)) or "none" for one in sets)
        questions.append(OpenQuestion(what, _missing_sensor(evidence), decision.any_odds > LEAST_LOG))
    untested = set(decision.untested) if not likely and not is_open else set()
    if untested:
        what = f"{', '.join(sorted(untested))}: neither shown nor excluded"
        questions.append(
            OpenQuestion(what, _TURN_REQUEST if untested != {signs.BOTH} else _missing_sensor(evidence))
        )
    return Directions(decision, mirror, convention, not is_open, tuple(causes), tuple(questions))


def _missing_motion(drive: Drive, decision: Decision) -> list[OpenQuestion]:
    """Turns and distance that the drive lacks."""
    turn, (left, right) = drive.turn - drive.turn_fit.bias * WINDOW, drive.tracks_over_tread.T
    count, turned = count_turns(turn), float(np.nansum(np.abs(turn[np.abs(turn) > _TURNING])))
    if drive.gyro is None:
        count = max(count_turns(0.5 * (right - left)), count_turns(0.5 * (right + left)))
        count = min(count, count_turns(drive.heading_turn)) if drive.compass is not None else count
    distances = [np.abs(window_sums(drive.grid, drive.grid.tracks @ one / 2.0)) for one in signs.DISTANCES]
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


def _sign_cause(
    name: str, log: float, drive: Drive, gyro: Gyro | None, mirror: int, convention: int
) -> Cause:
    topic = {
        signs.GYRO: gyro.name if gyro else "",
        signs.MIRROR: drive.fixes.name if drive.fixes else "",
        signs.HEADING: drive.compass.name if drive.compass else "",
    }.get(name, "sprockets")
    third = drive.fixes.name if drive.fixes else (drive.compass.name if drive.compass else "")
    also = f"; {third} agrees" if third else ""
    texts = {
        signs.SWAPPED: (
            f"the machine turns opposite to its tracks{also} with the gyro",
            remedies.SWAP_TRACKS,
        ),
        signs.BOTH: (
            f"the machine drives and turns opposite to its tracks{also} with the gyro",
            remedies.track_sign("left", "right"),
        ),
        signs.LEFT: (
            "the machine drives and turns as if the left track had the opposite sign",
            remedies.track_sign("left"),
        ),
        signs.RIGHT: (
            "the machine drives and turns as if the right track had the opposite sign",
            remedies.track_sign("right"),
        ),
        signs.GYRO: (
            f"the gyro turns opposite to the tracks{also} with the tracks",
            remedies.gyro_sign(gyro) if gyro else "",
        ),
    }
    if name in texts:
        evidence, remedy = texts[name]
        return Cause(name, topic, evidence, odds_of(log), remedy)
    if name == signs.MIRROR:
        evidence = "the path of the fixes is a mirror image of the path by tracks and gyro"
        remedy = (
            "Exchange the columns of x and y (of latitude and longitude) in the mapping",
            "Turn the sign of y: in the mapping 'scale: -1' at y",
            "Turn the sign of x: in the mapping 'scale: -1' at x",
        )[mirror]
        return Cause(MIRRORS[mirror], topic, evidence, odds_of(log), remedy)
    evidence = ("the heading counts from north, clockwise", "the heading counts clockwise")[convention]
    assert drive.compass is not None
    remedy = remedies.heading_convention(drive.compass, is_from_north=convention == 0)
    return Cause(
        signs.HEADING, topic, f"{evidence}: it turns against tracks, gyro and course", odds_of(log), remedy
    )
