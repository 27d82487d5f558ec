# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The slip estimator on slopes: motion along the ground, any order, high sensors, and level ground."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fixtures.imu_samples import imu_sample
from fixtures.pose_errors import THREE_SIGMA, position_nees
from fixtures.records import assert_order_does_not_matter

from trackslip_common.nodes.messages import make
from trackslip_common.units import GRAVITY
from trackslip_estimation.slip.conversions import fill_attitude, fill_odometry, odometry
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.local_odometry import LocalOdometry
from trackslip_estimation.slip.measurements import (
    HeadingFix,
    Measurement,
    Outcome,
    PoseFix,
    Sprockets,
    YawRate,
)
from trackslip_estimation.slip.models.model import DOWNHILL
from trackslip_estimation.slip.models.slope import inflate_downhill_slip
from trackslip_estimation.slip.mounting import quaternion_from_angles
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import STATE

MS, R = 1_000_000, 0.159
HEIGHT = 2.0  # m, of an antenna
GROUP = "sources.box_pose."
RECEIVER = {  # fixes of a receiver
    "sources__box_pose__fault_rate": 1 / 300,
    "sources__box_pose__jump_rate": 1 / 3000,
    "sources__box_pose__standing_share": 0.0,
}


def across(heading: float, slope: float) -> tuple[float, float]:
    """Roll and pitch of a machine on a plane that rises by ``slope`` to the north (y)."""
    n = np.array((0.0, -math.sin(slope), math.cos(slope)))
    c, s = math.cos(heading), math.sin(heading)
    ahead, left = n[0] * c + n[1] * s, n[1] * c - n[0] * s
    return math.atan2(-left, n[2]), math.atan2(ahead, math.hypot(left, n[2]))


def drive(heading: float, slope: float, seconds: float = 20.0, antenna: float = 0.0) -> list[Measurement]:
    """5 s of standstill, then straight on at 0.4 m/s without slip; 20 Hz, fixes once a second."""
    rng, found = np.random.default_rng(3), list[Measurement]()
    roll, pitch = across(heading, slope)
    lean = np.array((math.cos(roll) * math.sin(pitch), -math.sin(roll))) * antenna
    c, s = math.cos(heading), math.sin(heading)
    offset = np.array((c * lean[0] - s * lean[1], s * lean[0] + c * lean[1]))
    force = GRAVITY * np.array(
        (-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch))
    )
    for k in range(round(seconds * 20)):
        stamp_ns, distance = (k + 1) * 50 * MS, 0.4 * max(k * 0.05 - 5.0, 0.0)
        sample = imu_sample(stamp_ns, force, 0.0, rng)
        found += [Sprockets("sprockets", stamp_ns, 0.0, 0.0, (distance / R, distance / R)), sample]
        if k % 20 == 0:
            pose = np.array((*(distance * math.cos(pitch) * np.array((c, s)) + offset), heading))
            found.append(PoseFix("box_pose", stamp_ns, pose, np.diag((4e-4, 4e-4, 1e-4))))
    return found


def estimator(**changed: Any) -> SlipEstimator:
    return SlipEstimator(load_slip_parameters({k.replace("__", "."): v for k, v in changed.items()}))


def end_of(measurements: list[Measurement], **changed: Any) -> tuple[Any, list[Outcome]]:
    own = estimator(**changed)
    outcomes = [report.outcome for report, _ in own.process_all(measurements)]
    return own.estimate(), outcomes


@pytest.mark.parametrize("heading", [0.0, math.pi / 2.0, -math.pi / 2.0, 0.8])
def test_position_on_a_slope_is_horizontal_in_every_direction(heading: float) -> None:
    slope = math.radians(15.0)
    roll, pitch = across(heading, slope)
    end, outcomes = end_of(drive(heading, slope))
    distance = 0.4 * 14.95
    tilt = end.outputs.tilt
    np.testing.assert_allclose(tilt.tilt[:2], (roll, pitch), atol=math.radians(0.3))
    assert abs(tilt.tilt[2] - distance * math.sin(-pitch)) < 0.01 * distance
    expected = distance * math.cos(pitch) * np.array((math.cos(heading), math.sin(heading)))
    np.testing.assert_allclose(end.pose[:2], expected, atol=0.03)
    assert Outcome.GATED not in outcomes


