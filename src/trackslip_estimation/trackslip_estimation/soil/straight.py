# SPDX-License-Identifier: Apache-2.0
"""How much way a straight costs on each soil, held against the way that the machine was seen to lose.

    K, F_max   of a hypothesis: a few of them, spread over the grid of the posterior   m, N
    U, ΣF      mean track speed; thrust of both tracks                                 m/s, N
    v_x        speed of C with which a hypothesis pulls ΣF: F_max (q_L + q_R) = ΣF     m/s
    j, q       the soil sheared under the tracks, F/F_max: ``shear_field``             m, 1
    λ          way lost: ∫(U − v_x) dt                                                 m

The slips of a straight are small, and an estimate of them is late: the soil under the tracks is first that of
the turn before, which pulls without any slip, and fresh a contact length later. What is known well at each
moment is the thrust, and over a straight the way: from one good position to another the tracks rolled
farther than the machine came. So each hypothesis drives the straight with the slips that it needs for the
measured thrusts, and is judged by λ alone, which grows almost in proportion to K.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.soil.records import Place
from trackslip_estimation.soil.shear_field import carry, element_places, shares

FloatArray = NDArray[np.float64]

_MODULI, _LIMITS = 12, 9  # hypotheses: λ is nearly linear in K and in 1/F_max between them
_MOST_SLIP = 0.4  # a soil that is asked for more than it has lets the tracks spin; no farther than this
_CLOSE_PULL, _CLOSE_SLIP = 1e-3, 1e-5  # of q_L + q_R; of a slip
_TRIALS = 40  # about ten are needed


class Lost(NamedTuple):
    """What a straight cost."""

    measured: float  # λ, m
    expected: FloatArray  # (moduli, limits) λ on each soil of the grid, m
    variance: float  # of the measured, as far as the positions go, m²


class Hypotheses:
    """Soils that are driven on, and how the others lie between them."""

    def __init__(self, vehicle: Vehicle, elements: int, moduli: FloatArray, limits: FloatArray) -> None:
        self.x_e = element_places(vehicle.contact_length, elements)
        self.half_tread = 0.5 * vehicle.tread
        self.moduli = np.geomspace(moduli[0], moduli[-1], _MODULI)
        self.limits = np.geomspace(limits[0], limits[-1], _LIMITS)
        self._by_modulus = _between(self.moduli, moduli)
        self._by_limit = _between(-1.0 / self.limits, -1.0 / limits)

    def on_grid(self, values: FloatArray) -> FloatArray:
        """(moduli, limits) of the whole grid, from those driven on."""
        return np.asarray(self._by_modulus @ values @ self._by_limit.T)


class Straight:
    """A straight that the machine is on."""

    def __init__(self, hypotheses: Hypotheses, displacement: FloatArray, start: Place) -> None:
        """Begun at ``start`` with ``displacement`` (2, n, 2), j under the tracks."""
        self._soils, self._start, self._end = hypotheses, start, start
        shape = (len(hypotheses.moduli), len(hypotheses.limits))
        self._j = np.tile(displacement, (*shape, 1, 1, 1))
        self._expected = np.zeros(shape)
        self._rolled = self._came = 0.0

    @property
    def rolled(self) -> float:
        """Way of the tracks, m."""
        return abs(self._rolled)

    def roll(self, dt: float, tracks: FloatArray, twist: FloatArray, thrust: float, place: Place) -> None:
        """On to ``place`` in dt s, with ``thrust`` of both tracks together.

        Of the twist, v_x is each hypothesis' own.
        """
        s, way = self._soils, float(tracks.mean()) * dt
        slips = drive(self._j, twist, tracks, thrust, s.moduli, s.limits, s.x_e, s.half_tread, dt)
        self._expected += way * slips
        self._rolled += way
        self.arrive(place)

    def arrive(self, place: Place) -> None:
        """Be at ``place``, as is better known by now: a machine that stands is seen again and again."""
        self._came += self._end.way_to(place)
        self._end = place

    def lost(self) -> Lost:
        """λ until now."""
        forward = math.copysign(1.0, self._rolled)
        expected = self._soils.on_grid(forward * self._expected)
        variance = self._start.along() + self._end.along()
        return Lost(forward * (self._rolled - self._came), expected, variance)


@compiled
def _tried(
    slip: float,
    j: FloatArray,
    twist: FloatArray,
    tracks: FloatArray,
    modulus: FloatArray,
    x_e: FloatArray,
    half_tread: float,
    dt: float,
) -> tuple[float, FloatArray]:
    """q_L + q_R in the sense of travel after dt s with a mean slip, and j then."""
    U = (tracks[0] + tracks[1]) / 2.0
    own = np.array((U * (1.0 - slip), twist[1], twist[2]))
    q, none = np.empty((2, 1)), np.zeros(2)
    after = carry(j, own, tracks, x_e, half_tread, dt)
    shares(after, own, tracks, none, none, x_e, half_tread, modulus, q)
    return math.copysign(1.0, U) * (q[0, 0] + q[1, 0]), after


@compiled
def _needed(
    wanted: float,
    j: FloatArray,
    twist: FloatArray,
    tracks: FloatArray,
    modulus: FloatArray,
    x_e: FloatArray,
    half_tread: float,
    dt: float,
) -> tuple[float, FloatArray]:
    """Mean slip that pulls ``wanted``, and j after dt s with it.

    More slip pulls more, so false position (Illinois) closes in on it, or on the step of the pull at slip 0
    where the soil is sheared already.
    """
    low, high = -_MOST_SLIP, _MOST_SLIP
    f, after = _tried(low, j, twist, tracks, modulus, x_e, half_tread, dt)
    f_low = f - wanted
    if f_low >= 0.0:
        return low, after
    f, after = _tried(high, j, twist, tracks, modulus, x_e, half_tread, dt)
    f_high = f - wanted
    if f_high <= 0.0:
        return high, after
    slip, was_low, was_high = high, False, False
    for _ in range(_TRIALS):
        slip = (low * f_high - high * f_low) / (f_high - f_low)
        f, after = _tried(slip, j, twist, tracks, modulus, x_e, half_tread, dt)
        if abs(f - wanted) < _CLOSE_PULL or high - low < _CLOSE_SLIP:
            break
        if f < wanted:
            low, f_low = slip, f - wanted
            f_high *= 0.5 if was_low else 1.0
        else:
            high, f_high = slip, f - wanted
            f_low *= 0.5 if was_high else 1.0
        was_low, was_high = f < wanted, f >= wanted
    return slip, after


@compiled
def drive(
    j: FloatArray,
    twist: FloatArray,
    tracks: FloatArray,
    thrust: float,
    moduli: FloatArray,
    limits: FloatArray,
    x_e: FloatArray,
    half_tread: float,
    dt: float,
) -> FloatArray:
    """Mean slips (moduli, limits) of the hypotheses, whose j (moduli, limits, 2, n, 2) are carried on."""
    slips = np.empty((len(moduli), len(limits)))
    forward = math.copysign(1.0, tracks[0] + tracks[1])
    for a in range(len(moduli)):
        for b in range(len(limits)):
            wanted, modulus = forward * thrust / limits[b], moduli[a : a + 1]
            slips[a, b], j[a, b] = _needed(wanted, j[a, b], twist, tracks, modulus, x_e, half_tread, dt)
    return slips


def _between(nodes: FloatArray, places: FloatArray) -> FloatArray:
    """(places, nodes) weights of linear interpolation; both rise, the places lie within the nodes."""
    return np.stack([np.interp(places, nodes, unit) for unit in np.eye(len(nodes))], axis=1)
