# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Thrust from pressure: driving, braking and in between, with offsets of the transducers."""

import numpy as np
import pytest

from trackslip_common.parameter_record import record_of
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_estimation.soil.thrust import (
    THRUST,
    ThrustParameters,
    hold_thrust,
    measure_thrust,
    motor_of,
    new_transducers,
    update_noise,
    update_offsets,
)
from trackslip_estimation.terramechanics.hydraulics import thrust_of_pressure
from trackslip_sim.scenarios.scenario import Scenario, Segment
from trackslip_sim.truth.simulate import simulate

P = load_soil_parameters()
BAR = 1e5  # Pa
STEP = 0.01  # s


class Meter:
    """Thrusts from pressures, with offsets that are estimated meanwhile."""

    def __init__(self) -> None:
        self._numbers, self._motor = record_of(ThrustParameters, P.thrust)[0], motor_of(P.vehicle.whole())[0]
        self.transducers = new_transducers(P.thrust)[0]

    def learn(self, pressures: np.ndarray | None) -> bool:
        """Update the offsets after STEP; None means motion. Returns whether a pressure was rejected."""
        is_standing = pressures is not None
        readings = pressures if is_standing else np.zeros(2)
        return update_offsets(self.transducers, readings, is_standing, STEP, self._numbers)

    def measure(self, pressures: np.ndarray, speeds: np.ndarray) -> np.void:
        thrust = np.zeros(1, THRUST)
        measure_thrust(thrust[0], pressures, speeds, self.transducers, self._numbers, self._motor)
        return thrust[0]

    def read(self, reading: np.ndarray) -> None:
        update_noise(self.transducers, reading, self._numbers)

    def hold(self, thrust: np.void) -> None:
        hold_thrust(thrust, STEP, self._numbers, self._motor)


def learn_for(meter: Meter, pressures: np.ndarray, seconds: float, noise: float = 0.0) -> int:
    """Update the offsets for ``seconds`` at standstill; the number of samples with a rejected pressure."""
    rng = np.random.default_rng(1)
    return sum(meter.learn(pressures + noise * rng.standard_normal(2)) for _ in range(round(seconds / STEP)))


def test_digging_pressure_is_not_learned_as_an_offset() -> None:
    """3 bar for 8 s, below the limit of an offset, after a standstill in which the offset is observed."""
    meter, noise = Meter(), P.thrust.pressure_stddev
    offsets = np.array((0.2 * BAR, -0.4 * BAR))
    assert learn_for(meter, offsets, 10.0, noise) == 0
    assert learn_for(meter, offsets + 3.0 * BAR, 8.0, noise) > 750
    np.testing.assert_allclose(meter.transducers["offset"], offsets, atol=0.05 * BAR)
    assert learn_for(meter, offsets, 10.0, noise) == 0


def test_changed_offset_is_learned_after_its_persist_time() -> None:
    meter, noise = Meter(), P.thrust.pressure_stddev
    learn_for(meter, np.zeros(2), 10.0, noise)
    learn_for(meter, np.full(2, 3.0 * BAR), 2.0 * P.thrust.persist_time, noise)
    np.testing.assert_allclose(meter.transducers["offset"], 3.0 * BAR, atol=0.2 * BAR)


@pytest.mark.parametrize("soil", ["sand", "sandy_loam", "clayey_soil", "dry_clay"])
def test_thrust_is_right_within_three_percent_driving_and_braking(soil: str) -> None:
    segments = (Segment(4.0, 2.0, 2.0), Segment(4.0, 0.8, 2.2), Segment(4.0, -1.5, -1.5))
    truth = simulate(Scenario(name="test", soil=soil, segments=segments)).interpolate(np.arange(0, 12, STEP))
    meter, rng = Meter(), np.random.default_rng(2)
    learn_for(meter, np.zeros(2), 10.0, P.thrust.pressure_stddev)
    pressures = np.stack((truth.left_pressure, truth.right_pressure), axis=-1)
    pressures += P.thrust.pressure_stddev * rng.standard_normal(pressures.shape)
    speeds = np.stack((truth.left_speed, truth.right_speed), axis=-1)
    forces = np.array([meter.measure(p, w)["force"] for p, w in zip(pressures, speeds, strict=True)])
    true = np.stack((truth.left_thrust, truth.right_thrust), axis=-1)
    forces, true = (np.mean(f.reshape(-1, 10, 2), axis=1) for f in (forces, true))  # means of 0.1 s
    speeds, steady = speeds[::10], (truth.t[::10] % 4.0) > 2.0
    for sign in (1.0, -1.0):  # driving, braking
        kind = steady[:, None] & (true * speeds * sign > 0.0) & (np.abs(true) > 500.0)
        if kind.any():
            assert np.abs(forces[kind] / true[kind] - 1.0).max() < 0.03
    assert (steady[:, None] & (true * speeds < 0.0)).any() == (soil != "clayey_soil")