@pytest.mark.parametrize("heading", [0.0, math.pi / 2.0, 2.0])
@pytest.mark.parametrize("slope", [0.0, 0.1])
def test_position_is_inside_its_covariance_on_a_slope_that_no_imu_measures(
    heading: float, slope: float
) -> None:
    """The slope displaces an antenna 3 m above the ground by 0.3 m."""
    end, outcomes = end_of(
        drive(heading, slope, antenna=3.0), use_attitude=False, sources__box_pose__lever_arm_z=3.0
    )
    distance = 0.4 * 14.95 * math.cos(across(heading, slope)[1])
    error = end.pose[:2] - distance * np.array((math.cos(heading), math.sin(heading)))
    P = end.pose_covariance[:2, :2]
    assert error @ np.linalg.solve(P, error) < 13.8
    assert np.linalg.eigvalsh(P).max() < 0.2**2
    assert Outcome.GATED not in outcomes


def test_the_order_of_arrival_does_not_matter() -> None:
    assert_order_does_not_matter(load_slip_parameters(), drive(0.8, math.radians(15.0)))


def test_slip_on_a_slope_does_not_add_height() -> None:
    """The height follows fixes, not the integral of the track speeds."""
    slope, slip = math.radians(15.0), 0.3
    measurements = drive(math.pi / 2.0, slope)
    for k, m in enumerate(measurements):
        if isinstance(m, Sprockets) and m.positions is not None:
            turned = m.positions[0] / (1.0 - slip)
            measurements[k] = replace(m, positions=(turned, turned))
    end, _ = end_of(measurements)
    climbed = 0.4 * 14.95 * math.sin(slope)
    tilt = end.outputs.tilt
    assert abs(tilt.tilt[2] - climbed) < 0.02
    assert abs(tilt.tilt[2] - climbed) < 3.0 * math.sqrt(tilt.covariance[2, 2])


def test_height_follows_a_slide_during_a_turn_on_the_spot() -> None:
    """The mean track speed is zero in such a turn."""
    slope, rate, down = math.radians(10.0), 0.2, 0.04  # rad, rad/s, m/s
    measurements = drive(0.0, slope)
    for k, m in enumerate(measurements):
        t = max(m.stamp_ns * 1e-9 - 5.05, 0.0)
        roll, pitch = across(rate * t, slope)
        if isinstance(m, Sprockets):
            measurements[k] = replace(m, positions=(-2.5 * rate * t / R, 2.5 * rate * t / R))
        elif isinstance(m, YawRate):
            force = GRAVITY * np.array(
                (-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch))
            )
            f_x, f_y, f_z = force.tolist()
            r = rate * math.cos(pitch) / math.cos(roll) if t > 0.0 else 0.0  # about the normal of the plane
            measurements[k] = replace(m, rate=r, tilt_rates=(0.0, 0.0), acceleration=(f_x, f_y, f_z))
        else:
            pose = np.array((0.0, -down * math.cos(slope) * t, rate * t))
            measurements[k] = replace(m, pose=pose)
    end, _ = end_of(measurements)
    slid = -down * 14.95 * math.sin(slope)
    assert abs(end.outputs.tilt.tilt[2] - slid) < 0.03  # 0.085 without the slide


