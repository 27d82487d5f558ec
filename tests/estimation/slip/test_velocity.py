# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Velocities over ground: slip and heading from the course alone, outliers, radars, late arrivals."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from fixtures.fault_cases.robot_logs import is_present, read_log
from fixtures.records import assert_order_does_not_matter

from trackslip_common.arrays import FloatArray
from trackslip_common.make import header
from trackslip_common.message_fields import VelocityFields
from trackslip_common.message_reading import dtype_of
from trackslip_common.nodes.messages import make
from trackslip_estimation.slip.conversions import velocity_fix
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import (
    Measurement,
    Outcome,
    Sprockets,
    VelocityFix,
    YawRate,
)
from trackslip_estimation.slip.models.speed import COMMON_SLIP
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.records import to_records
from trackslip_estimation.slip.sources import Rejection
from trackslip_tools.replay.arrivals import reader_of

S = 1_000_000_000
SOURCE, STDDEV = "fix_velocity", 0.05  # m/s
LEVER = (1.1, -0.4)  # m
RATE = 20  # Hz, of sprockets and gyro
UNKNOWN = 1.8  # rad, standard deviation of an unknown heading


def with_velocities(**changed: object) -> SlipEstimatorParameters:
    """Parameters for tracks, gyro and velocities only, without position and heading."""
    values: dict[str, Any] = {
        "pose_sources": [""],
        "velocity_sources": [SOURCE],
        "start": "initial_pose",
        "initial_yaw_stddev": UNKNOWN,
        f"sources.{SOURCE}.lever_arm_x": LEVER[0],
        f"sources.{SOURCE}.lever_arm_y": LEVER[1],
    }
    return load_slip_parameters({**values, **changed})


@dataclass(frozen=True, eq=False)
class Drive:
    """Measurements of a drive, and its true headings."""

    measurements: list[Measurement]
    t: FloatArray  # (n,) s
    headings: FloatArray  # (n,) rad


