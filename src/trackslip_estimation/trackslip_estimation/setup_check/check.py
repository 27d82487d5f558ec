# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check: which few mistakes explain how tracks, inertial unit and fixes of a drive disagree.

What is found first is undone before the next step looks: missing values, units of time, the unit of the
speeds, the
inertial unit's axis and unit, then all signs together, then what has an interval: radius, lever arms,
offsets, delays.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from trackslip_estimation.setup_check import clocks, inertial, places, sides, signs, speeds
from trackslip_estimation.setup_check.directions import Directions, decide_signs
from trackslip_estimation.setup_check.evidence import Drive
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
from trackslip_estimation.setup_check.grid import WINDOW, Grid, make_grid, window_edges, window_sums
from trackslip_estimation.setup_check.heading import heading_at, unit_log
from trackslip_estimation.setup_check.log import Compass, Fixes, FloatArray, Gyro, Log
from trackslip_estimation.setup_check.path import Path, dead_reckoning, thinned
from trackslip_estimation.setup_check.turning import LEAST_TURNS, fit_turns, scale_of, turns_of

_UNIT_GAIN = 8.0  # ln likelihood of headings of another unit
_SEGMENTS = (2.5, 5.0, 10.0, 20.0, 40.0)  # s


@dataclass
class _Found:
    """What was found so far."""

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
    """Causes, most certain first, and what cannot be decided."""
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
    found.add(causes, [])
    found.add(places.judge_places(log.fixes))
    grid = make_grid(log, None)
    if grid is None or not _moves(grid):
        found.add(
            [],
            [
                Undetermined(
                    "everything: the tracks hardly move", "drive 10 m straight, and turn by 90° each way"
                )
            ],
        )
        return []
    fixes, compass = _primary(log)
    rough = speeds.rough_scale(grid, fixes) if fixes is not None else float("nan")
    unit = speeds.unit_of(rough)
    scaled = log.with_tracks(np.eye(2) / unit)
    state = _inertial(scaled, fixes, compass, found, is_unit_known=bool(np.isfinite(rough)))
    if state.is_contradicted:
        drive = Drive(state.grid, log.machine, fixes, compass)
        return facts_of(log, drive, np.eye(2))
    compass = _in_radians(compass, state, found)
    drive = Drive(state.grid, log.machine, fixes, compass, state.gyro is not None)
    causes = sides.judge_fixes(drive, unit)
    if causes:  # far away in their unit only
        found.causes = [c for c in found.causes if c.cause != "datum"]
    causes, open_ones = (causes, []) if causes else sides.judge_sides(drive, unit)
    if causes or open_ones:  # nothing that the tracks show against the fixes means what it says
        found.add(causes, open_ones)
        return facts_of(log, drive, np.eye(2))
    directions = decide_signs(drive, state.gyro, is_upside_down=state.is_upside_down)
    found.add(directions.causes, directions.undetermined)
    if directions.is_decided:
        _continuous(state.log, state.gyro, directions, unit, found)
    return facts_of(log, drive, directions.assignment.matrix)


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


def _moves(grid: Grid) -> bool:
    return float(np.nansum(np.abs(grid.tracks))) > 0.0


def _primary(log: Log) -> tuple[Fixes | None, Compass | None]:
    """The source of places with the most information, and the headings: of the same source if it has some."""
    fixes = max(log.fixes, key=lambda f: len(f.t) / max(float(np.median(f.stddevs)), 0.01), default=None)
    usable = [c for c in log.compasses if not c.is_above and np.isfinite(c.headings).sum() > 10]
    own = [c for c in usable if fixes is not None and c.name == fixes.name]
    used = [c for c in usable if c.is_used]
    return fixes, next(iter([*own, *used, *usable]), None)


def _inertial(
    log: Log, fixes: Fixes | None, compass: Compass | None, found: _Found, *, is_unit_known: bool
) -> inertial.Inertial:
    grid = make_grid(log, None)
    assert grid is not None
    turned = None
    if compass is not None:
        turned = heading_at(compass, grid.edges)
    for gyro in log.gyros:
        if len(gyro.t) < 10:
            continue
        state = inertial.examine(log, gyro, turned, fixes, is_unit_known=is_unit_known)
        if state is not None:
            found.add(state.causes, state.undetermined)
            return state
    return inertial.Inertial(log, None, grid)


