# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The swinging cab of the truth, and the sensors mounted on it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_common.errors import InputError
from trackslip_common.vehicle_files import load_vehicle
from trackslip_sim.machine.excavator import simulate_drive
from trackslip_sim.machine.sensors import MachineSensors, mounting_of
from trackslip_sim.parameters import EmulatorParameters, load_emulator_parameters
from trackslip_sim.scenarios.scenario import Scenario, Segment, load_scenario
from trackslip_sim.truth.record import Truth, TruthWindow
from trackslip_sim.truth.simulate import simulate
from trackslip_sim.truth.swing import swing_motion

STEP = 1e-3
CAB = load_vehicle("pc05_cab")


@settings(deadline=None, max_examples=40)
@given(
    targets=st.lists(st.floats(-6.0, 6.0), min_size=1, max_size=3),
    rate=st.floats(0.2, 2.0),
    acceleration=st.floats(0.2, 3.0),
    backlash=st.floats(0.0, 0.02),
)
def test_swing_reaches_its_target_within_its_limits(
    targets: list[float], rate: float, acceleration: float, backlash: float
) -> None:
    """The time for each target suffices for the longest swing."""
    wait = 12.0 / rate + 2.0 * rate / acceleration + 1.0
    state = np.zeros(3)
    for target in targets:
        count = round(wait / STEP)
        swung = swing_motion(np.full(count, target), (rate, acceleration, backlash), STEP, state)
        assert np.abs(swung[:, 1]).max() <= rate + 1e-9
        assert np.abs(np.diff(swung[:, 0])).max() <= rate * STEP + 1e-9
        assert swung[-1, 0] == pytest.approx(target, abs=backlash / 2.0 + 1e-4)
        assert swung[-1, 1] == 0.0


def test_backlash_moves_the_cab_late_when_it_turns_back() -> None:
    state = np.zeros(3)
    there = swing_motion(np.full(3000, 0.5), (1.0, 1.0, 0.01), STEP, state)
    back = swing_motion(np.full(200, 0.0), (1.0, 1.0, 0.01), STEP, state)
    assert there[-1, 0] == pytest.approx(0.495, abs=1e-4)
    assert np.all(back[:140, 0] == there[-1, 0])  # a move of 0.01 rad at 1 rad/s² takes 0.14 s
    assert back[-1, 0] < there[-1, 0]


def test_pieces_of_a_swing_are_the_whole() -> None:
    targets = np.repeat([1.0, -2.0], 4000)
    limits, state = (0.9, 0.8, 0.004), np.zeros(3)
    whole = swing_motion(targets, limits, STEP, np.zeros(3))
    pieces = [swing_motion(part, limits, STEP, state) for part in np.split(targets, 5)]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)


def test_cab_facing_forward_equals_a_machine_without_a_cab() -> None:
    scenario = load_scenario("thesis").with_duration(3.0)
    upper = CAB.upper_structure
    with_cab, without = simulate(scenario, upper=upper), simulate(scenario)
    np.testing.assert_array_equal(with_cab.x, without.x)
    assert not with_cab.swing.any()
    assert not with_cab.swing_rate.any()


def test_a_vehicle_without_a_cab_cannot_swing_it() -> None:
    scenario = Scenario(name="s", soil="sand", segments=(Segment(1.0, 0.0, 0.0, 1.0),))
    with pytest.raises(InputError, match=r"'s' swings .* accepted: a vehicle with upper_structure\.drive"):
        simulate(scenario, upper=None)


@pytest.fixture(scope="module")
def dug() -> tuple[EmulatorParameters, Truth, MachineSensors]:
    """The drive ``dig_cycles`` and its sensors."""
    p = load_emulator_parameters({"scenario": "dig_cycles", "vehicle": "pc05_cab"})
    truth = simulate_drive(p)
    window = TruthWindow((truth,), truth.duration)
    return p, truth, MachineSensors(window, p.noise, 0, 1, mounting_of(p.vehicle))


def test_sensors_on_the_cab_turn_about_the_swing_axis(
    dug: tuple[EmulatorParameters, Truth, MachineSensors],
) -> None:
    """The axis is fixed while the cab turns; the gyro measures both rotations."""
    p, truth, sensors = dug
    times = truth.t[::50]
    x, y, yaw = sensors.pose_at(times)
    upper_x, upper_y, upper_yaw = sensors.upper_pose_at(times)
    axis_x, axis_y = p.vehicle.swing_axis
    for upper, base, part in ((upper_x, x, np.cos), (upper_y, y, np.sin)):
        np.testing.assert_allclose(upper + axis_x * part(upper_yaw), base + axis_x * part(yaw), atol=1e-9)
    assert axis_y == 0.0
    np.testing.assert_allclose(upper_yaw - yaw, np.interp(times, truth.t, truth.swing), atol=1e-9)
    assert truth.swing.max() == pytest.approx(math.pi, abs=0.01)
    assert truth.swing.min() == pytest.approx(-math.pi, abs=0.01)
    fastest = int(np.argmax(truth.swing_rate))
    rate = sensors.imu(round(truth.t[fastest] * 1e9)).angular_velocity[2]
    assert rate == pytest.approx(0.94 + p.noise.gyro_bias, abs=5.0 * p.noise.gyro_stddev)
    reading = sensors.swing(round(truth.t[fastest] * 1e9))
    assert reading.position == pytest.approx(truth.swing[fastest], abs=0.01)


def test_the_encoder_reads_within_half_a_turn(dug: tuple[EmulatorParameters, Truth, MachineSensors]) -> None:
    _, truth, sensors = dug
    positions = [sensors.swing(round(t * 1e9)).position for t in truth.t[::200]]
    assert np.abs(positions).max() <= math.pi


def test_dig_cycles_end_near_their_start(dug: tuple[EmulatorParameters, Truth, MachineSensors]) -> None:
    _, truth, _ = dug
    assert math.hypot(truth.x[-1], truth.y[-1]) < 1.5
    assert truth.swing[-1] == pytest.approx(0.0, abs=0.005)
