# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A machine driven at random, towards places now in the laser's sight and now out of it."""

import math

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.vehicle import Vehicle
from trackslip_sim.machine.drawn import DrawnMachine, MotionErrors, integrated
from trackslip_sim.truth.ground import Ground
from trackslip_sim.truth.rows import Column
from trackslip_sim.truth.settings import TruthSettings
from trackslip_sim.truth.shear import ShearDrive

FASTEST = 3.0  # rad/s of a sprocket
_IN_SIGHT, _OUT_OF_SIGHT = ((-8.0, 18.0), (-5.0, 6.0)), ((-8.0, 18.0), (-22.0, -13.0))  # m, x and y
_NEAR = 4.0  # m, there
_PATIENCE = 150.0  # s for one place
_FACES, _FAR_OFF = 0.5, 1.0  # rad off a place, below which the machine drives there, or may turn on the spot


class Route:
    """What is commanded next, given where the machine is."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random, self._in_sight = random, True
        self._aim(0.0)

    def next(self, t: float, pose: FloatArray) -> tuple[float, float, float]:
        """Seconds, left and right sprocket speed (rad/s) of what comes next at a pose (3,) and ``t`` s."""
        x, y = self._place[0] - pose[0], self._place[1] - pose[1]
        if math.hypot(x, y) < _NEAR or t > self._until:
            self._aim(t)
        random, bearing = self._random, math.remainder(math.atan2(y, x) - pose[2], 2.0 * math.pi)
        kind, speed = random.uniform(), random.uniform(0.3, 1.0) * FASTEST
        if kind < 0.08:
            return random.uniform(2.0, 8.0), 0.0, 0.0
        if abs(bearing) > math.pi / 2.0 and kind < 0.5:
            speed, bearing = -speed, math.remainder(bearing + math.pi, 2.0 * math.pi)
        if kind > (0.7 if abs(bearing) > _FAR_OFF else 0.95):  # on the spot
            side = math.copysign(speed, bearing)
            return random.uniform(1.0, 6.0), -side, side
        if abs(bearing) < _FACES:
            slower = speed * (1.0 - random.uniform(0.0, 0.15))
            duration = random.uniform(3.0, 15.0)
        else:
            slower, duration = speed * random.uniform(0.0, 0.7), random.uniform(2.0, 10.0)
        to_left = (bearing > 0.0) == (speed > 0.0)
        return (duration, slower, speed) if to_left else (duration, speed, slower)

    def _aim(self, t: float) -> None:
        """At another place, in sight and out of it in turn."""
        self._in_sight = not self._in_sight
        ranges = _IN_SIGHT if self._in_sight else _OUT_OF_SIGHT
        self._place = tuple(self._random.uniform(low, high) for low, high in ranges)
        self._until = t + _PATIENCE


def drive_at_random(
    machine: DrawnMachine, setting: tuple[Ground, Vehicle, TruthSettings], duration: float, seed: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sprocket angles (n, 2) rad, twists (n, 3) and poses (n, 3), a sample period apart from time 0 on."""
    ground, vehicle, settings = setting
    random, period = np.random.default_rng((seed, 1)), settings.sample_period
    drive = ShearDrive(ground, vehicle, settings, vehicle.relief_pressure)
    route, errors = Route(random), MotionErrors(machine, vehicle.tread, period, random)
    angles, twists, poses = [np.zeros((1, 2))], [np.zeros((1, 3))], [np.zeros((1, 3))]
    driven, samples = 0, round(duration / period)
    while driven < samples:
        seconds, *speeds = route.next(driven * period, poses[-1][-1])
        count = min(round(seconds / period), samples - driven)
        rows = drive.drive(np.tile(speeds, (count * settings.steps_per_sample, 1)))
        tracks = rows[:, Column.TRACK_SPEED : Column.TRACK_SPEED + 2]
        angles.append(rows[:, Column.ANGLE : Column.ANGLE + 2])
        twists.append(errors.apply(tracks, rows[:, Column.V_X : Column.YAW_RATE + 1]))
        poses.append(integrated(twists[-1], period, poses[-1][-1]))
        driven += count
    return np.concatenate(angles), np.concatenate(twists), np.concatenate(poses)