def _in_radians(compass: Compass | None, state: inertial.Inertial, found: _Found) -> Compass | None:
    """The headings, if they are in rad; those in another unit are left out, and named."""
    if compass is None or state.gyro is None or state.factor != 1.0:
        return compass
    of_gyro = window_sums(state.grid, state.grid.turns)[:, 2]
    x = window_sums(state.grid, state.grid.tracks) / state.log.machine.tread
    scale = scale_of(of_gyro, x, WINDOW)
    fit = fit_turns(of_gyro, x, WINDOW)
    turns = np.nan_to_num(gyro_turn_of(state.grid, state.gyro, fit.bias))
    factor, gain = unit_log(compass, state.grid.edges, np.concatenate(([0.0], np.cumsum(turns))))
    is_known = turns_of(of_gyro - fit.bias * WINDOW) >= LEAST_TURNS and float(fit.logs.max()) > _UNIT_GAIN
    is_known &= bool(inertial.EFFICIENCY[0] < scale < inertial.EFFICIENCY[1])
    if factor == 1.0 or gain < _UNIT_GAIN or not is_known:
        return compass
    was, named = ("degrees", "radians") if factor > 1.0 else ("radians", "degrees")
    evidence = f"the heading turns {factor:.3g} times as much as the gyro: {was}, declared {named}"
    unit = "deg" if factor > 1.0 else "rad"
    remedy = f"State its unit in the mapping: yaw: {{column: …, unit: {unit}}}"
    if compass.is_used:
        found.add([Cause(signs.HEADING, compass.name, evidence, odds_of(gain), remedy)])
    return None


def _continuous(log: Log, gyro: Gyro | None, directions: Directions, unit: float, found: _Found) -> None:
    """On the log with all signs undone."""
    log = log.with_tracks(directions.assignment.matrix)
    if gyro is not None:
        gyro = replace(gyro, rates=gyro.rates * np.array((1.0, 1.0, directions.gyro)))
        log = log.with_gyro(gyro)
    fixes, compass = _primary(log)
    compass = compass if directions.has_heading else None
    if fixes is not None and directions.is_mirrored:
        fixes = replace(fixes, places=directions.right_places(fixes.places))
        log = log.with_fixes(fixes)
    if compass is not None and directions.heading < 0.0:
        compass = replace(compass, headings=directions.right_headings(compass.headings))
        log = log.with_compass(compass)
    grid = make_grid(log, gyro)
    if grid is None:
        return
    fit = fit_turns(
        window_sums(grid, grid.turns)[:, 2], window_sums(grid, grid.tracks) / log.machine.tread, WINDOW
    )
    lates = clocks.lates_of(grid, log, gyro, fixes, compass, fit.bias)
    names = {"tracks": "sprockets", "gyro": gyro.name if gyro else "", "fixes": fixes.name if fixes else ""}
    names["heading"] = compass.name if compass else ""
    found.measured += [_delay(late, names) for late in lates if late.first == "tracks" and late.stddev < 0.2]
    causes, open_ones = ([], []) if found.has("time_unit") else clocks.judge(lates, names)
    lever = _lever(grid, gyro, fit.bias, log, fixes, lates, compass)
    rival = lever.log_ratio if lever is not None else 0.0
    for cause in causes:
        late = clocks.value_of(cause, lates, names)
        # both move fixes along the path in turns
        if late.gain is not None and cause.source == names["fixes"] and rival > late.gain - _UNIT_GAIN:
            causes = []
            if rival < late.gain + _UNIT_GAIN:
                what = f"{cause.source}: late, or a lever arm"
                open_ones.append(Undetermined(what, "turn on the spot, and stop and start on straights"))
            break
        log = clocks.undelayed(log, cause, late.value)
        gyro = next((g for g in log.gyros if gyro is not None and g.name == gyro.name), gyro)
        fixes, compass = _primary(log)
        compass = compass if directions.has_heading else None
        grid = make_grid(log, gyro) or grid
    found.add(causes, open_ones)
    if fixes is None:
        needed = "record fixes while driving 10 m straight"
        found.add([], [Undetermined("rolling radius and unit of the speeds", needed)])
        return
    turned = float(fit.efficiencies[int(np.argmax(fit.logs))]) / unit
    is_known = gyro is not None and fit.logs.max() > LEAST_LOG and not found.has("gyro_unit")
    own, open_ones = _distances(grid, gyro, fit.bias, log, fixes, unit, turned if is_known else float("nan"))
    found.add(own, open_ones)
    if any(one.is_wrong for one in open_ones):  # an arm is in the unit of the fixes
        return
    if gyro is not None and not causes:
        found.add(*places.judge_lever(lever, fixes, log.machine))
    if lever is not None and max(lever.stddevs) < 0.3:
        found.measured += _arms(lever, fixes)
    if compass is not None:
        turn = gyro_turn_of(grid, gyro, fit.bias)
        offsets, open_ones, offset = places.judge_offset(grid, turn, fixes, compass)
        found.add(offsets, open_ones)
        found.measured += [] if offset is None else [offset]


