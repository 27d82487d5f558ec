# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Places of fixes, and headings: lever arms, offset of the heading, distance from the map, last digit."""

from collections.abc import Sequence

import numpy as np

from trackslip_common.arrays import BoolArray
from trackslip_estimation.setup_check import remedies
from trackslip_estimation.setup_check.count_angle import LEAST_ROUNDING_RATIO, MORE_DIGITS, rounding_of
from trackslip_estimation.setup_check.drive import Drive
from trackslip_estimation.setup_check.equal_runs import new_readings
from trackslip_estimation.setup_check.finding import (
    LEAST_LOG,
    READ_OFF,
    Cause,
    Finding,
    MeasuredValue,
    OpenQuestion,
    odds_of,
)
from trackslip_estimation.setup_check.fit import Lever, fit_lever
from trackslip_estimation.setup_check.grid import WINDOW, covered_cells, running_sum
from trackslip_estimation.setup_check.heading import mean_direction, place_at, straight_courses, wrap_angles
from trackslip_estimation.setup_check.log import Compass, Fixes, Machine, Tracks, group_of
from trackslip_estimation.setup_check.path import Path, thin_fixes
from trackslip_estimation.setup_check.signs import HEADING
from trackslip_estimation.setup_check.turning import robust_stddev

_LENGTHS = (5.0, 10.0, 20.0)  # s, of segments
_ICR_SHARE = 0.15  # longitudinal offset of the centre of rotation, share of the contact length
_LEAST_LEVER = 0.08  # m
_SIGNIFICANT = 4.0  # standard deviations
_KNOWN_DELAY_STDDEV, _UNKNOWN_DELAY_STDDEV = 0.05, 0.5  # s, where headings show the delay, and else
_TURN_REQUEST = "turn on the spot by 180° to the left and to the right"
_EXACT_SHARE = 0.06  # standard deviation of a known lever arm, share of the tread
_LEAST_TURN = np.radians(120.0)
_LEAST_OFFSET = 0.12  # rad; a side slope causes a smaller slip angle
_LEAST_COURSES = 5  # straight pieces
_ARM_STDDEV = 12**-0.5  # of the centre of rotation, share of the contact length: uniform within it
_MOST_PIECES = 0.8  # share of the pieces
_LEAST_AGREEMENT = 0.8  # length of the mean of directions that agree
_HALF_TURN = 0.3  # rad, tolerance of half a turn
_LONGEST_INTERVAL = 30.0  # s between pieces; a gyro drifts by less than _HALF_TURN
_FRONT_TEXT = "or front and rear exchanged: tracks swapped, and both counting backwards"
_AHEAD_REQUEST = "drive 10 m ahead: both tracks must count up"
_FARTHEST_SITE = 5e3  # m from the origin of the map, beyond any site
_LEAST_GRID_COORDINATE = 1e5  # m: coordinates of a national grid
_LEAST_SEPARATION = 20.0  # m between sources, all the time
_LEAST_STILL, _LEAST_SCATTER_RATIO = 20, 20.0  # steps at standstill; scatter over the stated one
_MEDIAN_STEP = 1.665  # median step of two axes over the standard deviation of one (Rayleigh, times √2)


def best_lever(path: Path, fixes: Fixes, tread: float, *, is_on_time: bool) -> Lever | None:
    """Δl by the segment length with the smallest error; ``is_on_time``: headings show that fixes are."""
    thin, delay_stddev = thin_fixes(fixes, 0.2), _KNOWN_DELAY_STDDEV if is_on_time else _UNKNOWN_DELAY_STDDEV
    fits = [fit_lever(path, thin, length, tread, delay_stddev) for length in _LENGTHS]
    levers = [lever for lever in fits if lever is not None]
    return min(levers, key=lambda lever: float(np.minimum(lever.stddevs, tread).sum()), default=None)


