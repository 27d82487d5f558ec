# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The soil estimator's study: its inputs and its scores."""

import math
from dataclasses import replace

import numpy as np
import pytest

from trackslip_estimation.slip.measurements import PoseFix, Sprockets
from trackslip_estimation.soil.soil_estimator import SoilState
from trackslip_estimation.soil.strength_summary import StrengthSummary
from trackslip_sim.scenarios.scenario import Scenario, Segment
from trackslip_sim.study.soil.parameters import SoilCell, load_soil_study_parameters, soil_cells
from trackslip_sim.study.soil.results import ChangeRow, SoilRow, summary
from trackslip_sim.study.soil.score import Result, run_trial, soil_change, steady_turns
from trackslip_sim.study.soil.trial import (
    START_NS,
    Setting,
    Trial,
    draw_readings,
    estimator_outputs,
    load_setting,
    simulate_trial,
)
from trackslip_sim.truth.ground import Patch
from trackslip_sim.truth.record import Truth

TRIAL = Trial("sand", 0.02, seed=3, scenario="slalom", duration=10.0, standstill=4.0)
ENDLESS = {"to_x": 100.0, "from_y": -100.0, "to_y": 100.0}
CELL = SoilCell("field_trial", "sand", drawn=False, sigma_xy=0.05)
RESULT = Result(
    limit=1.02,
    limit_interval=(0.9, 1.1),
    modulus=0.9,
    modulus_interval=(0.5, 1.5),
    identifiable=True,
    reason="",
    probability=0.8,
    mu_r=1.01,
    mu_r_interval=(0.95, 1.05),
    moment_error=0.04,
    moment_interval=(0.8, 1.2),
    driving_error=0.01,
    braking_error=0.03,
    offset_residue=800.0,
    into="",
    recognised_after=math.nan,
    wrong_before=math.nan,
)


@pytest.fixture(scope="module")
def setting() -> Setting:
    return load_setting()


def driven(*segments: tuple[float, float, float], patches: tuple[Patch, ...] = ()) -> Truth:
    scenario = Scenario(
        name="test", soil="sand", segments=tuple(Segment(*s) for s in segments), patches=patches
    )
    return simulate_trial(TRIAL, scenario)


# Inputs


def test_a_drawn_machine_is_another_one_at_each_seed() -> None:
    nominal, drawn, again, other = (
        simulate_trial(replace(TRIAL, seed=seed, drawn=drawn))
        for seed, drawn in ((3, False), (3, True), (3, True), (4, True))
    )
    np.testing.assert_array_equal(drawn.x, again.x)
    assert simulate_trial(replace(TRIAL, seed=4)).x[-1] == nominal.x[-1]
    assert len({float(truth.x[-1]) for truth in (nominal, drawn, other)}) == 3
    assert drawn.x[-1] == pytest.approx(nominal.x[-1], rel=0.05)


def test_drive_begins_at_standstill_and_has_the_requested_duration() -> None:
    truth = simulate_trial(TRIAL)
    assert truth.duration == pytest.approx(14.0, abs=0.01)
    moved = np.hypot(truth.x, truth.y)
    assert moved[truth.t < 4.0].max() < 1e-6 < 1.0 < moved[-1]


def test_readings_are_the_truth_with_noise_and_offsets(setting: Setting) -> None:
    truth = simulate_trial(TRIAL)
    readings = draw_readings(TRIAL, truth, setting)
    at = truth.interpolate(np.arange(0.0, truth.duration, 0.01))
    pressures = np.array([(r.left_pressure, r.right_pressure) for r in readings.pressures])
    noise = pressures - np.column_stack((at.left_pressure, at.right_pressure)) - readings.offsets
    assert noise.std() == pytest.approx(setting.noise.pressure_stddev, rel=0.05)
    assert np.abs(noise.mean(axis=0)).max() < 0.1 * setting.noise.pressure_stddev
    assert np.abs(readings.offsets).max() > 0.1 * setting.study.offset_stddev
    arrivals = readings.arrivals
    assert isinstance(arrivals[0], PoseFix)
    stamps = [m.stamp_ns for m in arrivals if isinstance(m, Sprockets)]
    assert stamps == [r.stamp_ns for r in readings.pressures]
    assert stamps == sorted({*stamps})
    late = [k for k, m in enumerate(arrivals) if isinstance(m, PoseFix) and m.stamp_ns > START_NS]
    assert all(
        arrivals[k + 1].stamp_ns > arrivals[k].stamp_ns for k in late[:-2]
    )  # a fix arrives late, with an old stamp


