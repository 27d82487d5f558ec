# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check: the few mistakes that explain why tracks, inertial unit and fixes of a drive disagree.

Each step undoes the mistakes it finds, before the next step: missing values, units of time, the unit of the
speeds, the inertial unit's axis and unit, then all signs together. Quantities with an interval are last:
delays, radius, lever arms, offsets.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trackslip_estimation.setup_check import (
    clocks,
    inertial,
    places,
    sides,
    signs,
    speeds,
    time_units,
    unmoved,
)
from trackslip_estimation.setup_check.accelerations import judge_accelerations
from trackslip_estimation.setup_check.common_clock import judge_early_arrivals, with_common_clock
from trackslip_estimation.setup_check.count_angle import judge_counts
from trackslip_estimation.setup_check.drive import Drive
from trackslip_estimation.setup_check.finding import (
    LEAST_LOG,
    LEAST_ODDS,
    READ_OFF,
    Cause,
    Finding,
    Findings,
    MeasuredValue,
    OpenQuestion,
    Result,
    odds_of,
)
from trackslip_estimation.setup_check.fit import Lever, segment_scales
from trackslip_estimation.setup_check.grid import WINDOW, make_grid, running_sum, window_sums
from trackslip_estimation.setup_check.heading import heading_unit
from trackslip_estimation.setup_check.log import TRACKS, Compass, Fixes, Gyro, Log
from trackslip_estimation.setup_check.missing_values import remove_missing
from trackslip_estimation.setup_check.path import thin_fixes, with_measured_noise
from trackslip_estimation.setup_check.pressures import judge_pressures
from trackslip_estimation.setup_check.quantities import judge_quantity
from trackslip_estimation.setup_check.turning import LEAST_TURNS, count_turns, turn_scale
from trackslip_estimation.setup_check.twist_frame import judge_twist_frame

_UNIT_GAIN = 8.0  # ln likelihood ratio: another unit of headings, a delay against a lever arm
_SEGMENTS = (2.5, 5.0, 10.0, 20.0, 40.0)  # s, lengths of segments
_STANDSTILL_QUESTION = OpenQuestion(
    "everything: the tracks hardly move", "drive 10 m straight, and turn by 90° each way"
)
_SLIDING_QUESTION = OpenQuestion(
    "rolling radius, unit of the speeds, and headings, of a machine that slides across its heading",
    "drive 10 m straight on level ground",
)


def check(log: Log) -> Result:
    """Causes, those with the highest odds first, and what the log cannot decide."""
    findings = Findings()
    with np.errstate(all="ignore"):
        facts = _run_steps(log, findings)
    findings.add([] if findings.has_cause("source_delay") else judge_early_arrivals(log))
    causes = [cause for cause in findings.causes if cause.odds >= LEAST_ODDS]
    causes.sort(key=lambda cause: -cause.odds)
    questions = tuple(dict.fromkeys(findings.undetermined))
    return Result(tuple(causes), questions, tuple(facts), tuple(findings.measured))


