# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check: the few mistakes that explain why tracks, inertial unit and fixes of a drive disagree.

Each step undoes the mistakes it finds, before the next step: missing values, units of time, the unit of the
speeds, the inertial unit's axis and unit, then all signs together. Quantities with an interval are last:
delays, radius, lever arms, offsets.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from trackslip_estimation.setup_check import clocks, inertial, places, sides, signs, speeds, unmoved
from trackslip_estimation.setup_check.common_clock import with_common_clock
from trackslip_estimation.setup_check.count_angle import judge_counts
from trackslip_estimation.setup_check.directions import decide_signs
from trackslip_estimation.setup_check.drive import Drive
from trackslip_estimation.setup_check.faults import Missing, without_missing
from trackslip_estimation.setup_check.finding import (
    LEAST_LOG,
    LEAST_ODDS,
    Cause,
    Measured,
    Result,
    Undetermined,
    odds_of,
)
from trackslip_estimation.setup_check.fit import Lever, scales
from trackslip_estimation.setup_check.grid import WINDOW, make_grid, window_sums
from trackslip_estimation.setup_check.gyro_scale import judge_scale
from trackslip_estimation.setup_check.heading import unit_log
from trackslip_estimation.setup_check.log import Compass, Fixes, Gyro, Log
from trackslip_estimation.setup_check.path import thinned, with_shown_noise
from trackslip_estimation.setup_check.quantities import judge_quantity
from trackslip_estimation.setup_check.turning import LEAST_TURNS, scale_of, turns_of

_UNIT_GAIN = 8.0  # ln likelihood ratio: another unit of headings, a delay against a lever arm
_SEGMENTS = (2.5, 5.0, 10.0, 20.0, 40.0)  # s, lengths of segments
_STILL = Undetermined("everything: the tracks hardly move", "drive 10 m straight, and turn by 90° each way")
_SLIDES = Undetermined(
    "rolling radius, unit of the speeds, and headings, of a machine that slides across its heading",
    "drive 10 m straight on level ground",
)


@dataclass
class _Found:
    """Causes, open questions and measured values of the steps so far."""

    causes: list[Cause] = field(default_factory=list)
    undetermined: list[Undetermined] = field(default_factory=list)
    measured: list[Measured] = field(default_factory=list)

    def has(self, name: str) -> bool:
        """Whether a cause of this name was found."""
        return any(cause.cause == name for cause in self.causes)

    def add(self, causes: Sequence[Cause], undetermined: Sequence[Undetermined] = ()) -> None:
        self.causes += causes
        self.undetermined += undetermined


def check(log: Log) -> Result:
    """Causes, those with the highest odds first, and what the log cannot decide."""
    found = _Found()
    with np.errstate(all="ignore"):
        facts = _check(log, found)
    causes = [cause for cause in found.causes if cause.odds >= LEAST_ODDS]
    causes.sort(key=lambda cause: -cause.odds)
    open_ones = tuple(dict.fromkeys(found.undetermined))
    return Result(tuple(causes), open_ones, tuple(facts), tuple(found.measured))


def _check(log: Log, found: _Found) -> list[str]:
    log, missing = without_missing(log)
    found.add([_missing_cause(one) for one in missing])
    log, causes = clocks.with_right_times(log)
    found.add(causes)
    if not causes:  # else the log may lack the sources in another unit
        log, causes = with_common_clock(log)
        found.add(causes)
    found.add(clocks.judge_fractions(log))
    found.add([*places.judge_places(log.fixes), *places.judge_digits(log.fixes)])
    log = replace(log, fixes=tuple(with_shown_noise(one) for one in log.fixes))
    if make_grid(log, None) is None or not np.nansum(np.abs(np.diff(log.tracks.angles, axis=0))) > 0.0:
        found.add([], [_STILL])
        return []
    log, drive = _with_right_quantities(log, found)
    rough = speeds.rough_scale(drive)
    unit = speeds.unit_of(rough, speeds.units_of(log))
    drive = Drive(drive.log.with_tracks(np.eye(2) / unit))
    state = _inertial(drive, log, found, is_unit_known=bool(np.isfinite(rough)))
    drive = state.drive if state.unit != 1.0 or state.is_contradicted else _in_radians(state.drive, found)
    causes, open_ones = clocks.judge_drift(drive)
    found.add(causes, open_ones)
    if causes or open_ones:  # a drifting clock changes all relations between sources
        return facts_of(log, drive, unit)
    found.add([], unmoved.judge_turns(drive))
    if questions := unmoved.judge_counting(drive):  # unsigned counts give no path
        found.add([], questions)
        return facts_of(log, drive, unit)
    sided = sides.Sides(None) if state.is_contradicted else sides.examine(drive, unit)
    if any(cause.cause == "frame" for cause in sided.causes):  # the wrong unit explains the distance
        found.causes = [cause for cause in found.causes if cause.cause != "datum"]
    found.add(sided.causes, sided.undetermined)
    if sided.drive is None:
        return facts_of(log, drive, unit)
    directions = decide_signs(sided.drive, is_upside_down=state.is_upside_down)
    found.add(directions.causes, directions.undetermined)
    undone = directions.undone(sided.drive)
    if directions.is_decided:
        _continuous(undone, unit, state.unit, found)
    return facts_of(log, undone, unit)


