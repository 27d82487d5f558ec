# SPDX-License-Identifier: Apache-2.0
"""The machine while its sprockets say nothing: it may stand, go on, or turn, each as fast as it can.

    v̂, ω̂   fastest that it can drive and turn              m/s, rad/s
    τ       how long an unknown speed lasts                 s
    x, P    mean and covariance of the state

The pose is held where it was and its uncertainty grows as that of a walk, by v̂ √(2 τ t). Where the misfits of
speed and yaw rate are states, all of both is misfit now. They are forgotten after each step, so that a gyro
that still works carries the heading on; over the first step the yaw rate may have changed by ω̂ √(t/τ).
"""

from dataclasses import dataclass

import numpy as np

from trackslip_estimation.slip.models.model import YAW, Gaussian, Outputs, X, Y
from trackslip_estimation.slip.models.speed import RATE_MISFIT, SPEED_MISFIT
from trackslip_estimation.slip.parameters import SlipEstimatorParameters

_LASTS = 1.0  # s, τ


@dataclass(frozen=True)
class Reach:
    """What the machine can do at the most, and where the state holds it."""

    speed: float  # m/s
    yaw_rate: float  # rad/s
    velocity: slice  # of the state: misfits of speed and yaw rate; empty where they are no states

    @property
    def unseen_yaw_rate(self) -> float:
        """Standard deviation of a yaw rate that no state holds, rad/s."""
        return self.yaw_rate if self.velocity.start == self.velocity.stop else 0.0

    def enter(self, state: Gaussian, known: Outputs, dt: float) -> Gaussian:
        """At the end of what is known, ``dt`` s before the next that is."""
        entered = self.forget(state)
        if self.velocity.start == self.velocity.stop:
            return entered
        rate = self.velocity.stop - 1
        mean, covariance = entered
        mean[rate] = known.twist[2]
        covariance[rate, rate] = known.twist_covariance[2, 2] + self.yaw_rate**2 * min(dt / _LASTS, 1.0)
        return entered

    def forget(self, state: Gaussian) -> Gaussian:
        """Speed and yaw rate unknown: about zero, as wide as they can be."""
        if self.velocity.start == self.velocity.stop:
            return state
        mean, covariance = state.mean.copy(), state.covariance.copy()
        mean[self.velocity] = 0.0
        covariance[self.velocity, :] = covariance[:, self.velocity] = 0.0
        covariance[self.velocity, self.velocity] = np.diag((self.speed**2, self.yaw_rate**2))
        return Gaussian(mean, covariance)

    def spread(self, state: Gaussian, dt: float) -> Gaussian:
        """What may have been driven in ``dt`` s, and turned where no state accounts for it."""
        walk = np.zeros(state.mean.size)
        walk[[X, Y, YAW]] = self.speed**2, self.speed**2, self.unseen_yaw_rate**2
        return Gaussian(state.mean, state.covariance + np.diag(2.0 * _LASTS * dt * walk))


def make_reach(p: SlipEstimatorParameters) -> Reach:
    """What the sprockets can do at the most."""
    fastest = p.vehicle.rolling_radius * p.max_sprocket_speed
    velocity = slice(0, 0) if p.model == "free_slips" else slice(SPEED_MISFIT, RATE_MISFIT + 1)
    return Reach(fastest, 2.0 * fastest / p.vehicle.tread, velocity)
