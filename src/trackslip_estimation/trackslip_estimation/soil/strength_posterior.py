# SPDX-License-Identifier: Apache-2.0
"""Shear modulus and strength of the soil, from slip and thrust, as a distribution over a grid.

    K        shear deformation modulus                                     m
    F_max    maximal tractive effort of one track                          N
    u        track speed r ω                                               m/s
    τ        time after which the errors of slip are new ones              s
    w        weight of a sample of duration dt: dt/τ in turns; a straight is one sample
    n        effective samples: how many independent ones are remembered

    p ← (1 − h) p + h p₀        the soil may have changed on the way: h = 1 − e^(−way/mean way on one soil)
    p ← p L^w                   L: of slips and thrusts in turns (``strength_grid``), of the way that a
                                straight has cost (``straight``)

p₀ is flat in ln K and ln F_max. Where the ground stays, p sharpens for good; where it changes, the little
that flows back from p₀ grows to all of p within a few independent samples.
"""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from trackslip_common.vehicle import Vehicle
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.records import Place
from trackslip_estimation.soil.shear_field import carry
from trackslip_estimation.soil.straight import Hypotheses, Straight
from trackslip_estimation.soil.strength_grid import NODES, log_likelihood
from trackslip_estimation.soil.strength_parameters import StrengthParameters

FloatArray = NDArray[np.float64]

LOW, MEDIAN, HIGH = 0.05, 0.5, 0.95
_LARGEST = 1e6  # m/s, and what else there is but thrusts: beyond it is no measurement
_LARGEST_THRUST = 1e9  # N
_EDGE = 1.2  # how near an interval may come to an end of the grid
_LONGEST = 1.0  # s between two samples; beyond it, what the tracks did meanwhile is not known


class Use(Enum):
    """What became of a sample."""

    GATHERED = "gathered"  # with the next ones: for an average, or a straight
    USED = "used"  # it completed either, which was used
    STANDING = "standing"
    INVALID = "invalid"  # not finite, a covariance that is none, or a duration out of range


@dataclass(frozen=True, eq=False)
class StrengthSample:
    """What the slip estimator and the pressures say of one moment."""

    dt: float  # s since the sample before
    tracks: FloatArray  # (2,) track speeds r ω, left and right, m/s
    twist: FloatArray  # (3,) v_x, v_y, yaw rate at C
    twist_covariance: FloatArray  # (3, 3)
    thrusts: FloatArray  # (2,) of the soil on each track, resistance included, N; nan where not known
    thrust_variances: FloatArray  # (2,) N²
    motion: Motion
    place: Place


@dataclass(frozen=True)
class StrengthSummary:
    """The posterior in numbers: medians, and the interval from 5 to 95 %."""

    shear_modulus: float  # m
    shear_modulus_interval: tuple[float, float]
    thrust_limit: float  # N
    thrust_limit_interval: tuple[float, float]
    effective_samples: float
    identifiable: bool
    reason: str  # why not; empty where it is