def test_slip_variance_is_inflated_when_the_slope_reverses() -> None:
    """A machine that spins its tracks up 15° of clayey soil rolls down with another slip."""
    k = 2.3
    state = np.zeros(1, STATE)[0]
    level, speeds = state["attitude"]["level"], state["speeds"]
    state["mean"][DOWNHILL], level["known"] = k, 1
    deviations = []
    for down, turned in ((-0.26, 2.0), (-0.26, 2.0), (-0.26, 0.0), (0.26, 2.0)):
        state["covariance"][DOWNHILL, DOWNHILL] = 1e-4
        level["downhill_x"], speeds["left"], speeds["right"] = down, turned, turned
        inflate_downhill_slip(state)
        deviations.append(math.sqrt(state["covariance"][DOWNHILL, DOWNHILL]))
    assert deviations[1] == deviations[2] == 0.01
    assert deviations[3] > 0.9 * k


def test_an_antenna_leans_with_the_machine() -> None:
    slope = math.radians(15.0)
    measurements = drive(0.8, slope, antenna=HEIGHT)
    found, _ = end_of(measurements, **{f"{GROUP}lever_arm_z": HEIGHT})
    expected, _ = end_of(drive(0.8, slope))
    np.testing.assert_allclose(found.pose[:2], expected.pose[:2], atol=0.02)
    ignored, _ = end_of(measurements)
    assert np.hypot(*(ignored.pose - expected.pose)[:2]) > 0.3


def without_force(measurements: list[Measurement]) -> list[Measurement]:
    nothing = (math.nan, math.nan, math.nan)
    return [replace(m, acceleration=nothing) if isinstance(m, YawRate) else m for m in measurements]


def test_estimate_without_accelerations_is_that_of_flat_ground() -> None:
    """Without accelerations and with ``use_attitude: false`` the bits are equal."""
    measurements = drive(0.8, math.radians(10.0))
    flat, _ = end_of(without_force(measurements))
    off, _ = end_of(measurements, use_attitude=False)
    assert flat.outputs.tilt is None
    assert off.outputs.tilt is None
    np.testing.assert_array_equal(flat.pose, off.pose)
    np.testing.assert_array_equal(flat.pose_covariance, off.pose_covariance)
    np.testing.assert_array_equal(flat.outputs.twist, off.outputs.horizontal)


def test_first_enabled_imu_gives_the_tilt() -> None:
    both = {"yaw_rate_sources": ["one", "two"], "sources.one.use_acceleration": False}
    assert load_slip_parameters(both).tilt_source == "two"
    assert load_slip_parameters({**both, "sources.two.use_acceleration": False}).tilt_source is None
    assert load_slip_parameters({**both, "use_attitude": False}).tilt_source is None


def test_messages_carry_the_tilt() -> None:
    end, _ = end_of(drive(0.8, math.radians(15.0)))
    message = odometry(make, end, "map", "base_link")
    roll, pitch, height = end.outputs.tilt.tilt.tolist()
    turn = message.pose.pose.orientation
    assert (turn.x, turn.y, turn.z, turn.w) == quaternion_from_angles(roll, pitch, float(end.pose[2]))
    assert message.pose.pose.position.z == height
    assert message.pose.covariance[14] == end.outputs.tilt.covariance[2, 2]
    imu = make("sensor_msgs/msg/Imu")
    fill_attitude(imu, end, end.outputs.tilt)
    assert imu.orientation == turn
    assert imu.orientation_covariance[0] == end.outputs.tilt.covariance[0, 0]
    level = replace(end, outputs=replace(end.outputs, tilt=None))
    fill_odometry(message, level)
    assert (turn.x, turn.y, message.pose.pose.position.z) == (0.0, 0.0, 0.0)
    assert message.pose.covariance[14] == message.pose.covariance[21] == 1e6


def test_local_odometry_runs_along_the_ground_too() -> None:
    own, local, last = estimator(), LocalOdometry(), None
    for _, estimate in own.process_all(drive(0.0, 0.0)):
        last = local.estimate_in_odom(estimate) if estimate is not None else last
    assert last is not None
    own, local, tilted = estimator(), LocalOdometry(), None
    for _, estimate in own.process_all(drive(math.pi / 2.0, math.radians(15.0))):
        tilted = local.estimate_in_odom(estimate) if estimate is not None else tilted
    assert tilted is not None
    assert np.hypot(*tilted.pose[:2]) == pytest.approx(
        math.cos(math.radians(15.0)) * np.hypot(*last.pose[:2]), rel=0.01
    )