def _with_right_quantities(log: Log, found: _Found) -> tuple[Log, Drive]:
    """The log with its columns as the right quantities; a drive without gyro, and without wrong fixes."""
    drive, quantity = judge_quantity(Drive.of(log, _first_gyro(log), *_primary(log)))
    found.add([] if quantity is None else [quantity])
    counts = None if found.has("speed_unit") else judge_counts(log.counts)
    found.add([] if counts is None else [counts])
    log = replace(log, tracks=drive.log.tracks)
    log = log if drive.gyro is None else log.with_gyro(drive.gyro)
    causes, open_ones = unmoved.judge_fixes(drive)
    found.add(causes, open_ones)
    return log, Drive.of(log, None, None if causes else drive.fixes, drive.compass)


def _missing_cause(one: Missing) -> Cause:
    evidence = (
        f"{one.column} jumps to {one.value:g} and back {one.count} times ({one.share:.1%} of the readings)"
    )
    remedy = (
        "Leave out what stands for a missing value: blank cells, or in the "
        f"mapping 'missing: {one.value:g}' at that column"
    )
    odds = odds_of(min(one.count * one.numbers, 20) * 2.0)
    return Cause("missing_value", one.source, evidence, odds, remedy)


def _primary(log: Log) -> tuple[Fixes | None, Compass | None]:
    """The fixes with the most information, and the headings: of the same source if it has any."""
    fixes = max(log.fixes, key=lambda f: len(f.t) / max(f.noise, 0.01), default=None)
    usable = [c for c in log.compasses if not c.is_above and np.isfinite(c.headings).sum() > 10]
    own = [c for c in usable if fixes is not None and c.name == fixes.name]
    used = [c for c in usable if c.is_used]
    return fixes, next(iter([*own, *used, *usable]), None)


def _first_gyro(log: Log) -> Gyro | None:
    """The first gyro of the log that has readings."""
    return next((one for one in log.gyros if len(one.t) >= 10), None)


def _inertial(drive: Drive, log: Log, found: _Found, *, is_unit_known: bool) -> inertial.Inertial:
    """Result for the first gyro of the log that has readings."""
    gyro = _first_gyro(log)
    if gyro is None:
        return inertial.Inertial(drive)
    state = inertial.examine(drive, gyro, is_unit_known=is_unit_known)
    found.add(state.causes, state.undetermined)
    return state


def _in_radians(drive: Drive, found: _Found) -> Drive:
    """The drive without its headings if they are not in rad; that becomes a cause."""
    compass = drive.compass
    if compass is None or drive.gyro is None:
        return drive
    scale = scale_of(drive.turn, drive.x, WINDOW)
    turned = np.concatenate(([0.0], np.cumsum(np.nan_to_num(drive.gyro_turn))))
    factor, gain = unit_log(compass, drive.grid.edges, turned)
    is_known = turns_of(drive.turn - drive.fit.bias * WINDOW) >= LEAST_TURNS
    is_known &= float(drive.fit.logs.max()) > _UNIT_GAIN
    is_known &= bool(inertial.EFFICIENCY[0] < scale < inertial.EFFICIENCY[1])
    if factor == 1.0 or gain < _UNIT_GAIN or not is_known:
        return drive
    was, named, unit = ("degrees", "radians", "deg") if factor > 1.0 else ("radians", "degrees", "rad")
    evidence = f"the heading turns {factor:.3g} times as much as the gyro: {was}, declared {named}"
    remedy = f"State its unit in the mapping: yaw: {{column: …, unit: {unit}}}"
    if compass.is_used:
        found.add([Cause(signs.HEADING, compass.name, evidence, odds_of(gain), remedy)])
    return Drive.of(drive.log, drive.gyro, drive.fixes, None)


def _continuous(drive: Drive, unit: float, gyro_unit: float, found: _Found) -> None:
    """Judge quantities with an interval; ``drive`` has right signs and right units of speeds and gyro."""
    lates = clocks.lates_of(drive)
    lever = _lever(drive, lates)
    late = _judge_delays(lates, lever, drive.fixes, found)
    if late is not None:
        drive = clocks.undelayed(drive, late)
    scale = judge_scale(drive, gyro_unit, lever)
    if scale is not None:
        found.causes = [cause for cause in found.causes if cause.cause != scale.cause]  # replaces a unit
        found.add([scale])
    if drive.fixes is None:
        needed = "record fixes while driving 10 m straight"
        found.add([], [Undetermined("rolling radius and unit of the speeds", needed)])
        return
    if places.slides(drive):
        found.add([], [_SLIDES])
        return
    if not found.has("speed_unit") and not _judge_distance(drive, drive.fixes, unit, found):
        return  # a lever arm needs the unit of the fixes
    if drive.gyro is not None and late is None and scale is None:
        found.add(*places.judge_lever(lever, drive.fixes, drive.machine))
    found.add([], places.judge_direction(drive))
    if lever is not None and max(lever.stddevs) < 0.3:
        found.measured += _arms(lever, drive.fixes)
    if drive.compass is not None:
        offsets, open_ones, offset = places.judge_offset(drive, drive.compass)
        found.add(offsets, open_ones)
        found.measured += [] if offset is None else [offset]