class StrengthPosterior:
    """Recursive posterior over (ln K, ln F_max); both tracks share the soil."""

    def __init__(self, parameters: StrengthParameters, vehicle: Vehicle) -> None:
        p = self.parameters = parameters
        lowest, highest = p.lowest_limit * vehicle.weight, p.highest_limit * vehicle.weight
        self._modulus_edges = _edges(p.lowest_modulus, p.highest_modulus, p.modulus_cells)
        self._limit_edges = _edges(lowest, highest, p.limit_cells)
        self.log_moduli, self.log_limits = _centres(self._modulus_edges), _centres(self._limit_edges)
        self._moduli, self._limits = np.exp(self.log_moduli), np.exp(self.log_limits)
        lasting = p.slip_bias_stddev * vehicle.contact_length / self._moduli
        self._modulus_blur = _blur(self.log_moduli, lasting)
        self._limit_blur = _blur(self.log_limits, np.full(p.limit_cells, p.thrust_scale_stddev))
        self._prior = np.full((p.modulus_cells, p.limit_cells), 1.0 / (p.modulus_cells * p.limit_cells))
        self._hypotheses = Hypotheses(vehicle, p.elements, self._moduli, self._limits)
        self._x_e, self._half_tread = self._hypotheses.x_e, self._hypotheses.half_tread
        self.reset()

    def reset(self) -> None:
        """Know nothing."""
        self._grid = self._prior.copy()
        self._age = np.zeros_like(self._grid)  # effective samples since the soil became that of the cell
        self.effective_samples = 0.0
        self._leave_ground()

    def _leave_ground(self) -> None:
        self._displacement = np.zeros((2, self.parameters.elements, 2))
        self._time, self._sum = 0.0, np.zeros(18)
        self._straight: Straight | None = None
        self._place: Place | None = None  # at the end of the last average
        self._halted = False  # since the straight

    def update(self, sample: StrengthSample) -> Use:
        """Use one sample of slip and thrust."""
        if not _is_usable(sample):
            self._straight = None
            if not 0.0 < sample.dt <= _LONGEST:
                self._leave_ground()
            return Use.INVALID
        self._time += sample.dt
        self._sum += sample.dt * np.concatenate(
            (
                sample.tracks,
                sample.twist,
                sample.thrusts,
                sample.thrust_variances,
                sample.twist_covariance.ravel(),
            )
        )
        if self._time < self.parameters.interval * (1.0 - 1e-6):
            return Use.GATHERED
        tracks, twist, thrusts, variances, covariance = np.split(self._sum / self._time, (2, 5, 7, 9))
        dt, self._time, self._sum = self._time, 0.0, np.zeros(18)
        likely = (np.abs(thrusts) < _LARGEST_THRUST) & (variances > 0.0) & (variances < _LARGEST_THRUST**2)
        thrusts = np.where(likely, thrusts, np.nan)
        average = StrengthSample(
            dt, tracks, twist, covariance.reshape(3, 3), thrusts, variances, sample.motion, sample.place
        )
        return self._use(average)

    def _use(self, now: StrengthSample) -> Use:
        """An average."""
        p = self.parameters
        way = abs(float(now.tracks.mean())) * now.dt
        self._learn(np.zeros_like(self._grid), 0.0, -math.expm1(-way / p.change_distance))
        start, self._place = self._place or now.place, now.place
        before, x_e, half = self._displacement, self._x_e, self._half_tread
        self._displacement = carry(before, now.twist, now.tracks, x_e, half, now.dt)
        if now.motion is Motion.STANDING:
            self._halted = True
            if self._straight is not None:
                self._straight.arrive(now.place)
            return Use.STANDING
        straight = now.motion is Motion.STRAIGHT and bool(np.isfinite(now.thrusts).all())
        use = Use.GATHERED if straight and not self._halted else self._judge()
        self._halted = False
        if straight:
            self._straight = self._straight or Straight(self._hypotheses, before, start)
            self._straight.roll(now.dt, now.tracks, now.twist, float(now.thrusts.sum()), now.place)
            return self._judge() if self._straight.rolled >= p.longest_straight else use
        return self._turn(now) if now.motion is Motion.TURNING else use

    def _turn(self, now: StrengthSample) -> Use:
        """Slips and thrusts of a turn tell by themselves."""
        p = self.parameters
        thrusts = np.where(np.abs(now.tracks) >= p.slowest_track, now.thrusts, np.nan)
        if not np.isfinite(thrusts).any():
            return Use.GATHERED
        weight = min(now.dt / p.correlation_time, 1.0)
        log = log_likelihood(
            self._displacement,
            now.twist,
            self._spread(now.twist_covariance, now.tracks),
            now.tracks,
            thrusts,
            now.thrust_variances + p.thrust_stddev**2,
            self._x_e,
            self._half_tread,
            self._moduli,
            self._limits,
            NODES,
            p.thrust_share_stddev * math.sqrt(self._shared()),
            p.degrees_of_freedom,
        )
        self._learn(weight * log, weight, 0.0)
        return Use.USED

    def _judge(self) -> Use:
        """What the straight that has ended says of each soil."""
        p, straight, self._straight = self.parameters, self._straight, None
        if straight is None or straight.rolled < p.shortest_straight:
            return Use.GATHERED
        lost = straight.lost()
        bias = p.slip_bias_stddev * straight.rolled
        variance = lost.variance + p.way_stddev**2 + self._shared() * bias**2
        squares = (lost.measured - lost.expected) ** 2 / variance
        degrees = p.degrees_of_freedom
        self._learn(-0.5 * (degrees + 1.0) * np.log1p(squares / degrees), 1.0, 0.0)
        return Use.USED

    def _spread(self, covariance: FloatArray, tracks: FloatArray) -> FloatArray:
        """Upper triangular factor of the twist's covariance, with what it does not know of."""
        p = self.parameters
        own = np.square((p.speed_stddev, p.speed_stddev, p.yaw_rate_stddev))
        slip = p.slip_bias_stddev * float(np.abs(tracks).mean())
        lasting = np.square((slip, 0.0, slip / self._half_tread))
        whole = covariance + np.diag(own + self._shared() * lasting)
        return np.ascontiguousarray(np.linalg.cholesky(whole[::-1, ::-1])[::-1, ::-1])

    def _shared(self) -> float:
        """How many samples share an error that lasts: it enters each of them as often.

        Together they then are worth hardly more than one sample with this error alone. No more than
        ``lasting_samples``, lest after a long drive another soil be taken for such an error.
        """
        return 1.0 + min(self.effective_samples, self.parameters.lasting_samples)

    def _learn(self, log: FloatArray, weight: float, change: float) -> None:
        """Both lines of the recursion, and for how long the soil of each cell has been there."""
        likelihood = np.exp(log - log.max())
        kept = (1.0 - change) * self._grid * likelihood
        both = kept + change * self._prior * likelihood
        self._age = self._age * np.divide(kept, both, out=np.zeros_like(both), where=both > 0.0) + weight
        self._grid = both / both.sum()
        self.effective_samples = float(np.sum(self._grid * self._age))

    @property
    def grid(self) -> FloatArray:
        """Probability of each cell (moduli, limits); sums to 1.

        Errors that never average come in here: one of the thrust's scale is one of F_max, and one of slip, b,
        shifts each shear displacement by up to b l, and K with it.
        """
        return np.asarray(self._modulus_blur.T @ self._grid @ self._limit_blur)

    def summary(self) -> StrengthSummary:
        """Medians, intervals, and whether they say something."""
        grid = self.grid
        moduli = np.exp(_quantiles(grid.sum(axis=1), self._modulus_edges))
        limits = np.exp(_quantiles(grid.sum(axis=0), self._limit_edges))
        reason = self._reason(moduli, limits)
        return StrengthSummary(
            float(moduli[1]),
            (float(moduli[0]), float(moduli[2])),
            float(limits[1]),
            (float(limits[0]), float(limits[2])),
            self.effective_samples,
            not reason,
            reason,
        )

    def _reason(self, moduli: FloatArray, limits: FloatArray) -> str:
        """Why the posterior does not identify the soil; empty where it does."""
        p = self.parameters
        if self.effective_samples < 1.0:
            return "too little driving yet"
        if limits[2] > p.widest_ratio * limits[0]:
            return "F_max: thrusts far below it tell no more than K/F_max; a turn would"
        if moduli[2] > p.widest_ratio * moduli[0]:
            return "K: the slips are within their own errors"
        if moduli[0] < _EDGE * p.lowest_modulus or moduli[2] * _EDGE > p.highest_modulus:
            return "K: at the end of the range looked for"
        return ""