def drive(
    heading: float = 2.3,
    slip: float = 0.1,
    speed: float = 3.0,
    duration: float = 30.0,
    hertz: int = 5,
    seed: int = 0,
    body: bool = False,
) -> Drive:
    """From standstill straight on and in gentle bends; ``speed`` of the sprockets, rad/s, < 0 backward.

    ``body``: velocities in axes of the machine, from a sensor that faces backward and measures one axis.
    """
    rng, p = np.random.default_rng(seed), load_slip_parameters()
    r, B = p.vehicle.kinematics.rolling_radius, p.vehicle.kinematics.tread
    t = np.arange(round(duration * RATE)) / RATE
    found: list[Measurement] = []
    headings = np.empty(t.size)
    for k, now in enumerate(t.tolist()):
        mean = speed * min(max(now - 1.0, 0.0), 1.0)
        bend = 0.0 if now < 6.0 else 0.15 * mean * math.sin(0.5 * (now - 6.0))
        left, right = mean - bend, mean + bend
        rate, v = 0.6 * r * (right - left) / B, (1.0 - slip) * r * mean
        headings[k] = heading
        stamp_ns = S + round(now * S)
        found.append(Sprockets("sprockets", stamp_ns, left, right))
        found.append(YawRate("imu/data_raw", stamp_ns, rate + 0.003 * rng.standard_normal(), 1e-5))
        if k % (RATE // hertz) == 0:
            u = np.array((v - rate * LEVER[1], rate * LEVER[0]))
            cos, sin = math.cos(heading), math.sin(heading)
            z = np.array((cos * u[0] - sin * u[1], sin * u[0] + cos * u[1])) if not body else -u
            R = np.diag((STDDEV**2, STDDEV**2 if not body else 1e6))
            found.append(VelocityFix(SOURCE, stamp_ns, z + STDDEV * rng.standard_normal(2), R))
        heading += rate / RATE
    return Drive(found, t, headings)


def run(measurements: list[Measurement], p: SlipEstimatorParameters) -> tuple[FloatArray, list[Any]]:
    """Rows (k, 5) after each velocity: stamp, s, heading and variance, i₀ and variance; their reports."""
    estimator, rows, reports = SlipEstimator(p), [], []
    for m in measurements:
        report, _ = estimator.process(m)
        if isinstance(m, VelocityFix):
            reports.append(report)
            if estimator.started:
                state = estimator.window.best[estimator.window.count - 1]
                P = state["covariance"]
                i0 = state["mean"][COMMON_SLIP], P[COMMON_SLIP, COMMON_SLIP]
                rows.append((m.stamp_ns / S - 1.0, state["mean"][2], P[2, 2], *i0))
    return np.array(rows), reports


def heading_errors(found: FloatArray, truth: Drive) -> FloatArray:
    """(k,) heading errors, rad."""
    return np.asarray(np.angle(np.exp(1j * (found[:, 1] - np.interp(found[:, 0], truth.t, truth.headings)))))


@pytest.mark.parametrize("heading", [-3.1, -1.2, 0.4, 2.0])
@pytest.mark.parametrize("speed", [3.0, -3.0])
def test_course_gives_an_unknown_heading_forward_and_backward(heading: float, speed: float) -> None:
    truth = drive(heading, speed=speed)
    found, reports = run(truth.measurements, with_velocities())
    errors, late = heading_errors(found, truth), found[:, 0] > 6.0
    assert np.abs(errors[late]).max() < 0.12
    assert np.mean(errors[late] ** 2 / found[late, 2]) < 6.0
    assert sum(r.outcome == Outcome.ACCEPTED for r in reports) > 0.95 * len(reports)


@pytest.mark.parametrize("slip", [-0.03, 0.0, 0.03])
def test_velocity_makes_the_slip_observable_without_positions(slip: float) -> None:
    """Slips of two prior standard deviations; velocities of 0.05 m/s five times a second."""
    truth = drive(slip=slip)
    found, _ = run(truth.measurements, with_velocities())
    late = found[:, 0] > 20.0
    assert np.abs(found[late, 3] - slip).max() < 0.03
    assert found[-1, 4] < 0.6 * found[0, 4]
    assert np.mean((found[late, 3] - slip) ** 2 / found[late, 4]) < 6.0


def test_unknown_heading_is_not_taken_for_a_slip() -> None:
    squares = []
    for seed in range(12):
        truth = drive(0.55 * seed, slip=0.0, seed=seed, duration=6.0)
        found, _ = run(truth.measurements, with_velocities())
        squares += list(found[found[:, 0] > 2.0, 3] ** 2 / found[found[:, 0] > 2.0, 4])
    assert np.mean(squares) < 2.5


def test_radar_facing_backward_makes_the_slip_observable() -> None:
    radar = {f"sources.{SOURCE}.axes": "body", f"sources.{SOURCE}.mounting_yaw": math.pi}
    truth = drive(slip=0.03, body=True)
    found, reports = run(truth.measurements, with_velocities(initial_yaw_stddev=0.02, **radar))
    late = found[:, 0] > 20.0
    assert np.abs(found[late, 3] - 0.03).max() < 0.03
    assert found[-1, 4] < 0.6 * found[0, 4]
    assert {r.dof for r in reports if r.outcome == Outcome.ACCEPTED} == {1}


def test_single_wrong_velocity_is_gated() -> None:
    truth = drive()
    places = [k for k, m in enumerate(truth.measurements) if isinstance(m, VelocityFix)]
    spoilt = list(truth.measurements)
    m = spoilt[places[100]]
    assert isinstance(m, VelocityFix)
    spoilt[places[100]] = VelocityFix(SOURCE, m.stamp_ns, m.velocity + 3.0, m.covariance)
    clean, _ = run(truth.measurements, with_velocities())
    found, reports = run(spoilt, with_velocities())
    assert reports[100].outcome == Outcome.GATED
    assert np.abs(found[-1, [1, 3]] - clean[-1, [1, 3]]).max() < 0.01


def test_order_of_arrival_does_not_matter() -> None:
    p = with_velocities(history_window=2.0)
    assert_order_does_not_matter(p, drive(duration=12.0).measurements, latest=1.5)


def message(velocity: tuple[float, float], variances: tuple[float, float], stamp_ns: int = 5 * S) -> Any:
    covariance = np.zeros((6, 6))
    covariance[0, 0], covariance[1, 1] = variances
    linear = make("geometry_msgs/msg/Vector3", x=velocity[0], y=velocity[1], z=0.3)
    twist = make("geometry_msgs/msg/Twist", linear=linear)
    return make(
        "geometry_msgs/msg/TwistWithCovarianceStamped",
        header=header(make, stamp_ns, "gnss"),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance.ravel()),
    )