def _run_steps(log: Log, findings: Findings) -> list[str]:
    findings.add(_unusable_cause(name, count) for name, count in log.unusable.items())
    log, causes = remove_missing(log)
    findings.add(causes)
    log, causes = time_units.correct_time_units(log)
    causes += time_units.judge_fractions(log)
    findings.add(causes)
    if not causes:  # else the log may lack the sources in another unit
        log, causes = with_common_clock(log)
        findings.add(causes)
    findings.add([*places.judge_places(log.fixes), *places.judge_digits(log.fixes)])
    findings.add(places.judge_scatter(log.fixes, log.tracks))
    fixes, causes = places.drop_held(log.fixes)
    findings.add(causes)
    log = replace(log, fixes=tuple(with_measured_noise(source) for source in fixes))
    if make_grid(log, None) is None or not np.nansum(np.abs(np.diff(log.tracks.angles, axis=0))) > 0.0:
        findings.add(unmoved.judge_dead_tracks(log) or [_STANDSTILL_QUESTION])
        return []
    log, drive = _correct_quantities(log, findings)
    frames = [] if findings.has_cause("datum") else judge_twist_frame(drive)  # fixes that leap show no path
    if frames:  # the tracks show no path
        findings.add(frames)
        return summary_lines(log, drive, 1.0)
    rough = speeds.rough_scale(drive)
    unit = speeds.likely_unit(rough, speeds.speed_units(log))
    drive = Drive(drive.log.with_tracks(np.eye(2) / unit))
    gyro_result = _examine_first_gyro(drive, log, findings, is_unit_known=bool(np.isfinite(rough)))
    is_unclear = gyro_result.unit != 1.0 or gyro_result.is_contradicted
    drive = gyro_result.drive if is_unclear else _remove_wrong_headings(gyro_result.drive, findings)
    if drift := clocks.judge_drift(drive):  # changes all relations between sources
        findings.add(drift)
        return summary_lines(log, drive, unit)
    findings.add(unmoved.judge_turns(drive))
    if questions := unmoved.judge_counting(drive):  # unsigned counts give no path
        findings.add(questions)
        return summary_lines(log, drive, unit)
    comparison = (
        sides.TracksResult(None) if gyro_result.is_contradicted else sides.compare_tracks(drive, unit)
    )
    if comparison.has_wrong_frame:  # which explains the distance from the map, and the scatter
        findings.withdraw("datum")
        findings.withdraw("position_noise")
    findings.add(comparison.findings)
    if comparison.drive is None:
        return summary_lines(log, drive, unit)
    directions = signs.decide_signs(comparison.drive, is_upside_down=gyro_result.is_upside_down)
    findings.add(directions.findings)
    corrected = directions.correct_signs(comparison.drive)
    if directions.is_decided:
        findings.add(judge_pressures(corrected))
        _judge_continuous(corrected, unit, gyro_result.unit, findings)
        if not (findings.has_cause("imu_mounting") or findings.has_cause("source_delay")):
            findings.add(judge_accelerations(corrected))
    return summary_lines(log, corrected, unit)


def _correct_quantities(log: Log, findings: Findings) -> tuple[Log, Drive]:
    """The log with its columns as the right quantities; a drive without gyro, and without wrong fixes."""
    drive, quantity = judge_quantity(Drive.from_sources(log, _first_gyro(log), *_primary_sources(log)))
    findings.add(quantity)
    findings.add([] if findings.has_cause("speed_unit") else judge_counts(log.counts))
    log = replace(log, tracks=drive.log.tracks)
    log = log if drive.gyro is None else log.with_gyro(drive.gyro)
    found = unmoved.judge_fixes(drive)
    findings.add(found)
    is_wrong = any(isinstance(one, Cause) for one in found)
    return log, Drive.from_sources(log, None, None if is_wrong else drive.fixes, drive.compass)


def _unusable_cause(name: str, count: int) -> Cause:
    evidence = f"none of {count} readings of {name} is valid: values not finite, or variances not above 0"
    remedy = (
        "Let its driver state values and covariance; of a log, trackslip import takes stddev: {x: …}; "
        "of poses without headings, use_heading: false"
    )
    return Cause("invalid_readings", name, evidence, READ_OFF, remedy)


def _primary_sources(log: Log) -> tuple[Fixes | None, Compass | None]:
    """The fixes with the most information, and the headings: of the same source if it has any."""
    fixes = max(log.fixes, key=lambda f: len(f.t) / max(f.noise, 0.01), default=None)
    usable = [c for c in log.compasses if not c.is_above and np.isfinite(c.headings).sum() > 10]
    of_fixes = [c for c in usable if fixes is not None and c.name == fixes.name]
    used = [c for c in usable if c.is_used]
    return fixes, next(iter([*of_fixes, *used, *usable]), None)


def _first_gyro(log: Log) -> Gyro | None:
    """The first gyro of the log that has readings."""
    return next((gyro for gyro in log.gyros if len(gyro.t) >= 10), None)


def _examine_first_gyro(
    drive: Drive, log: Log, findings: Findings, *, is_unit_known: bool
) -> inertial.GyroResult:
    """Result for the first gyro of the log that has readings."""
    gyro = _first_gyro(log)
    if gyro is None:
        return inertial.GyroResult(drive)
    result = inertial.examine_gyro(drive, gyro, is_unit_known=is_unit_known)
    findings.add(result.findings)
    return result


