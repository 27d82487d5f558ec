# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Search for the box in a scan: segment it into objects, fit the box to each, gate by the expected pose.

A rectangle looks the same after half a turn and nearly so after a quarter. If the expected heading does not
resolve this, the box is fitted both ways, and ``heading_ambiguity.py`` weights the two.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.special import chdtri

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_common.tally import Tally
from trackslip_common.vehicle import Box
from trackslip_estimation.box.background import Background
from trackslip_estimation.box.clusters import (
    Beams,
    IndexArray,
    object_beams,
    rejoin_parts,
    segment_scan,
    split_at_gaps,
)
from trackslip_estimation.box.fit import Optimum, count_beams_through, fit_pose, likely_starting_poses
from trackslip_estimation.box.frames import Frames
from trackslip_estimation.box.heading_ambiguity import QUARTER_TURN, sides_are_known
from trackslip_estimation.box.measurement_model import Rectangle
from trackslip_estimation.box.parameters import BoxLocalizerParameters
from trackslip_estimation.box.track import Expectation

HEADING_OFFSETS = np.linspace(-0.5 * QUARTER_TURN, 0.5 * QUARTER_TURN, 25)


class Reason(Enum):
    """Why a scan or an object in it gave no fix; in the order of the checks."""

    MALFORMED = "malformed"
    NOT_LATER = "not_later_than_the_scan_before"
    AHEAD = "stamp_ahead"  # and not (yet) confirmed by the following stamps
    NOTHING_NEAR = "nothing_near_the_prediction"
    BACKGROUND = "was_there_before"
    FEW_BEAMS = "few_beams"
    TOO_NEAR = "too_near_the_laser"
    SIZE = "larger_than_the_box"
    SHAPE = "not_the_shape_of_the_box"
    GATE = "too_far_from_the_prediction"
    UNCERTAIN = "one_of_several_places"  # found, but perhaps another object


@dataclass(frozen=True, eq=False)
class Candidate:
    """An object that can be the box.

    fits: within an eighth of a turn of the expected heading and, if ambiguous, of a quarter turn from it;
    position: (2,) of base_link in odom by the better fit, m; distance: from the expected position, m;
    is_new: whether the object is new: the laser measured behind it before, or the box.
    """

    beams: Beams
    fits: list[Optimum]
    position: FloatArray
    distance: float
    is_new: bool


