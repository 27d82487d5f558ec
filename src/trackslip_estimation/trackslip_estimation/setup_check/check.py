# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check: which few mistakes explain how tracks, inertial unit and fixes of a drive disagree.

What is found first is undone before the next step looks: missing values, units of time, the unit of the speeds, the
inertial unit's axis and unit, then all signs together, then what has an interval: radius, lever arms, offsets, delays.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from trackslip_estimation.setup_check import clocks, inertial, places, remedies, signs, speeds
from trackslip_estimation.setup_check.directions import Directions, decide_signs
from trackslip_estimation.setup_check.evidence import Drive, gyro_turn
from trackslip_estimation.setup_check.faults import without_missing
from trackslip_estimation.setup_check.finding import Cause, Result, Undetermined, odds_of
from trackslip_estimation.setup_check.fit import scales
from trackslip_estimation.setup_check.grid import WINDOW, Grid, make_grid, window_edges, window_sums
from trackslip_estimation.setup_check.heading import heading_at, unit_log
from trackslip_estimation.setup_check.log import Compass, Fixes, FloatArray, Gyro, Log
from trackslip_estimation.setup_check.path import Path, dead_reckoning, thinned
from trackslip_estimation.setup_check.turning import fit_turns

_UNIT_GAIN = 8.0  # ln likelihood of headings of another unit
_SEGMENTS = (2.5, 5.0, 10.0, 20.0)  # s
_LEAST_ANGLE = np.radians(20.0)  # of a turn
_TURNING = np.radians(3.0)  # in a window


@dataclass
class _Found:
    """What was found so far."""

    causes: list[Cause] = field(default_factory=list)
    undetermined: list[Undetermined] = field(default_factory=list)

    def add(self, causes: Sequence[Cause], undetermined: Sequence[Undetermined] = ()) -> None:
        self.causes += causes
        self.undetermined += undetermined


def check(log: Log) -> Result:
    """Causes, most certain first, and what cannot be decided."""
    found = _Found()
    with np.errstate(all="ignore"):
        facts = _check(log, found)
    causes = [cause for cause in found.causes if cause.odds >= 100.0]
    causes.sort(key=lambda cause: -cause.odds)
    return Result(tuple(causes), tuple(dict.fromkeys(found.undetermined)), tuple(facts))


def _check(log: Log, found: _Found) -> list[str]:
    log, missing = without_missing(log)
    found.add([_missing_cause(one) for one in missing])
    log, causes = clocks.with_right_times(log)
    found.add(causes, [])
    found.add(places.judge_places(log.fixes))
    grid = make_grid(log, None)
    if grid is None or not _moves(grid):
        found.add([], [Undetermined("everything: the tracks hardly move", "drive 10 m straight, and turn by 90° each way")])
        return []
    fixes, compass = _primary(log)
    rough = speeds.rough_scale(grid, fixes) if fixes is not None else float("nan")
    unit = speeds.unit_of(rough)
    scaled = log.with_tracks(np.eye(2) / unit)
    state = _inertial(scaled, fixes, compass, found)
    compass = _in_radians(compass, state, found)
    drive = Drive(state.grid, log.machine, fixes, compass, state.gyro is not None)
    directions = decide_signs(drive, state.gyro, is_upside_down=state.is_upside_down)
    found.add(directions.causes, directions.undetermined)
    if directions.is_decided:
        _continuous(state.log, state.gyro, directions, unit, found)
    return facts_of(log, drive, directions)


def _missing_cause(one: object) -> Cause:
    from trackslip_estimation.setup_check.faults import Missing

    assert isinstance(one, Missing)
    evidence = f"{one.column} jumps to {one.value:g} and back {one.count} times ({one.share:.1%} of the readings)"
    remedy = f"Leave out what stands for a missing value: blank cells, or in the mapping 'missing: {one.value:g}' at that column"
    return Cause("missing_value", one.source, evidence, odds_of(min(one.count, 20) * 1.5), remedy)


def _moves(grid: Grid) -> bool:
    return float(np.nansum(np.abs(grid.tracks))) > 0.0


