# SPDX-License-Identifier: Apache-2.0
"""Which object of a scan is the box: cut the scan into objects, fit the box to each, keep the one expected.

    Δ  heading of a fit less the expected one  rad

A rectangle looks the same after half a turn and nearly so after a quarter: the heading is the one nearest
to that expected, unless that has grown too uncertain and the sides' lengths are evidence too (``sides.py``).
"""

import dataclasses
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from trackslip_common.tally import Tally
from trackslip_common.vehicle import Box
from trackslip_estimation.box.background import Background
from trackslip_estimation.box.clusters import Beams, beams_on, clusters, rejoined
from trackslip_estimation.box.fit import Optimum, Rectangle, likely_starts, most_likely, seen_through
from trackslip_estimation.box.frames import Frames
from trackslip_estimation.box.parameters import BoxLocalizerParameters
from trackslip_estimation.box.sides import SideDoubt
from trackslip_estimation.box.track import EIGHTH_TURN, Expectation

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

QUARTER = np.linspace(-EIGHTH_TURN, EIGHTH_TURN, 25)
SPREADS = 3.0  # standard deviations in the reach of the heading
SEEN_THROUGH = 0.2  # share of its beams that may go on behind a box: those beside an end that is not seen


class Reason(Enum):
    """Why a scan or an object in it gave no fix; in the order of how far it came."""

    MALFORMED = "malformed"
    NOT_LATER = "not_later_than_the_scan_before"
    AHEAD = "stamp_ahead"  # and not (yet) confirmed by those that follow
    NOTHING_NEAR = "nothing_near_the_prediction"
    FEW_BEAMS = "few_beams"
    TOO_NEAR = "too_near_the_laser"
    SIZE = "larger_than_the_box"
    SHAPE = "not_the_shape_of_the_box"
    BACKGROUND = "was_there_before"
    GATE = "too_far_from_the_prediction"


@dataclass(frozen=True, eq=False)
class Candidate:
    """An object that can be the box; distance: of its fit from the expected pose, m."""

    beams: Beams
    optimum: Optimum
    doubt: SideDoubt | None
    distance: float


class BoxSearch:
    """Fits the box to the objects of a scan. Remembers the background, and counts objects refused."""

    def __init__(self, p: BoxLocalizerParameters, box: Box, tally: Tally) -> None:
        self._parameters = p
        self._tally = tally
        self._frames = Frames(p, box)
        self.box = Rectangle(box.length, box.width)
        self.range_stddev = float(np.hypot(p.range_stddev, p.range_resolution / np.sqrt(12.0)))
        self.background = Background()

    def find(self, ranges: FloatArray, angles: FloatArray, expected: Expectation) -> Candidate | Reason:
        """The object most like the box near the expected pose, or how far the best of the others came."""
        reach = self.box.diagonal + 3.0 * self.range_stddev
        parts = clusters(ranges, angles, self.range_stddev, self._parameters.grazing_angle)
        near = self._near(ranges, angles, expected)
        found: list[Candidate] = []
        reasons = [Reason.NOTHING_NEAR]
        for indices in rejoined(parts, ranges, angles, reach) + parts:
            if not near[indices].any() or any(np.isin(indices, other.beams.indices).any() for other in found):
                continue
            beams = beams_on(indices, ranges, angles, self.box.diagonal, 3.0 * self.range_stddev)
            outcome = self._evaluate(beams, expected, ranges, angles)
            if isinstance(outcome, Candidate):
                found.append(outcome)
            else:
                self._tally.add("object", outcome)
                reasons.append(outcome)
        if found:
            return min(found, key=lambda candidate: candidate.distance)
        return max(reasons, key=list(Reason).index)

    def _evaluate(
        self, beams: Beams, expected: Expectation, ranges: FloatArray, angles: FloatArray
    ) -> Candidate | Reason:
        """Whether one object is the box."""
        points = beams.points()
        if len(beams.ranges) < self._parameters.minimum_beams:
            return Reason.FEW_BEAMS
        if np.linalg.norm(points[-1] - points[0]) > self.box.diagonal + 3.0 * self.range_stddev:
            return Reason.SIZE
        if beams.ranges.min() < 0.5 * self.box.diagonal:  # then the laser could be within the box fitted
            return Reason.TOO_NEAR
        optimum, doubt = self._fitted(beams, expected)
        through = seen_through(optimum.pose, self.box, ranges, angles, 3.0 * self.range_stddev)
        if not optimum.chi2 <= self._limit(optimum.freedom) or through > SEEN_THROUGH * len(beams.ranges):
            return Reason.SHAPE
        if self.background.holds(ranges, beams, 3.0 * np.sqrt(2.0) * self.range_stddev):
            return Reason.BACKGROUND
        difference = self._frames.odom_from_laser(optimum.pose) - expected.pose
        distance = float(np.hypot(difference[0], difference[1]))
        if distance > expected.reach or abs(difference[2]) > expected.yaw_reach:
            return Reason.GATE
        return Candidate(beams, optimum, doubt, distance)

    def _near(self, ranges: FloatArray, angles: FloatArray, expected: Expectation) -> BoolArray:
        """(N,) which beams end where the box may be."""
        x, y = self._frames.laser_from_odom(expected.pose)[:2]
        with np.errstate(invalid="ignore"):  # no return straight ahead: ∞ sin 0
            away = np.hypot(ranges * np.cos(angles) - x, ranges * np.sin(angles) - y)
        near: BoolArray = away <= expected.reach + 0.5 * self.box.diagonal
        return near

    def _fitted(self, beams: Beams, expected: Expectation) -> tuple[Optimum, SideDoubt | None]:
        """The likeliest fit, by half turns nearest to the expected heading; the doubt about its sides.

        Within an eighth of a turn the expectation decides; beyond, the sides' lengths are evidence too.
        """
        heading = float(self._frames.laser_from_odom(expected.pose)[2])
        spread = expected.yaw_reach / SPREADS

        def nearest(middle: float) -> tuple[Optimum, float]:
            optimum = self.settled(middle, beams)
            turned = optimum.pose[2] - heading
            turned -= np.pi * np.round(turned / np.pi)
            pose = np.array([*optimum.pose[:2], heading + turned])
            return dataclasses.replace(optimum, pose=pose), (turned / spread) ** 2

        expected_fit, near = nearest(heading)
        if not expected.is_ambiguous:
            return expected_fit, expected.doubt
        other_fit, far = nearest(heading + np.pi / 2.0)
        turn = float(np.copysign(np.pi / 2.0, other_fit.pose[2] - expected_fit.pose[2]))
        doubt = SideDoubt(turn, near - far).after(expected_fit.chi2 - other_fit.chi2)
        return (expected_fit if doubt is None or doubt.turn == turn else other_fit), doubt

    def settled(self, heading: float, beams: Beams) -> Optimum:
        """The fit from the likeliest start about a heading, or from the next where that one gets stuck."""
        stuck: list[Optimum] = []
        for start in likely_starts(heading + QUARTER, self.box, beams, self.range_stddev):
            optimum = most_likely(start, self.box, beams, self.range_stddev)
            if optimum.chi2 <= self._limit(optimum.freedom):
                return optimum
            stuck.append(optimum)
        return min(stuck, key=lambda optimum: optimum.chi2)

    def _limit(self, freedom: int) -> float:
        """χ² above which a fit is refused."""
        return float(chdtri(freedom, 1.0 - self._parameters.fit_probability))