def test_thrust_variance_covers_driving_and_braking_near_zero_speed() -> None:
    meter = Meter()
    pressures, speed = np.full(2, 50 * BAR), P.thrust.speed_stddev
    for true_speed in (0.0, 0.5 * speed, 5.0 * speed, -5.0 * speed):
        measured = meter.measure(pressures, np.full(2, true_speed))
        for direction in (1.0, -1.0):
            true = float(thrust_of_pressure(50 * BAR, direction, P.vehicle.whole()))
            if true_speed * direction >= 0.0 or abs(true_speed) < speed:
                assert (np.abs(measured["force"] - true) < 3.0 * np.sqrt(measured["variance"])).all()
    standing, driving = (meter.measure(pressures, np.full(2, w))["variance"] for w in (0.0, 1.0))
    assert (standing > 20.0 * driving).all()


def test_thrust_passes_smoothly_from_driving_to_braking() -> None:
    meter = Meter()
    speeds = np.linspace(-0.2, 0.2, 401)
    forces = np.array([meter.measure(np.full(2, 50 * BAR), np.full(2, w))["force"][0] for w in speeds])
    assert (np.diff(forces) <= 0.0).all()
    assert np.abs(np.diff(forces)).max() < 0.03 * (forces[0] - forces[-1])


def test_unknown_speed_gives_the_thrust_of_zero_speed() -> None:
    meter = Meter()
    unknown, none = (meter.measure(np.full(2, 50 * BAR), np.full(2, w)) for w in (np.nan, 0.0))
    np.testing.assert_array_equal(unknown["force"], none["force"])


@pytest.mark.parametrize("offset", [2.0, -2.0])
def test_offsets_of_two_bar_are_learned_to_a_tenth_in_ten_seconds_of_standing(offset: float) -> None:
    meter = Meter()
    true = np.array((offset, -0.5 * offset)) * BAR
    learn_for(meter, true, 10.0, P.thrust.pressure_stddev)
    assert (np.abs(meter.transducers["offset"] - true) < 0.1 * BAR).all()
    assert (np.sqrt(meter.transducers["offset_variance"]) < 0.1 * BAR).all()


def test_trapped_oil_and_slopes_are_no_offsets() -> None:
    meter = Meter()
    learn_for(meter, np.array((30.0, -8.0)) * BAR, 20.0)
    np.testing.assert_array_equal(meter.transducers["offset"], 0.0)


def test_offsets_wait_until_the_pressure_has_settled() -> None:
    meter = Meter()
    for _ in range(20):
        learn_for(meter, np.full(2, BAR), 0.9 * P.thrust.settling_time)
        meter.learn(None)  # motion
    np.testing.assert_array_equal(meter.transducers["offset"], 0.0)


def test_unobserved_thrust_is_held_with_variance_growing_to_relief() -> None:
    meter = Meter()
    thrust = meter.measure(np.full(2, 50 * BAR), np.ones(2))
    force = thrust["force"].copy()
    variances = []
    for _ in range(20_000):
        meter.hold(thrust)
        variances.append(float(thrust["variance"][0]))
    np.testing.assert_array_equal(thrust["force"], force)
    assert not thrust["is_known"]
    assert (np.diff(variances) >= 0.0).all()
    assert variances[-1] == pytest.approx(
        float(thrust_of_pressure(P.vehicle.whole().relief_pressure, 1, P.vehicle.whole())) ** 2
    )


@pytest.mark.parametrize("repeats", [1, 5], ids=["each read once", "repeated by a gateway"])
@pytest.mark.parametrize("ripple", [0.0, 4.0 * BAR, 20.0 * BAR])
def test_thrust_is_as_uncertain_as_its_readings_scatter(ripple: float, repeats: int) -> None:
    """Readings of 2 s of steps between straights and turns, then of a straight, at 50 Hz."""
    meter, rng, expected = Meter(), np.random.default_rng(2), max(ripple, P.thrust.pressure_stddev)
    learn_for(meter, np.zeros(2), 10.0)
    for k in range(600):
        level = 45.0 * BAR if k > 300 or k // 75 % 2 else 120.0 * BAR
        reading = level + expected * rng.standard_normal(2)
        for _ in range(repeats):
            meter.read(reading)
    thrust = meter.measure(np.full(2, 45.0 * BAR), np.full(2, 2.0))
    per_pascal = thrust["force"] / (45.0 * BAR)
    np.testing.assert_allclose(np.sqrt(thrust["variance"]) / per_pascal, expected, rtol=0.3)
