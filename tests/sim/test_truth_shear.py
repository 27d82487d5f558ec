# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The shear truth against (3.3), against published values, and at its limits."""

import dataclasses

import numpy as np
import pytest

from trackslip_common.errors import InputError
from trackslip_common.soils import soil
from trackslip_common.vehicle_files import load_vehicle
from trackslip_estimation.soil.classes import soil_thrust_limit
from trackslip_estimation.terramechanics.traction import thrust
from trackslip_sim.scenarios.scenario import Scenario, Segment, load_scenario
from trackslip_sim.truth.ground import Patch
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.settings import load_settings
from trackslip_sim.truth.simulate import simulate

VEHICLE = load_vehicle().whole()
SETTINGS = load_settings()
SOILS = ("sand", "sandy_loam", "clayey_soil", "dry_clay")
FAST, SLOW = 0.4 / VEHICLE.rolling_radius, 0.24 / VEHICLE.rolling_radius

# Left and right slip, left and right thrust N, yaw rate rad/s; right track at 60 %.
INNER_60 = {
    "sand": (0.21, -0.016, 3296.0, -785.0, -0.096),
    "sandy_loam": (0.19, -0.018, 3308.0, -797.0, -0.109),
    "clayey_soil": (0.38, 0.008, 2627.0, 1140.0, -0.012),
    "dry_clay": (0.14, -0.075, 3388.0, -2132.0, -0.120),
}
STRAIGHT_SLIP = {"sand": 0.0072, "sandy_loam": 0.016, "clayey_soil": 0.016, "dry_clay": 0.0016}


def drive(*segments: tuple[float, float, float], soil: str = "sand", **fields: object) -> Scenario:
    return Scenario(name="test", soil=soil, segments=tuple(Segment(*s) for s in segments), **fields)


def random_drive(seed: int, soil: str) -> Scenario:
    """20 s of commands that change at random every 2 s, from full reverse to full speed."""
    speeds = np.random.default_rng(seed).uniform(-1.0, 3.0, (10, 2))
    return drive(*((2.0, float(left), float(right)) for left, right in speeds), soil=soil)


@pytest.mark.parametrize("name", SOILS)
def test_straight_motion_is_equation_3_3(name: str) -> None:
    end = simulate(drive((30.0, FAST, FAST), soil=name)).interpolate(30.0)  # the transient has decayed
    ground = soil(name)
    limit = soil_thrust_limit(ground, VEHICLE)
    expected = thrust(end.left_slip, limit, ground.value("shear_modulus"), VEHICLE.contact_length)
    assert end.left_thrust == pytest.approx(expected, rel=0.01)
    assert end.left_thrust[0] == pytest.approx(0.5 * ground.value("mu_r") * VEHICLE.weight, rel=1e-3)
    assert end.left_slip[0] == pytest.approx(STRAIGHT_SLIP[name], rel=0.03)


@pytest.mark.parametrize("name", SOILS)
def test_turn_with_inner_track_at_60_percent(name: str) -> None:
    end = simulate(drive((15.0, FAST, SLOW), soil=name)).interpolate(15.0)
    measured = (end.left_slip, end.right_slip, end.left_thrust, end.right_thrust, end.yaw_rate)
    assert np.concatenate(measured) == pytest.approx(INNER_60[name], rel=0.05)


@pytest.mark.parametrize("name", SOILS)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_halving_the_step_moves_the_end_by_less_than_a_millimetre(name: str, seed: int) -> None:
    scenario = random_drive(seed, name)
    whole = simulate(scenario, settings=SETTINGS)
    half = simulate(scenario, settings=dataclasses.replace(SETTINGS, step=SETTINGS.step / 2))
    assert np.hypot(whole.x[-1] - half.x[-1], whole.y[-1] - half.y[-1]) < 1e-3


def test_heavy_machine_on_stiff_ground_is_balanced_within_rounding() -> None:
    """1e-6 N is below the rounding of the forces of 21 t; an unbalanced step raises."""
    heavy = load_vehicle("excavator_20t").whole()
    driven = simulate(load_scenario("field_trial").with_duration(60.0), soil="dry_clay", vehicle=heavy)
    assert np.isfinite(driven.x).all()


@pytest.mark.parametrize("name", ["sand", "clayey_soil"])
def test_spot_turn_with_low_relief_pressure_stalls(name: str) -> None:
    scenario = load_scenario("spot_turn")
    truth = simulate(scenario, soil=name)
    assert all(np.isfinite(getattr(truth, field.name)).all() for field in dataclasses.fields(Truth)[:-1])
    stalled = truth.interpolate(np.arange(10.0, 20.0, 0.1))
    assert np.abs(stalled.left_spool).min() > 0.6  # commanded to turn all the time
    assert np.abs(stalled.yaw_rate).max() < 1e-3
    assert np.hypot(stalled.v_x, stalled.v_y).max() < 1e-4
    assert np.abs(stalled.right_speed).max() < 1e-2
    assert stalled.right_pressure == pytest.approx(scenario.relief_pressure, rel=1e-3)
    assert truth.v_x[-1] > 0.3  # drives straight afterwards
    free = simulate(dataclasses.replace(scenario, relief_pressure=None), soil=name).interpolate(19.0)
    assert free.yaw_rate[0] > 0.1  # without the relief valve it does not stall


