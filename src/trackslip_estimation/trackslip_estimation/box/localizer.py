# SPDX-License-Identifier: Apache-2.0
"""base_link in odom from scan to scan: which object is the box, which side is its front, and where it is.

    p̂, v    predicted pose of base_link in odom; its rate of change  m, m, rad; m/s, m/s, rad/s
    Δ       heading of a fit less the predicted one                  rad

A rectangle looks the same after half a turn and nearly so after a quarter: the heading is the one nearest
to the prediction, unless that has grown too old to tell and the sides' lengths say otherwise (``sides.py``).
The localizer knows only its own fixes, so that they stay independent of any estimator's errors.
"""

import dataclasses
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from trackslip_common.tally import Tally
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.box.background import Background
from trackslip_estimation.box.clusters import Beams, beams_on, clusters, rejoined
from trackslip_estimation.box.fit import (
    Optimum,
    Rectangle,
    likely_starts,
    most_likely,
    posterior,
    seen_through,
)
from trackslip_estimation.box.parameters import BoxLocalizerParameters
from trackslip_estimation.box.sides import SideDoubt, half_turn_variance

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

NS = 1e-9  # s
EIGHTH_TURN = np.pi / 4.0  # up to here the nearest of four alike headings is the right one
QUARTER = np.linspace(-EIGHTH_TURN, EIGHTH_TURN, 25)
SHORTEST_STEP = 0.01  # s, least time over which a velocity is formed
SPREADS = 3.0  # standard deviations in the reach of the heading
SEEN_THROUGH = 0.2  # share of its beams that may go on behind a box: those beside an end that is not seen


class Reason(Enum):
    """Why a scan or an object in it gave no fix; in the order of how far it came."""

    MALFORMED = "malformed"
    NOT_LATER = "not_later_than_the_scan_before"
    NOTHING_NEAR = "nothing_near_the_prediction"
    FEW_BEAMS = "few_beams"
    SIZE = "larger_than_the_box"
    SHAPE = "not_the_shape_of_the_box"
    BACKGROUND = "was_there_before"
    GATE = "too_far_from_the_prediction"


@dataclass(frozen=True)
class Rejection:
    """A scan without a fix."""

    reason: Reason


@dataclass(frozen=True)
class BoxFix:
    """base_link in odom when the beams hit the box, m and rad; covariance (3, 3) of (x, y, yaw)."""

    stamp_ns: int
    x: float
    y: float
    yaw: float
    covariance: FloatArray


@dataclass(frozen=True)
class _Expectation:
    """Where base_link should be, and how far from there a fix may lie; (x, y, yaw), m, rad."""

    pose: FloatArray
    reach: float
    yaw_reach: float


@dataclass(frozen=True)
class _Candidate:
    beams: Beams
    optimum: Optimum
    doubt: SideDoubt | None
    distance: float