def _remove_wrong_headings(drive: Drive, findings: Findings) -> Drive:
    """The drive without its headings if they are not in rad; that becomes a cause."""
    compass = drive.compass
    if compass is None or drive.gyro is None:
        return drive
    scale = turn_scale(drive.turn, drive.tracks_over_tread)
    gyro_angles = running_sum(np.nan_to_num(drive.gyro_turn))
    factor, gain = heading_unit(compass, drive.grid.edges, gyro_angles)
    is_known = count_turns(drive.turn - drive.turn_fit.bias * WINDOW) >= LEAST_TURNS
    is_known &= float(drive.turn_fit.logs.max()) > _UNIT_GAIN
    is_known &= bool(inertial.EFFICIENCY[0] < scale < inertial.EFFICIENCY[1])
    if factor == 1.0 or gain < _UNIT_GAIN or not is_known:
        return drive
    true_unit, declared, unit = (
        ("degrees", "radians", "deg") if factor > 1.0 else ("radians", "degrees", "rad")
    )
    evidence = f"the heading turns {factor:.3g} times as much as the gyro: {true_unit}, declared {declared}"
    remedy = f"State its unit in the mapping: yaw: {{column: …, unit: {unit}}}"
    if compass.is_used:
        findings.add([Cause(signs.HEADING, compass.name, evidence, odds_of(gain), remedy)])
    return Drive.from_sources(drive.log, drive.gyro, drive.fixes, None)


def _judge_continuous(drive: Drive, unit: float, gyro_unit: float, findings: Findings) -> None:
    """Judge quantities with an interval; ``drive`` has right signs and right units of speeds and gyro."""
    delays = clocks.measure_delays(drive)
    lever = _fit_lever_arm(drive, delays)
    delay, late = _judge_delays(delays, lever, drive, findings)
    if delay is not None:
        drive = clocks.remove_delay(drive, delay.value, late)
    scale = inertial.judge_scale(drive, gyro_unit, lever)
    if scale is not None:
        findings.withdraw(scale.cause)  # a unit
        findings.add([scale])
    if drive.fixes is None:
        needed = "record fixes while driving 10 m straight"
        findings.add([OpenQuestion("rolling radius and unit of the speeds", needed)])
        return
    if findings.has_cause("position_axes_swapped"):  # their scales are exchanged too
        return
    if places.is_sliding(drive):
        findings.add([_SLIDING_QUESTION])
        return
    if not findings.has_cause("speed_unit") and not _judge_distance(drive, drive.fixes, unit, findings):
        return  # a lever arm needs the unit of the fixes
    if drive.gyro is not None and delay is None and scale is None:
        findings.add(places.judge_lever(lever, drive.fixes, drive.machine))
    findings.add(places.judge_direction(drive))
    if lever is not None and max(lever.stddevs) < 0.3:
        findings.add(_measured_lever_arms(lever, drive.fixes))
    if drive.compass is not None:
        findings.add(places.judge_offset(drive, drive.compass))


def _fit_lever_arm(drive: Drive, delays: Sequence[clocks.SourceDelay]) -> Lever | None:
    """Lever arm of the fixes, by the turns of a gyro: turns by the tracks depend on the ground."""
    fixes = drive.fixes
    if fixes is None or drive.gyro is None:
        return None
    is_on_time = any(delay.gain is None and fixes.name in (delay.first, delay.second) for delay in delays)
    return places.best_lever(drive.path, fixes, drive.machine.tread, is_on_time=is_on_time)


