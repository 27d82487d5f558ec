# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Posterior of shear modulus and strength of the soil over a grid, from slip and thrust.

    K        shear deformation modulus                                     m
    F_max    maximal tractive effort of one track                          N
    u        track speed r ω                                               m/s
    τ        correlation time of slip errors in turns                      s
    w        weight of a sample of duration dt: dt/τ in turns; a straight is one sample
    n        effective samples: number of independent ones remembered

    p ← (1 − h) p + h p₀        the soil may have changed: h = 1 − e^(−distance/mean distance on one soil)
    p ← p L^w                   L: likelihood of slips and thrusts in turns (``turn_likelihood``), of the slip
                                distance of a straight (``straight``)

p₀ is flat in ln K and ln F_max. On constant ground p narrows. After a change of the soil, the share of p that
came from p₀ dominates within a few independent samples.
"""

import math

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.covariance import ROUNDING
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.records import PoseWithCovariance
from trackslip_estimation.soil.shear_field import Contact, Rolling, propagate_displacement
from trackslip_estimation.soil.straight import Hypotheses, StraightSegment
from trackslip_estimation.soil.strength_average import Average
from trackslip_estimation.soil.strength_grid import StrengthGrid
from trackslip_estimation.soil.strength_parameters import StrengthParameters
from trackslip_estimation.soil.strength_summary import StrengthSummary, summarise_cells
from trackslip_estimation.soil.turn_likelihood import Turn, squared_distances, thrust_curves
from trackslip_estimation.terramechanics.elements import element_positions

_LEAST_PROBABILITY = 1e-300  # least probability as a divisor


class StrengthPosterior:
    """Recursive posterior over (ln K, ln F_max); both tracks share the soil."""

    def __init__(self, parameters: StrengthParameters, vehicle: Vehicle) -> None:
        p = self.parameters = parameters
        self.grid = StrengthGrid(p, vehicle)
        self._contact = Contact(element_positions(vehicle.contact_length, p.elements), 0.5 * vehicle.tread)
        self._hypotheses = Hypotheses(self._contact, self.grid.moduli, self.grid.limits)
        self._nothing = np.ones(self.grid.shape)  # likelihood without a measurement
        self.reset()

    def reset(self) -> None:
        """Reset to the prior."""
        shape = self.grid.shape
        self.cells = np.full(shape, 1.0 / math.prod(shape))
        """(moduli, limits) probability of each, before errors that never average; sums to 1"""
        self._age = np.zeros(shape)  # effective samples since the soil changed to that of the cell
        self.effective_samples = 0.0
        self.reset_displacement()

    def reset_displacement(self) -> None:
        """Reset the shear displacement and the segment: the motion of the tracks is unknown."""
        self._displacement = np.zeros((2, self.parameters.elements, 2))
        self._pose: PoseWithCovariance | None = None  # at the end of the last average
        self._halted = False  # whether the last average was at standstill
        self.break_segment()

    def break_segment(self) -> None:
        """Discard the straight in progress."""
        self._segment: StraightSegment | None = None

    def update(self, now: Average) -> None:
        """Update with one average of slips and thrusts."""
        rolling, dt = Rolling(now["twist"], now["tracks"], float(now["lean"])), float(now["dt"])
        distance = abs(float(rolling.tracks.mean())) * dt
        change = -math.expm1(-distance / self.parameters.change_distance)
        self._bayes_update(self._nothing, 0.0, change)
        pose = PoseWithCovariance(now["pose"].copy(), now["pose_covariance"].copy())
        start, self._pose = self._pose or pose, pose
        stretch, stretch_stddev = float(now["stretch"]), float(now["stretch_stddev"])
        before = self._displacement
        self._displacement = propagate_displacement(before, rolling, self._contact, dt)
        if now["motion"] == Motion.STANDING:
            self._halted = True
            if self._segment is not None:
                self._segment.set_end(pose, stretch, stretch_stddev)
            return
        thrust = float(now["force"].sum())
        is_straight = now["motion"] == Motion.STRAIGHT and math.isfinite(thrust)
        if self._halted or not is_straight:
            self._evaluate_segment()
        self._halted = False
        if is_straight:
            self._segment = self._segment or StraightSegment(self._hypotheses, before, start)
            self._segment.add(dt, rolling, thrust, float(now["lean_stddev"]))
            self._segment.set_end(pose, stretch, stretch_stddev)
            if self._segment.track_distance >= self.parameters.longest_straight:
                self._evaluate_segment()
        elif now["motion"] == Motion.TURNING:
            self._evaluate_turn(now, rolling)

    def _evaluate_turn(self, now: Average, rolling: Rolling) -> None:
        """Update with the slips and thrusts of a turn."""
        p, tracks, shared = self.parameters, rolling.tracks, self._shared_samples()
        force = np.where(np.abs(tracks) >= p.slowest_track, now["force"], np.nan)
        count = int(np.isfinite(force).sum())
        if not count:
            return
        turn = Turn(
            self._displacement,
            rolling,
            self._covariance_root(now["twist_covariance"], tracks),
            force,
            now["variance"] + p.thrust_stddev**2 + (shared - 1.0) * now["swing_variance"],
            p.thrust_share_stddev * math.sqrt(shared),
            float(now["lean_stddev"]) * math.sqrt(shared),
        )
        squares = squared_distances(
            thrust_curves(turn, self._contact, self.grid.moduli), turn, self.grid.limits
        )
        self._update_cells(squares, count, min(float(now["dt"]) / p.correlation_time, 1.0))

    def _evaluate_segment(self) -> None:
        """Update with the slip distance of the straight that has ended."""
        p, segment, self._segment = self.parameters, self._segment, None
        if segment is None or segment.track_distance < p.shortest_straight:
            return
        slip_distance = segment.slip_distance()
        if abs(slip_distance.measured) > p.most_straight_slip * segment.track_distance:
            return  # spinning tracks are at the limit of the soil: independent of K
        bias = p.slip_bias_stddev * segment.track_distance
        correlated = bias**2 + slip_distance.of_lean**2
        variance = slip_distance.variance + p.distance_stddev**2 + self._shared_samples() * correlated
        self._update_cells((slip_distance.measured - slip_distance.expected) ** 2 / variance, 1, 1.0)

    def _covariance_root(self, covariance: FloatArray, tracks: FloatArray) -> FloatArray:
        """Return the upper triangular root of the twist's covariance, with least variances and slip bias."""
        p = self.parameters
        least_variances = np.square((p.speed_stddev, p.speed_stddev, p.yaw_rate_stddev))
        slip = p.slip_bias_stddev * float(np.abs(tracks).mean())
        bias_variances = np.square((slip, 0.0, slip / self._contact.half_tread))
        rounding = 4.0 * ROUNDING * np.diag(covariance)  # by which it may be asymmetric and indefinite
        whole = covariance + np.diag(least_variances + rounding + self._shared_samples() * bias_variances)
        return np.ascontiguousarray(np.linalg.cholesky(whole[::-1, ::-1])[::-1, ::-1])

    def _shared_samples(self) -> float:
        """Return the number of samples that share a time-correlated error: the factor of its variance.

        Together these samples then carry hardly more information than one sample with this error alone. The
        bound ``correlated_samples`` keeps a change of soil after a long drive from passing for such an error.
        """
        return 1.0 + min(self.effective_samples, self.parameters.correlated_samples)

    def _update_cells(self, squares: FloatArray, count: int, weight: float) -> None:
        """Update by the Student-t likelihood of ``squares`` (moduli, limits), of ``count`` measurements."""
        degrees = self.parameters.degrees_of_freedom
        log = -0.5 * (degrees + count) * np.log1p(squares / degrees)
        self._bayes_update(np.exp(weight * (log - log.max())), weight, 0.0)

    def _bayes_update(self, likelihood: FloatArray, weight: float, change: float) -> None:
        """Apply both equations of the recursion; update the ages of the cells and n."""
        self.effective_samples = float(_bayes_update(self.cells, self._age, likelihood, weight, change))

    def summary(self) -> StrengthSummary:
        """Return medians, intervals, and whether they are identifiable."""
        return summarise_cells(self.grid, self.cells, self.effective_samples)


@compiled
def _bayes_update(
    cells: FloatArray, age: FloatArray, likelihood: FloatArray, weight: float, change: float
) -> float:
    """Update p and the age of each cell (moduli, limits) in place; return their mean age, n."""
    replaced, total, aged = change / cells.size, 0.0, 0.0
    for a in range(cells.shape[0]):
        for b in range(cells.shape[1]):
            unchanged = (1.0 - change) * cells[a, b] * likelihood[a, b]
            cells[a, b] = unchanged + replaced * likelihood[a, b]
            age[a, b] = age[a, b] * np.divide(unchanged, max(cells[a, b], _LEAST_PROBABILITY)) + weight
            total += cells[a, b]
    for a in range(cells.shape[0]):
        for b in range(cells.shape[1]):
            cells[a, b] /= total
            aged += cells[a, b] * age[a, b]
    return aged
