# SPDX-License-Identifier: Apache-2.0
"""The slips that thrust and soil tell of straight motion by (3.3), or nearly (3.12): once after each turn.

A yaw rate cannot reveal equal slips on both tracks; these can. They rest on K and F_max, which rest on slips:
an estimator that takes them hears itself again. Hence one after a turn, never a stream; with all of what is
not known of K in their covariance; and from the soil as it was known when the turn ended, before the slips
that are to be put right had their say.

    i, F     slip and thrust of a track, positive in the direction of travel      1, N
    K, F_max of the soil, as published last in the turn, with 5 and 95 % points   m, N
    σ        of ln K and of ln F_max: their 5 and 95 % points are 3.29 σ apart
    C        covariance of both slips: K, F_max and (3.3) are wrong for both alike, thrusts each for itself
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_common.parameters import Parameters, parameter
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.records import SlipSeed
from trackslip_estimation.soil.strength_posterior import StrengthSummary
from trackslip_estimation.soil.thrust import Thrust
from trackslip_estimation.terramechanics.traction import slip_of_thrust

FloatArray = NDArray[np.float64]

_INTERVAL = 2.0 * 1.6449  # standard deviations from 5 to 95 %


@dataclass(frozen=True, kw_only=True)
class SeedParameters(Parameters):
    """When slips have settled after a turn, and how far (3.3) is trusted then."""

    settling_time: float = parameter("straight on for so long", unit="s", gt=0.0)
    settling_lengths: float = parameter(
        "and so many contact lengths on: where a turn has sheared the soil, tracks hardly slip", ge=0.0
    )
    share_stddev: float = parameter("what (3.3) leaves out of a slip, relative", gt=0.0)
    thrust_stddev: float = parameter("what pressures leave out of a thrust", unit="N", gt=0.0)


class SlipSeeder:
    """Waits for the end of a turn, and for straight motion to settle."""

    def __init__(self, p: SeedParameters, contact_length: float) -> None:
        self._p = p
        self._length = contact_length
        self._due = False  # there was a turn, and no seed since
        self._soil: StrengthSummary | None = None  # when straight motion began
        self._time = self._way = 0.0  # s, m: straight on

    def step(
        self,
        stamp_ns: int,
        dt: float,
        motion: Motion,
        tracks: FloatArray,
        thrust: Thrust | None,
        soil: StrengthSummary | None,
    ) -> SlipSeed | None:
        """One moment; the seed where one is due and can be told. ``tracks`` (2,) r ω, m/s."""
        if motion is not Motion.STRAIGHT:
            self._due |= motion is Motion.TURNING
            self._time, self._way, self._soil = 0.0, 0.0, soil
            return None
        self._time += dt
        self._way += abs(float(np.mean(tracks))) * dt
        settled = self._time >= self._p.settling_time
        settled = settled and self._way >= self._p.settling_lengths * self._length
        if not (self._due and settled) or thrust is None or not (self._soil and self._soil.identifiable):
            return None
        found = slips_of(thrust, np.sign(tracks), self._soil, self._p, self._length)
        if found is None:
            return None
        self._due = False
        return SlipSeed(stamp_ns, *found)


def slips_of(
    thrust: Thrust, direction: FloatArray, soil: StrengthSummary, p: SeedParameters, length: float
) -> tuple[FloatArray, FloatArray] | None:
    """(2,) i and (2, 2) C; ``direction`` of travel of each track, 1 or −1.

    None where the soil may give no such thrust: no slip belongs to it.
    """
    force, stddev = thrust.force * direction, np.sqrt(thrust.variance + p.thrust_stddev**2)
    limit, modulus = soil.thrust_limit, soil.shear_modulus
    of_limit = math.exp(_log_stddev(soil.thrust_limit_interval))
    if not (np.abs(force) + stddev < limit / of_limit).all():
        return None

    def slips(forces: FloatArray, largest: float) -> FloatArray:
        return slip_of_thrust(forces, largest, modulus, length)

    found = slips(force, limit)
    by_limit = (slips(force, limit / of_limit) - slips(force, limit * of_limit)) / 2.0
    by_force = (slips(force + stddev, limit) - slips(force - stddev, limit)) / 2.0
    of_both = _log_stddev(soil.shear_modulus_interval) ** 2 + p.share_stddev**2
    covariance = of_both * np.outer(found, found) + np.outer(by_limit, by_limit) + np.diag(by_force**2)
    return found, covariance


def _log_stddev(interval: tuple[float, float]) -> float:
    low, high = interval
    return math.log(high / low) / _INTERVAL