def _judge_delays(
    delays: list[clocks.SourceDelay], lever: Lever | None, drive: Drive, findings: Findings
) -> tuple[clocks.SourceDelay | None, tuple[str, ...]]:
    """Delay and topics of the delayed source, unless a lever arm explains its path.

    In turns, both shift fixes along the path.
    """
    fixes, compass = drive.fixes, drive.compass
    findings.add(_measured_delay(delay) for delay in delays if delay.first == TRACKS and delay.stddev < 0.2)
    if findings.has_cause("time_unit") or findings.has_cause("source_delay"):
        return None, ()
    receiver = list(dict.fromkeys(source.name for source in (fixes, compass) if source is not None))
    found, late = clocks.judge_delays(delays, receiver)
    delay = clocks.most_precise_delay(late, delays) if late else None
    if delay is not None and delay.gain is not None and fixes is not None and delay.second == fixes.name:
        advantage = delay.gain - (0.0 if lever is None else lever.log_ratio)
        if advantage < _UNIT_GAIN:
            found, delay = [], None
        if abs(advantage) < _UNIT_GAIN:
            what = f"{fixes.name}: late, or a lever arm"
            found = [OpenQuestion(what, "turn on the spot, and stop and start on straights")]
    findings.add(found)
    return delay, late


def _judge_distance(drive: Drive, fixes: Fixes, unit: float, findings: Findings) -> bool:
    """Judge distance by tracks against distance by fixes; False if the unit of the fixes may be wrong."""
    fit, thin = drive.turn_fit, thin_fixes(fixes, 0.2)
    all_scales = [segment_scales(drive.path, thin, length) for length in _SEGMENTS]
    best = max((scales for scales in all_scales if scales is not None), key=speeds.piece_counts, default=None)
    is_known = drive.gyro is not None and fit.logs.max() > LEAST_LOG and not findings.has_cause("gyro_unit")
    turn_ratio = float(fit.efficiencies[int(np.argmax(fit.logs))]) / unit if is_known else float("nan")
    found = speeds.judge_distance(best, drive.log, unit, drive.distance_by_fixes, turn_ratio)
    findings.add(found)
    return not any(isinstance(one, OpenQuestion) and one.is_wrong for one in found)


def _measured_delay(delay: clocks.SourceDelay) -> MeasuredValue:
    basis = "turn rates" if delay.gain is None else "path of the fixes"
    return MeasuredValue(
        "delay", delay.second, delay.value, 2.0 * delay.stddev, "s", f"after the sprockets, by {basis}"
    )


def _measured_lever_arms(lever: Lever, fixes: Fixes) -> list[Finding]:
    values = fixes.lever[0] + lever.value.real, fixes.lever[1] + lever.value.imag
    basis = f"{np.degrees(lever.turned):.0f}° of turns"
    return [
        MeasuredValue(f"lever_arm_{axis}", fixes.name, value, 2.0 * stddev, "m", basis)
        for axis, value, stddev in zip("xy", values, lever.stddevs, strict=True)
    ]


def summary_lines(log: Log, drive: Drive, unit: float) -> list[str]:
    """Lines with distance and turn by each odometer, and rates, for the user to compare with the drive.

    ``unit``: factor of the speeds, undone in ``drive``; the lines state the recorded values.
    """
    left, right = unit * np.where(drive.grid.is_driven[:, np.newaxis], drive.grid.tracks, 0.0).T
    steps = np.abs(window_sums(drive.grid, (left + right) / 2.0))
    distance = float(np.nansum(steps))
    lines = [f"distance: {distance:.1f} m by the tracks"]
    if drive.fixes is not None and np.nansum(steps[drive.exceeds_noise(steps / unit)]) > distance / 2.0:
        lines[0] += f", {drive.distance_by_fixes:.1f} m by {drive.fixes.name}"
    turns = {"the tracks": window_sums(drive.grid, right - left) / log.machine.tread}
    if drive.gyro is not None:
        turns["the gyro"] = drive.turn
    if drive.compass is not None:
        turns[f"the heading of {drive.compass.name}"] = drive.heading_turn
    turned = [f"{np.degrees(np.nansum(np.abs(turn))):.0f}° by {name}" for name, turn in turns.items()]
    lines.append(f"turned: {', '.join(turned)}")
    series = [(name, t) for name, _, t in time_units.source_stamps(log) if len(t) > 2]
    rates = [f"{name} {1.0 / float(np.median(np.diff(t))):.3g} Hz" for name, t in series]
    lines.append(f"rates: {', '.join(rates)}")
    return lines