def test_relief_bounds_every_pressure() -> None:
    scenario = dataclasses.replace(random_drive(3, "dry_clay"), relief_pressure=9e6)
    truth = simulate(scenario)
    for pressure in (truth.left_pressure, truth.right_pressure, truth.supply_pressure):
        assert np.abs(pressure).max() <= 9e6 * (1.0 + 1e-9)
    assert truth.supply_pressure.max() == pytest.approx(9e6)


def test_pump_flow_bounds_the_speed() -> None:
    end = simulate(drive((3.0, 100.0, 100.0))).interpolate(3.0)
    top = 2.0 * np.pi * VEHICLE.pump_flow * VEHICLE.volumetric_efficiency
    top /= VEHICLE.motor_displacement * VEHICLE.gear_ratio
    assert end.left_speed[0] == pytest.approx(top, rel=1e-3)


def test_without_commands_nothing_moves() -> None:
    truth = simulate(drive((1.0, 0.0, 0.0)))
    for name in ("x", "y", "yaw", "left_angle", "left_thrust", "left_slip", "slip_angle"):
        assert not getattr(truth, name).any()


def test_machine_comes_to_rest_without_chatter() -> None:
    truth = simulate(drive((5.0, 2.5, 1.0), (5.0, 0.0, 0.0)))
    rest = truth.interpolate(np.arange(7.0, 10.0, 0.005))
    assert np.ptp(rest.x) < 1e-5
    assert np.ptp(rest.yaw) < 1e-5
    assert np.abs(rest.left_thrust).max() < 50.0
    assert not rest.left_slip.any()


def test_braking_thrust_is_divided_by_the_efficiency() -> None:
    end = simulate(drive((20.0, FAST, SLOW), soil="sand")).interpolate(20.0)
    swept = VEHICLE.motor_displacement * VEHICLE.gear_ratio / (2.0 * np.pi * VEHICLE.rolling_radius)
    assert end.left_thrust == pytest.approx(VEHICLE.motor_efficiency * swept * end.left_pressure)
    assert end.right_thrust == pytest.approx(swept * end.right_pressure / VEHICLE.motor_efficiency)


def test_patches_change_the_soil_during_a_drive() -> None:
    patch = Patch(soil="clayey_soil", from_x=2.0, to_x=100.0, from_y=-5.0, to_y=5.0)
    truth = simulate(drive((30.0, FAST, FAST), soil="sand", patches=(patch,)))
    assert (truth.soil_name(0), truth.soil_name()) == ("sand", "clayey_soil")
    assert truth.x[np.argmax(truth.soil_index)] == pytest.approx(2.0, abs=0.01)
    assert truth.left_resistance[-1] == pytest.approx(0.15 * VEHICLE.weight, rel=1e-3)
    alone = simulate(drive((30.0, FAST, FAST), soil="clayey_soil"))
    assert truth.left_slip[-1] == pytest.approx(alone.left_slip[-1], rel=1e-3)


def test_load_shifts_between_the_tracks_and_along_them() -> None:
    left = dataclasses.replace(SETTINGS, load_y=0.25 * VEHICLE.tread)  # 3/4 of the weight on the left
    end = simulate(drive((5.0, FAST, FAST)), settings=left).interpolate(5.0)
    assert end.left_resistance == pytest.approx(3.0 * end.right_resistance, rel=1e-6)
    assert end.yaw_rate[0] > 0.0  # the loaded track has more resistance
    turn = drive((20.0, FAST, SLOW))
    even = simulate(turn).interpolate(20.0)
    ahead = simulate(turn, settings=dataclasses.replace(SETTINGS, load_x=0.15)).interpolate(20.0)
    assert even.v_y[0] < ahead.v_y[0] - 1e-3  # turns about a point further ahead


@pytest.mark.parametrize(("name", "value"), [("load_x", 0.22), ("load_y", -0.4)])
def test_load_off_the_contact_is_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match=rf"{name}: {value} m .*accepted"):
        simulate(drive((1.0, 1.0, 1.0)), settings=dataclasses.replace(SETTINGS, **{name: value}))


def test_interpolation_is_linear_and_keeps_the_soil_before() -> None:
    patch = Patch(soil="dry_clay", from_x=0.5, to_x=9.0, from_y=-1.0, to_y=1.0)
    truth = simulate(drive((4.0, 2.0, 2.1), patches=(patch,)))
    assert len(truth) == 801
    assert truth.duration == pytest.approx(4.0)
    between = truth.interpolate(2.0025)
    assert between.x[0] == pytest.approx(0.5 * (truth.x[400] + truth.x[401]))
    assert between.soil_name() == truth.soil_name(400)
    assert truth.interpolate(99.0).x[0] == truth.x[-1]


def test_speeds_are_the_derivatives_of_the_pose() -> None:
    truth = simulate(load_scenario("slalom"))
    along = np.cos(truth.yaw) * truth.v_x - np.sin(truth.yaw) * truth.v_y
    moved = np.sum(0.5 * (along[1:] + along[:-1])) * SETTINGS.sample_period
    assert moved == pytest.approx(truth.x[-1], abs=1e-4)
    assert np.gradient(truth.left_angle, truth.t)[1000] == pytest.approx(truth.left_speed[1000], rel=1e-3)