def slide(seconds: float = 25.0) -> list[Measurement]:
    """Across a slope of 15° a machine slides down at 1 m/s while its tracks run; positions, headings."""
    found = list[Measurement]()
    for m in drive(0.0, math.radians(15.0), seconds):
        if isinstance(m, Sprockets):
            t = m.stamp_ns * 1e-9
            down = min(5.05 - t, 0.0) * math.cos(math.radians(15.0))
            found.append(m)
            if round(t * 20) % 2 == 0:
                fix = np.array((0.0, down, 0.0)), np.diag((1e-4, 1e-4, 1e6))
                found.append(PoseFix("box_pose", m.stamp_ns, *fix))
                found.append(HeadingFix("heading", m.stamp_ns, 0.0, 1e-5))
        elif isinstance(m, YawRate):
            found.append(m)
    return found


def test_slide_keeps_the_heading_of_the_compass() -> None:
    """Fixes move sideways while the tracks run; the compass headings are accepted."""
    own = estimator(heading_sources=["heading"], sources__box_pose__use_heading=False)
    reports = [report for report, _ in own.process_all(slide())]
    rejected = [r for r in reports if r.source == "heading" and r.outcome is Outcome.GATED]
    assert len(rejected) <= 3
    assert abs(own.estimate().pose[2]) < 2.0 * 0.05  # rad, of a compass


SILENT, BACK = 10.0, 40.0  # s, of the IMU


def over_a_ramp() -> tuple[list[Measurement], dict[int, tuple[float, float]]]:
    """Straight on at 0.4 m/s, from level ground up a ramp of 15° at 12 s; truth: stamp → pitch and height.

    The IMU is silent from SILENT to BACK.
    """
    rng, found, truth = np.random.default_rng(4), list[Measurement](), dict[int, tuple[float, float]]()
    x = z = 0.0
    for k in range(50 * 20):
        t, stamp_ns = k * 0.05, (k + 1) * 50 * MS
        pitch = -math.radians(15.0) * min(max((t - 12.0) / 3.0, 0.0), 1.0)
        rate = -math.radians(15.0) / 3.0 if 12.0 <= t < 15.0 else 0.0
        truth[stamp_ns] = pitch, z
        found.append(Sprockets("sprockets", stamp_ns, 0.4 / R, 0.4 / R))
        if not SILENT <= t < BACK:
            force = GRAVITY * np.array((-math.sin(pitch), 0.0, math.cos(pitch)))
            found.append(imu_sample(stamp_ns, force, rate, rng))
        if k % 20 == 0:
            found.append(PoseFix("box_pose", stamp_ns, np.array((x, 0.0, 0.0)), np.diag((4e-4, 4e-4, 1e-4))))
        x, z = x + 0.4 * math.cos(pitch) * 0.05, z - 0.4 * math.sin(pitch) * 0.05
    return found, truth


def test_tilt_of_a_silent_imu_becomes_unknown_and_the_height_with_it_and_its_silence_is_named() -> None:
    own, (measurements, truth) = estimator(), over_a_ramp()
    has_tilt: list[float] = []  # s
    for m in measurements:
        _, e = own.process(m)
        if m.stamp_ns == 30 * 1000 * MS:
            status = own.attitude
        if e is None or e.outputs.tilt is None:
            continue
        pitch, z = truth[e.stamp_ns]
        tilt, P = e.outputs.tilt.tilt, e.outputs.tilt.covariance
        assert abs(tilt[1] - pitch) < 4.0 * math.sqrt(P[1, 1])
        assert abs(tilt[2] - z) < max(4.0 * math.sqrt(P[2, 2]), 0.02)
        has_tilt.append(e.stamp_ns * 1e-9)
    silence = [t for t in has_tilt if SILENT < t < BACK]
    assert SILENT + 2.0 < max(silence) < SILENT + 15.0
    assert math.sqrt(P[1, 1]) < math.radians(1.0)
    assert 0.3 < math.sqrt(P[2, 2]) < 4.0  # the machine has climbed 2.5 m
    assert status == "flat: imu/data_raw is silent"


