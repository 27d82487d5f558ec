# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The attitude filter on synthetic motions: standstill, turns, acceleration, vibration, missing forces."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.units import GRAVITY
from trackslip_estimation.attitude.filter import propagate_height, update_with_sample
from trackslip_estimation.attitude.parameters import CONSTANTS, constants
from trackslip_estimation.attitude.records import ATTITUDE, BIAS_X, HEIGHT, IMU, PITCH, ROLL
from trackslip_estimation.attitude.start import reset_attitude
from trackslip_estimation.attitude.status import attitude_text
from trackslip_estimation.slip.parameters import load_slip_parameters

N = np.zeros(1, CONSTANTS)
N[0] = constants(load_slip_parameters().attitude, measures_height=False)
TOPIC = "imu/data_raw"


@compiled
def filter_samples(attitude: Any, samples: Any, n: Any, means: FloatArray) -> None:
    """Run the filter over all samples; write its means to ``means`` (k, 7)."""
    for k in range(samples.size):
        propagate_height(attitude[0], samples[k].velocity[0], samples[k].velocity[1], 0.01)
        attitude[0].sample = samples[k]
        update_with_sample(attitude[0], n[0])
        means[k] = attitude[0].mean


@compiled
def reset(attitude: Any) -> None:
    reset_attitude(attitude[0])


class Ride:
    """IMU at 100 Hz on a machine with given roll, pitch, yaw rate and speed over time."""

    def __init__(self, seconds: float, seed: int = 0, **motion: Any) -> None:
        self.t = np.arange(round(seconds * 100)) * 0.01
        zero = np.zeros_like(self.t)
        columns = {name: np.broadcast_to(value, zero.shape) for name, value in motion.items()}
        self.roll, self.pitch = columns.get("roll", zero), columns.get("pitch", zero)
        self.yaw_rate, self.speed = columns.get("yaw_rate", zero), columns.get("speed", zero)
        self.random = np.random.default_rng(seed)

    def samples(
        self, noise: float = 0.05, gyro: float = 0.003, gyro_bias: float = 0.0, bias: float = 0.0
    ) -> NDArray[np.void]:
        """(n,) of ``IMU``; rates follow from the angles (ZYX), forces from the motion."""
        samples = np.zeros(len(self.t), IMU)
        sin, cos = np.sin(self.roll), np.cos(self.roll)
        roll_rate, pitch_rate = np.gradient(self.roll, 0.01), np.gradient(self.pitch, 0.01)
        p = roll_rate - self.yaw_rate * np.sin(self.pitch)
        q = pitch_rate * cos + self.yaw_rate * sin * np.cos(self.pitch)
        r = self.yaw_rate * cos * np.cos(self.pitch) - pitch_rate * sin
        samples["stamp_ns"] = np.round(self.t * 1e9).astype(np.int64) + 1
        samples["rates"] = np.column_stack((p + gyro_bias, q - gyro_bias, r))
        samples["rates"][:, :2] += self.random.normal(0.0, gyro, (len(self.t), 2))
        samples["rate_variances"] = gyro**2
        force = np.column_stack((-np.sin(self.pitch), sin * np.cos(self.pitch), cos * np.cos(self.pitch)))
        force *= GRAVITY
        force[:, 0] += np.gradient(self.speed, 0.01) + bias
        force[:, 1] += r * self.speed
        force[:, 2] -= q * self.speed
        samples["force"] = force + self.random.normal(0.0, noise, force.shape)
        samples["force_variance"] = 0.05**2
        samples["velocity"][:, 0], samples["known_velocity"], samples["use_force"] = self.speed, 1, 1
        return samples


def run(samples: NDArray[np.void]) -> tuple[Any, FloatArray]:
    attitude, means = np.zeros(1, ATTITUDE), np.empty((len(samples), 7))
    reset(attitude)
    filter_samples(attitude, samples, N, means)
    return attitude[0], means


def rms_error(ride: Ride, means: FloatArray, after: float = 5.0) -> float:
    """RMS error of roll and pitch, degrees."""
    late = ride.t > after
    both = np.column_stack((means[:, ROLL] - ride.roll, means[:, PITCH] - ride.pitch))[late]
    return math.degrees(float(np.sqrt((both**2).mean())))


