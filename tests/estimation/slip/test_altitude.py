# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Altitudes of fixes: they correct the height through the lever arm; invalid ones are rejected by reason."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trackslip_bags.messages import make
from trackslip_common.units import GRAVITY
from trackslip_estimation.attitude.records import HEIGHT, AttitudeRejection
from trackslip_estimation.slip.conversions import Frames, pose_fix, pose_with_covariance
from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.local_odometry import LocalOdometry
from trackslip_estimation.slip.measurements import (
    UNOBSERVED,
    Measurement,
    Outcome,
    PoseFix,
    Report,
    Sprockets,
    YawRate,
)
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.transforms import blank_transforms, fill_transforms

S, R, FIX = 1_000_000_000, 0.159, "box_pose"
ROLL, PITCH = -0.05, -0.15  # rad: uphill
BIAS = 0.1  # m/s² of the accelerometer along x: 0.6°, which are 0.4 m of height over 40 m
BEGIN = 12.0  # m, height of C at the start
STDDEV = 0.02  # m, of altitudes
ANTENNA = (1.2, -0.4, 2.5)
REQUESTED: dict[str, Any] = {
    "sources.box_pose.use_altitude": True,
    **{f"sources.box_pose.lever_arm_{axis}": at for axis, at in zip("xyz", ANTENNA, strict=True)},
}
RECEIVER = "gnss_pose"
StatedAltitude = Callable[[float, float], tuple[float, float]]


def as_measured(_: float, altitude: float) -> tuple[float, float]:
    return altitude, STDDEV**2


def drive(
    stated: StatedAltitude = as_measured, seconds: float = 100.0, tilt: tuple[float, float] = (ROLL, PITCH)
) -> list[Measurement]:
    """5 s of standstill on the slope, then uphill at 0.4 m/s; fixes at 2 Hz.

    ``stated`` maps seconds and the true altitude of the antenna to the altitude of the fix and its
    variance.
    """
    rng, measurements = np.random.default_rng(5), list[Measurement]()
    turn = Rotation.from_euler("ZYX", (0.4, tilt[1], tilt[0]))
    force = turn.inv().apply((0.0, 0.0, GRAVITY)) + np.array((BIAS, 0.0, 0.0))
    for k in range(round(seconds * 20)):
        stamp_ns, distance = (k + 1) * S // 20, 0.4 * max(k * 0.05 - 5.0, 0.0)
        measurements.append(Sprockets("sprockets", stamp_ns, 0.0, 0.0, (distance / R, distance / R)))
        acceleration = tuple((force + rng.normal(0.0, 0.05, 3)).tolist())
        rates = rng.normal(0.0, 0.003, 3).tolist()
        imu = YawRate(
            "imu/data_raw", stamp_ns, rates[2], 9e-6, (rates[0], rates[1]), (9e-6, 9e-6), acceleration, 2.5e-3
        )
        measurements.append(imu)
        if k % 10 == 0:
            place = turn.apply((distance, 0.0, 0.0)) + turn.apply(ANTENNA) + (0.0, 0.0, BEGIN)
            x, y, z = (place + rng.normal(0.0, (0.01, 0.01, STDDEV))).tolist()
            altitude, variance = stated(k * 0.05, z)
            pose = np.array((x, y, 0.4))
            measurements.append(PoseFix(FIX, stamp_ns, pose, np.diag((1e-4, 1e-4, 1e-4)), altitude, variance))
    return measurements