def _lever(
    grid: Grid,
    gyro: Gyro | None,
    bias: float,
    log: Log,
    fixes: Fixes | None,
    lates: Sequence[clocks.Late],
    compass: Compass | None,
) -> Lever | None:
    """Of the fixes, by the turns of a gyro: those of tracks depend on the ground."""
    if fixes is None or gyro is None:
        return None
    is_on_time = any(late.gain is None and "fixes" in _parties(late, compass, fixes) for late in lates)
    path = _path(grid, gyro, bias, log)
    return places.lever_of(path, fixes, log.machine.tread, is_on_time=is_on_time)


def _distances(
    grid: Grid, gyro: Gyro | None, bias: float, log: Log, fixes: Fixes, unit: float, turned: float
) -> tuple[list[Cause], list[Undetermined]]:
    path, thin = _path(grid, gyro, bias, log), thinned(fixes, 0.2)
    noise = float(np.median(fixes.stddevs))
    all_scales = [scales(path, thin, length, noise) for length in _SEGMENTS]
    best = max((one for one in all_scales if one is not None), key=speeds.worth, default=None)
    return speeds.judge(best, log.machine, unit, speeds.distance_of(fixes, grid), turned)


def _delay(late: clocks.Late, names: dict[str, str]) -> Measured:
    basis = "path of the fixes" if late.gain is not None else "turn rates"
    return Measured(
        "delay", names[late.second], late.value, 2.0 * late.stddev, "s", f"after the sprockets, by {basis}"
    )


def _arms(lever: Lever, fixes: Fixes) -> list[Measured]:
    values = fixes.lever[0] + lever.value.real, fixes.lever[1] + lever.value.imag
    basis = f"{np.degrees(lever.turned):.0f}° of turns"
    return [
        Measured(f"lever_arm_{axis}", fixes.name, value, 2.0 * stddev, "m", basis)
        for axis, value, stddev in zip("xy", values, lever.stddevs, strict=True)
    ]


def _parties(late: clocks.Late, compass: Compass | None, fixes: Fixes) -> set[str]:
    """The sources of a pair; headings of the fixes' own messages have their stamps."""
    own = compass is not None and compass.name == fixes.name
    return {"fixes" if own and one == "heading" else one for one in (late.first, late.second)}


def gyro_turn_of(grid: Grid, gyro: Gyro | None, bias: float) -> FloatArray:
    """(m,) rad."""
    return np.asarray(grid.turns[:, 2] - bias * grid.cell) if gyro is not None else np.zeros(len(grid.tracks))


def _path(grid: Grid, gyro: Gyro | None, bias: float, log: Log) -> Path:
    turn = (
        gyro_turn_of(grid, gyro, bias)
        if gyro is not None
        else 0.7 * (grid.tracks[:, 1] - grid.tracks[:, 0]) / log.machine.tread
    )
    return dead_reckoning(grid, grid.tracks.mean(axis=1), turn)


def facts_of(log: Log, drive: Drive, matrix: FloatArray) -> list[str]:
    """Distance and turn by each odometer, and rates: what a user checks against memory."""
    grid = drive.grid
    tracks = grid.tracks @ matrix.T
    way = float(np.nansum(np.abs(window_sums(grid, tracks.mean(axis=1)))))
    lines = [f"distance: {way:.1f} m by the tracks"]
    if drive.fixes is not None:
        lines[0] += f", {speeds.distance_of(drive.fixes, grid):.1f} m by {drive.fixes.name}"
    by_tracks = window_sums(grid, tracks[:, 1] - tracks[:, 0]) / log.machine.tread
    turned = [f"{np.degrees(np.nansum(np.abs(by_tracks))):.0f}° by the tracks"]
    if drive.has_gyro:
        turned.append(f"{np.degrees(np.nansum(np.abs(drive.turn))):.0f}° by the gyro")
    if drive.compass is not None:
        of_heading = np.diff(heading_at(drive.compass, window_edges(grid)))
        turned.append(
            f"{np.degrees(np.nansum(np.abs(of_heading))):.0f}° by the heading of {drive.compass.name}"
        )
    lines.append(f"turned: {', '.join(turned)}")
    series = [("sprockets", log.tracks.t), *((g.name, g.t) for g in log.gyros)]
    series += [(f.name, f.t) for f in log.fixes]
    rates = [f"{name} {1.0 / float(np.median(np.diff(t))):.3g} Hz" for name, t in series if len(t) > 2]
    lines.append(f"rates: {', '.join(rates)}")
    return lines
