# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sensors on a cab that swings: their measurements, and the motion of the undercarriage."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fixtures.drawn_machine import GNSS
from fixtures.filter_steps import config_of
from fixtures.records import assert_order_does_not_matter
from fixtures.swinging_cab import CAB, ENCODER, FIX, GYRO, Cab, Part, Recording, dig, record

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError
from trackslip_common.make import header
from trackslip_common.nodes.messages import make
from trackslip_common.units import GRAVITY
from trackslip_common.vehicle_files import vehicle_layer
from trackslip_estimation.slip.conversions import swing as swing_message
from trackslip_estimation.slip.conversions import swing_angle
from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, YawRate
from trackslip_estimation.slip.models.model import (
    GYRO_BIAS,
    SENSOR_ERRORS,
    UNDERCARRIAGE_SIZE,
    YAW,
)
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters

WITH, WITHOUT = {"vehicle": "pc05_cab"}, {"vehicle": "pc05_cab", "swing_sources": [""]}
TWO_ANTENNAS = {**GNSS, "sources.box_pose.yaw_offset_stddev": 0.02}
ANTENNA = {**WITH, "pose_sources": ["gnss_pose"]}


def of_cab(**changed: Any) -> SlipEstimatorParameters:
    return load_slip_parameters(WITH, {name.replace("__", "."): value for name, value in changed.items()})


def estimates(measurements: list[Measurement], p: SlipEstimatorParameters) -> list[Estimate]:
    return [e for _, e in SlipEstimator(p).process_all(measurements) if e is not None]


def errors(found: list[Estimate], truth: Recording) -> FloatArray:
    """(k, 8) time, errors of x, y, heading and swing, and 3 standard deviations of x, heading, swing."""
    rows = []
    times = np.array([e.stamp_ns * 1e-9 - 1.0 for e in found])
    expected_ = [np.interp(times, truth.t, column) for column in (*truth.poses.T, truth.swings[:, 0])]
    for e, t, *true in zip(found, times, *expected_, strict=True):
        assert e.outputs.swing is not None
        off = (*(e.pose - true[:3]), e.outputs.swing.angle - true[3])
        P = e.pose_covariance
        spread = 3.0 * np.sqrt((max(P[0, 0], P[1, 1]), P[2, 2], e.outputs.swing.covariance[0, 0]))
        rows.append(
            (t, *off[:2], math.remainder(off[2], math.tau), math.remainder(off[3], math.tau), *spread)
        )
    return np.array(rows)


def test_sensors_below_the_cab_give_the_same_bits() -> None:
    """Bit for bit the estimate of a machine without a cab; the two swing states are unused."""
    below = dict.fromkeys(
        (f"vehicle.sensors.mounts.{name}" for name in ("box", "antenna", "imu")), "undercarriage"
    )
    p, plain = load_slip_parameters(WITH, below), load_slip_parameters()
    assert (p.swings, p.swing_encoders(), p.initial_pose()[0][2]) == (False, {}, 0.0)
    assert config_of(WITH, below)[0]["size"] == SENSOR_ERRORS + 3  # offsets of a position and a heading
    assert config_of(WITH)[0]["size"] == SENSOR_ERRORS + 4  # and that of the encoder
    given = record(dig(), Cab(encoder=False)).measurements
    own, other = SlipEstimator(p), SlipEstimator(plain)
    for (_, a), (_, b) in zip(own.process_all(given), other.process_all(given), strict=True):
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            np.testing.assert_array_equal(a.pose, b.pose)
            np.testing.assert_array_equal(a.pose_covariance, b.pose_covariance)
            np.testing.assert_array_equal(a.outputs.slips, b.outputs.slips)
            assert a.outputs.swing is None
    last = own.window.best[own.window.count - 1]
    assert not last["mean"][UNDERCARRIAGE_SIZE:].any()
    assert not last["covariance"][UNDERCARRIAGE_SIZE:].any()


