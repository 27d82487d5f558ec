# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Track of base_link from fix to fix, and the prediction of the next fix.

    p, v   pose of base_link in odom, its rate of change   m, m, rad; m/s, m/s, rad/s
    σ, τ   standard deviation of v, and its correlation time  as v; s
    e      e^{−Δt/τ}

Each axis has its own Kalman filter. v is a first-order Gauss–Markov process, so that in an absence the
predicted position comes to rest and its variance grows:

    p ← p + τ (1 − e) v      v ← e v
    Q_pp = σ² (2 τ Δt − τ² (3 − 4 e + e²))      Q_pv = σ² τ (1 − e)²      Q_vv = σ² (1 − e²)
"""

import math
from dataclasses import dataclass, field

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.box.background import Background
from trackslip_estimation.box.heading_ambiguity import (
    CERTAIN_WEIGHTS,
    QUARTER_TURN,
    Headings,
    Mode,
    SideEvidence,
)
from trackslip_estimation.box.parameters import BoxLocalizerParameters

INITIAL_YAW_STDDEV = np.pi / 16.0  # rad: the initial heading is given to within π/4
_NS = 1e-9  # s


@dataclass(frozen=True, eq=False)
class Expectation:
    """Predicted pose of base_link, (x, y, yaw) in m and rad, and the gates of a fix about it.

    yaw_variance: of the predicted heading, rad²; headings: hypotheses of it and its quarter turns.
    elapsed: since the previous fix, s.
    """

    pose: FloatArray
    reach: float
    yaw_reach: float
    yaw_variance: float
    headings: Headings
    elapsed: float

    def innovation_variance(self, fix: Mode, p: BoxLocalizerParameters) -> float:
        """Return the heading variance, rad², at which a fix beyond ``ambiguity_gate`` is inside it; else 0.

        Few beams sometimes fit a corner where there is a side; the fit is then overconfident.
        """
        turned = float(fix.pose[2] - self.pose[2])
        squared = (turned - QUARTER_TURN * round(turned / QUARTER_TURN)) ** 2
        contradicts = squared > p.ambiguity_gate**2 * (self.yaw_variance + fix.covariance[2, 2])
        return squared / p.ambiguity_gate**2 if contradicts else 0.0


@dataclass(frozen=True, eq=False)
class Track:
    """p and v: mean (3, 2) and covariance (3, 2, 2), by axis; the hypotheses of the heading."""

    stamp_ns: int
    mean: FloatArray
    covariance: FloatArray
    headings: Headings

    @classmethod
    def from_pose(
        cls,
        stamp_ns: int,
        pose: FloatArray,
        variance: FloatArray,
        headings: Headings,
        p: BoxLocalizerParameters,
    ) -> "Track":
        """Return a track from a pose (3,) with variances (3,), with any velocity of the vehicle."""
        mean, covariance = np.zeros((3, 2)), np.zeros((3, 2, 2))
        mean[:, 0], covariance[:, 0, 0], covariance[:, 1, 1] = pose, variance, _rate_variance(p)
        return cls(stamp_ns, mean, covariance, headings)

    def predict(self, stamp_ns: int, p: BoxLocalizerParameters) -> "Track":
        """Return the track propagated to a later stamp; an earlier stamp counts as its own."""
        elapsed = max(0.0, (stamp_ns - self.stamp_ns) * _NS)
        tau, decay = p.coast_time, np.exp(-elapsed / p.coast_time)
        transition = np.array(((1.0, tau * (1.0 - decay)), (0.0, decay)))
        noise = np.empty((2, 2))
        noise[0, 0] = 2.0 * tau * elapsed - tau**2 * (3.0 - 4.0 * decay + decay**2)
        noise[0, 1] = noise[1, 0] = tau * (1.0 - decay) ** 2
        noise[1, 1] = 1.0 - decay**2
        covariance = transition @ self.covariance @ transition.T + _rate_variance(p)[:, None, None] * noise
        return Track(max(stamp_ns, self.stamp_ns), self.mean @ transition.T, covariance, self.headings)

    def expectation(self, stamp_ns: int, p: BoxLocalizerParameters) -> Expectation:
        """Return the prediction of the next fix, gated by the possible motion since the last."""
        elapsed = max(0.0, (stamp_ns - self.stamp_ns) * _NS)
        predicted = self.predict(stamp_ns, p)
        variance = float(predicted.covariance[2, 0, 0])
        return Expectation(
            pose=predicted.mean[:, 0],
            reach=p.gate_distance + elapsed * p.top_speed,
            yaw_reach=p.gate_yaw + p.yaw_spreads * np.sqrt(variance),
            yaw_variance=variance,
            headings=self.headings,
            elapsed=elapsed,
        )

    def update(self, stamp_ns: int, fix: Mode, headings: Headings, p: BoxLocalizerParameters) -> "Track":
        """Return the track updated with a fix of the first hypothesis; ``headings``: those after the fix."""
        predicted = self.predict(stamp_ns, p)
        innovation_variance = predicted.covariance[:, 0, 0] + fix.covariance.diagonal()
        innovation = fix.pose - predicted.mean[:, 0]
        turn = QUARTER_TURN * round(float(innovation[2]) / QUARTER_TURN)  # to another hypothesis
        innovation[2] -= turn
        gain = predicted.covariance[:, :, 0] / innovation_variance[:, None]
        mean = predicted.mean + gain * innovation[:, None]
        mean[2, 0] += turn
        covariance = predicted.covariance - gain[:, :, None] * predicted.covariance[:, None, 0, :]
        return Track(predicted.stamp_ns, mean, 0.5 * (covariance + covariance.swapaxes(1, 2)), headings)

    def restamp(self, stamp_ns: int, p: BoxLocalizerParameters) -> "Track":
        """Return the track at its pose, with unknown velocity: after the clock is set, Δt is unknown."""
        return Track.from_pose(stamp_ns, self.mean[:, 0], self.covariance[:, 0, 0], self.headings, p)


@dataclass(frozen=True, eq=False)
class LocalizerState:
    """State for the next localizer: the track, the stamp of the latest scan, and the background.

    laser: (3,) pose of the laser for the background, in odom, m and rad.
    """

    track: Track
    scan_ns: int
    background: Background = field(default_factory=Background.empty)
    laser: tuple[float, float, float] = (0.0, 0.0, 0.0)


def initial_expectation(p: BoxLocalizerParameters) -> Expectation:
    """Return the prediction at the start: the initial pose."""
    return Expectation(
        pose=np.array([p.initial_x, p.initial_y, p.initial_yaw]),
        reach=p.initial_reach,
        yaw_reach=np.pi / 4.0,
        yaw_variance=INITIAL_YAW_STDDEV**2,
        headings=Headings(CERTAIN_WEIGHTS, SideEvidence()),
        elapsed=math.inf,
    )


def _rate_variance(p: BoxLocalizerParameters) -> FloatArray:
    """Return σ² of each axis (3,)."""
    return np.array((p.top_speed, p.top_speed, p.top_yaw_rate)) ** 2