def stddev(attitude: Any, k: int) -> float:
    return float(np.sqrt(attitude["covariance"][k, k]))


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.26, 0.0), (0.0, -0.26), (-0.2, 0.3)])
def test_tilt_at_standstill_is_right_within_0_2_degrees(roll: float, pitch: float) -> None:
    ride = Ride(20.0, roll=roll, pitch=pitch)
    attitude, means = run(ride.samples(gyro_bias=0.008))
    assert rms_error(ride, means) < 0.2
    assert stddev(attitude, ROLL) > math.radians(0.25)  # a bias of 0.05 m/s² has the same effect


def test_tilt_error_of_an_accelerometer_bias_is_within_the_covariance() -> None:
    ride = Ride(20.0, pitch=0.1)
    attitude, means = run(ride.samples(bias=0.05))
    off = abs(means[-1, PITCH] - 0.1)
    assert off == pytest.approx(0.05 / GRAVITY, rel=0.3)
    assert off < 2.0 * stddev(attitude, PITCH)


def test_turns_separate_a_bias_from_a_tilt() -> None:
    """The slope does not turn with the machine, a bias does."""
    seconds = 60.0
    t = np.arange(round(seconds * 100)) * 0.01
    turned = 0.2 * np.clip(t - 10.0, 0.0, None)
    ride = Ride(
        seconds,
        yaw_rate=np.where(t > 10.0, 0.2, 0.0),
        roll=np.arcsin(0.2 * np.sin(turned)),
        pitch=np.arctan(-math.tan(math.asin(0.2)) * np.cos(turned)),
    )
    attitude, _ = run(ride.samples(bias=0.05))
    assert attitude["mean"][BIAS_X] == pytest.approx(0.05, abs=0.02)
    assert stddev(attitude, PITCH) < math.radians(0.2)


def test_accelerating_and_turning_do_not_tilt_the_estimate() -> None:
    t = np.arange(4000) * 0.01
    ride = Ride(40.0, speed=0.5 * np.abs(np.sin(0.5 * t)), yaw_rate=0.4 * np.sin(0.3 * t))
    _, means = run(ride.samples())
    assert rms_error(ride, means) < 0.2


def test_attitude_and_height_follow_a_hill() -> None:
    t = np.arange(6000) * 0.01
    ride = Ride(
        60.0, speed=np.where(t > 5.0, 0.5, 0.0), pitch=-0.26 * np.sin(0.2 * np.clip(t - 8.0, 0.0, None))
    )
    _, means = run(ride.samples())
    assert rms_error(ride, means) < 0.5
    climbed = np.cumsum(-ride.speed * np.sin(ride.pitch)) * 0.01
    assert np.abs(means[:, HEIGHT] - climbed).max() < 0.01 * float(np.abs(climbed).max()) + 0.01


def test_attitude_under_vibration_follows_the_gyro() -> None:
    t = np.arange(6000) * 0.01
    ride = Ride(60.0, roll=0.2 * np.sin(0.2 * t), pitch=0.1 * np.sin(0.3 * t))
    attitude, means = run(ride.samples(noise=3.0))
    assert rms_error(ride, means, after=10.0) < 0.5
    assert attitude["noise"] == pytest.approx(9.0 / 8.0, rel=0.5)  # noise of the mean of eight samples


def test_attitude_without_roll_and_pitch_gyros_follows_the_accelerometers() -> None:
    ride = Ride(20.0, roll=0.1)
    samples = ride.samples()
    samples["rates"][:, :2] = np.nan
    assert rms_error(ride, run(samples)[1]) < 0.5


@pytest.mark.parametrize(
    ("force", "words"),
    [
        ((math.nan, math.nan, math.nan), "has no accelerations"),
        ((0.0, 0.0, 0.0), "are rejected: 0.00 m/s² on average, gravity is 9.81"),
        ((0.1, 0.0, 0.3), "are rejected: 0.32 m/s²"),
        ((0.0, 0.0, -9.6), "set its mounting"),
        ((9.8, 0.0, 0.1), "set its mounting"),
    ],
)
def test_acceleration_that_is_not_gravity_leaves_the_ground_flat(force: Any, words: str) -> None:
    samples = Ride(5.0).samples()
    samples["force"] = force
    attitude, means = run(samples)
    assert attitude["known"] == attitude["level"]["known"] == 0
    assert not means.any()
    text = attitude_text(attitude, TOPIC)
    assert text.startswith("flat: ")
    assert words in text
    assert TOPIC in text


