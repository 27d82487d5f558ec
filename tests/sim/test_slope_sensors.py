# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Measurements of the sensors of a machine on a slope, as recorded in a bag."""

import math
from typing import Any

import numpy as np
import pytest

from trackslip_bags.reader import open_bag
from trackslip_common.units import GRAVITY
from trackslip_sim.machine.offline import record_drive
from trackslip_sim.machine.placement import Placement
from trackslip_sim.machine.sensors import MachineSensors
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.truth.record import Truth, TruthWindow
from trackslip_sim.truth.simulate import simulate

QUIET = {
    f"noise.{name}": 0.0
    for name in (
        *("gyro_stddev", "gyro_bias", "gyro_bias_x", "gyro_bias_y", "acceleration_stddev"),
        *("acceleration_bias_x", "acceleration_bias_y", "acceleration_bias_z", "field_stddev"),
    )
}
ANTENNA = (0.3, -0.2, 2.0)
PARAMETERS = load_emulator_parameters(
    {
        **QUIET,
        **dict(zip(("gnss.antenna_x", "gnss.antenna_y", "gnss.antenna_z"), ANTENNA, strict=True)),
        "lead_in": 6.0,
        "gnss.device.rate": 10.0,
        "gnss.heading_stddev": 1e-4,
    }
)
S = 1_000_000_000


@pytest.fixture(scope="module")
def truth() -> Truth:
    return simulate(load_scenario("hill").with_duration(80.0))


@pytest.fixture(scope="module")
def bag(truth: Truth, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[float, Any]]]:
    """(seconds of the drive, message) by topic."""
    path = tmp_path_factory.mktemp("slope") / "bag"
    record_drive(PARAMETERS, truth, path)
    by_topic: dict[str, list[tuple[float, Any]]] = {}
    requested = ["/imu/data_raw", "/truth/attitude", "/truth/odometry", "/gnss_pose", "/fix", "/heading"]
    with open_bag(path) as reader:
        for m in reader.messages(requested):
            message = reader.deserialize(m.raw, m.type_name)
            stamp = message.header.stamp
            by_topic.setdefault(m.topic, []).append((stamp.sec - 7.0 + stamp.nanosec * 1e-9, message))
    return by_topic


def placements(truth: Truth, times: list[float]) -> list[Placement]:
    at = truth.interpolate(times)
    columns = (at.x, at.y, at.yaw, at.z, at.pitch, at.roll)
    return [Placement(*row) for row in np.column_stack(columns).tolist()]


def of_drive(
    messages: list[tuple[float, Any]], end: float, begin: float = 0.0
) -> tuple[list[float], list[Any]]:
    within = [(t, m) for t, m in messages if begin <= t <= end]
    return [t for t, _ in within], [m for _, m in within]


def test_accelerometers_measure_gravity_alone_before_the_drive() -> None:
    slope = simulate(load_scenario("side_slope").with_duration(2.0))
    sensors = MachineSensors(TruthWindow((slope,), 2.0), PARAMETERS.noise, 7 * S, 1)
    sample = sensors.imu(5 * S)
    roll = math.radians(15.0)
    expected = (0.0, GRAVITY * math.sin(roll), GRAVITY * math.cos(roll))
    assert sample.acceleration == pytest.approx(expected, abs=1e-9)
    assert sample.angular_velocity == (0.0, 0.0, 0.0)


@pytest.mark.slow
def test_accelerometers_measure_gravity_and_motion(bag: dict[str, Any], truth: Truth) -> None:
    times, messages = of_drive(bag["/imu/data_raw"], truth.duration - 0.1, 0.1)
    measured = np.array(
        [(m.linear_acceleration.x, m.linear_acceleration.y, m.linear_acceleration.z) for m in messages]
    )
    gravity = np.array([p.rotation()[2] * GRAVITY for p in placements(truth, times)])
    at = truth.interpolate(times)
    changes = [np.interp(times, truth.t, np.gradient(v, truth.t)) for v in (truth.v_x, truth.v_y)]
    ahead, left = changes[0] - at.yaw_rate * at.v_y, changes[1] + at.yaw_rate * at.v_x
    assert np.degrees(at.pitch).min() < -10.0  # nose up
    # The resolution of the line is 1 mg.
    np.testing.assert_allclose(measured[:, 0], gravity[:, 0] + ahead, atol=0.011)
    np.testing.assert_allclose(measured[:, 1], gravity[:, 1] + left, atol=0.011)
    np.testing.assert_allclose(measured[:, 2], gravity[:, 2], atol=0.05)


