# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sub-model 2 on the shear truth: μ_r and the mobilised μ_l, with measured thrusts and slips."""

from functools import cache

import numpy as np
import pytest
from fixtures.soil_samples import Sample, level_load

from trackslip_common.soils import soil
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil.dynamics import MU_L, MU_R, new_dynamics, step
from trackslip_estimation.soil.soil_estimator import SoilEstimator, SoilState
from trackslip_estimation.soil.soil_parameters import (
    SoilEstimatorParameters,
    load_soil_parameters,
    make_config,
)
from trackslip_sim.machine.hydraulics import START_NS, InputErrors, soil_inputs
from trackslip_sim.scenarios.scenario import Scenario, Segment
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.simulate import simulate

P = load_soil_parameters({"soil_period": 0.1})
VEHICLE = P.vehicle.whole()
MOTION = load_slip_parameters().motion
SOILS = ("sand", "sandy_loam", "clayey_soil", "dry_clay")
SEGMENTS = ((4.0, 0.0, 0.0), (6.0, 2.0, 2.0), (6.0, 1.0, 2.2), (3.0, 1.8, 1.8), (6.0, 2.2, 1.2))
TURNS, STRAIGHT = ((12.0, 16.0), (21.0, 25.0)), ((6.0, 10.0), (17.5, 19.0))  # s, steady parts


@cache
def driven(name: str) -> tuple[Truth, list[SoilState]]:
    scenario = Scenario(name="test", soil=name, segments=tuple(Segment(*row) for row in SEGMENTS))
    truth, estimator = simulate(scenario), SoilEstimator(P)
    outputs = [
        o for one in soil_inputs(truth, VEHICLE, MOTION, InputErrors()) for o in estimator.advance(one)
    ]
    return truth, [output for output in outputs if isinstance(output, SoilState)]


def within(states: list[SoilState], *times: tuple[float, float]) -> list[SoilState]:
    t = {id(s): (s.stamp_ns - START_NS) * 1e-9 for s in states}
    return [s for s in states if any(a <= t[id(s)] <= b for a, b in times)]


@pytest.mark.parametrize("name", SOILS)
def test_longitudinal_resistance_is_found_within_five_percent(name: str) -> None:
    _, states = driven(name)
    true = soil(name).value("mu_r")
    for state in within(states, *STRAIGHT, *TURNS):
        assert state.mu_r == pytest.approx(true, rel=0.05)
        assert abs(state.mu_r - true) < 3.0 * np.sqrt(state.mu_r_variance)


@pytest.mark.parametrize("name", SOILS)
def test_mobilised_lateral_resistance_is_the_moment_within_ten_percent(name: str) -> None:
    truth, states = driven(name)
    for state in within(states, *TURNS):
        moment = float(truth.interpolate((state.stamp_ns - START_NS) * 1e-9).turning_moment[0])
        true = 3.0 * moment / (VEHICLE.weight * VEHICLE.contact_length)  # (3.8)
        assert state.mu_l == pytest.approx(true, rel=0.10)
        assert abs(state.mu_l - true) < 3.0 * np.sqrt(state.mu_l_variance)


def test_lateral_resistance_is_held_while_driving_straight() -> None:
    _, states = driven("sand")
    mu_l = [state.mu_l for state in within(states, (17.5, 19.0))]
    assert max(mu_l) - min(mu_l) < 1e-3 < 0.2 < mu_l[0]


class Filter:
    """Sub-model 2 in steps of 0.01 s."""

    def __init__(self, p: SoilEstimatorParameters = P) -> None:
        self._state, self._numbers = new_dynamics(p.dynamics), make_config(p)
        self.load = level_load(VEHICLE)

    @property
    def mu(self) -> np.ndarray:
        return self._state["mean"][0, [MU_R, MU_L]]

    @property
    def mu_variance(self) -> np.ndarray:
        return self._state["covariance"][0, [MU_R, MU_L], [MU_R, MU_L]]

    def step(self, motion: Motion, twist: np.ndarray, forces: np.ndarray | None, stddev: float) -> None:
        tracks, covariance = np.array((0.0, twist[2])), stddev**2 * np.eye(3)
        moment = Sample(0.01, tracks, twist, covariance, forces, np.full(2, 100.0), motion)
        sample, thrust = moment.records()
        step(self._state[0], sample[0], thrust[0], self.load[0], self._numbers[0])


