# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Slips of straight motion from thrust and soil by the inverse of (3.3), nearly (3.12); once after each turn.

Equal slips of both tracks are not observable from the yaw rate; a seed makes them observable. K and F_max are
themselves estimated from slips, so that a seed is correlated with the slip estimate. Therefore only one seed
follows each turn. Its covariance includes the full uncertainty of K. Its soil strength is that at the end of
the turn, not influenced by the slips to be corrected.

    i, F     slip and thrust of a track, positive in the direction of travel      1, N
    K, F_max of the soil, as published last in the turn, with 5 and 95 % points   m, N
    σ        stddev of ln K and of ln F_max: their 5 and 95 % points are 3.29 σ apart
    C        covariance of both slips; errors of K, F_max and (3.3) are common, of thrusts independent
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.records import SlipSeed
from trackslip_estimation.soil.strength_summary import StrengthSummary
from trackslip_estimation.terramechanics.traction import slip_of_thrust

if TYPE_CHECKING:
    from trackslip_estimation.soil.interpolation import Sample
    from trackslip_estimation.soil.soil_parameters import SoilConfig
    from trackslip_estimation.soil.thrust import ThrustRecord

_STRAIGHT, _TURNING = int(Motion.STRAIGHT), int(Motion.TURNING)
_INTERVAL = 2.0 * 1.6449  # standard deviations from 5 to 95 %


@dataclass(frozen=True, kw_only=True)
class SeedParameters(Parameters):
    """When slips have settled after a turn, and the errors of a seed."""

    settling_time: float = parameter("time of straight motion before a seed", unit="s", gt=0.0)
    settling_lengths: float = parameter(
        "contact lengths of straight motion before a seed; tracks hardly slip on soil sheared by a turn",
        ge=0.0,
    )
    share_stddev: float = parameter("relative standard deviation of a slip by (3.3)", gt=0.0)
    thrust_stddev: float = parameter(
        "standard deviation added to that of a thrust from pressures", unit="N", gt=0.0
    )


class SeedStrength(Record):
    """What a seed needs of a ``StrengthSummary``."""

    shear_modulus: float  # m
    shear_modulus_log_stddev: float
    thrust_limit: float  # N
    thrust_limit_log_stddev: float
    largest_thrust: float  # N, up to which a seed is computed; 0 if not identifiable


class Seeder(Record):
    """State for the next seed."""

    is_due: int  # whether a turn has had no seed yet
    time: float  # s, of straight motion
    distance: float  # m, of straight motion
    newest: SeedStrength  # of the newest soil state
    in_turn: SeedStrength  # when straight motion began


def set_strength(seeder: Seeder, strength: StrengthSummary) -> None:
    """Set the strength of the newest soil state."""
    newest = seeder["newest"]
    for name in ("shear_modulus", "thrust_limit"):
        low, high = getattr(strength, f"{name}_interval")
        newest[name] = getattr(strength, name)
        newest[f"{name}_log_stddev"] = math.log(high / low) / _INTERVAL
    largest = strength.thrust_limit / math.exp(newest["thrust_limit_log_stddev"])
    newest["largest_thrust"] = largest if strength.identifiable else 0.0


def make_seed(
    seeder: Seeder, sample: Sample, thrust: ThrustRecord, p: SeedParameters, length: float
) -> SlipSeed:
    """Return the seed due at a sample with its thrust; ``length``: contact length, m."""
    slips = straight_slips(thrust, np.sign(sample["tracks"]), seeder["in_turn"], p, length)
    return SlipSeed(int(sample["stamp_ns"]), *slips)


@compiled
def is_seed_due(seeder: Seeder, sample: Sample, thrust: ThrustRecord, p: SoilConfig) -> bool:
    """Add a sample with its thrust; return whether a seed is due: slips have settled after a turn."""
    if sample.motion != _STRAIGHT:
        seeder.is_due = seeder.is_due or sample.motion == _TURNING
        seeder.time = seeder.distance = 0.0
        _copy_strength(seeder.in_turn, seeder.newest)
        return False
    seeder.time += sample.dt
    seeder.distance += abs(0.5 * (sample.tracks[0] + sample.tracks[1])) * sample.dt
    is_settled = seeder.time >= p.seed.settling_time
    is_settled = is_settled and seeder.distance >= p.seed.settling_lengths * p.vehicle.contact_length
    if not (seeder.is_due and is_settled and thrust.is_known):
        return False
    for k in range(2):
        stddev = math.sqrt(thrust.variance[k] + p.seed.thrust_stddev**2)
        if not (
            abs(thrust.force[k]) + stddev < seeder.in_turn.largest_thrust and abs(sample.tracks[k]) > 0.0
        ):
            return False
    seeder.is_due = False
    return True


@compiled
def _copy_strength(to: SeedStrength, source: SeedStrength) -> None:
    to.shear_modulus, to.shear_modulus_log_stddev = source.shear_modulus, source.shear_modulus_log_stddev
    to.thrust_limit, to.thrust_limit_log_stddev = source.thrust_limit, source.thrust_limit_log_stddev
    to.largest_thrust = source.largest_thrust


def straight_slips(
    thrust: ThrustRecord, direction: FloatArray, soil: SeedStrength, p: SeedParameters, length: float
) -> tuple[FloatArray, FloatArray]:
    """Return i (2,) and C (2, 2); ``direction``: of travel of each track, 1 or −1.

    Raises:
        InputError: a thrust reaches F_max within one standard deviation of either.
    """
    force, stddev = thrust["force"] * direction, np.sqrt(thrust["variance"] + p.thrust_stddev**2)
    limit, modulus = float(soil["thrust_limit"]), float(soil["shear_modulus"])
    limit_ratio = math.exp(soil["thrust_limit_log_stddev"])

    def slips(forces: FloatArray, largest: float) -> FloatArray:
        return slip_of_thrust(forces, largest, modulus, length)

    mean = slips(force, limit)
    limit_error = (slips(force, limit / limit_ratio) - slips(force, limit * limit_ratio)) / 2.0
    force_error = (slips(force + stddev, limit) - slips(force - stddev, limit)) / 2.0
    relative_variance = float(soil["shear_modulus_log_stddev"]) ** 2 + p.share_stddev**2
    covariance = (
        relative_variance * np.outer(mean, mean)
        + np.outer(limit_error, limit_error)
        + np.diag(force_error**2)
    )
    return mean, covariance