def _is_usable(sample: StrengthSample) -> bool:
    needed = (sample.tracks, sample.twist, sample.twist_covariance)
    if not (0.0 < sample.dt <= _LONGEST and all((np.abs(a) < _LARGEST).all() for a in needed)):
        return False
    return bool(np.linalg.eigvalsh(sample.twist_covariance)[0] > -1e-12)


def _edges(lowest: float, highest: float, cells: int) -> FloatArray:
    """Of cells of even width in the logarithm (cells + 1,)."""
    return np.linspace(math.log(lowest), math.log(highest), cells + 1)


def _centres(edges: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (edges[1:] + edges[:-1]))


def _blur(centres: FloatArray, stddevs: FloatArray) -> FloatArray:
    """(n, n) matrix whose rows spread each cell like a Gaussian of its own width; they sum to 1."""
    width = centres[1] - centres[0]
    steps = (centres[None, :] - centres[:, None]) / np.maximum(stddevs, 1e-3 * width)[:, None]
    weights = np.exp(-0.5 * steps**2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _quantiles(mass: FloatArray, edges: FloatArray) -> FloatArray:
    """Where the cumulated mass (n,), spread evenly within each cell, passes LOW, MEDIAN and HIGH."""
    return np.interp((LOW, MEDIAN, HIGH), np.concatenate(((0.0,), np.cumsum(mass))) / mass.sum(), edges)