def steady(
    thrust: tuple[float, float], motion: Motion, twist: tuple[float, float, float], s: float
) -> Filter:
    dynamics = Filter()
    for _ in range(round(s / 0.01)):
        dynamics.step(motion, np.array(twist), np.array(thrust), 1e-3)
    return dynamics


def test_steady_motion_equals_the_closed_forms() -> None:
    """μ_r = (F_L + F_R)/W straight, μ_l = 3 B (F_R − F_L)/(2 W l) in a left turn; mirrored to the right."""
    weight = VEHICLE.weight
    straight = steady((1000.0, 1200.0), Motion.STRAIGHT, (0.3, 0.0, 0.0), 30.0)
    assert straight.mu[0] == pytest.approx(2200.0 / weight, rel=1e-3)
    lateral = 3.0 * VEHICLE.tread * 3000.0 / (2.0 * weight * VEHICLE.contact_length)
    for left, right, rate in ((-500.0, 2500.0, 0.1), (2500.0, -500.0, -0.1)):
        turn = steady((left, right), Motion.TURNING, (0.3, 0.0, rate), 30.0)
        np.testing.assert_allclose(turn.mu, (2000.0 / weight, lateral), rtol=1e-3)


def test_reverse_is_resisted_forwards() -> None:
    backwards = steady((-1000.0, -1000.0), Motion.STRAIGHT, (-0.3, 0.0, 0.0), 30.0)
    assert backwards.mu[0] == pytest.approx(2000.0 / VEHICLE.weight, rel=1e-3)


def test_resistance_is_held_while_a_machine_on_a_slope_may_be_at_standstill() -> None:
    """The tracks spin; a twist two standard deviations from zero does not prove a slide."""
    pull, mu_r = -0.2 * VEHICLE.weight, 0.3
    dynamics = Filter()
    dynamics.load["pull"] = pull
    climbing = np.full(2, (mu_r * VEHICLE.weight - pull) / 2.0)
    for _ in range(1000):
        dynamics.step(Motion.STRAIGHT, np.array((0.3, 0.0, 0.0)), climbing, 1e-3)
    before = dynamics.mu[0]
    assert before == pytest.approx(mu_r, rel=0.01)
    for _ in range(200):
        dynamics.step(Motion.STRAIGHT, np.array((-0.06, 0.0, 0.0)), np.full(2, -pull / 2.0), 0.03)
    assert dynamics.mu[0] == pytest.approx(before, abs=0.01)


def test_uncertain_inertia_widens_the_resistance_while_a_turn_begins() -> None:
    """The same accelerated turn: a larger variance of I_z gives a larger variance of μ_l."""
    deviations = []
    for inertia in (0.0, 0.5):
        dynamics = Filter(load_soil_parameters({"dynamics.yaw_inertia_stddev": inertia}))
        for k in range(50):
            twist = np.array((0.3, 0.0, 0.5 * (k + 1) * 0.01))
            dynamics.step(Motion.TURNING, twist, np.array((0.0, 3000.0)), 1e-3)
        deviations.append(np.sqrt(dynamics.mu_variance[1]))
    assert deviations[1] > 1.5 * deviations[0]


def test_without_thrusts_the_coefficients_are_held_and_grow_uncertain_while_driving_only() -> None:
    dynamics = steady((1000.0, 1000.0), Motion.STRAIGHT, (0.3, 0.0, 0.0), 10.0)
    before, variance = dynamics.mu.copy(), dynamics.mu_variance[0]
    for _ in range(500):
        dynamics.step(Motion.STANDING, np.zeros(3), None, 0.0)
    assert dynamics.mu_variance[0] == variance
    for _ in range(500):
        dynamics.step(Motion.STRAIGHT, np.array((0.3, 0.0, 0.0)), None, 0.0)
    np.testing.assert_array_equal(dynamics.mu, before)
    assert dynamics.mu_variance[0] > 4.0 * variance
