# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Models of the machine's sensors: measurements of the true motion, before the protocols encode them.

a       specific force at C, acceleration minus gravity in the body frame:
        v̇ + ω × v + g (-sin θ, cos θ sin ϕ, cos θ cos ϕ)      m/s²
v, ω    (v_x, v_y, 0), (p, q, r), body frame                   m/s, rad/s
θ, ϕ    pitch (nose down > 0), roll (left side up > 0)         rad
b_g     constant bias of the gyro                              rad/s
σ       angle of the upper structure; an inertial unit on it measures a, B in its axes and the rate ψ̇ + σ̇
B       earth's field, horizontal (to the north, +y of the site) and downward   T
"""

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.units import GRAVITY
from trackslip_common.vehicle import UPPER, VehicleParameters
from trackslip_drivers.records import HydraulicsSample, ImuSample, SprocketSample, SwingSample
from trackslip_sim.machine.placement import Placement, rotation_about_z, upper_poses
from trackslip_sim.truth.record import Truth, TruthWindow


@dataclass(frozen=True, kw_only=True)
class SensorNoise(Parameters):
    """Noise and biases of the machine's sensors, and the earth's field."""

    pressure_stddev: float = parameter("noise of each pressure", unit="Pa", ge=0.0)
    gyro_stddev: float = parameter("noise of each rate", unit="rad/s", ge=0.0)
    gyro_bias: float = parameter("bias of the yaw rate", unit="rad/s")
    gyro_bias_x: float = parameter("bias of the roll rate", unit="rad/s")
    gyro_bias_y: float = parameter("bias of the pitch rate", unit="rad/s")
    acceleration_stddev: float = parameter("noise of each acceleration", unit="m/s²", ge=0.0)
    acceleration_bias_x: float = parameter("bias of the acceleration ahead", unit="m/s²")
    acceleration_bias_y: float = parameter("bias of the acceleration to the left", unit="m/s²")
    acceleration_bias_z: float = parameter("bias of the acceleration upward", unit="m/s²")
    field_stddev: float = parameter("noise of each component of the field", unit="T", ge=0.0)
    field_horizontal: float = parameter("earth's field, horizontal", unit="T")
    field_down: float = parameter("earth's field, downward", unit="T")


class Measurable(NamedTuple):
    """The measurable quantities at one time; names and units as in ``Truth``, and v̇ + ω × v."""

    left_angle: float
    right_angle: float
    left_speed: float
    right_speed: float
    left_pressure: float
    right_pressure: float
    left_spool: float
    right_spool: float
    supply_pressure: float
    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float
    roll_rate: float
    pitch_rate: float
    yaw_rate: float
    swing: float
    swing_rate: float
    a_x: float
    a_y: float
    a_z: float


class Mounting(NamedTuple):
    """Sensors on the upper structure, and its swing axis."""

    axis: tuple[float, float] = (0.0, 0.0)  # in base_link, m
    imu_above: bool = False
    encoder_stddev: float = 0.0  # rad, of the swing encoder; 0: no encoder


UNDERCARRIAGE_MOUNTING = Mounting()
_REST_ACCELERATION = np.array((0.0, 0.0, GRAVITY))


def mounting_of(vehicle: VehicleParameters) -> Mounting:
    """The mounting in the vehicle's file."""
    encoder = vehicle.sensors.swing_encoder if vehicle.sensors is not None else None
    stddev = encoder.stddev if encoder is not None else 0.0
    return Mounting(vehicle.swing_axis, vehicle.mount_of("imu") == UPPER, stddev)


def swing_topics(vehicle: VehicleParameters) -> tuple[str, ...]:
    """Topics with swing angles: of the encoder, if any, and the truth."""
    if vehicle.upper_structure is None:
        return ()
    return ("swing", "truth/swing") if mounting_of(vehicle).encoder_stddev > 0.0 else ("truth/swing",)


