# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Slip distance of a straight segment: measured, and expected on each soil hypothesis.

    K, F_max   of a hypothesis: a few of them, spread over the grid of the posterior   m, N
    U, ΣF      mean track speed; thrust of both tracks                                 m/s, N
    v_x        speed of C at which a hypothesis gives ΣF: F_max (q_L + q_R) = ΣF       m/s
    j, q       shear displacement under the tracks, F/F_max: ``shear_field``           m, 1
    λ          slip distance: ∫(U − v_x) dt                                            m

Slips of straight motion are small, and their estimates lag. Soil sheared in the turn before gives thrust
without slip; fresh soil follows one contact length later. The thrust is measured well at each instant, and λ
over the whole straight: the track distance exceeds the distance between two good positions. Each hypothesis
therefore travels the straight with the slips that the measured thrusts require. The likelihood uses λ alone,
which is almost proportional to K.

A small slip gives the thrust F_max i l/(2 K) (1 - l lean/6). The relative error of λ by an error of the
lean of the load is l/6 times that error.
"""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.soil.records import PoseWithCovariance
from trackslip_estimation.soil.shear_field import (
    LARGEST_DISPLACEMENT,
    LEAST_SLIDING,
    Contact,
    Rolling,
    displacement_before,
    mobilised_share,
    soil_path,
)

_MODULI, _LIMITS = 12, 9  # hypotheses: λ is nearly linear in K and in 1/F_max between them
_MOST_SLIP = 0.4  # bound of the slip, for thrusts beyond the strength of a hypothesis
_THRUST_TOLERANCE, _SLIP_TOLERANCE = 1e-3, 1e-5  # tolerances of q_L + q_R and of a slip
_ITERATIONS = 40  # about ten are needed


class Soils(NamedTuple):
    """Soil hypotheses: each K with each F_max."""

    moduli: FloatArray  # (m,) m
    limits: FloatArray  # (l,) N


class SlipDistance(NamedTuple):
    """Slip distance of a straight."""

    measured: float  # λ, m
    expected: FloatArray  # (moduli, limits) λ on each soil of the grid, m
    variance: float  # of the measured λ, by the positions, m²
    of_lean: float  # standard deviation of λ by the error of the load's lean, m


class Hypotheses:
    """Soil hypotheses, and the interpolation from them to the whole grid."""

    def __init__(self, contact: Contact, moduli: FloatArray, limits: FloatArray) -> None:
        self.contact = contact
        self.soils = Soils(
            np.geomspace(moduli[0], moduli[-1], _MODULI), np.geomspace(limits[0], limits[-1], _LIMITS)
        )
        self._by_modulus = _interpolation_weights(self.soils.moduli, moduli)
        self._by_limit = _interpolation_weights(-1.0 / self.soils.limits, -1.0 / limits)

    def interpolate_to_grid(self, values: FloatArray) -> FloatArray:
        """Return values (moduli, limits) on the whole grid, interpolated from those of the hypotheses."""
        return np.asarray(self._by_modulus @ values @ self._by_limit.T)


class StraightSegment:
    """The straight in progress, as travelled on each hypothesis."""

    def __init__(self, hypotheses: Hypotheses, displacement: FloatArray, start: PoseWithCovariance) -> None:
        """Begin at ``start`` with ``displacement`` (2, n, 2), j under the tracks, m."""
        self._hypotheses, self._start, self._end = hypotheses, start, start
        shape = tuple(map(len, hypotheses.soils))
        self._j = np.tile(displacement, (*shape, 1, 1, 1))
        self._expected = np.zeros(shape)
        self._track_distance = self._travelled = self._distance_stddev = self._leaning = 0.0

    @property
    def track_distance(self) -> float:
        """Track distance, m."""
        return abs(self._track_distance)

    def add(self, dt: float, rolling: Rolling, thrust: float, lean_stddev: float = 0.0) -> None:
        """Add ``dt`` s with the total ``thrust`` of both tracks; each hypothesis has its own v_x.

        ``lean_stddev``: standard deviation of the rolling's lean, 1/m.
        """
        s, distance = self._hypotheses, float(rolling.tracks.mean()) * dt
        self._expected += distance * drive_hypotheses(self._j, rolling, thrust, s.soils, s.contact, dt)
        self._track_distance += distance
        self._leaning += abs(distance) * lean_stddev

    def set_end(self, pose: PoseWithCovariance, stretch: float = 1.0, stretch_stddev: float = 0.0) -> None:
        """Move the end to ``pose``, at standstill repeatedly as the pose becomes more accurate.

        ``stretch``: distance along the ground over the horizontal one; ``stretch_stddev``: relative error.
        """
        distance = stretch * self._end.distance_to(pose)
        self._travelled += distance
        self._distance_stddev += abs(distance) * stretch_stddev
        self._end = pose

    def slip_distance(self) -> SlipDistance:
        """Return λ up to now."""
        forward = math.copysign(1.0, self._track_distance)
        expected = self._hypotheses.interpolate_to_grid(forward * self._expected)
        variance = self._start.variance_along() + self._end.variance_along() + self._distance_stddev**2
        measured = forward * (self._track_distance - self._travelled)
        x_e = self._hypotheses.contact.x_e
        length = len(x_e) * (x_e[0] - x_e[1])
        of_lean = measured * self._leaning / max(self.track_distance, LEAST_SLIDING) * length / 6.0
        return SlipDistance(measured, expected, variance, abs(float(of_lean)))


class _ThrustTerms(NamedTuple):
    """Terms of a hypothesis' thrust over a step that do not depend on its slip; (2, n): tracks, elements."""

    before: FloatArray  # j_x carried along, m
    across: FloatArray  # j_y at the end of the step, m
    time: FloatArray  # for which the soil was under the track, s
    s_y: FloatArray  # m/s
    strength: FloatArray  # (n,) w
    shares: FloatArray  # buffer for the elements' shares of q