@pytest.mark.parametrize(("model", "filter_"), [("turning", "ekf"), ("icr", "daf")])
@pytest.mark.parametrize("encoder", [True, False])
def test_slewing_does_not_turn_the_undercarriage(model: str, filter_: str, encoder: bool) -> None:
    truth = record(dig(), Cab(encoder=encoder))
    p = load_slip_parameters(WITH if encoder else WITHOUT, {"model": model, "filter": filter_})
    found = errors(estimates(truth.measurements, p), truth)
    late = found[found[:, 0] > 6.0]
    assert np.sqrt(np.mean(late[:, 3] ** 2)) < (0.01 if encoder else 0.03)
    assert np.abs(late[:, 1:3]).max() < 0.06
    assert np.mean(np.abs(late[:, 3]) < late[:, 6]) > 0.97
    assert np.mean(np.abs(late[:, 4]) < late[:, 7]) > 0.97
    assert np.mean(np.abs(late[:, 1:3]).max(axis=1) < late[:, 5]) > 0.9


def test_fixes_on_the_cab_are_down_weighted_only_within_their_correlation_time() -> None:
    parts = [Part(2.0), Part(20.0, 2.0, 2.0)]
    far = record(parts, Cab(fix_hertz=1.0)).measurements
    close = record(parts, Cab(fix_hertz=20.0)).measurements
    assert _last_place(far, 0.1) == pytest.approx(_last_place(far, 0.0), rel=0.02)
    assert _last_place(close, 5.0) > 1.3 * _last_place(close, 0.0)


def _last_place(given: list[Measurement], repeat_time: float) -> float:
    """Standard deviation of the position at the end, m."""
    end = estimates(given, of_cab(swing__repeat_time=repeat_time))[-1]
    return math.sqrt(end.pose_covariance[0, 0])


@pytest.mark.parametrize("minutes", [6, pytest.param(60, marks=pytest.mark.slow)])
@pytest.mark.parametrize("encoder", [True, False])
def test_heading_error_of_slewing_at_standstill_is_within_its_covariance(minutes: int, encoder: bool) -> None:
    """The cab swings to and fro by nearly a turn; as the machine drives off, heading and swing converge."""
    swings = [Part(8.0, swing_to=target) for _ in range(2 * minutes) for target in (3.0, -3.0, 2.0, 0.0)]
    path = [Part(6.0, 2.0, 2.0), Part(6.0, 1.2, 2.2), Part(6.0, 2.0, 2.0)]
    truth = record([Part(2.0), *path[:1], Part(2.0), *swings, *path], Cab(encoder=encoder, fix_hertz=1.0))
    found = errors(estimates(truth.measurements, load_slip_parameters(WITH if encoder else WITHOUT)), truth)
    standing = found[(found[:, 0] > 10.0) & (found[:, 0] < 10.0 + 64.0 * minutes)]
    assert (np.abs(standing[:, 3]) < standing[:, 6]).all()
    assert standing[-1, 6] < 3.0 * (0.01 if encoder else 0.04)
    assert np.abs(found[-40:, 3]).max() < (0.01 if encoder else 0.02)
    assert np.abs(found[-40:, 4]).max() < (0.01 if encoder else 0.02)
    assert (np.abs(found[-40:, 3]) < found[-40:, 6]).all()


def test_gyro_bias_is_not_estimated_from_a_slew() -> None:
    """With a gyro alone, its rate at standstill may be a swing."""
    truth = record([Part(30.0), Part(30.0, swing_to=6.0)], Cab(encoder=False, bias=0.0))
    first = next(m for m in truth.measurements if isinstance(m, PoseFix))
    given = [m for m in truth.measurements if not isinstance(m, PoseFix) or m is first]
    own = SlipEstimator(load_slip_parameters(WITHOUT))
    own.process_all(given)
    last, prior = own.window.best[own.window.count - 1], own.config[0]["prior_variance"]
    assert last["covariance"][GYRO_BIAS, GYRO_BIAS] > 0.98 * prior[GYRO_BIAS]
    assert abs(last["mean"][GYRO_BIAS]) < 2e-4
    assert abs(last["mean"][YAW]) < 3.0 * math.sqrt(last["covariance"][YAW, YAW])
    below = {"vehicle.sensors.mounts.imu": "undercarriage", "vehicle.sensors.mounts.box": "undercarriage"}
    rest = SlipEstimator(load_slip_parameters(WITHOUT, below))
    rest.process_all([m for m in given if m.stamp_ns < 30 * 10**9])
    at_rest = rest.window.best[rest.window.count - 1]
    assert at_rest["covariance"][GYRO_BIAS, GYRO_BIAS] < 0.1 * prior[GYRO_BIAS]


