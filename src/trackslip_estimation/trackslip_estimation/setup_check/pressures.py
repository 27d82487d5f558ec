# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Pressures over the travel motors that are not what they state: the soil estimator's watch, over a log."""

import math

import numpy as np

from trackslip_common.arrays import BoolArray
from trackslip_common.parameter_record import record_of
from trackslip_common.record_types import dtype_of, make_table
from trackslip_common.units import GRAVITY
from trackslip_estimation.setup_check.drive import Drive
from trackslip_estimation.setup_check.finding import READ_OFF, Cause, Finding, OpenQuestion
from trackslip_estimation.setup_check.grid import WINDOW, covered_cells, integral
from trackslip_estimation.setup_check.log import Pressures
from trackslip_estimation.slip.motion import Motion, MotionState, Speeds, classify
from trackslip_estimation.soil.interpolation import SAMPLE, Sample
from trackslip_estimation.soil.pressure_watch import (
    NO_FAULT,
    PressureFault,
    PressureWatch,
    WatchParameters,
    evaluate_pressures,
)

_LEAST_TIME = 10.0  # s of driving with pressures
_LEAST_SHARE = 0.5  # of this time with one fault
_LEVEL = 0.1  # rad, largest tilt of level ground: accelerations of the machine add to it
_OF_SIDE = "Bind the sensor of this side as it is: signal, unit and sign in the roles or the mapping file"
_UNIT = "State the unit of the pressures in the roles or the mapping file: {unit: bar}; messages have Pa"
_MISTAKES = {
    PressureFault.LEFT_STUCK: ("pressure_frozen", _OF_SIDE),
    PressureFault.RIGHT_STUCK: ("pressure_frozen", _OF_SIDE),
    PressureFault.LEFT_LOW: ("pressure_side", _OF_SIDE),
    PressureFault.RIGHT_LOW: ("pressure_side", _OF_SIDE),
    PressureFault.WRONG_SIGN: (
        "pressure_sign",
        "Exchange both ports of the motors in the roles or the mapping file: signal, and minus",
    ),
    PressureFault.SWAPPED: (
        "pressures_swapped",
        "Exchange left_pressure and right_pressure in the roles or the mapping file",
    ),
}


def judge_pressures(drive: Drive) -> list[Finding]:
    """A cause for the fault that most of the driving shows, as the soil estimator reports it."""
    pressures = drive.log.pressures
    if pressures is None or len(pressures.t) < 2:
        return []
    level = _level_cells(drive)
    seconds, driven = _fault_times(drive, pressures, level)
    fault = max(seconds, key=lambda fault: seconds[fault])
    if driven < _LEAST_TIME or seconds[fault] < _LEAST_SHARE * driven:
        return []
    if level is None and fault is PressureFault.WRONG_SIGN:
        return [
            OpenQuestion(fault.value, "drive on level ground, or with an inertial unit on the undercarriage")
        ]
    name, remedy = _MISTAKES.get(fault, ("pressure_unit", _UNIT))
    evidence = f"{fault.value}, in {seconds[fault]:.0f} of {driven:.0f} s of driving"
    return [Cause(name, pressures.name, evidence, READ_OFF, remedy)]


def _fault_times(
    drive: Drive, pressures: Pressures, level: BoolArray | None
) -> tuple[dict[PressureFault, float], float]:
    """Seconds of driving with each fault, and with pressures; on level ground alone where that is known."""
    grid, radius = drive.grid, drive.machine.radius
    is_covered = grid.is_driven & covered_cells(pressures.t, grid.edges)
    is_covered &= np.isfinite(grid.tracks).all(axis=1) & (True if level is None else level)
    middle = (grid.edges[1:] + grid.edges[:-1]) / 2.0
    newest = pressures.values[np.searchsorted(pressures.t, middle, side="right") - 1]
    watch = make_table(PressureWatch, dtype_of(PressureWatch), 1)[0]
    limits = record_of(WatchParameters, pressures.limits)[0]
    sample, state = make_table(Sample, SAMPLE, 1)[0], MotionState()
    seconds, driven = dict.fromkeys(PressureFault, 0.0), 0.0
    sample["dt"], sample["has_pressures"], sample["spools"] = grid.cell, True, math.nan
    for speeds, reading, is_known in zip(grid.tracks / grid.cell, newest, is_covered, strict=True):
        if not is_known:
            continue
        state = classify(state, Speeds(*(speeds / radius).tolist()), grid.cell, pressures.motion)
        sample["tracks"], sample["motion"], sample["pressures"] = speeds, state.motion, reading
        sample["reading"] = reading
        fault = evaluate_pressures(watch, sample, limits, pressures.relief, False, level is not None)
        if state.motion in (Motion.STRAIGHT, Motion.TURNING):
            driven += grid.cell
            if fault != NO_FAULT:
                seconds[tuple(PressureFault)[fault]] += grid.cell
    return seconds, driven


def _level_cells(drive: Drive) -> BoolArray | None:
    """(m,) whether an inertial unit on the undercarriage shows level ground; None: there is none."""
    edges, gyro = drive.grid.edges, drive.gyro
    if gyro is None or gyro.is_above or not np.isfinite(gyro.accelerations).any():
        return None
    is_finite = np.isfinite(gyro.accelerations).all(axis=1)
    t, forces = gyro.t[is_finite], integral(gyro.t[is_finite], gyro.accelerations[is_finite])
    middle = (edges[1:] + edges[:-1]) / 2.0
    ends = (np.column_stack([np.interp(middle + s * WINDOW / 2.0, t, c) for c in forces.T]) for s in (-1, 1))
    before, after = ends
    return np.asarray(np.hypot(*(after - before).T[:2]) < _LEVEL * WINDOW * GRAVITY)
