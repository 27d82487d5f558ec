# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Orientations of IMUs: roll and pitch updates through the mounting, gated, and rejected by reason."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.made_bags import write_changed
from fixtures.records import assert_order_does_not_matter
from fixtures.swinging_cab import CAB, Cab, Part, record
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from trackslip_bags.reader import open_bag
from trackslip_common.arrays import FloatArray
from trackslip_common.make import header
from trackslip_common.nodes.messages import make
from trackslip_common.units import GRAVITY
from trackslip_common.vehicle_files import vehicle_layer
from trackslip_estimation.attitude.records import AttitudeRejection
from trackslip_estimation.slip.conversions import yaw_rate
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, PoseFix, Report, Sprockets, YawRate
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.sources import YawRateSource
from trackslip_tools.cli.main import main

MS, R, IMU = 1_000_000, 0.159, "imu/data_raw"
GROUP = "sources.imu_data_raw."
REQUESTED = {f"{GROUP}use_orientation": True}
ROLL, PITCH = -0.12, -0.2  # rad, of the slope
BIAS = 0.15  # m/s² of both horizontal accelerometers: 0.9°, three times the assumed bias
STDDEV = 0.003  # rad, noise of the orientation
ABSENT, ZERO = np.array((-1.0, *(0.0,) * 8)), np.zeros(9)
ANGLES = st.floats(-math.pi, math.pi)


def message(
    turn: Any, covariance: FloatArray, force: Any = (0.0, 0.0, GRAVITY), stamp_ns: int = MS, size: float = 1.0
) -> Any:
    """A sensor_msgs/Imu with orientation ``turn``, a scipy Rotation, and a quaternion of length ``size``."""
    x, y, z, w = (size * turn.as_quat()).tolist()
    quaternion = make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
    forces = dict(zip("xyz", (float(f) for f in force), strict=True))
    return make(
        "sensor_msgs/msg/Imu",
        header=header(make, stamp_ns, "imu_link"),
        orientation=quaternion,
        orientation_covariance=covariance,
        angular_velocity_covariance=np.diag((9e-6, 9e-6, 9e-6)).ravel(),
        linear_acceleration=make("geometry_msgs/msg/Vector3", **forces),
        linear_acceleration_covariance=np.diag((2.5e-3, 2.5e-3, 2.5e-3)).ravel(),
    )


def machine(roll: float = ROLL, pitch: float = PITCH, yaw: float = 0.4) -> Any:
    return Rotation.from_euler("ZYX", (yaw, pitch, roll))


def imu_of(**changed: Any) -> YawRateSource:
    p = load_slip_parameters({**REQUESTED, **{GROUP + name: value for name, value in changed.items()}})
    return p.gyros()[IMU]


def drive(state: Any = None, seconds: float = 20.0) -> list[Measurement]:
    """5 s of standstill on the slope, then 0.4 m/s; 20 Hz, fixes once a second.

    ``state`` maps seconds to the covariance that the IMU states and the length of its quaternion.
    """
    rng, found, imu = np.random.default_rng(3), list[Measurement](), imu_of()
    force = machine().inv().apply((0.0, 0.0, GRAVITY)) + np.array((BIAS, BIAS, 0.0))
    own = np.diag((STDDEV**2,) * 3).ravel(), 1.0
    for k in range(round(seconds * 20)):
        stamp_ns, distance = (k + 1) * 50 * MS, 0.4 * max(k * 0.05 - 5.0, 0.0)
        found.append(Sprockets("sprockets", stamp_ns, 0.0, 0.0, (distance / R, distance / R)))
        shown = machine() * Rotation.from_rotvec(rng.normal(0.0, STDDEV, 3))
        covariance, size = own if state is None else state(k * 0.05)
        acceleration = force + rng.normal(0.0, 0.05, 3)
        measured = yaw_rate(message(shown, covariance, acceleration, stamp_ns, size), IMU, imu)
        assert isinstance(measured, YawRate)
        found.append(measured)
        if k % 20 == 0:
            along = distance * math.cos(PITCH)
            pose = np.array((along * math.cos(0.4), along * math.sin(0.4), 0.4))
            found.append(PoseFix("box_pose", stamp_ns, pose, np.diag((4e-4, 4e-4, 1e-4))))
    return found