def test_attitude_variance_grows_without_accelerations() -> None:
    ride = Ride(100.0, roll=0.2)
    samples = ride.samples(gyro_bias=0.005)
    samples["force"][1000:] = np.nan
    attitude, means = run(samples)
    before = run(samples[:1000])[0]
    assert stddev(attitude, ROLL) > 2.0 * stddev(before, ROLL)
    assert abs(means[-1, ROLL] - 0.2) < 3.0 * stddev(attitude, ROLL)


def test_missing_imu_is_reported_as_flat_ground() -> None:
    assert attitude_text(np.zeros(1, ATTITUDE)[0], None).startswith("flat: no IMU")


def test_a_tilted_mounting_is_observable_after_turns() -> None:
    seconds = 90.0
    t = np.arange(round(seconds * 100)) * 0.01
    ride = Ride(seconds, yaw_rate=np.where(t > 5.0, 0.3, 0.0))
    attitude, _ = run(ride.samples(bias=0.4))
    assert "imu/data_raw is tilted 2." in attitude_text(attitude, TOPIC)


def test_speed_noise_at_100_hz_is_not_taken_for_vibration() -> None:
    """Fixes and rounding change the speed by some cm/s; the pitch must not follow the gyro."""
    ride = Ride(60.0, speed=np.clip(np.arange(6000) * 0.01 - 3.0, 0.0, 0.5))
    samples = ride.samples(gyro_bias=0.0015)
    noise = np.random.default_rng(2).normal(0.0, 0.02, len(samples))
    samples["velocity"][:, 0] += np.where(ride.speed > 0.0, noise, 0.0)
    attitude, means = run(samples)
    assert np.abs(means[1000:, PITCH]).max() < math.radians(0.2)  # 0.56 if taken for vibration
    assert stddev(attitude, PITCH) < math.radians(0.4)  # 0.85 likewise


def test_samples_of_a_span_count_as_their_mean() -> None:
    """While the ground tilts, the mean force belongs to the mean tilt, not to that at the end of the span."""
    t = np.arange(3000) * 0.01
    ride = Ride(30.0, pitch=0.1 * np.sin(1.5 * t))
    _, means = run(ride.samples(noise=0.0, gyro=1e-5))
    assert np.abs(means[500:, PITCH] - ride.pitch[500:]).max() < 1e-3


@pytest.mark.parametrize("rate", [12.0, 50.0])
def test_message_without_acceleration_does_not_restart_the_span(rate: float) -> None:
    """The span is not shortened either."""
    every = round(100.0 / rate)
    samples = Ride(30.0, pitch=0.1).samples()[::every]
    samples["force"][1::2] = np.nan
    _, means = run(samples)
    assert np.abs(means[-1, PITCH] - 0.1) < 0.005


@pytest.mark.parametrize(("rate", "seconds"), [(0.02, 60.0), (0.05, 11.0), (0.2, 3.0)])
def test_the_roll_recovers_from_a_wrong_roll_rate(rate: float, seconds: float) -> None:
    ride = Ride(120.0, speed=0.5)
    samples = ride.samples()
    samples["rates"][(ride.t > 20.0) & (ride.t < 20.0 + seconds), 0] += rate
    attitude, means = run(samples)
    off = np.degrees(np.abs(means[:, ROLL]))
    assert off[(ride.t > 30.0) & (ride.t < 20.0 + seconds)].max(initial=0.0) < 5.0
    assert off[ride.t > 30.0 + seconds].max() < 0.5
    assert stddev(attitude, ROLL) < math.radians(0.5)


@pytest.mark.parametrize("braking", [0.5, 1.5, 4.0])
@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_a_slide_on_locked_tracks_does_not_tilt_the_estimate(speed: float, braking: float) -> None:
    t = np.arange(4000) * 0.01
    ride = Ride(40.0, speed=speed * np.clip(1.0 - (t - 10.0) / braking, 0.0, 1.0))
    samples = ride.samples()
    samples["velocity"][t > 10.0, 0] = 0.0
    _, means = run(samples)
    assert np.degrees(np.abs(means[:, PITCH])).max() < 0.5
