# SPDX-License-Identifier: Apache-2.0
"""What the sensors on the machine measure of the true motion, before their protocols make bytes of it.

a       specific force at C: v̇_x − v_y φ̇, v̇_y + v_x φ̇, g     m/s²
b_g     constant bias of the gyro                              rad/s
B       earth's field, horizontal (to the north, +y of the site) and downward   T
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_common.parameters import Parameters, parameter
from trackslip_common.vehicle import GRAVITY
from trackslip_drivers.records import HydraulicsSample, ImuSample, SprocketSample
from trackslip_sim.truth.record import Truth

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SensorNoise(Parameters):
    """How far the machine's sensors are from the truth."""

    pressure_stddev: float = parameter("noise of each pressure", unit="Pa", ge=0.0)
    gyro_stddev: float = parameter("noise of each rate", unit="rad/s", ge=0.0)
    gyro_bias: float = parameter("bias of the yaw rate", unit="rad/s")
    acceleration_stddev: float = parameter("noise of each acceleration", unit="m/s²", ge=0.0)
    field_stddev: float = parameter("noise of each component of the field", unit="T", ge=0.0)
    field_horizontal: float = parameter("earth's field, horizontal", unit="T")
    field_down: float = parameter("earth's field, downward", unit="T")


class MachineSensors:
    """Readings at any stamp of a drive that begins at ``drive_start_ns``; standing before and after."""

    def __init__(self, truth: Truth, noise: SensorNoise, drive_start_ns: int, seed: int) -> None:
        self._truth = truth
        self._noise = noise
        self._start_ns = drive_start_ns
        self._random = np.random.default_rng(seed)
        v_x_rate, v_y_rate = np.gradient(truth.v_x, truth.t), np.gradient(truth.v_y, truth.t)
        self._a_x: FloatArray = v_x_rate - truth.v_y * truth.yaw_rate
        self._a_y: FloatArray = v_y_rate + truth.v_x * truth.yaw_rate

    def time(self, stamp_ns: int) -> float:
        """Seconds of the drive."""
        return (stamp_ns - self._start_ns) * 1e-9

    def pose_at(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """True x, y, yaw at times of the drive, s."""
        truth = self._truth
        x, y, yaw = (np.interp(times, truth.t, column) for column in (truth.x, truth.y, truth.yaw))
        return x, y, yaw

    def sprockets(self, stamp_ns: int) -> SprocketSample:
        """Without noise: the encoder's rounding is the device's."""
        at = self._truth.at(self.time(stamp_ns))
        return SprocketSample(
            stamp_ns, *(float(v[0]) for v in (at.left_angle, at.right_angle, at.left_speed, at.right_speed))
        )

    def hydraulics(self, stamp_ns: int) -> HydraulicsSample:
        """Pressures with transducer noise, spools without."""
        at = self._truth.at(self.time(stamp_ns))
        noise = self._noise.pressure_stddev * self._random.standard_normal(3)
        return HydraulicsSample(
            stamp_ns,
            float(at.left_pressure[0] + noise[0]),
            float(at.right_pressure[0] + noise[1]),
            float(at.left_spool[0]),
            float(at.right_spool[0]),
            float(at.supply_pressure[0] + noise[2]),
        )

    def imu(self, stamp_ns: int) -> ImuSample:
        """Level ground: no roll, no pitch."""
        t, truth, noise = self.time(stamp_ns), self._truth, self._noise
        driving = 0.0 <= t <= truth.duration
        a_x, a_y, yaw, rate = (
            float(np.interp(t, truth.t, column))
            for column in (self._a_x, self._a_y, truth.yaw, truth.yaw_rate)
        )
        if not driving:
            a_x = a_y = rate = 0.0
        acceleration = np.array((a_x, a_y, GRAVITY)) + noise.acceleration_stddev * self._normal()
        rates = np.array((0.0, 0.0, rate + noise.gyro_bias)) + noise.gyro_stddev * self._normal()
        north = noise.field_horizontal
        field = np.array((north * np.sin(yaw), north * np.cos(yaw), -noise.field_down))
        field += noise.field_stddev * self._normal()
        return ImuSample(stamp_ns, _vector(acceleration), _vector(rates), _vector(field), over_range=False)

    def _normal(self) -> FloatArray:
        return self._random.standard_normal(3)


def _vector(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