@pytest.mark.parametrize("start", [-3.0, 2.0])
def test_heading_is_known_from_the_start_with_a_swung_cab(start: float) -> None:
    """With an encoder, from its first reading."""
    truth = record([Part(3.0), Part(6.0, 2.0, 2.0)], Cab(start=start))
    found = errors(estimates(truth.measurements, of_cab()), truth)
    assert np.abs(found[found[:, 0] > 0.2, 3]).max() < 0.06
    assert np.abs(found[found[:, 0] > 0.2, 1:3]).max() < 0.05
    assert (np.abs(found[:, 3]) < found[:, 6]).all()


def test_driving_off_makes_an_unmeasured_swing_observable() -> None:
    """The cab points 0.25 rad aside at the start, with all sensors on it."""
    parts = [Part(3.0), Part(8.0, 2.0, 2.0), Part(6.0, 1.2, 2.2), Part(8.0, 2.0, 2.0)]
    truth = record(parts, Cab(start=0.25, encoder=False))
    p = load_slip_parameters(WITHOUT, {"swing.initial_angle_stddev": 0.2})
    found = errors(estimates(truth.measurements, p), truth)
    assert (np.abs(found[:, 3]) < found[:, 6]).all()
    assert np.abs(found[-60:, 3]).max() < 0.03
    assert np.abs(found[-60:, 4]).max() < 0.03


def test_an_unknown_swing_is_estimated_from_the_path() -> None:
    parts = [Part(3.0), Part(10.0, 2.0, 2.0), Part(6.0, 1.2, 2.2), Part(8.0, 2.0, 2.0)]
    truth = record(parts, Cab(start=2.4, encoder=False))
    p = load_slip_parameters(WITHOUT, {"swing.initial_angle_stddev": 3.0})
    found = errors(estimates(truth.measurements, p), truth)
    assert np.abs(found[-60:, 3]).max() < 0.05
    assert np.abs(found[-60:, 4]).max() < 0.05
    assert np.abs(found[-60:, 1:3]).max() < 0.06


def test_swing_while_it_drives_is_measured_by_the_encoder() -> None:
    parts = [Part(2.0), Part(6.0, 2.0, 2.0), Part(6.0, 2.0, 2.0, 1.5), Part(6.0, 2.0, 2.0)]
    truth = record(parts, Cab())
    found = errors(estimates(truth.measurements, of_cab()), truth)
    assert np.abs(found[:, 4]).max() < 0.15
    assert np.abs(found[-60:, 3]).max() < 0.02


def test_frozen_fixes_do_not_stop_a_swing_at_standstill() -> None:
    """The cab has no encoder, and fixes may repeat at standstill."""
    recording = record(
        [*dig(), Part(4.0), Part(6.0, swing_to=1.5), Part(6.0, swing_to=0.0)], Cab(encoder=False)
    )
    measurements, frozen = list(recording.measurements), None
    for k, m in enumerate(measurements):
        if isinstance(m, PoseFix) and 16.0 <= m.stamp_ns * 1e-9 - 1.0 < 30.0:
            frozen = m.pose if frozen is None else frozen
            measurements[k] = replace(m, pose=frozen)
    found = errors(estimates(measurements, load_slip_parameters(WITHOUT, TWO_ANTENNAS)), recording)
    assert np.hypot(found[:, 1], found[:, 2]).max() < 0.05
    assert np.abs(found[:, 4]).max() < 0.15
    assert np.abs(found[:, 3]).max() < 0.1