class BoxLocalizer:
    """Follows the box through scans given in order; its state depends on nothing else."""

    def __init__(self, parameters: BoxLocalizerParameters, vehicle: Vehicle) -> None:
        self._parameters = parameters
        self._box = Rectangle(vehicle.box_length, vehicle.box_width)
        self._offset: FloatArray = np.array([vehicle.box_x, vehicle.box_y])
        self._laser: FloatArray = np.array([parameters.laser_x, parameters.laser_y])
        self._laser_turn = _rotation(parameters.laser_yaw)
        self._range_stddev = float(
            np.hypot(parameters.range_stddev, parameters.range_resolution / np.sqrt(12.0))
        )
        self.tally = Tally()
        self.reset()

    def reset(self) -> None:
        """Forget every scan: start again from the initial pose."""
        p = self._parameters
        self._pose: FloatArray = np.array([p.initial_x, p.initial_y, p.initial_yaw])
        self._velocity: FloatArray = np.zeros(3)
        self._fix_stamp_ns: int | None = None
        self._doubt: SideDoubt | None = None
        self._half_turn_variance = 0.0
        self._background = Background()
        self._scan_stamp_ns: int | None = None

    def locate(
        self,
        stamp_ns: int,
        ranges: FloatArray,
        angle_min: float,
        angle_increment: float,
        time_increment: float,
    ) -> BoxFix | Rejection:
        """One scan: ranges (N,), m, counter-clockwise from ``angle_min``; ``stamp_ns``: of the first beam."""
        if ranges.ndim != 1 or ranges.size < 2 or not angle_increment > 0.0:
            return self._reject(Reason.MALFORMED)
        if self._scan_stamp_ns is not None and stamp_ns <= self._scan_stamp_ns:
            return self._reject(Reason.NOT_LATER)
        self._scan_stamp_ns = stamp_ns
        angles = angle_min + angle_increment * np.arange(ranges.size, dtype=np.float64)
        expected = self._expectation(stamp_ns)
        found = self._box_in(ranges, angles, expected)
        if isinstance(found, Reason):
            return self._reject(found)
        ambiguous = expected.yaw_reach > EIGHTH_TURN
        if ambiguous:
            turned = float(found.optimum.pose[2] - self._in_laser(expected.pose)[2])
            self._half_turn_variance += half_turn_variance(turned, expected.yaw_reach / SPREADS)
        else:  # sure enough that this is the box, and the rest is not
            self._background.learn(ranges, found.beams)
        optimum = self._sides_told(found, ambiguous=ambiguous)
        in_laser, covariance = posterior(optimum, self._box, found.beams, self._range_stddev)
        covariance[2, 2] += self._half_turn_variance
        if self._doubt is not None:
            shift = 0.5 * (self._box.length - self._box.width)  # of the centre, were the sides exchanged
            covariance += self._doubt.probability() * np.diag([shift, shift, self._doubt.turn]) ** 2
        stamp_ns += round(time_increment / NS * float(found.beams.indices.mean()))
        return self._accept(stamp_ns, in_laser, covariance)

    def _sides_told(self, found: _Candidate, *, ambiguous: bool) -> Optimum:
        """Raise or settle the doubt about the sides; the fit to believe."""
        self._doubt, optimum = found.doubt, found.optimum
        if ambiguous or self._doubt is None:
            return optimum
        turn = self._doubt.turn
        other = self._settled(optimum.pose[2] + turn, found.beams)
        self._doubt = self._doubt.after(optimum.chi2 - other.chi2)
        return optimum if self._doubt is None or self._doubt.turn == turn else other

    def _expectation(self, stamp_ns: int) -> _Expectation:
        """Constant velocity since the last fix, within what the vehicle can have moved.

        A lost vehicle is sought about its last place: the reach has grown with the time since then.
        """
        parameters = self._parameters
        if self._fix_stamp_ns is None:
            return _Expectation(self._pose, parameters.initial_reach, EIGHTH_TURN)
        elapsed = max(0.0, (stamp_ns - self._fix_stamp_ns) * NS)
        coasted = min(elapsed, parameters.coast_time) * self._velocity
        return _Expectation(
            self._pose + coasted,
            parameters.gate_distance + elapsed * parameters.top_speed,
            parameters.gate_yaw + elapsed * parameters.top_yaw_rate,
        )

    def _box_in(self, ranges: FloatArray, angles: FloatArray, expected: _Expectation) -> _Candidate | Reason:
        """The object most like the box near the prediction, or how far the best of the others came."""
        parts = clusters(ranges, angles, self._range_stddev, self._parameters.grazing_angle)
        whole = rejoined(parts, ranges, angles, self._box.diagonal + 3.0 * self._range_stddev)
        near = self._near(ranges, angles, expected)
        found: list[_Candidate] = []
        reasons = [Reason.NOTHING_NEAR]
        for indices in whole + parts:
            if not near[indices].any() or any(np.isin(indices, other.beams.indices).any() for other in found):
                continue
            beams = beams_on(indices, ranges, angles, self._box.diagonal, 3.0 * self._range_stddev)
            judged = self._judge(beams, expected, ranges, angles)
            if isinstance(judged, _Candidate):
                found.append(judged)
            else:
                self.tally.add("object", judged)
                reasons.append(judged)
        if found:
            return min(found, key=lambda candidate: candidate.distance)
        return max(reasons, key=list(Reason).index)

    def _judge(
        self, beams: Beams, expected: _Expectation, ranges: FloatArray, angles: FloatArray
    ) -> _Candidate | Reason:
        """Whether one object is the box."""
        points = beams.points()
        if len(beams.ranges) < self._parameters.minimum_beams:
            return Reason.FEW_BEAMS
        if np.linalg.norm(points[-1] - points[0]) > self._box.diagonal + 3.0 * self._range_stddev:
            return Reason.SIZE
        optimum, doubt = self._fitted(beams, expected)
        through = seen_through(optimum.pose, self._box, ranges, angles, 3.0 * self._range_stddev)
        if optimum.chi2 > self._limit(optimum.freedom) or through > SEEN_THROUGH * len(beams.ranges):
            return Reason.SHAPE
        if self._background.holds(ranges, beams, 3.0 * np.sqrt(2.0) * self._range_stddev):
            return Reason.BACKGROUND
        difference = self._in_odom(optimum.pose) - expected.pose
        distance = float(np.hypot(difference[0], difference[1]))
        if distance > expected.reach or abs(difference[2]) > expected.yaw_reach:
            return Reason.GATE
        return _Candidate(beams, optimum, doubt, distance)

    def _near(self, ranges: FloatArray, angles: FloatArray, expected: _Expectation) -> BoolArray:
        """(N,) which beams end where the box may be."""
        x, y = self._in_laser(expected.pose)[:2]
        with np.errstate(invalid="ignore"):  # no return straight ahead: ∞ sin 0
            away = np.hypot(ranges * np.cos(angles) - x, ranges * np.sin(angles) - y)
        near: BoolArray = away <= expected.reach + 0.5 * self._box.diagonal
        return near

    def _fitted(self, beams: Beams, expected: _Expectation) -> tuple[Optimum, SideDoubt | None]:
        """The likeliest fit, by half turns nearest to the prediction; the doubt about its sides.

        Within an eighth of a turn the prediction decides; beyond, the sides' lengths speak too.
        """
        heading = float(self._in_laser(expected.pose)[2])
        spread = expected.yaw_reach / SPREADS

        def nearest(middle: float) -> tuple[Optimum, float]:
            optimum = self._settled(middle, beams)
            turned = optimum.pose[2] - heading
            turned -= np.pi * np.round(turned / np.pi)
            pose = np.array([*optimum.pose[:2], heading + turned])
            return dataclasses.replace(optimum, pose=pose), (turned / spread) ** 2

        expected_fit, near = nearest(heading)
        if expected.yaw_reach <= EIGHTH_TURN:
            return expected_fit, self._doubt
        other_fit, far = nearest(heading + np.pi / 2.0)
        turn = float(np.copysign(np.pi / 2.0, other_fit.pose[2] - expected_fit.pose[2]))
        doubt = SideDoubt(turn, near - far).after(expected_fit.chi2 - other_fit.chi2)
        return (expected_fit if doubt is None or doubt.turn == turn else other_fit), doubt

    def _settled(self, heading: float, beams: Beams) -> Optimum:
        """The fit from the likeliest start about a heading, or from the next where that one gets stuck."""
        stuck: list[Optimum] = []
        for start in likely_starts(heading + QUARTER, self._box, beams, self._range_stddev):
            optimum = most_likely(start, self._box, beams, self._range_stddev)
            if optimum.chi2 <= self._limit(optimum.freedom):
                return optimum
            stuck.append(optimum)
        return min(stuck, key=lambda optimum: optimum.chi2)

    def _limit(self, freedom: int) -> float:
        """χ² above which a fit is refused."""
        return float(chdtri(freedom, 1.0 - self._parameters.fit_probability))

    def _accept(self, stamp_ns: int, in_laser: FloatArray, covariance: FloatArray) -> BoxFix:
        """Take the fix into the state, and give it for base_link in odom."""
        pose = self._in_odom(in_laser)
        self._velocity = self._velocity_after(stamp_ns, pose)
        self._pose, self._fix_stamp_ns = pose, stamp_ns
        jacobian = np.eye(3)
        jacobian[:2, :2] = self._laser_turn
        jacobian[:2, 2] = -_rotation(pose[2] + np.pi / 2.0) @ self._offset
        yaw = float(np.arctan2(np.sin(pose[2]), np.cos(pose[2])))
        return BoxFix(stamp_ns, float(pose[0]), float(pose[1]), yaw, jacobian @ covariance @ jacobian.T)

    def _velocity_after(self, stamp_ns: int, pose: FloatArray) -> FloatArray:
        """Corrected by a share of the fix's surprise; none from a fix that starts or restarts the track."""
        parameters = self._parameters
        if self._fix_stamp_ns is None:
            return np.zeros(3)
        step = max((stamp_ns - self._fix_stamp_ns) * NS, SHORTEST_STEP)
        surprise = pose - (self._pose + step * self._velocity)
        if step > parameters.coast_time or abs(surprise[2]) > EIGHTH_TURN:
            return np.zeros(3)
        velocity = self._velocity + parameters.velocity_gain / step * surprise
        limit = np.array([parameters.top_speed, parameters.top_speed, parameters.top_yaw_rate])
        return np.clip(velocity, -limit, limit)

    def _reject(self, reason: Reason) -> Rejection:
        self.tally.add("scan", reason)
        return Rejection(reason)

    def _in_laser(self, base: FloatArray) -> FloatArray:
        """Pose (3,) of the box in the laser frame from that of base_link in odom."""
        centre = base[:2] + _rotation(base[2]) @ self._offset
        return np.array(
            [*(self._laser_turn.T @ (centre - self._laser)), base[2] - self._parameters.laser_yaw]
        )

    def _in_odom(self, box: FloatArray) -> FloatArray:
        """Pose (3,) of base_link in odom from that of the box in the laser frame."""
        yaw = box[2] + self._parameters.laser_yaw
        place = self._laser + self._laser_turn @ box[:2] - _rotation(yaw) @ self._offset
        return np.array([*place, yaw])


def _rotation(angle: float) -> FloatArray:
    """(2, 2) matrix that turns by ``angle``, rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])