def judge_lever(lever: Lever | None, fixes: Fixes, machine: Machine) -> list[Finding]:
    """A wrong lever arm of a source on the undercarriage."""
    if fixes.is_above:
        needed = "measure it by tape: the check knows lever arms on the undercarriage only"
        return [OpenQuestion(f"lever arm of {fixes.name}, which swings", needed)]
    if lever is None or lever.turned < _LEAST_TURN or min(lever.stddevs) > 0.5 * machine.tread + 0.3:
        return [OpenQuestion(f"lever arm of {fixes.name}", _TURN_REQUEST)]
    correction = np.array((lever.value.real, lever.value.imag))
    stddevs = np.array(lever.stddevs)
    allowed = np.array(
        (_ICR_SHARE * machine.contact_length + _LEAST_LEVER, 0.1 * machine.tread + _LEAST_LEVER)
    )
    is_wrong = np.abs(correction) > allowed + _SIGNIFICANT * stddevs
    if not is_wrong.any() or lever.log_ratio < LEAST_LOG:
        if max(stddevs) < _EXACT_SHARE * machine.tread:
            return []
        what = f"lever arm of {fixes.name}, which turns show to ± {_SIGNIFICANT * max(stddevs):.2g} m only"
        return [OpenQuestion(what, _TURN_REQUEST)]
    value = np.array(fixes.lever) + correction
    is_mirrored = (np.abs(value + fixes.lever) < allowed + _SIGNIFICANT * stddevs).all()
    if np.hypot(*fixes.lever) > _LEAST_LEVER and is_mirrored:
        what = f"lever arm of {fixes.name} of the other sign, {_FRONT_TEXT}"
        return [OpenQuestion(what, _AHEAD_REQUEST, is_wrong=True)]
    group = group_of(fixes.name)
    axes = [k for k in (0, 1) if is_wrong[k] or stddevs[k] < _EXACT_SHARE * machine.tread]
    position_text = ", ".join(f"{'xy'[k]} {value[k]:.2f} ± {2.0 * stddevs[k]:.2f}" for k in axes)
    evidence = (
        f"in turns the fixes are those of a sensor at {position_text} m; "
        f"stated: {fixes.lever[0]:g}, {fixes.lever[1]:g} m"
    )
    rounded = (np.round(value, 2) + 0.0).tolist()  # no -0
    values = [remedies.parameter(f"{group}.lever_arm_{'xy'[k]}", rounded[k]) for k in axes]
    return [Cause("lever_arm", fixes.name, evidence, odds_of(lever.log_ratio), "Set " + " ".join(values))]


def is_sliding(drive: Drive) -> bool:
    """Whether the machine moves sideways, to the same side in forward and reverse."""
    steps = drive.courses
    is_reverse = drive.tracks_over_tread.sum(axis=1)[steps.windows] < 0.0
    if min(is_reverse.sum(), (~is_reverse).sum()) < _LEAST_COURSES:
        return False
    directions = np.exp(1j * (steps.courses - steps.headings))
    by_tracks = np.where(is_reverse, -directions, directions)
    is_same_side = abs(directions.mean()) > max(abs(by_tracks.mean()), _LEAST_AGREEMENT)
    return bool(is_same_side and abs(directions.mean().imag) > abs(directions.mean().real))


def judge_offset(drive: Drive, compass: Compass) -> list[Finding]:
    """Offset of headings against courses: cause, open question, and its value where there are courses."""
    steps = drive.courses
    if drive.fixes is None or len(steps.courses) < _LEAST_COURSES:
        needed = "drive 10 m straight ahead with fixes and headings"
        return [OpenQuestion(f"offset of the heading of {compass.name}", needed)]
    distances = drive.tracks_over_tread.sum(axis=1)[steps.windows]
    differences = wrap_angles(steps.courses - steps.headings - np.where(distances < 0.0, np.pi, 0.0))
    # in a turn, a sensor ahead of the centre of rotation moves to its side
    curves = np.sign(distances) * steps.curves
    differences = wrap_angles(differences - drive.fixes.lever[0] * curves)
    middle = mean_direction(differences)
    residuals = wrap_angles(differences - middle)
    scatter = robust_stddev(residuals) / float(np.sqrt(len(residuals)))
    by_arm = _ARM_STDDEV * drive.machine.contact_length * abs(float(np.mean(curves)))
    mean_stddev = float(np.hypot(scatter, by_arm))
    stddev = float(np.hypot(1.25 * mean_stddev, 0.01))
    basis = f"{len(residuals)} straight pieces, course less heading"
    measured = MeasuredValue("yaw_offset", compass.name, middle, 2.0 * stddev, "rad", basis)
    if found := _judge_reverse(compass, distances < 0.0, np.abs(residuals) > np.pi - _HALF_TURN):
        return found
    is_usual = np.abs(residuals) < 0.5
    if not compass.is_used or abs(middle) < _LEAST_OFFSET + 2.0 * stddev or is_usual.mean() < 0.7:
        return [measured]
    log_ratio = 0.5 * ((abs(middle) - 0.05) / max(mean_stddev, 0.02)) ** 2
    if log_ratio < LEAST_LOG:
        return [measured]
    if abs(middle) > np.pi - _HALF_TURN:
        what = f"heading of {compass.name} off by half a turn, {_FRONT_TEXT}"
        return [measured, OpenQuestion(what, _AHEAD_REQUEST, is_wrong=True)]
    if compass.of_poses:
        unused = remedies.parameter(f"{group_of(compass.name)}.use_heading", "false")
        remedy = (
            f"Add {middle:.3f} rad to the headings of {compass.name} where they are made (box_localizer: "
            f"heading of the box; mapping: origin {-middle:.3f} rad at yaw, {middle:.3f} rad at heading), "
            f"or {unused}"
        )
        if abs(abs(middle) - np.pi / 2.0) < _LEAST_OFFSET:
            remedy += "; if x of the places points north, exchange x and y and turn one sign instead"
    else:
        offset = float(wrap_angles(np.array((compass.offset - middle,)))[0])
        remedy = f"Set {remedies.parameter(f'{group_of(compass.name)}.offset', round(offset, 3))}"
    evidence = (
        f"the course of the fixes is {middle:.3f} ± {2.0 * stddev:.3f} rad from the "
        f"stated heading in {len(residuals)} straight pieces"
    )
    return [measured, Cause("heading_offset", compass.name, evidence, odds_of(log_ratio), remedy)]