def _primary(log: Log) -> tuple[Fixes | None, Compass | None]:
    """The source of places with the most information, and the headings: of the same source if it has some."""
    fixes = max(log.fixes, key=lambda f: len(f.t) / max(float(np.median(f.stddevs)), 0.01), default=None)
    usable = [c for c in log.compasses if not c.is_above and np.isfinite(c.headings).sum() > 10]
    own = [c for c in usable if fixes is not None and c.name == fixes.name]
    used = [c for c in usable if c.is_used]
    return fixes, next(iter([*own, *used, *usable]), None)


def _inertial(log: Log, fixes: Fixes | None, compass: Compass | None, found: _Found) -> inertial.Inertial:
    grid = make_grid(log, None)
    assert grid is not None
    turned = None
    if compass is not None:
        turned = heading_at(compass, grid.edges)
    for gyro in log.gyros:
        if len(gyro.t) < 10:
            continue
        state = inertial.examine(log, gyro, 1.0, turned)
        if state is not None:
            found.add(state.causes)
            return state
    return inertial.Inertial(log, None, grid)


def _in_radians(compass: Compass | None, state: inertial.Inertial, found: _Found) -> Compass | None:
    """The headings, if they are in rad; those in another unit are left out, and named."""
    if compass is None or state.gyro is None:
        return compass
    turns = np.nan_to_num(state.grid.turns[:, 2])
    factor, gain = unit_log(compass, state.grid.edges, np.concatenate(([0.0], np.cumsum(turns))))
    if factor == 1.0 or gain < _UNIT_GAIN:
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
    fit = fit_turns(window_sums(grid, grid.turns)[:, 2], window_sums(grid, grid.tracks) / log.machine.tread, WINDOW)
    lates = clocks.lates_of(grid, log, gyro, fixes, compass, fit.bias)
    names = {"tracks": "sprockets", "gyro": gyro.name if gyro else "", "fixes": fixes.name if fixes else ""}
    names["heading"] = compass.name if compass else ""
    causes, open_ones = clocks.judge(lates, names)
    found.add(causes, open_ones)
    for cause in causes:
        log = clocks.undelayed(log, cause, clocks.value_of(cause, lates, names))
        gyro = next((g for g in log.gyros if gyro is not None and g.name == gyro.name), gyro)
        fixes, compass = _primary(log)
        compass = compass if directions.has_heading else None
        grid = make_grid(log, gyro) or grid
    if fixes is None:
        found.add([], [Undetermined("rolling radius and unit of the speeds", "record fixes while driving 10 m straight")])
        return
    path = _path(grid, gyro, fit.bias, log)
    noise = float(np.median(fixes.stddevs))
    thin = thinned(fixes, 0.2)
    all_scales = [scales(path, thin, length, noise) for length in _SEGMENTS]
    best = max((s for s in all_scales if s is not None), key=speeds.worth, default=None)
    found.add(*speeds.judge(best, log.machine, unit, speeds.distance_of(fixes, grid)))
    if not causes:
        found.add(*places.judge_lever(path, fixes, log))
    if compass is not None:
        turn = gyro_turn_of(grid, gyro, fit.bias)
        offsets, open_ones, _ = places.judge_offset(grid, turn, fixes, compass)
        found.add(offsets, open_ones)


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


def facts_of(log: Log, drive: Drive, directions: Directions) -> list[str]:
    """Distance and turn by each odometer, and rates: what a user checks against memory."""
    grid = drive.grid
    tracks = grid.tracks @ directions.assignment.matrix.T
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
        turned.append(f"{np.degrees(np.nansum(np.abs(of_heading))):.0f}° by the heading of {drive.compass.name}")
    lines.append(f"turned: {', '.join(turned)}")
    series = [("sprockets", log.tracks.t), *((s.name, s.t) for s in (*log.gyros, *log.fixes))]
    rates = [f"{name} {1.0 / float(np.median(np.diff(t))):.3g} Hz" for name, t in series if len(t) > 2]
    lines.append(f"rates: {', '.join(rates)}")
    return lines