def test_a_run_is_near_the_truth_and_repeats_itself(setting: Setting) -> None:
    result = run_trial(TRIAL, setting)
    assert (result.limit, result.mu_r) == pytest.approx((1.0, 1.0), abs=0.1)
    assert result.limit_interval[0] < 1.0 < result.limit_interval[1]
    assert 0.0 < result.driving_error < 0.05
    assert 0.0 < result.braking_error < 0.1
    assert 0.0 < result.moment_error < 0.1
    assert 0.0 < result.offset_residue < 5e3
    assert (result.into, math.isnan(result.recognised_after)) == ("", True)
    outputs = estimator_outputs(draw_readings(TRIAL, simulate_trial(TRIAL), setting), setting)
    last = [output for output in outputs if isinstance(output, SoilState)][-1]
    assert last.classes["sand"] == result.probability


# Scores


def test_a_turn_is_steady_after_two_seconds() -> None:
    truth = driven((3.0, 2.0, 2.0), (5.0, 1.2, 2.2), (5.0, 1.9, 2.0), (5.0, 2.2, 1.2), (4.0, 2.2, 1.8))
    times = np.arange(0.0, truth.duration, 0.25)
    steady = times[steady_turns(truth, times)]
    turns = ((5.0, 8.25), (15.0, 18.25), (20.0, 22.0))  # from 2 s after the start of each turn to its end
    within = [[low <= t <= high for low, high in turns] for t in steady]
    assert all(any(row) for row in within)
    assert all(any(column) for column in zip(*within, strict=True))


def state(t: float, **classes: float) -> SoilState:
    summary_ = StrengthSummary(0.01, (0.005, 0.02), 3e3, (2e3, 4e3), 5.0, identifiable=True, reason="")
    return SoilState(START_NS + round(t * 1e9), 0.2, 1e-4, 0.3, 1e-4, summary_, classes)


def test_a_border_is_noticed_when_the_right_class_is_certain() -> None:
    truth = driven((10.0, 2.2, 2.2), patches=(Patch(soil="dry_clay", from_x=1.5, **ENDLESS),))
    crossed = float(truth.t[np.argmax(truth.x >= 1.5)])
    assert 3.0 < crossed < 7.0
    before = [state(0.0, sand=0.2, dry_clay=0.9), state(crossed - 0.1, sand=0.7, dry_clay=0.3)]
    after = [state(crossed + 1.0, sand=0.3, dry_clay=0.7), state(crossed + 2.0, sand=0.1, dry_clay=0.81)]
    change = soil_change([*before, *after, state(crossed + 3.0, sand=0.0, dry_clay=0.9)], truth)
    assert change["into"] == "dry_clay"
    assert change["recognised_after"] == pytest.approx(2.0, abs=0.02)
    assert change["wrong_before"] == pytest.approx(0.3)
    assert soil_change([*before, after[0]], truth)["recognised_after"] == math.inf


def test_a_cell_has_medians_the_worst_and_counts() -> None:
    missed = replace(RESULT, limit=0.8, limit_interval=(0.7, 0.9), identifiable=False, moment_error=math.nan)
    row = summary(CELL, [RESULT, missed, replace(RESULT, limit=1.04, offset_residue=3e3)])
    assert isinstance(row, SoilRow)
    assert (row.soil, row.sigma_xy, row.seeds) == ("sand", 0.05, 3)
    assert (row.F_max_error, row.F_max_worst) == pytest.approx((0.04, 0.2))
    assert (row.F_max_inside, row.K_inside, row.mu_r_inside, row.identifiable) == (2, 3, 3, 2)
    assert (row.K_error, row.K_ratio) == pytest.approx((0.1, 3.0))
    assert (row.M_r_error, row.M_r_worst) == (0.04, 0.04)
    assert (row.offset_residue, row.offset_residue_worst) == (800.0, 3e3)


def test_a_border_has_a_row_of_its_own() -> None:
    crossings = [
        replace(RESULT, into="dry_clay", recognised_after=t, wrong_before=0.1) for t in (5.0, 7.0, math.inf)
    ]
    row = summary(CELL, crossings)
    assert isinstance(row, ChangeRow)
    assert (row.soil, row.into, row.recognised, row.seeds) == ("sand", "dry_clay", 2, 3)
    assert (row.recognised_after, row.recognised_after_worst) == (7.0, math.inf)


def test_the_grid_drives_patches_only_on_the_soil_they_name() -> None:
    values = {"soils": ["sand", "dry_clay"], "sigma_xy": [0.01, 0.05], "drawn": True}
    cells = list(soil_cells(load_soil_study_parameters(values)))
    assert len(cells) == len(set(cells)) == (2 + 1) * 2 * 2
    assert {cell.soil for cell in cells if cell.scenario == "soil_change"} == {"sand"}