@compiled
def drive_hypotheses(
    j: FloatArray, rolling: Rolling, thrust: float, soils: Soils, contact: Contact, dt: float
) -> FloatArray:
    """Return the mean slips (moduli, limits) of the hypotheses; update their j (moduli, limits, 2, n, 2)."""
    n, half_tread = len(contact.x_e), contact.half_tread
    path = soil_path(rolling.tracks, contact.x_e, dt)
    shape = (2, n)
    strength = np.maximum(1.0 + rolling.lean * contact.x_e, 0.0)
    terms = _ThrustTerms(
        np.empty(shape), np.empty(shape), path.time, np.empty(shape), strength, np.empty(shape)
    )
    for k in range(2):
        for e in range(n):
            terms.s_y[k, e] = rolling.twist[1] + rolling.twist[2] * contact.x_e[e]
    slips = np.empty((len(soils.moduli), len(soils.limits)))
    forward = math.copysign(1.0, rolling.tracks[0] + rolling.tracks[1])
    for a in range(slips.shape[0]):
        for b in range(slips.shape[1]):
            displacement, thrust_share = j[a, b], forward * thrust / soils.limits[b]
            for k in range(2):
                for e in range(n):
                    s_y = rolling.twist[1] + rolling.twist[2] * path.middle[k, e]
                    terms.before[k, e] = displacement_before(displacement, path, k, e, 0)
                    terms.across[k, e] = (
                        displacement_before(displacement, path, k, e, 1) + s_y * path.time[k, e]
                    )
            slip = _needed_slip(thrust_share, terms, rolling, half_tread, soils.moduli[a])
            _update_displacement(displacement, slip, terms, rolling, half_tread)
            slips[a, b] = slip
    return slips