def run(measurements: list[Measurement], **changed: Any) -> tuple[Any, SlipEstimator, list[Report]]:
    own = SlipEstimator(load_slip_parameters(changed))
    reports = [report for report, _ in own.process_all(measurements)]
    return own.estimate(), own, reports


def off(estimate: Any) -> float:
    """Norm of the errors of roll and pitch, degrees."""
    return math.degrees(float(np.hypot(*(estimate.outputs.tilt.tilt[:2] - (ROLL, PITCH)))))


def rejections(reports: list[Report]) -> list[AttitudeRejection]:
    return [report.attitude for report in reports if report.attitude is not None]


def test_orientation_corrects_the_tilt_beside_biased_accelerometers() -> None:
    measurements = drive()
    with_it, _, reports = run(measurements, **REQUESTED)
    without, _, _ = run(measurements)
    assert rejections(reports) == []
    assert off(with_it) < 0.4
    assert off(without) > 1.0
    errors = with_it.outputs.tilt.tilt[:2] - (ROLL, PITCH)
    assert errors @ np.linalg.solve(with_it.outputs.tilt.covariance[:2, :2], errors) < 9.2  # χ² of two, 99 %


def test_orientation_alone_gives_the_attitude() -> None:
    alone, own, _ = run(drive(), **REQUESTED, **{f"{GROUP}use_acceleration": False})
    assert off(alone) < 0.3
    assert "roll -6." in own.attitude


def test_time_correlated_orientation_errors_do_not_average_out() -> None:
    """More samples in the same time add no information."""
    brief, _, _ = run(drive(seconds=3.0), **REQUESTED)
    assert brief.outputs.tilt.covariance[1, 1] > 0.5 * STDDEV**2


@pytest.mark.parametrize(
    ("covariance", "size", "rejection"),
    [
        (ABSENT, 1.0, AttitudeRejection.NO_ORIENTATION),
        (ZERO, 1.0, AttitudeRejection.NO_COVARIANCE),
        (np.full(9, math.nan), 1.0, AttitudeRejection.NO_COVARIANCE),
        (np.eye(3).ravel() * 1e-5, 0.0, AttitudeRejection.NO_ROTATION),
        (np.eye(3).ravel() * 1e-5, math.nan, AttitudeRejection.NO_ROTATION),
    ],
)
def test_malformed_orientation_is_refused_by_name(
    covariance: FloatArray, size: float, rejection: AttitudeRejection
) -> None:
    """The rest of the message is used as if no orientation were requested, bit for bit."""
    measurements = drive(lambda _: (covariance, size), seconds=8.0)
    found, own, reports = run(measurements, **REQUESTED)
    expected, _, plain = run(measurements)
    imus = [report for report in reports if report.source == IMU and not report.outcome.is_rejected]
    assert len(imus) > 100
    assert {report.attitude for report in imus[1:]} == {rejection}
    assert rejections(plain) == []
    np.testing.assert_array_equal(found.pose, expected.pose)
    np.testing.assert_array_equal(found.outputs.tilt.tilt, expected.outputs.tilt.tilt)
    assert f"is rejected: {rejection.name.lower().replace('_', ' ')}" in own.attitude


def test_orientation_that_contradicts_gyro_and_gravity_is_gated() -> None:
    """The mounting angle is wrong by 0.4 rad from the tenth second on."""
    measurements = drive(seconds=20.0)
    for k, m in enumerate(measurements):
        if isinstance(m, YawRate) and m.stamp_ns > 10_000 * MS:
            up = Rotation.from_rotvec((0.0, 0.4, 0.0)).apply(m.up)
            measurements[k] = YawRate(**{**vars(m), "up": tuple(up.tolist())})
    found, own, reports = run(measurements, **REQUESTED)
    gated = [r for r in reports if r.attitude is AttitudeRejection.ORIENTATION_GATED]
    assert {r.stamp_ns > 10_000 * MS for r in gated} == {True}
    assert len(gated) == 200
    assert off(found) < 1.0
    assert "orientation gated" in own.attitude