def test_the_order_of_arrival_does_not_matter() -> None:
    assert_order_does_not_matter(of_cab(), record(dig(), Cab()).measurements)


def leaning(recording: Recording, roll: float, pitch: float) -> list[Measurement]:
    """The measurements with the accelerations of a slope."""
    below = GRAVITY * np.array(
        (-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch))
    )
    found: list[Measurement] = []
    for m in recording.measurements:
        if isinstance(m, YawRate):
            swing = np.interp(m.stamp_ns * 1e-9 - 1.0, recording.t, recording.swings[:, 0])
            cos, sin = math.cos(swing), math.sin(swing)
            x, y, z = below.tolist()
            m = replace(m, acceleration=(cos * x + sin * y, cos * y - sin * x, z))
        found.append(m)
    return found


def test_imu_on_the_cab_gives_the_tilt_of_the_undercarriage() -> None:
    truth = record([Part(5.0), Part(8.0, swing_to=2.5), Part(2.0)], Cab())
    for e in estimates(leaning(truth, 0.1, -0.15), of_cab())[40:]:
        assert e.outputs.tilt is not None
        np.testing.assert_allclose(e.outputs.tilt.tilt[:2], (0.1, -0.15), atol=0.01)
        np.testing.assert_allclose(e.outputs.tilt.force[:2], (1.4655, 0.968), atol=0.1)


def test_imu_on_the_cab_gives_no_tilt_while_the_swing_is_unknown() -> None:
    truth = record([Part(5.0)], Cab(encoder=False))
    own = SlipEstimator(load_slip_parameters(WITHOUT, {"swing.initial_angle_stddev": 2.0}))
    own.process_all(truth.measurements)
    assert own.estimate().outputs.tilt is None
    assert "imu/data_raw is on the upper structure, whose swing angle is unknown" in own.attitude


def test_mounts_of_sensors_are_those_of_the_vehicle() -> None:
    p = load_slip_parameters(ANTENNA, {"heading_sources": ["heading"]})
    assert {name: source.above for name, source in p.mountable_sources().items()} == {
        "gnss_pose": True,
        GYRO: True,
        "heading": True,
    }
    assert p.swing_encoders()[ENCODER].stddev == 0.002
    assert of_cab(sources__box_pose__mount="undercarriage").poses()[FIX].above is False
    assert (
        load_slip_parameters({"sources.box_pose.mount": "upper"}).swing_encoders() == {}
    )  # the file has no encoder
    other = {name: value for name, value in vehicle_layer(CAB).items() if "swing_encoder" not in name}
    assert load_slip_parameters(other).swing_encoders() == {}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"model": "free_slips"},
            "'free_slips' has no swing angle, and the upper structure carries box_pose, imu/data_raw",
        ),
        ({"sources.box_pose.mount": "roof"}, r"mount: 'roof'.*accepted: one of undercarriage, upper"),
        ({"swing.acceleration": 0.0}, "swing.acceleration: 0.0 is out of range"),
    ],
)
def test_inconsistent_swing_settings_are_refused_in_one_line(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_slip_parameters(WITH, changed)


def test_swing_messages_have_angle_rate_and_standard_deviations() -> None:
    end = estimates(record([Part(3.0), Part(4.0, swing_to=1.0)], Cab()).measurements, of_cab())[-1]
    message, swing = swing_message(make, end, "base_link"), end.outputs.swing
    assert swing is not None
    assert list(message.name) == ["swing", "swing_stddev"]
    assert list(message.position) == [swing.angle, math.sqrt(swing.covariance[0, 0])]
    assert list(message.velocity) == [swing.rate, math.sqrt(swing.covariance[1, 1])]
    assert swing_angle(message, ENCODER, 1e-4).angle == swing.angle
    nameless = make(
        "sensor_msgs/msg/JointState", header=header(make, 10**9, ""), name=["boom"], position=[1.0]
    )
    own = SlipEstimator(of_cab())
    report, _ = own.process(swing_angle(nameless, ENCODER, 1e-4))
    assert report.outcome is Outcome.INVALID
