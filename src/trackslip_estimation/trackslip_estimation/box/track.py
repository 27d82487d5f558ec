# SPDX-License-Identifier: Apache-2.0
"""The track of base_link from fix to fix, and where it makes the next one expected.

p, v  pose of base_link in odom at the last fix; its rate of change  m, m, rad; m/s, m/s, rad/s
p̂     predicted pose: p + v Δt, for as long as ``coast_time``
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.box.parameters import BoxLocalizerParameters
from trackslip_estimation.box.sides import SideDoubt

FloatArray = NDArray[np.float64]

EIGHTH_TURN = np.pi / 4.0  # up to here the nearest of four alike headings is the right one
SHORTEST_STEP = 0.01  # s, least time over which a velocity is formed
_NS = 1e-9  # s


@dataclass(frozen=True, eq=False)
class Expectation:
    """Where base_link should be, (x, y, yaw) in m and rad, and how far from there a fix may lie.

    doubt: about the sides of the box; half_turn_variance: of the heading, which may be the opposite, rad².
    """

    pose: FloatArray
    reach: float
    yaw_reach: float
    doubt: SideDoubt | None = None
    half_turn_variance: float = 0.0

    @property
    def is_ambiguous(self) -> bool:
        """Whether the heading could be another one of the four that look alike."""
        return self.yaw_reach > EIGHTH_TURN


def initial_expectation(p: BoxLocalizerParameters) -> Expectation:
    """At the start: about the initial pose."""
    return Expectation(
        np.array([p.initial_x, p.initial_y, p.initial_yaw]), reach=p.initial_reach, yaw_reach=EIGHTH_TURN
    )


@dataclass(frozen=True, eq=False)
class Track:
    """p, v and when; with what is not certain about the heading."""

    stamp_ns: int
    pose: FloatArray
    velocity: FloatArray
    doubt: SideDoubt | None
    half_turn_variance: float

    def expectation(self, stamp_ns: int, p: BoxLocalizerParameters) -> Expectation:
        """Constant velocity since the last fix, within what the vehicle can have moved.

        A lost vehicle is sought about its last place: the reach has grown with the time since then.
        """
        elapsed = max(0.0, (stamp_ns - self.stamp_ns) * _NS)
        return Expectation(
            pose=self.pose + min(elapsed, p.coast_time) * self.velocity,
            reach=p.gate_distance + elapsed * p.top_speed,
            yaw_reach=p.gate_yaw + elapsed * p.top_yaw_rate,
            doubt=self.doubt,
            half_turn_variance=self.half_turn_variance,
        )

    def velocity_after(self, stamp_ns: int, pose: FloatArray, p: BoxLocalizerParameters) -> FloatArray:
        """Corrected by a share of the fix's innovation; zero where the fix restarts the track."""
        step = max((stamp_ns - self.stamp_ns) * _NS, SHORTEST_STEP)
        innovation = pose - (self.pose + step * self.velocity)
        if step > p.coast_time or abs(innovation[2]) > EIGHTH_TURN:
            return np.zeros(3)
        limit = np.array([p.top_speed, p.top_speed, p.top_yaw_rate])
        velocity: FloatArray = np.clip(self.velocity + p.velocity_gain / step * innovation, -limit, limit)
        return velocity

    def restamped(self, stamp_ns: int) -> "Track":
        """Standing where it was: the clock was set, and how long ago that was is unknown."""
        return Track(stamp_ns, self.pose, np.zeros(3), self.doubt, self.half_turn_variance)