def with_time_correlated_errors(rate: int, seed: int) -> list[Measurement]:
    """A drive on level ground with fixes of a receiver; half of their variance is correlated over 10 s."""
    rng, measurements, error = np.random.default_rng(seed), list[Measurement](), np.zeros(3)
    decay, stddevs = math.exp(-0.1 / rate), np.array((0.01, 0.01, STDDEV))
    turn = Rotation.from_euler("ZYX", (0.4, 0.0, 0.0))
    for k, m in enumerate(m for m in drive(tilt=(0.0, 0.0)) if not isinstance(m, PoseFix)):
        measurements.append(m)
        if k % (40 // rate) == 1:  # sprockets and IMU have 20 Hz
            distance = 0.4 * max(m.stamp_ns / S - 5.05, 0.0)
            error = decay * error + rng.normal(0.0, math.sqrt(0.5 * (1.0 - decay**2)), 3) * stddevs
            white = rng.normal(0.0, math.sqrt(0.5), 3) * stddevs
            place = turn.apply((distance, 0.0, 0.0)) + turn.apply(ANTENNA) + (0.0, 0.0, BEGIN) + error + white
            pose, R = np.array((*place[:2], 0.4)), np.diag((1e-4, 1e-4, 1e-4))
            measurements.append(PoseFix(RECEIVER, m.stamp_ns, pose, R, float(place[2]), STDDEV**2))
    return measurements


def run(
    measurements: list[Measurement], source: str = FIX, **changed: Any
) -> tuple[list[Estimate], list[Report]]:
    requested = {key.replace(FIX, source): value for key, value in REQUESTED.items()}
    p = load_slip_parameters({"pose_sources": (source,), **requested, **changed})
    steps = SlipEstimator(p).process_all(measurements)
    return [estimate for _, estimate in steps if estimate is not None], [report for report, _ in steps]


def height(estimate: Estimate) -> tuple[float, float]:
    """Height, m, and its standard deviation."""
    tilt = estimate.outputs.tilt
    assert tilt is not None
    return float(tilt.tilt[HEIGHT]), math.sqrt(tilt.covariance[HEIGHT, HEIGHT])


def true_height(estimate: Estimate) -> float:
    return BEGIN + 0.4 * max(estimate.stamp_ns / S - 5.05, 0.0) * math.sin(-PITCH)


def rejections(reports: list[Report]) -> list[AttitudeRejection]:
    return [report.attitude for report in reports if report.attitude is not None]


def test_height_follows_the_receiver() -> None:
    estimates, reports = run(drive())
    tilted = [e for e in estimates if e.stamp_ns > S]
    errors = np.array([height(e)[0] - true_height(e) for e in tilted])
    stddevs = np.array([height(e)[1] for e in tilted])
    assert np.sqrt(np.mean(errors**2)) < 0.015
    assert np.mean((errors / stddevs) ** 2) < 2.0
    assert rejections(reports) == []
    without, _ = run(drive(), **{"sources.box_pose.use_altitude": False})
    assert height(without[-1])[0] - (true_height(without[-1]) - BEGIN) == pytest.approx(0.3, abs=0.15)


def test_first_altitude_during_a_climb_sets_the_height() -> None:
    """The variance of the height must stay finite while there is no altitude."""
    late = drive(lambda t, z: (z, STDDEV**2) if t > 20.0 else (0.0, UNOBSERVED), seconds=60.0)
    estimates, reports = run(late)
    found = [(*height(e), true_height(e)) for e in estimates if e.stamp_ns > 20.6 * S]
    assert rejections(reports) == []
    assert max(stddev for _, stddev, _ in found) < 0.05
    assert max(abs(at - truth) / stddev for at, stddev, truth in found) < 4.0


def test_fixes_of_a_high_antenna_on_a_slope_are_accepted_from_the_start() -> None:
    """The first fix arrives before the tilt is known."""
    _, reports = run(drive(seconds=6.0))
    assert {report.outcome for report in reports if report.source == FIX} == {Outcome.ACCEPTED}


def test_altitudes_halve_the_pitch_error() -> None:
    def off(estimates: list[Estimate]) -> float:
        tilt = estimates[-1].outputs.tilt
        assert tilt is not None
        return abs(float(tilt.tilt[1]) - PITCH)

    assert off(run(drive())[0]) < 0.5 * off(run(drive(), **{"sources.box_pose.use_altitude": False})[0])


@pytest.mark.parametrize(("rate", "seed"), [(1, 1), (1, 2), (10, 3)])  # Hz
def test_time_correlated_altitude_errors_keep_the_pitch_consistent(rate: int, seed: int) -> None:
    """Altitudes with a common error must not make the pitch overconfident, at any rate of fixes."""
    estimates, _ = run(with_time_correlated_errors(rate, seed), RECEIVER)
    nees = []
    for e in estimates:
        tilt = e.outputs.tilt
        if tilt is not None and e.stamp_ns > 10 * S:
            nees.append(float(tilt.tilt[1]) ** 2 / float(tilt.covariance[1, 1]))
    assert np.mean(nees) < 2.0


def test_one_wrong_altitude_moves_nothing() -> None:
    def wrong(t: float, altitude: float) -> tuple[float, float]:
        return (altitude + 5.0 if t == 50.0 else altitude), STDDEV**2

    def missing(t: float, altitude: float) -> tuple[float, float]:
        return (math.nan, UNOBSERVED) if t == 50.0 else (altitude, STDDEV**2)

    of_wrong, reports = run(drive(wrong))
    of_missing, _ = run(drive(missing))
    assert rejections(reports) == [AttitudeRejection.ALTITUDE_GATED]
    for one, other in zip(of_wrong, of_missing, strict=True):
        np.testing.assert_array_equal(one.pose, other.pose)
        if other.outputs.tilt is not None:
            assert height(one) == height(other)


@pytest.mark.parametrize("step", [-2.0, 0.6])
def test_persistent_altitudes_are_accepted(step: float) -> None:
    """After the base station is moved, altitudes are rejected for three timeouts and accepted then."""
    estimates, reports = run(drive(lambda t, z: (z + step if t >= 50.0 else z, STDDEV**2)))
    assert len(rejections(reports)) == 6
    assert set(rejections(reports)) == {AttitudeRejection.ALTITUDE_GATED}
    after = [e for e in estimates if e.stamp_ns > 54 * S]
    assert max(abs(height(e)[0] - true_height(e) - step) for e in after) < 0.1


def test_altitudes_that_do_not_agree_are_never_accepted() -> None:
    sign = {False: -1.0, True: 1.0}
    wild, reports = run(
        drive(lambda t, z: (z + sign[round(2 * t) % 2 == 0] * 3.0, STDDEV**2) if t > 50.0 else (z, STDDEV**2))
    )
    assert len(rejections(reports)) > 80
    assert abs(height(wild[-1])[0] - true_height(wild[-1])) < 0.5


@pytest.mark.parametrize("variance", [0.0, -1.0, math.nan])
def test_altitudes_without_a_variance_are_counted(variance: float) -> None:
    estimates, reports = run(drive(lambda _, z: (z, variance), seconds=10.0))
    assert set(rejections(reports)) == {AttitudeRejection.NO_ALTITUDE}
    assert height(estimates[-1])[1] > 100.0


def test_an_unknown_height_is_reported_as_unknown() -> None:
    own = SlipEstimator(load_slip_parameters(REQUESTED))
    own.process_all(drive(lambda *_: (0.0, UNOBSERVED), seconds=10.0))
    assert "height unknown until a fix has an altitude" in own.attitude
    own = SlipEstimator(load_slip_parameters(REQUESTED))
    own.process_all(drive(seconds=10.0))
    assert "height 12." in own.attitude


def test_flat_pose_has_no_altitude() -> None:
    """z is 0 and has the variance of an unobserved state."""
    fix = PoseFix(FIX, S, np.zeros(3), np.eye(3))
    message = pose_with_covariance(make, fix, "map")
    found = pose_fix(message, FIX)
    assert (found.altitude, found.altitude_variance) == (0.0, UNOBSERVED)
    known = pose_fix(
        pose_with_covariance(make, replace(fix, altitude=3.0, altitude_variance=4.0), "map"), FIX
    )
    assert (known.altitude, known.altitude_variance) == (3.0, 4.0)
    estimates, reports = run(drive(lambda *_: (0.0, UNOBSERVED), seconds=10.0))
    assert rejections(reports) == []
    assert height(estimates[-1])[1] > 100.0


def test_the_first_altitude_does_not_move_odom() -> None:
    """z of odom → base_link is continuous; map → odom takes the correction."""
    estimates, _ = run(drive(seconds=30.0))
    local, heights = LocalOdometry(), []
    message = blank_transforms(make, Frames("map", "odom", "base_link"))
    for estimate in estimates:
        found = local.estimate_in_odom(estimate)
        fill_transforms(message, estimate, found)
        of_odom, of_base = (t.transform.translation.z for t in message.transforms)
        if estimate.outputs.tilt is not None:
            assert of_odom + of_base == pytest.approx(height(estimate)[0])
            heights.append(height(found))
    climbed, stddevs = np.array(heights).T
    assert np.max(np.abs(np.diff(climbed))) < 0.4 * 0.05 * math.sin(-PITCH) * 1.5 + 1e-6
    assert abs(climbed[-1] - (true_height(estimates[-1]) - BEGIN)) < 3.0 * stddevs[-1]