class BoxSearch:
    """Fits the box to the objects of a scan in front of a background; counts rejected objects."""

    def __init__(self, p: BoxLocalizerParameters, box: Box, tally: Tally) -> None:
        self._parameters = p
        self._tally = tally
        self._frames = Frames(p, box)
        self.box = Rectangle(box.length, box.width)
        self.range_stddev = float(np.hypot(p.range_stddev, p.range_resolution / np.sqrt(12.0)))
        self._margin = 3.0 * self.range_stddev  # largest error of a range, m
        self._range_margin = float(3.0 * np.sqrt(2.0) * self.range_stddev)  # of the difference of two, m
        self._largest_extent = self.box.diagonal + self._margin
        self.background = Background.empty()

    def find_candidates(
        self, ranges: FloatArray, angles: FloatArray, expected: Expectation
    ) -> list[Candidate] | Reason:
        """Return the objects near the expected pose that can be the box, or the last check reached.

        The background is cut off: a post beside the box would lengthen or rotate it.
        """
        is_background = self.background.matching_beams(ranges, angles, self._range_margin)
        parts = [
            part
            for cluster in segment_scan(ranges, angles, self.range_stddev, self._parameters.grazing_angle)
            for part in split_at_gaps(cluster, is_background[cluster][1:] != is_background[cluster][:-1])
        ]
        near = self._beams_near(ranges, angles, expected)
        candidates: list[Candidate] = []
        reasons = [Reason.NOTHING_NEAR]
        for indices in rejoin_parts(parts, ranges, angles, self._largest_extent) + parts:
            if not near[indices].any() or any(
                np.isin(indices, other.beams.indices).any() for other in candidates
            ):
                continue
            outcome: Candidate | Reason = Reason.BACKGROUND
            if 2 * np.count_nonzero(is_background[indices]) <= len(indices):
                outcome = self._evaluate_object(indices, expected, ranges, angles)
            if isinstance(outcome, Candidate):
                candidates.append(outcome)
            else:
                self._tally.add("object", outcome)
                reasons.append(outcome)
        return candidates or max(reasons, key=list(Reason).index)

    def _evaluate_object(
        self, indices: IndexArray, expected: Expectation, ranges: FloatArray, angles: FloatArray
    ) -> Candidate | Reason:
        """Return the candidate if an object can be the box, else why not."""
        if len(indices) < self._parameters.minimum_beams:
            return Reason.FEW_BEAMS
        beams = object_beams(indices, ranges, angles, self.box.diagonal, self._margin)
        if beams.extent() > self._largest_extent:
            return Reason.SIZE
        if beams.ranges.min() < 0.5 * self.box.diagonal:  # then the laser could be within the box fitted
            return Reason.TOO_NEAR
        fits = self._fit_headings(beams, expected)
        best = min(fits, key=lambda fit: fit.chi2)
        through = count_beams_through(best.pose, self.box, ranges, angles, self._margin)
        is_explained = self._is_explained(best, self._parameters.fit_probability)
        if not is_explained or through > self._parameters.seen_through * len(beams.ranges):
            return Reason.SHAPE
        pose = self._frames.odom_from_laser(best.pose)
        difference = pose - expected.pose
        distance = float(np.hypot(difference[0], difference[1]))
        turned = abs(difference[2] - QUARTER_TURN * np.round(difference[2] / QUARTER_TURN))
        if distance > expected.reach or turned > expected.yaw_reach:
            return Reason.GATE
        at_new_objects = self.background.new_object_beams(ranges, angles, self._range_margin)[indices]
        is_new = 2 * int(np.count_nonzero(at_new_objects)) > len(indices)
        return Candidate(beams, fits, pose[:2], distance, is_new)

    def _beams_near(self, ranges: FloatArray, angles: FloatArray, expected: Expectation) -> BoolArray:
        """Return which beams (N,) end where the box may be."""
        x, y = self._frames.laser_from_odom(expected.pose)[:2]
        with np.errstate(invalid="ignore"):  # no return straight ahead: ∞ sin 0
            distance = np.hypot(ranges * np.cos(angles) - x, ranges * np.sin(angles) - y)
        near: BoolArray = distance <= expected.reach + 0.5 * self.box.diagonal
        return near

    def _fit_headings(self, beams: Beams, expected: Expectation) -> list[Optimum]:
        """Return the fit about the expected heading and, if ambiguous, that about a quarter turn from it."""
        heading = float(self._frames.laser_from_odom(expected.pose)[2])
        first = self.fit_near_heading(heading, beams)
        variance = expected.yaw_variance + min(float(np.linalg.inv(first.information)[2, 2]), 1.0)
        if sides_are_known(float(first.pose[2]) - heading, variance, expected.headings.weights):
            return [first]
        return [first, self.fit_near_heading(heading + QUARTER_TURN, beams)]

    def fit_near_heading(self, middle: float, beams: Beams) -> Optimum:
        """Return the first good fit within an eighth of a turn of ``middle``, else the best of all starts."""
        starts = likely_starting_poses(middle + HEADING_OFFSETS, self.box, beams, self.range_stddev)
        poor_fits: list[Optimum] = []
        for start in starts:
            optimum = fit_pose(start, self.box, beams, self.range_stddev)
            if abs(optimum.pose[2] - middle) <= 0.5 * QUARTER_TURN:
                if self._is_explained(optimum, self._parameters.good_fit):
                    return optimum
                poor_fits.append(optimum)
        if not poor_fits:  # all have left this eighth of a turn
            return fit_pose(starts[0], self.box, beams, self.range_stddev, steps=0)
        return min(poor_fits, key=lambda optimum: optimum.chi2)

    @staticmethod
    def _is_explained(optimum: Optimum, probability: float) -> bool:
        """Whether its χ² is within the quantile of this probability."""
        return optimum.chi2 <= float(chdtri(optimum.freedom, 1.0 - probability))