@pytest.mark.parametrize("silence", [(0.0, 20.0), (10.0, 40.0)])
def test_position_is_inside_its_covariance_while_the_imu_of_a_high_antenna_is_silent(
    silence: tuple[float, float],
) -> None:
    """On a side slope of 15° the antenna is 0.5 m beside the machine."""
    begin, end = silence
    own, inside = estimator(sources__box_pose__lever_arm_z=HEIGHT), list[bool]()
    for m in drive(0.0, math.radians(15.0), 60.0, HEIGHT):
        t = m.stamp_ns * 1e-9
        if isinstance(m, YawRate) and begin <= t < end:
            continue
        e = own.process(m)[1]
        if e is not None:
            position = np.array((0.4 * max(t - 5.05, 0.0), 0.0))
            inside.append(position_nees(e, position) < THREE_SIGMA)
    assert np.mean(inside) > 0.97
    assert np.hypot(*(own.estimate().pose[:2] - position)) < 0.03


def slide_down(heading: float, bias: float = 0.0) -> tuple[list[Measurement], dict[int, float]]:
    """On a slope of 15° tracks spin at 0.6 m/s for 20 s, and stop; RTK five times a second; truth: stamp → y.

    ``bias``: of the accelerometer across the machine, m/s².
    """
    slope, rng = math.radians(15.0), np.random.default_rng(6)
    given, truth = list[Measurement](), dict[int, float]()
    roll, pitch = across(heading, slope)
    force = GRAVITY * np.array(
        (-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch))
    )
    force[1] += bias
    y = turned = speed = 0.0
    for k in range(40 * 20):
        t, stamp_ns = k * 0.05, (k + 1) * 50 * MS
        spins = 0.6 if 5.0 <= t < 25.0 else 0.0
        steady = 1.0 - 0.15 * math.sin(0.5 * (t - 5.0)) if spins else 0.0
        speed += min(max(steady - speed, -0.7 * 0.05), 0.5 * 0.05)  # within 2 s and 1.4 s
        y, turned, truth[stamp_ns] = y - speed * math.cos(slope) * 0.05, turned + spins * 0.05 / R, y
        sample = imu_sample(stamp_ns, force, 0.0, rng)
        given += [Sprockets("sprockets", stamp_ns, spins / R, spins / R, (turned, turned)), sample]
        if k % 4 == 0:
            pose = np.array((*rng.normal((0.0, y), 0.02), rng.normal(heading, 0.01)))
            given.append(PoseFix("box_pose", stamp_ns, pose, np.diag((4e-4, 4e-4, 1e-4))))
    return given, truth


def test_fixes_follow_a_slide_that_slows_down_and_stops_after_the_tracks() -> None:
    own, (given, truth) = estimator(**RECEIVER), slide_down(0.0)
    errors, nees = [], []
    for m in given:
        _, e = own.process(m)
        if e is not None:
            error = e.pose[:2] - (0.0, truth[e.stamp_ns])
            errors.append(math.hypot(*error))
            nees.append(position_nees(e, np.array((0.0, truth[e.stamp_ns]))))
    assert np.mean(nees) < 5.0
    assert max(errors) < 0.3


def test_error_of_the_tilt_does_not_turn_the_heading_of_a_machine_that_slides_back() -> None:
    """Up a slope tracks spin; the tilt is off by 0.3° across it, and the antennas are mounted with ± 1°."""
    own = estimator(**RECEIVER, sources__box_pose__yaw_offset_stddev=0.02)
    own.process_all(slide_down(math.pi / 2.0, bias=0.05)[0])
    e = own.estimate()
    error, stddev = abs(float(e.pose[2]) - math.pi / 2.0), math.sqrt(e.pose_covariance[2, 2])
    assert error < 3.0 * stddev
    assert error < 0.02