def test_the_order_of_arrival_does_not_matter() -> None:
    assert_order_does_not_matter(load_slip_parameters(REQUESTED), drive(seconds=8.0))


@pytest.mark.slow
@given(ANGLES, st.floats(-1.5, 1.5), ANGLES)
def test_mounting_rotation_is_removed(roll: float, pitch: float, yaw: float) -> None:
    mounting = Rotation.from_euler("ZYX", (yaw, pitch, roll))
    imu = imu_of(mounting_roll=roll, mounting_pitch=pitch, mounting_yaw=yaw)
    own = np.diag(mounting.as_matrix().T @ np.diag((1e-6, 4e-6, 9e-6)) @ mounting.as_matrix())
    found = yaw_rate(message(machine() * mounting, np.diag(own).ravel()), IMU, imu)
    assert isinstance(found, YawRate)
    np.testing.assert_allclose(found.up, machine().inv().apply((0.0, 0.0, 1.0)), atol=1e-9)
    expected = np.diag(mounting.as_matrix() @ np.diag(own) @ mounting.as_matrix().T)
    np.testing.assert_allclose(found.up_variances, expected[:2], atol=1e-12)


def test_orientation_of_a_swung_cab_is_rotated_to_the_undercarriage() -> None:
    """The swing angle of the encoder is 1.2 rad; the ground has the slope of ``drive``."""
    recording = record([Part(3.0), Part(4.0, swing_to=1.2), Part(4.0)], Cab())
    on_cab = Rotation.from_matrix(machine().as_matrix())
    measurements: list[Measurement] = []
    for m in recording.measurements:
        if isinstance(m, YawRate):
            swing = np.interp(m.stamp_ns * 1e-9 - 1.0, recording.t, recording.swings[:, 0])
            unit = on_cab * Rotation.from_rotvec((0.0, 0.0, float(swing)))
            up, lean = unit.inv().apply((0.0, 0.0, 1.0)), (STDDEV**2, STDDEV**2)
            m = YawRate(**{**vars(m), "up": tuple(up.tolist()), "up_variances": lean})
        measurements.append(m)
    given_ = {**REQUESTED, f"{GROUP}use_acceleration": False, **vehicle_layer(CAB)}
    found, _, reports = run(measurements, **given_)
    assert rejections(reports) == [AttitudeRejection.SWING_UNKNOWN]  # before the first encoder reading
    assert found.outputs.swing.angle == pytest.approx(1.2, abs=0.02)
    assert off(found) < 0.3


def test_orientation_is_off_by_default() -> None:
    assert not load_slip_parameters().gyros()[IMU].use_orientation
    found = yaw_rate(message(machine(), np.eye(3).ravel()), IMU, load_slip_parameters().gyros()[IMU])
    assert isinstance(found, YawRate)
    assert np.isnan((*found.up, *found.up_variances)).all()


def test_imu_with_orientation_is_preferred_to_one_with_accelerations() -> None:
    both = {"yaw_rate_sources": ["one", "two"], "sources.two.use_orientation": True}
    assert load_slip_parameters(both).tilt_source == "two"
    assert load_slip_parameters({**both, "sources.one.use_orientation": True}).tilt_source == "one"


def test_replay_counts_refused_orientations(emulated_bag: Path, tmp_path: Path) -> None:
    def with_covariance(number: int, imu: Any) -> Any:
        imu.orientation_covariance = (ABSENT, ZERO, np.eye(3).ravel() * 1e-4)[number % 3]
        return imu

    with open_bag(write_changed(tmp_path / "bag", emulated_bag, f"/{IMU}", with_covariance)) as bag:
        count = bag.topics[f"/{IMU}"].count
    command = ["replay", str(tmp_path / "bag"), "--json", str(tmp_path / "found.json")]
    assert main([*command, "--set", f"slip_estimator.{GROUP}use_orientation=true"]) == 0
    counted = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))["rejected"][IMU]
    waited = counted.get("waiting", 0)
    assert counted["no_orientation"] == pytest.approx((count - waited) / 3, abs=1)
    assert counted["no_covariance"] == pytest.approx((count - waited) / 3, abs=1)