def test_gyros_measure_all_three_rates(bag: dict[str, Any], truth: Truth) -> None:
    times, messages = of_drive(bag["/imu/data_raw"], truth.duration)
    rates = np.array([(m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z) for m in messages])
    at = truth.interpolate(times)
    expected = np.column_stack((at.roll_rate, at.pitch_rate, at.yaw_rate))
    np.testing.assert_allclose(rates, expected, atol=2e-4)  # resolution of the line: 0.01 °/s
    assert (np.abs(expected).max(axis=0) > (0.004, 0.02, 0.1)).all()


def test_true_attitude_and_height_are_recorded(bag: dict[str, Any], truth: Truth) -> None:
    for topic in ("/truth/attitude", "/truth/odometry"):
        times, messages = of_drive(bag[topic], truth.duration)
        for message, place in zip(messages[::20], placements(truth, times)[::20], strict=True):
            q = message.orientation if topic == "/truth/attitude" else message.pose.pose.orientation
            assert up_of(q) == pytest.approx(place.rotation()[2], abs=1e-9)
            if topic == "/truth/odometry":
                assert message.pose.pose.position.z == pytest.approx(place.z)
    assert max(m.pose.pose.position.z for _, m in bag["/truth/odometry"]) > 2.0


def up_of(q: Any) -> tuple[float, float, float]:
    """The site's vertical in base_link."""
    return 2 * (q.x * q.z - q.w * q.y), 2 * (q.y * q.z + q.w * q.x), 1 - 2 * (q.x**2 + q.y**2)


def test_an_antenna_leans_with_the_machine(bag: dict[str, Any], truth: Truth) -> None:
    times, messages = of_drive(bag["/gnss_pose"], truth.duration, 0.5)
    antennas = np.array([p.to_site(*ANTENNA) for p in placements(truth, times)])
    fixes = np.array([(m.pose.pose.position.x, m.pose.pose.position.y) for m in messages])
    errors = fixes - antennas[:, :2]
    assert np.sqrt(np.mean(errors**2)) < 0.015
    upright = np.column_stack((truth.interpolate(times).x, truth.interpolate(times).y))
    assert np.hypot(*(antennas[:, :2] - upright).T).max() > 0.5  # 2 m high, tilted by up to 15°
    _, messages = of_drive(bag["/fix"], truth.duration, 0.5)
    climb = np.array([m.altitude for m in messages]) - PARAMETERS.gnss.altitude
    assert climb == pytest.approx(antennas[:, 2], abs=0.1)


def test_a_pair_of_antennas_measures_the_heading_in_the_horizontal_plane(
    bag: dict[str, Any], truth: Truth
) -> None:
    times, messages = of_drive(bag["/heading"], truth.duration, 0.5)
    yaw = np.array([2.0 * math.atan2(m.orientation.z, m.orientation.w) for m in messages])
    errors = yaw - truth.interpolate(times).yaw
    assert np.abs(np.remainder(errors + math.pi, 2.0 * math.pi) - math.pi).max() < 1e-3


def test_azimuth_of_an_oblique_pair_depends_on_roll() -> None:
    place = Placement(x=0.0, y=0.0, yaw=4.0, roll=0.3)
    assert place.azimuth(0.0) == pytest.approx(4.0)
    assert place.azimuth(0.5) == pytest.approx(4.0 + math.atan(math.tan(0.5) * math.cos(0.3)))