def _judge_reverse(compass: Compass, is_reverse: BoolArray, is_opposite: BoolArray) -> list[Finding]:
    """Headings that flip with the direction of travel, or tracks that do not count it.

    (n,) straight pieces: whether the tracks reverse; whether course less heading is half a turn from most.
    """
    ahead, back = is_opposite[~is_reverse], is_opposite[is_reverse]
    opposite_count = int(is_opposite.sum())
    least = min(len(ahead), opposite_count, len(is_opposite) - opposite_count)
    if not compass.is_used or least < _LEAST_COURSES:
        return []
    if len(back) >= _LEAST_COURSES and abs(back.mean() - ahead.mean()) > _MOST_PIECES:
        evidence = (
            f"the heading turns round in {len(back)} straight pieces in reverse, against {len(ahead)} "
            "forward: a course over ground, or a heading of a cab that swung"
        )
        alternative = f"leave {compass.name} out of slip_estimator.heading_sources"
        if compass.of_poses:
            alternative = remedies.parameter(f"{group_of(compass.name)}.use_heading", "false")
        remedy = f"Take the heading of two antennas on the undercarriage, or {alternative}"
        return [Cause(HEADING, compass.name, evidence, odds_of(2.0 * len(back)), remedy)]
    return [] if len(back) else [_direction_question(compass.name, opposite_count, len(ahead))]


def _direction_question(sources: str, opposite_count: int, pieces: int) -> OpenQuestion:
    what = (
        f"machine that goes backwards by {sources} in {opposite_count} of {pieces} straight pieces, while "
        "the tracks count forward: encoders without a direction, or a heading of a cab that swung"
    )
    return OpenQuestion(what, "drive 10 m in reverse with the cab ahead", is_wrong=True)


def judge_direction(drive: Drive) -> list[Finding]:
    """Tracks that count forward only, by courses and the turns of the gyro, without headings.

    Between two straight pieces, the course turns as the gyro does, or by half a turn more.
    """
    if drive.gyro is None or drive.fixes is None or drive.compass is not None:
        return []
    edges = drive.grid.edges
    gyro_compass = Compass(drive.gyro.name, edges, running_sum(drive.gyro_turn))
    steps = straight_courses(drive.grid, drive.fixes, gyro_compass)
    distances = drive.tracks_over_tread.sum(axis=1)[steps.windows]
    if len(distances) < _LEAST_COURSES or (distances < 0.0).any():
        return []
    turn_differences = np.abs(wrap_angles(np.diff(steps.courses - steps.headings)))
    is_near = np.diff(steps.windows) * WINDOW < _LONGEST_INTERVAL
    turns_round = (turn_differences > np.pi - _HALF_TURN) & is_near
    is_opposite = running_sum(turns_round.astype(np.float64)) % 2 == 1
    fewer = min(int(is_opposite.sum()), int((~is_opposite).sum()))
    if fewer < _LEAST_COURSES or turns_round.sum() < 2:
        return []
    return [_direction_question(f"{drive.fixes.name} and {drive.gyro.name}", fewer, len(is_opposite))]


def judge_places(fixes: Sequence[Fixes]) -> list[Finding]:
    """Fixes kilometres from the origin of the map, or from the fix before; two sources metres apart."""
    causes: list[Finding] = []
    for source in fixes:
        is_finite = np.isfinite(source.places).all(axis=1)
        places = source.places[is_finite]
        if len(places) < 5:
            continue
        middle = np.median(places, axis=0)
        size = np.abs(middle)
        is_grid = (size > _LEAST_GRID_COORDINATE).all() and size[0] < 3.5e7 and size[1] < 1.1e7
        distance = float(np.hypot(*middle))
        steps = np.hypot(*np.diff(places, axis=0).T)
        leaps = np.flatnonzero(steps > 1e3)
        is_persistent = len(leaps) and np.hypot(*(places[leaps[-1] + 1] - places[leaps[0]])) > 1e3
        if is_persistent and len(leaps) <= 3 and min(leaps[0] + 1, len(places) - leaps[-1] - 1) >= 3:
            evidence = f"fixes leap by {steps[leaps[0]] / 1e3:.1f} km from one to the next, and stay there"
            remedy = (
                "Give all fixes one datum: in the mapping datum: "
                "{latitude: …, longitude: …}; of gnss_localizer its datum"
            )
            causes.append(Cause("datum", source.name, evidence, READ_OFF, remedy))
        elif distance > _FARTHEST_SITE and not is_grid:
            evidence = f"fixes are {distance / 1e3:.1f} km from the origin of the map"
            remedy = (
                "Set the datum to the site: in the mapping datum: first; of "
                "gnss_localizer datum_latitude and datum_longitude"
            )
            causes.append(Cause("datum", source.name, evidence, READ_OFF, remedy))
    return causes + _judge_separation(fixes)


