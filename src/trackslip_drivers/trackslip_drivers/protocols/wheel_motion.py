# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sprocket motion of other machines, from several joints per side or speeds of a base controller.

    q_k, n   angle or speed of a joint, sprocket turns per joint turn with its sign    rad or rad/s, 1
    v, ω     speeds that a base controller reports                                     m/s, rad/s
    b        wheel separation configured in the base controller                        m
    r        rolling radius of the vehicle                                             m

Joints: q_j = n mean(q_k) of each side. Speeds: ω_j = (v ∓ ω b/2)/r, left and right. The speeds, too, are
measured at the tracks, so slips remain to be estimated.
"""

import math
from collections.abc import Mapping, Sequence
from enum import Enum

from trackslip_common.turns import TurnCounter
from trackslip_drivers.records import SprocketSample
from trackslip_drivers.wheel_parameters import WheelParameters


class Rejection(Enum):
    """Reason for the rejection of a message."""

    MISSING_JOINT = "lacks a joint"
    LENGTH_MISMATCH = "names and values differ in number"
    NO_VALUES = "has neither positions nor velocities"
    NOT_A_NUMBER = "not a number"


class JointMotion:
    """Samples of consecutive joint states; positions are differenced if there are no velocities.

    Positions may wrap after each turn of a joint; those of a sample are continuous.
    """

    def __init__(self, p: WheelParameters) -> None:
        self._sides = (
            (p.left_joints, p.left_sign / p.joint_ratio),
            (p.right_joints, p.right_sign / p.joint_ratio),
        )
        self._uses = p.uses
        self.restart()

    def restart(self) -> None:
        """Forget earlier messages: the next one does not continue them."""
        self._last: tuple[int, tuple[float, float]] | None = None
        self._turns = {name: TurnCounter() for joints, _ in self._sides for name in joints}

    def sample(
        self, stamp_ns: int, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float]
    ) -> SprocketSample | Rejection:
        """The sample of one message, whose arrays may be empty; missing positions are nan."""
        positions = positions if self._uses != "velocities" else ()
        velocities = velocities if self._uses != "positions" else ()
        if {len(positions), len(velocities)} - {0, len(names)}:
            return Rejection.LENGTH_MISMATCH
        if not positions and not velocities:
            return Rejection.NO_VALUES
        index = {name: k for k, name in enumerate(names)}
        if any(name not in index for joints, _ in self._sides for name in joints):
            return Rejection.MISSING_JOINT
        continuous = self._unwrapped_positions(stamp_ns, positions, velocities, index)
        angles, speeds = self._side_means(continuous, index), self._side_means(velocities, index)
        if not velocities:
            speeds = self._differenced_speeds(stamp_ns, angles)
        if not all(map(math.isfinite, (*speeds, *(angles if positions else ())))):
            return Rejection.NOT_A_NUMBER
        return SprocketSample(stamp_ns, *angles, *speeds)

    def _unwrapped_positions(
        self, stamp_ns: int, positions: Sequence[float], velocities: Sequence[float], index: Mapping[str, int]
    ) -> Sequence[float]:
        """The positions; those of the sides' joints without the jumps of a wrap."""
        continuous = list(positions)
        for name, turns in self._turns.items() if continuous else ():
            k = index[name]
            continuous[k] = turns.unwrap(stamp_ns, continuous[k], velocities[k] if velocities else math.nan)
        return continuous

    def _side_means(self, values: Sequence[float], index: Mapping[str, int]) -> tuple[float, float]:
        if not values:
            return math.nan, math.nan
        left, right = (
            ratio * sum(values[index[name]] for name in joints) / len(joints) for joints, ratio in self._sides
        )
        return left, right

    def _differenced_speeds(self, stamp_ns: int, angles: tuple[float, float]) -> tuple[float, float]:
        """Differenced positions, rad/s; zero for the first. The estimator prefers the positions."""
        last = self._last
        if all(map(math.isfinite, angles)):
            self._last = stamp_ns, angles
        if last is None or stamp_ns <= last[0]:
            return 0.0, 0.0
        seconds = (stamp_ns - last[0]) * 1e-9
        return (angles[0] - last[1][0]) / seconds, (angles[1] - last[1][1]) / seconds


def sample_of_speeds(stamp_ns: int, v: float, rate: float, p: WheelParameters) -> SprocketSample | Rejection:
    """The sample of a base controller's speeds; its positions are nan."""
    half = rate * p.wheel_separation / 2.0
    r = p.vehicle.kinematics.rolling_radius
    left, right = (v - half) / r, (v + half) / r
    if not (math.isfinite(left) and math.isfinite(right)):
        return Rejection.NOT_A_NUMBER
    return SprocketSample(stamp_ns, math.nan, math.nan, left, right)
