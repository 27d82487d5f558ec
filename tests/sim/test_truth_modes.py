# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The thesis' forward simulation, and drives of both modes in pieces."""

import numpy as np
import pytest

from trackslip_common.errors import InputError
from trackslip_common.soils import soil
from trackslip_common.vehicle_files import load_vehicle
from trackslip_estimation.soil.classes import soil_thrust_limit
from trackslip_estimation.terramechanics.traction import thrust
from trackslip_sim.scenarios.scenario import Scenario, Segment, load_scenario
from trackslip_sim.truth.record import COLUMNS, join_pieces
from trackslip_sim.truth.settings import load_settings
from trackslip_sim.truth.simulate import duration_of, simulate, simulate_in_pieces

VEHICLE = load_vehicle().whole()
SETTINGS = load_settings()
SOILS = ("sand", "sandy_loam", "clayey_soil", "dry_clay")


def test_thesis_manoeuvre_ends_as_far_apart_as_in_figures_6_1_and_6_2() -> None:
    runs = [simulate(load_scenario("thesis"), soil=name, mode="thesis") for name in SOILS]
    driven = [run.interpolate(np.arange(1.0, 35.0, 0.1)) for run in runs]  # after the first start
    assert all(run.duration == pytest.approx(35.0) for run in runs)
    assert max(np.abs([run.left_slip, run.right_slip]).max() for run in driven) < 0.08
    ends = np.array([[run.x[-1], run.y[-1], run.yaw[-1]] for run in runs])
    apart = np.linalg.norm(ends[:, None, :2] - ends[None, :, :2], axis=2).max()
    assert 0.4 < apart < 0.8  # thesis: up to 0.6 m
    assert 0.1 < np.ptp(ends[:, 2]) < 0.35  # thesis: up to 0.3 rad


@pytest.mark.parametrize("name", SOILS)
def test_thesis_mode_balances_the_free_body(name: str) -> None:
    scenario = Scenario(name="turn", soil=name, segments=(Segment(20.0, 2.4, 2.0),))
    end = simulate(scenario, mode="thesis").interpolate(20.0)
    ground = soil(name)
    limit = soil_thrust_limit(ground, VEHICLE)
    for slip, force in ((end.left_slip, end.left_thrust), (end.right_slip, end.right_thrust)):
        expected = thrust(slip, limit, ground.value("shear_modulus"), VEHICLE.contact_length)
        assert force == pytest.approx(expected, rel=1e-6)
    resistance = end.left_resistance + end.right_resistance
    assert end.left_thrust + end.right_thrust == pytest.approx(resistance, rel=1e-6)
    assert resistance[0] == pytest.approx(ground.value("mu_r") * VEHICLE.weight, rel=1e-3)
    turning = 0.5 * VEHICLE.tread * (end.right_thrust - end.left_thrust)
    assert turning == pytest.approx(-end.turning_moment, rel=1e-3)
    assert end.yaw_rate[0] < 0.0
    tightness = 0.5 * VEHICLE.tread * abs(end.yaw_rate) / end.v_x
    full = ground.value("mu_l") * VEHICLE.weight * VEHICLE.contact_length / 3.0
    assert end.turning_moment == pytest.approx(full * tightness, rel=1e-6)


def test_thesis_mode_needs_lateral_resistance() -> None:
    with pytest.raises(InputError, match=r"soft_soil.*mu_r|soft_soil.*mu_l"):
        simulate(load_scenario("straight"), soil="soft_soil", mode="thesis")


def test_unknown_mode_is_refused() -> None:
    with pytest.raises(InputError, match=r"mode: 'magic' is unknown; accepted: shear, thesis"):
        simulate(load_scenario("straight"), mode="magic")


@pytest.mark.parametrize("mode", ["shear", "thesis"])
def test_a_drive_in_pieces_is_the_drive_in_one(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load_scenario("patches").with_duration(7.003)
    whole = simulate(scenario, mode=mode)
    monkeypatch.setattr("trackslip_sim.truth.simulate.PIECE", 1.5)
    pieces = list(simulate_in_pieces(scenario, mode=mode))
    assert len(pieces) == 5
    again = join_pieces(pieces)
    assert again.duration == whole.duration == duration_of(scenario, SETTINGS)
    for name in (*COLUMNS, "soil_index"):
        np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))