def judge_digits(fixes: Sequence[Fixes]) -> list[Finding]:
    """Places whose rounding is coarser than their stated standard deviation."""
    causes: list[Finding] = []
    for source in fixes:
        rounding = max(
            (rounding_of(column[np.isfinite(column)], source.noise) for column in source.places.T),
            default=0.0,
        )
        if rounding <= LEAST_ROUNDING_RATIO * source.noise:
            continue
        fault = f"are rounded by {rounding:.2g} m"
        remedy = f"Record {MORE_DIGITS}"
        causes.append(_overstated_cause("position_resolution", source, fault, remedy, rounding))
    return causes


def judge_scatter(fixes: Sequence[Fixes], tracks: Tracks) -> list[Finding]:
    """Places that scatter far more at standstill of the tracks than their stated standard deviation."""
    causes: list[Finding] = []
    for source in fixes:
        if source.is_above or min(len(source.t), len(tracks.t)) <= _LEAST_STILL:
            continue
        angles = np.column_stack([np.interp(source.t, tracks.t, side) for side in tracks.angles.T])
        steps = np.abs(np.diff(source.complex_places))
        is_still = (np.diff(angles, axis=0) == 0.0).all(axis=1) & covered_cells(tracks.t, source.t)
        steps = steps[is_still & np.isfinite(steps)]
        scatter = float(np.median(steps)) / _MEDIAN_STEP if len(steps) >= _LEAST_STILL else 0.0
        if scatter <= _LEAST_SCATTER_RATIO * source.noise:
            continue
        fault = f"scatter by {scatter:.2g} m at standstill"
        remedy = f"State stddev: {{x: {scatter:.2g}, y: {scatter:.2g}}} in the mapping"
        causes.append(_overstated_cause("position_noise", source, fault, remedy, scatter))
    return causes


def _overstated_cause(name: str, source: Fixes, fault: str, remedy: str, floor: float) -> Cause:
    """The cause of places that are less precise than stated; a ``floor``, m, is the other remedy."""
    evidence = f"its places {fault}, and state a standard deviation of {source.noise:.2g} m"
    setting = remedies.parameter(f"{group_of(source.name)}.position_floor", float(f"{floor:.2g}"))
    return Cause(name, source.name, evidence, READ_OFF, f"{remedy}, or set {setting}")


def drop_held(fixes: Sequence[Fixes]) -> tuple[tuple[Fixes, ...], list[Cause]]:
    """The sources with each place once, and a cause for each whose last place a logger holds.

    A held place is late by half the time for which it is held.
    """
    rows = [new_readings(source.places) for source in fixes]
    causes = []
    for source, is_new in zip(fixes, rows, strict=True):
        if not is_new.all():
            times = len(is_new) / int(is_new.sum())
            evidence = f"each of its places comes about {times:.0f} times, under new stamps: it is held"
            remedy = (
                "Record the topic or log of the receiver itself, each fix once (mapping of a CSV log: "
                "new_when_changes)"
            )
            causes.append(Cause("position_resolution", source.name, evidence, READ_OFF, remedy))
    return tuple(source.select(is_new) for source, is_new in zip(fixes, rows, strict=True)), causes


def _judge_separation(fixes: Sequence[Fixes]) -> list[Cause]:
    if len(fixes) < 2:
        return []
    first, second = fixes[0], fixes[1]
    gaps = np.abs(place_at(second, first.t) - first.complex_places)
    gaps = gaps[np.isfinite(gaps)]
    if len(gaps) < 10:
        return []
    middle = float(np.median(gaps))
    noise = first.noise + second.noise
    if middle < max(_LEAST_SEPARATION, 10.0 * noise) or float(np.percentile(gaps, 5)) < 0.5 * middle:
        return []
    evidence = f"places of {first.name} and {second.name} are {middle:.0f} m apart, all the time"
    remedy = (
        "Give both one map: the same datum and frame; or leave one out of "
        f"{remedies.parameter('pose_sources', f'[{first.name}]')}"
    )
    return [Cause("frame", second.name, evidence, READ_OFF, remedy)]