def _lever(drive: Drive, lates: Sequence[clocks.Late]) -> Lever | None:
    """Lever arm of the fixes, by the turns of a gyro: turns by the tracks depend on the ground."""
    fixes = drive.fixes
    if fixes is None or drive.gyro is None:
        return None
    is_on_time = any(late.gain is None and fixes.name in (late.first, late.second) for late in lates)
    return places.lever_of(drive.path, fixes, drive.machine.tread, is_on_time=is_on_time)


def _judge_delays(
    lates: list[clocks.Late], lever: Lever | None, fixes: Fixes | None, found: _Found
) -> clocks.Late | None:
    """The delayed source, unless a lever arm explains its path: in turns, both shift fixes along the path."""
    found.measured += [_delay(late) for late in lates if late.first == clocks.TRACKS and late.stddev < 0.2]
    causes, open_ones = ([], []) if found.has("time_unit") else clocks.judge(lates)
    late = clocks.late_of(causes[0].source, lates) if causes else None
    if late is not None and late.gain is not None and fixes is not None and late.second == fixes.name:
        better = late.gain - (0.0 if lever is None else lever.log_ratio)
        if abs(better) < _UNIT_GAIN:
            what = f"{late.second}: late, or a lever arm"
            open_ones.append(Undetermined(what, "turn on the spot, and stop and start on straights"))
        if better < _UNIT_GAIN:
            causes, late = [], None
    found.add(causes, open_ones)
    return late


def _judge_distance(drive: Drive, fixes: Fixes, unit: float, found: _Found) -> bool:
    """Judge distance by tracks against distance by fixes; False if the unit of the fixes may be wrong."""
    fit, thin = drive.fit, thinned(fixes, 0.2)
    all_scales = [scales(drive.path, thin, length) for length in _SEGMENTS]
    best = max((one for one in all_scales if one is not None), key=speeds.worth, default=None)
    is_known = drive.gyro is not None and fit.logs.max() > LEAST_LOG and not found.has("gyro_unit")
    turned = float(fit.efficiencies[int(np.argmax(fit.logs))]) / unit if is_known else float("nan")
    causes, open_ones = speeds.judge(best, drive.log, unit, drive.distance_by_fixes, turned)
    found.add(causes, open_ones)
    return not any(one.is_wrong for one in open_ones)


def _delay(late: clocks.Late) -> Measured:
    basis = "turn rates" if late.gain is None else "path of the fixes"
    return Measured(
        "delay", late.second, late.value, 2.0 * late.stddev, "s", f"after the sprockets, by {basis}"
    )


def _arms(lever: Lever, fixes: Fixes) -> list[Measured]:
    values = fixes.lever[0] + lever.value.real, fixes.lever[1] + lever.value.imag
    basis = f"{np.degrees(lever.turned):.0f}° of turns"
    return [
        Measured(f"lever_arm_{axis}", fixes.name, value, 2.0 * stddev, "m", basis)
        for axis, value, stddev in zip("xy", values, lever.stddevs, strict=True)
    ]


def facts_of(log: Log, drive: Drive, unit: float) -> list[str]:
    """Lines with distance and turn by each odometer, and rates, for the user to compare with the drive.

    ``unit``: factor of the speeds, undone in ``drive``; the lines state the recorded values.
    """
    left, right = unit * drive.grid.tracks.T
    distance = float(np.nansum(np.abs(window_sums(drive.grid, (left + right) / 2.0))))
    lines = [f"distance: {distance:.1f} m by the tracks"]
    if drive.fixes is not None:
        lines[0] += f", {drive.distance_by_fixes:.1f} m by {drive.fixes.name}"
    turns = {"the tracks": window_sums(drive.grid, right - left) / log.machine.tread}
    if drive.gyro is not None:
        turns["the gyro"] = drive.turn
    if drive.compass is not None:
        turns[f"the heading of {drive.compass.name}"] = drive.heading_turn
    turned = [f"{np.degrees(np.nansum(np.abs(turn))):.0f}° by {name}" for name, turn in turns.items()]
    lines.append(f"turned: {', '.join(turned)}")
    series = [(clocks.TRACKS, log.tracks.t), *((g.name, g.t) for g in log.gyros)]
    series += [(f.name, f.t) for f in log.fixes]
    rates = [f"{name} {1.0 / float(np.median(np.diff(t))):.3g} Hz" for name, t in series if len(t) > 2]
    lines.append(f"rates: {', '.join(rates)}")
    return lines