def test_message_becomes_a_velocity_at_the_instant_of_its_measurement() -> None:
    stated = with_velocities(**{f"sources.{SOURCE}.latency": 0.1}).velocities()[SOURCE]
    found = velocity_fix(message((1.0, -2.0), (0.0, 0.09)), SOURCE, stated)
    assert isinstance(found, VelocityFix)
    assert found.stamp_ns == 5 * S - S // 10
    np.testing.assert_array_equal(found.velocity, (1.0, -2.0))
    np.testing.assert_allclose(found.covariance, np.diag((stated.stddev**2, 0.09)))
    assert velocity_fix(message((0.0, 0.0), (-1.0, 0.0)), SOURCE, stated) is Rejection.NO_VELOCITY


def test_table_of_a_bag_has_the_bits_of_live_conversions() -> None:
    stated = with_velocities(**{f"sources.{SOURCE}.latency": 0.05}).velocities()[SOURCE]
    rng = np.random.default_rng(4)
    read, measurements = np.zeros(20, dtype_of(VelocityFields)), []
    for k in range(20):
        velocity, variances = rng.normal(size=2), rng.choice((0.0, 0.01, 0.3), 2)
        one = velocity_fix(message(tuple(velocity), tuple(variances), 5 * S + k), SOURCE, stated)
        assert isinstance(one, VelocityFix)
        measurements.append(one)
        read[k]["stamp_ns"], read[k]["v_x"], read[k]["v_y"] = 5 * S + k, *velocity
        read[k]["covariance"] = np.diag(variances)
    rows, expected = reader_of(stated).rows(read), to_records(measurements, {SOURCE: 0})
    for name in ("kind", "stamp_ns", "value", "noise"):
        assert rows[name].tobytes() == expected[name].tobytes(), name


def _mower() -> tuple[Drive, FloatArray, dict[str, object]]:
    """Tracks, gyro and a 1 Hz Doppler velocity made from the mower's log; distance, m; vehicle parameters."""
    log, rng = read_log("mower"), np.random.default_rng(1)
    speeds = [(m.left_speed + m.right_speed) / 2.0 for m in log.odometry if isinstance(m, Sprockets)]
    stamps = [m.stamp_ns for m in log.odometry if isinstance(m, Sprockets)]
    v = 0.2 * np.array(speeds)
    t = np.array(stamps) / S
    found, headings = (
        list(log.odometry),
        np.interp(t, log.truth.t + t[0] - log.truth.t[0], log.truth.poses[:, 2]),
    )
    for second in np.arange(math.ceil(t[0]), math.floor(t[-1])):
        k = int(np.searchsorted(t, second))
        z = v[k] * np.array((math.cos(headings[k]), math.sin(headings[k]))) + STDDEV * rng.standard_normal(2)
        found.append(VelocityFix(SOURCE, stamps[k] + 2000, z, STDDEV**2 * np.eye(2)))
    found.sort(key=lambda m: m.stamp_ns)
    distance = np.concatenate(([0.0], np.cumsum(np.abs(v[1:]) * np.diff(t))))
    return Drive(found, t - 1.0, headings), distance, log.vehicle


@pytest.mark.skipif(not is_present("mower"), reason="the log is not in the shared folder")
def test_mower_finds_heading_and_slip_from_course_alone() -> None:
    truth, distance, vehicle = _mower()
    lever = {f"sources.{SOURCE}.lever_arm_{axis}": 0.0 for axis in "xy"}
    found, _ = run(truth.measurements, with_velocities(**vehicle, **lever))
    moving = float(truth.t[np.searchsorted(distance, 0.05)])
    assert abs(found[found[:, 0] > moving + 2.0][0, 3]) < 0.01  # i₀: tracks and Doppler have the same speed
    after = np.interp(found[:, 0], truth.t, distance) > 10.0
    errors = heading_errors(found, truth)[after]
    assert abs(errors[0]) < 0.05
    assert np.quantile(np.abs(errors), 0.95) < 0.05
    assert np.mean(errors**2 / found[after, 2]) < 4.0