class MachineSensors:
    """Readings at any stamp of a drive from ``drive_start_ns`` on; standstill before and after it.

    Stamps may go back by at most the length of the window.
    """

    def __init__(
        self,
        window: TruthWindow,
        noise: SensorNoise,
        drive_start_ns: int,
        seed: int,
        mounting: Mounting = UNDERCARRIAGE_MOUNTING,
    ) -> None:
        self._window = window
        self._noise = noise
        self._mounting = mounting
        self._encoder_random = np.random.default_rng((seed, 1))
        self._start_ns = drive_start_ns
        self._random = np.random.default_rng(seed)
        self._cached_ns: int | None = None
        self._tabulate()

    def time(self, stamp_ns: int) -> float:
        """Seconds of the drive."""
        return (stamp_ns - self._start_ns) * 1e-9

    def pose_at(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """True x, y, yaw at times of the drive, s."""
        self._advance_window(float(times[-1]))
        truth = self._window.truth
        x, y, yaw = (np.interp(times, truth.t, column) for column in (truth.x, truth.y, truth.yaw))
        return x, y, yaw

    def placement(self, stamp_ns: int) -> Placement:
        """True pose and attitude of base_link."""
        at = self._truth_at(stamp_ns)
        return Placement(x=at.x, y=at.y, z=at.z, roll=at.roll, pitch=at.pitch, yaw=at.yaw)

    def upper_placement(self, stamp_ns: int) -> Placement:
        """True pose and attitude of the upper structure's frame, which equals base_link at σ = 0."""
        return self.placement(stamp_ns).rotated_about_z(self._truth_at(stamp_ns).swing, self._mounting.axis)

    def upper_pose_at(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """True x, y, yaw of the upper structure's frame at times of the drive, s."""
        x, y, yaw = self.pose_at(times)
        swing = np.interp(times, self._window.truth.t, self._window.truth.swing)
        x, y, upper_yaw = upper_poses(np.stack((x, y, yaw), axis=1), swing, self._mounting.axis).T
        return x, y, upper_yaw

    def swing(self, stamp_ns: int) -> SwingSample:
        """Reading of the swing encoder with noise."""
        true = self.true_swing(stamp_ns)
        angle = true.position + self._mounting.encoder_stddev * self._encoder_random.standard_normal()
        return true._replace(position=math.remainder(angle, 2.0 * math.pi))

    def true_swing(self, stamp_ns: int) -> SwingSample:
        """True swing angle, within ±π, and rate."""
        at = self._truth_at(stamp_ns)
        return SwingSample(stamp_ns, math.remainder(at.swing, 2.0 * math.pi), at.swing_rate)

    def sprockets(self, stamp_ns: int) -> SprocketSample:
        """Sprocket angles and speeds without noise; the device rounds them."""
        at = self._truth_at(stamp_ns)
        return SprocketSample(stamp_ns, at.left_angle, at.right_angle, at.left_speed, at.right_speed)

    def hydraulics(self, stamp_ns: int) -> HydraulicsSample:
        """Pressures with transducer noise, spools without."""
        at = self._truth_at(stamp_ns)
        left, right, supply = (self._noise.pressure_stddev * self._random.standard_normal(3)).tolist()
        return HydraulicsSample(
            stamp_ns,
            at.left_pressure + left,
            at.right_pressure + right,
            at.left_spool,
            at.right_spool,
            at.supply_pressure + supply,
        )

    def imu(self, stamp_ns: int) -> ImuSample:
        """Inertial readings at C, in the axes of the mount; at standstill before and after the drive."""
        at, noise = self._truth_at(stamp_ns), self._noise
        driving = 0.0 <= self.time(stamp_ns) <= self._window.duration
        to_sensor = self.placement(stamp_ns).rotation().T
        acceleration = to_sensor @ _REST_ACCELERATION
        rates = np.zeros(3)
        if driving:
            acceleration += (at.a_x, at.a_y, at.a_z)
            rates += (at.roll_rate, at.pitch_rate, at.yaw_rate)
        if self._mounting.imu_above:
            to_upper = rotation_about_z(at.swing).T
            to_sensor = to_upper @ to_sensor
            acceleration = to_upper @ acceleration
            rates = to_upper @ rates
            rates[2] += at.swing_rate if driving else 0.0
        acceleration += (noise.acceleration_bias_x, noise.acceleration_bias_y, noise.acceleration_bias_z)
        acceleration += noise.acceleration_stddev * self._standard_normal()
        rates += (noise.gyro_bias_x, noise.gyro_bias_y, noise.gyro_bias)
        rates += noise.gyro_stddev * self._standard_normal()
        field = to_sensor @ np.array((0.0, noise.field_horizontal, -noise.field_down))
        field += noise.field_stddev * self._standard_normal()
        return ImuSample(stamp_ns, _vector(acceleration), _vector(rates), _vector(field), over_range=False)

    def _truth_at(self, stamp_ns: int) -> Measurable:
        """The truth interpolated at one stamp, as by ``Truth.interpolate``."""
        if stamp_ns != self._cached_ns:
            t = self.time(stamp_ns)
            self._advance_window(t)
            times, table = self._times, self._table
            k = bisect_right(times, t) - 1
            if k < 0 or k == len(times) - 1:
                row = table[max(k, 0)]
            else:
                row = self._slopes[k] * (t - times[k]) + table[k]
            self._cached_ns, self._cached_truth = stamp_ns, Measurable._make(row.tolist())
        return self._cached_truth

    def _advance_window(self, t: float) -> None:
        if self._window.advance(t):
            self._tabulate()

    def _tabulate(self) -> None:
        """Tabulate the truth within the window as rows of ``Measurable``."""
        truth = self._window.truth
        columns = [getattr(truth, name) for name in Measurable._fields[:-3]]
        self._times: list[float] = truth.t.tolist()
        self._table: FloatArray = np.column_stack([*columns, accelerations(truth)])
        self._slopes = np.diff(self._table, axis=0) / np.diff(truth.t)[:, np.newaxis]
        self._cached_ns = None

    def _standard_normal(self) -> FloatArray:
        return self._random.standard_normal(3)


def accelerations(truth: Truth) -> FloatArray:
    """(n, 3) v̇ + ω × v at C in the body frame, m/s²."""
    v_x_rate, v_y_rate = np.zeros(len(truth)), np.zeros(len(truth))
    if len(truth) > 1:
        v_x_rate, v_y_rate = np.gradient(truth.v_x, truth.t), np.gradient(truth.v_y, truth.t)
    ahead, left = v_x_rate - truth.v_y * truth.yaw_rate, v_y_rate + truth.v_x * truth.yaw_rate
    return np.column_stack((ahead, left, truth.v_y * truth.roll_rate - truth.v_x * truth.pitch_rate))


def tilt_readings(
    truth: Truth, times: FloatArray, noise: SensorNoise, random: np.random.Generator
) -> FloatArray:
    """(m, 5) readings of roll and pitch rate, rad/s, and specific force, m/s², of an inertial unit at C."""
    at = truth.interpolate(times)
    motion = [np.interp(times, truth.t, column) for column in accelerations(truth).T]
    vertical = np.cos(at.pitch)
    gravity = (-np.sin(at.pitch), vertical * np.sin(at.roll), vertical * np.cos(at.roll))
    biases = noise.acceleration_bias_x, noise.acceleration_bias_y, noise.acceleration_bias_z
    forces = [a + GRAVITY * g + b for a, g, b in zip(motion, gravity, biases, strict=True)]
    rates = at.roll_rate + noise.gyro_bias_x, at.pitch_rate + noise.gyro_bias_y
    stddevs = (*2 * (noise.gyro_stddev,), *3 * (noise.acceleration_stddev,))
    readings: FloatArray = np.column_stack((*rates, *forces))
    return readings + stddevs * random.standard_normal((len(times), 5))


def _vector(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
