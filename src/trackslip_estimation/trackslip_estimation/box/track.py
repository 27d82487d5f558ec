# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The track of base_link from fix to fix, and where it makes the next one expected.

    p, v   pose of base_link in odom, its rate of change   m, m, rad; m/s, m/s, rad/s
    σ, τ   standard deviation of v, and the time for which it lasts  as v; s
    e      e^{−Δt/τ}

Each axis is a Kalman filter of its own: v is a first-order Gauss–Markov process, so that after an absence
the vehicle is sought about where it was, ever wider:

    p ← p + τ (1 − e) v      v ← e v
    Q_pp = σ² (2 τ Δt − τ² (3 − 4 e + e²))      Q_pv = σ² τ (1 − e)²      Q_vv = σ² (1 − e²)
"""

import math
from dataclasses import dataclass, field

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.box.background import Background
from trackslip_estimation.box.parameters import BoxLocalizerParameters
from trackslip_estimation.box.quarters import CERTAIN, QUARTER_TURN, Headings, Mode, SideEvidence

INITIAL_YAW_STDDEV = np.pi / 16.0  # rad: the initial heading is given to within π/4
_NS = 1e-9  # s


@dataclass(frozen=True, eq=False)
class Expectation:
    """Where base_link should be, (x, y, yaw) in m and rad, and how far from there a fix may lie.

    yaw_variance: of the heading predicted, rad²; headings: this one, and its quarter turns.
    elapsed: since the fix before, s.
    """

    pose: FloatArray
    reach: float
    yaw_reach: float
    yaw_variance: float
    headings: Headings
    elapsed: float

    def innovation_variance(self, fix: Mode, p: BoxLocalizerParameters) -> float:
        """Heading variance, rad², with which a fix that its own track contradicts agrees with it; else 0.

        Few beams now and then fit a corner where there is a side, and are sure of it.
        """
        turned = float(fix.pose[2] - self.pose[2])
        squared = (turned - QUARTER_TURN * round(turned / QUARTER_TURN)) ** 2
        contradicts = squared > p.ambiguity_gate**2 * (self.yaw_variance + fix.covariance[2, 2])
        return squared / p.ambiguity_gate**2 if contradicts else 0.0


@dataclass(frozen=True, eq=False)
class Track:
    """p and v: mean (3, 2) and covariance (3, 2, 2), an axis each; the hypotheses of the heading."""

    stamp_ns: int
    mean: FloatArray
    covariance: FloatArray
    headings: Headings

    @classmethod
    def begun(
        cls,
        stamp_ns: int,
        pose: FloatArray,
        variance: FloatArray,
        headings: Headings,
        p: BoxLocalizerParameters,
    ) -> "Track":
        """At a pose (3,) with its variances (3,), moving at any speed that the vehicle has."""
        mean, covariance = np.zeros((3, 2)), np.zeros((3, 2, 2))
        mean[:, 0], covariance[:, 0, 0], covariance[:, 1, 1] = pose, variance, _rate_variance(p)
        return cls(stamp_ns, mean, covariance, headings)

    def predicted(self, stamp_ns: int, p: BoxLocalizerParameters) -> "Track":
        """At a later time; an earlier one is taken for this."""
        elapsed = max(0.0, (stamp_ns - self.stamp_ns) * _NS)
        tau, left = p.coast_time, np.exp(-elapsed / p.coast_time)
        transition = np.array(((1.0, tau * (1.0 - left)), (0.0, left)))
        noise = np.empty((2, 2))
        noise[0, 0] = 2.0 * tau * elapsed - tau**2 * (3.0 - 4.0 * left + left**2)
        noise[0, 1] = noise[1, 0] = tau * (1.0 - left) ** 2
        noise[1, 1] = 1.0 - left**2
        covariance = transition @ self.covariance @ transition.T + _rate_variance(p)[:, None, None] * noise
        return Track(max(stamp_ns, self.stamp_ns), self.mean @ transition.T, covariance, self.headings)

    def expectation(self, stamp_ns: int, p: BoxLocalizerParameters) -> Expectation:
        """Of the next fix: within what the vehicle can have moved since the last."""
        elapsed = max(0.0, (stamp_ns - self.stamp_ns) * _NS)
        there = self.predicted(stamp_ns, p)
        variance = float(there.covariance[2, 0, 0])
        return Expectation(
            pose=there.mean[:, 0],
            reach=p.gate_distance + elapsed * p.top_speed,
            yaw_reach=p.gate_yaw + p.yaw_spreads * np.sqrt(variance),
            yaw_variance=variance,
            headings=self.headings,
            elapsed=elapsed,
        )

    def updated(self, stamp_ns: int, fix: Mode, headings: Headings, p: BoxLocalizerParameters) -> "Track":
        """With a fix of the first hypothesis; ``headings`` are those of after it."""
        there = self.predicted(stamp_ns, p)
        innovation_variance = there.covariance[:, 0, 0] + fix.covariance.diagonal()
        innovation = fix.pose - there.mean[:, 0]
        turn = QUARTER_TURN * round(float(innovation[2]) / QUARTER_TURN)  # to another hypothesis
        innovation[2] -= turn
        gain = there.covariance[:, :, 0] / innovation_variance[:, None]
        mean = there.mean + gain * innovation[:, None]
        mean[2, 0] += turn
        covariance = there.covariance - gain[:, :, None] * there.covariance[:, None, 0, :]
        return Track(there.stamp_ns, mean, 0.5 * (covariance + covariance.swapaxes(1, 2)), headings)

    def restamped(self, stamp_ns: int, p: BoxLocalizerParameters) -> "Track":
        """Standing where it was: the clock was set, and how long ago that was is unknown."""
        return Track.begun(stamp_ns, self.mean[:, 0], self.covariance[:, 0, 0], self.headings, p)


@dataclass(frozen=True, eq=False)
class Kept:
    """What a localizer leaves to the next: its track, the stamp of its latest scan, and the background.

    laser: (3,) where the background was seen from, in odom, m and rad.
    """

    track: Track
    scan_ns: int
    background: Background = field(default_factory=Background.unknown)
    laser: tuple[float, float, float] = (0.0, 0.0, 0.0)


def initial_expectation(p: BoxLocalizerParameters) -> Expectation:
    """At the start: about the initial pose."""
    return Expectation(
        pose=np.array([p.initial_x, p.initial_y, p.initial_yaw]),
        reach=p.initial_reach,
        yaw_reach=np.pi / 4.0,
        yaw_variance=INITIAL_YAW_STDDEV**2,
        headings=Headings(CERTAIN, SideEvidence()),
        elapsed=math.inf,
    )


def _rate_variance(p: BoxLocalizerParameters) -> FloatArray:
    """σ² of each axis (3,)."""
    return np.array((p.top_speed, p.top_speed, p.top_yaw_rate)) ** 2