@compiled
def _sliding_along(slip: float, rolling: Rolling, half_tread: float, k: int) -> float:
    """Return s_x of track k at a mean slip of both tracks, m/s."""
    U = 0.5 * (rolling.tracks[0] + rolling.tracks[1])
    return float(U * (1.0 - slip) - rolling.twist[2] * half_tread * (1.0 - 2.0 * k) - rolling.tracks[k])


@compiled
def _mobilised_thrust(
    slip: float, terms: _ThrustTerms, rolling: Rolling, half_tread: float, modulus: float
) -> float:
    """Return q_L + q_R in the direction of travel after the step with a mean slip."""
    n, per_modulus = terms.time.shape[1], 1.0 / modulus
    total = 0.0
    for k in range(2):
        s_x = _sliding_along(slip, rolling, half_tread, k)
        before, across, time = terms.before[k], terms.across[k], terms.time[k]
        s_y, shares = terms.s_y[k], terms.shares[k]
        for e in range(n):
            j_x = before[e] + s_x * time[e]
            displacement = min(math.sqrt(j_x * j_x + across[e] * across[e]), LARGEST_DISPLACEMENT)
            sliding = max(math.sqrt(s_x * s_x + s_y[e] * s_y[e]), LEAST_SLIDING)
            share = terms.strength[e] * mobilised_share(displacement * per_modulus)
            shares[e] = np.divide(share, sliding)  # no check for 0
        for e in range(n):
            total -= s_x * shares[e]
    return float(math.copysign(1.0, rolling.tracks[0] + rolling.tracks[1]) * total / n)


@compiled
def _needed_slip(
    thrust_share: float, terms: _ThrustTerms, rolling: Rolling, half_tread: float, modulus: float
) -> float:
    """Return the mean slip, within ±_MOST_SLIP, at which ``_mobilised_thrust`` is ``thrust_share``.

    Thrust rises with slip, so false position (Illinois) converges to it, or to the step of the thrust at
    slip 0 where the soil is sheared already.
    """
    low, high = -_MOST_SLIP, _MOST_SLIP
    f_low = _mobilised_thrust(low, terms, rolling, half_tread, modulus) - thrust_share
    if f_low >= 0.0:
        return low
    f_high = _mobilised_thrust(high, terms, rolling, half_tread, modulus) - thrust_share
    if f_high <= 0.0:
        return high
    slip, was_low, was_high = high, False, False
    for _ in range(_ITERATIONS):
        slip = (low * f_high - high * f_low) / (f_high - f_low)
        f = _mobilised_thrust(slip, terms, rolling, half_tread, modulus) - thrust_share
        if abs(f) < _THRUST_TOLERANCE or high - low < _SLIP_TOLERANCE:
            break
        if f < 0.0:
            low, f_low = slip, f
            f_high *= 0.5 if was_low else 1.0
        else:
            high, f_high = slip, f
            f_low *= 0.5 if was_high else 1.0
        was_low, was_high = f < 0.0, f >= 0.0
    return slip


@compiled
def _update_displacement(
    j: FloatArray, slip: float, terms: _ThrustTerms, rolling: Rolling, half_tread: float
) -> None:
    """Set j (2, n, 2) after the step with a mean slip."""
    for k in range(2):
        s_x = _sliding_along(slip, rolling, half_tread, k)
        for e in range(terms.time.shape[1]):
            j_x, j_y = terms.before[k, e] + s_x * terms.time[k, e], terms.across[k, e]
            scale = min(1.0, LARGEST_DISPLACEMENT / max(math.hypot(j_x, j_y), LEAST_SLIDING))
            j[k, e, 0], j[k, e, 1] = scale * j_x, scale * j_y


def _interpolation_weights(nodes: FloatArray, places: FloatArray) -> FloatArray:
    """Return weights (places, nodes) of linear interpolation; both ascend, places lie within the nodes."""
    return np.stack([np.interp(places, nodes, unit) for unit in np.eye(len(nodes))], axis=1)
