# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Shear modulus and strength of the soil, from slip and thrust, as a distribution over a grid.

    K        shear deformation modulus                                     m
    F_max    maximal tractive effort of one track                          N
    u        track speed r ω                                               m/s
    τ        time after which the errors of slip are new ones              s
    w        weight of a sample of duration dt: dt/τ in turns; a straight is one sample
    n        effective samples: how many independent ones are remembered

    p ← (1 − h) p + h p₀        the soil may have changed on the way: h = 1 − e^(−distance/mean distance on
                                one soil)
    p ← p L^w                   L: of slips and thrusts in turns (``turn_likelihood``), of the distance that
                                a straight has cost (``straight``)

p₀ is flat in ln K and ln F_max. Where the ground stays, p sharpens for good; where it changes, the little
that flows back from p₀ grows to all of p within a few independent samples.
"""

import math
from enum import Enum

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.records import PoseWithCovariance
from trackslip_estimation.soil.shear_field import Contact, Rolling, carry, element_places
from trackslip_estimation.soil.straight import Hypotheses, StraightSegment
from trackslip_estimation.soil.strength_average import Average
from trackslip_estimation.soil.strength_grid import StrengthGrid
from trackslip_estimation.soil.strength_parameters import StrengthParameters
from trackslip_estimation.soil.strength_summary import StrengthSummary, summarize
from trackslip_estimation.soil.turn_likelihood import Turn, curves_of, squared_distances

_LEAST = 1e-300  # of a probability that is divided by


class SampleOutcome(Enum):
    """What became of an average."""

    GATHERED = "gathered"  # with the next ones, for a straight
    USED = "used"  # or it completed one, which was used
    STANDING = "standing"


class StrengthPosterior:
    """Recursive posterior over (ln K, ln F_max); both tracks share the soil."""

    def __init__(self, parameters: StrengthParameters, vehicle: Vehicle) -> None:
        p = self.parameters = parameters
        self.grid = StrengthGrid(p, vehicle)
        self._contact = Contact(element_places(vehicle.contact_length, p.elements), 0.5 * vehicle.tread)
        self._hypotheses = Hypotheses(self._contact, self.grid.moduli, self.grid.limits)
        self._nothing = np.ones(self.grid.shape)  # the likelihood where nothing was seen
        self.reset()

    def reset(self) -> None:
        """Know nothing."""
        shape = self.grid.shape
        self.cells = np.full(shape, 1.0 / math.prod(shape))
        """(moduli, limits) probability of each, before errors that never average; sums to 1"""
        self._age = np.zeros(shape)  # effective samples since the soil became that of the cell
        self.effective_samples = 0.0
        self.leave_ground()

    def leave_ground(self) -> None:
        """Where the tracks are now, nothing is known of what they did to the soil."""
        self._displacement = np.zeros((2, self.parameters.elements, 2))
        self._pose: PoseWithCovariance | None = None  # at the end of the last average
        self._halted = False  # since the straight
        self.break_segment()

    def break_segment(self) -> None:
        """What comes next does not go on from what was."""
        self._segment: StraightSegment | None = None

    def update(self, now: Average) -> SampleOutcome:
        """Use one average of slips and thrusts."""
        rolling, dt = Rolling(now["twist"], now["tracks"], float(now["lean"])), float(now["dt"])
        distance = abs(float(rolling.tracks.mean())) * dt
        change = -math.expm1(-distance / self.parameters.change_distance)
        self._bayes_update(self._nothing, 0.0, change)
        pose = PoseWithCovariance(now["pose"].copy(), now["pose_covariance"].copy())
        start, self._pose = self._pose or pose, pose
        stretch, stretch_stddev = float(now["stretch"]), float(now["stretch_stddev"])
        before = self._displacement
        self._displacement = carry(before, rolling, self._contact, dt)
        if now["motion"] == Motion.STANDING:
            self._halted = True
            if self._segment is not None:
                self._segment.set_end(pose, stretch, stretch_stddev)
            return SampleOutcome.STANDING
        thrust = float(now["force"].sum())
        straight = now["motion"] == Motion.STRAIGHT and math.isfinite(thrust)
        outcome = SampleOutcome.GATHERED if straight and not self._halted else self._evaluate_segment()
        self._halted = False
        if straight:
            self._segment = self._segment or StraightSegment(self._hypotheses, before, start)
            self._segment.add(dt, rolling, thrust, float(now["lean_stddev"]))
            self._segment.set_end(pose, stretch, stretch_stddev)
            is_long = self._segment.track_distance >= self.parameters.longest_straight
            return self._evaluate_segment() if is_long else outcome
        return self._evaluate_turn(now, rolling) if now["motion"] == Motion.TURNING else outcome

    def _evaluate_turn(self, now: Average, rolling: Rolling) -> SampleOutcome:
        """What slips and thrusts of a turn say of each soil."""
        p, tracks, shared = self.parameters, rolling.tracks, self._shared()
        force = np.where(np.abs(tracks) >= p.slowest_track, now["force"], np.nan)
        known = int(np.isfinite(force).sum())
        if not known:
            return SampleOutcome.GATHERED
        turn = Turn(
            self._displacement,
            rolling,
            self._root_of(now["twist_covariance"], tracks),
            force,
            now["variance"] + p.thrust_stddev**2 + (shared - 1.0) * now["swing_variance"],
            p.thrust_share_stddev * math.sqrt(shared),
            float(now["lean_stddev"]) * math.sqrt(shared),
        )
        squares = squared_distances(curves_of(turn, self._contact, self.grid.moduli), turn, self.grid.limits)
        self._learn(squares, known, min(float(now["dt"]) / p.correlation_time, 1.0))
        return SampleOutcome.USED

    def _evaluate_segment(self) -> SampleOutcome:
        """What the straight that has ended says of each soil."""
        p, segment, self._segment = self.parameters, self._segment, None
        if segment is None or segment.track_distance < p.shortest_straight:
            return SampleOutcome.GATHERED
        lost = segment.slip_distance()
        if abs(lost.measured) > p.most_straight_slip * segment.track_distance:
            return SampleOutcome.GATHERED  # tracks that spin are at the limit of the soil: not K's doing
        bias = p.slip_bias_stddev * segment.track_distance
        correlated = bias**2 + lost.of_lean**2
        variance = lost.variance + p.distance_stddev**2 + self._shared() * correlated
        self._learn((lost.measured - lost.expected) ** 2 / variance, 1, 1.0)
        return SampleOutcome.USED

    def _root_of(self, covariance: FloatArray, tracks: FloatArray) -> FloatArray:
        """Upper triangular factor of the twist's covariance, with what it does not know of."""
        p = self.parameters
        own = np.square((p.speed_stddev, p.speed_stddev, p.yaw_rate_stddev))
        slip = p.slip_bias_stddev * float(np.abs(tracks).mean())
        correlated = np.square((slip, 0.0, slip / self._contact.half_tread))
        whole = covariance + np.diag(own + self._shared() * correlated)
        return np.ascontiguousarray(np.linalg.cholesky(whole[::-1, ::-1])[::-1, ::-1])

    def _shared(self) -> float:
        """How many samples share an error that lasts: it enters each of them as often.

        Together they then are worth hardly more than one sample with this error alone. No more than
        ``correlated_samples``, lest after a long drive another soil be taken for such an error.
        """
        return 1.0 + min(self.effective_samples, self.parameters.correlated_samples)

    def _learn(self, squares: FloatArray, known: int, weight: float) -> None:
        """Student-t likelihood of ``squares`` (moduli, limits), of so many known numbers."""
        degrees = self.parameters.degrees_of_freedom
        log = -0.5 * (degrees + known) * np.log1p(squares / degrees)
        self._bayes_update(np.exp(weight * (log - log.max())), weight, 0.0)

    def _bayes_update(self, likelihood: FloatArray, weight: float, change: float) -> None:
        """Both lines of the recursion, and for how long the soil of each cell has been there."""
        self.effective_samples = float(_bayes_update(self.cells, self._age, likelihood, weight, change))

    def summary(self) -> StrengthSummary:
        """Medians, intervals, and whether they say something."""
        return summarize(self.grid, self.cells, self.effective_samples)


@compiled
def _bayes_update(
    cells: FloatArray, age: FloatArray, likelihood: FloatArray, weight: float, change: float
) -> float:
    """p and the age of each cell (moduli, limits), in place; their mean age, which is n."""
    replaced, total, aged = change / cells.size, 0.0, 0.0
    for a in range(cells.shape[0]):
        for b in range(cells.shape[1]):
            kept = (1.0 - change) * cells[a, b] * likelihood[a, b]
            cells[a, b] = kept + replaced * likelihood[a, b]
            age[a, b] = age[a, b] * np.divide(kept, max(cells[a, b], _LEAST)) + weight
            total += cells[a, b]
    for a in range(cells.shape[0]):
        for b in range(cells.shape[1]):
            cells[a, b] /= total
            aged += cells[a, b] * age[a, b]
    return aged
