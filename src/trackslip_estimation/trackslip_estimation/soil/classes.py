# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Which of the known soils the strength posterior points to, if any.

    P(class) ∝ π Σ p/p₀ N(ln K; class) N(ln F_max; class)        'none of these': flat over the grid, like p₀

    c, ϕ     apparent cohesion, angle of internal shearing resistance       Pa, rad
    A, W     contact area of both tracks 2 b l, weight                      m², N

c and ϕ cannot be distinguished at one load: all pairs on the line A c + W tan ϕ = 2 F_max have that F_max.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.soils import Soil
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.soil.strength_grid import StrengthGrid
from trackslip_estimation.terramechanics.strength import thrust_limit

NONE = "none of these"


@dataclass(frozen=True, kw_only=True)
class ClassesParameters(Parameters):
    """How far a soil of a class may be from its table, and how many soils are in no table."""

    modulus_spread: float = parameter("standard deviation of ln K within a class", gt=0.0)
    limit_spread: float = parameter("standard deviation of ln F_max within a class", gt=0.0)
    none_prior: float = parameter("probability that a soil is none of the known", gt=0.0, lt=1.0)


class SoilClasses:
    """The known soils, as densities over the cells of a grid."""

    def __init__(
        self, parameters: ClassesParameters, soils: Iterable[Soil], vehicle: Vehicle, grid: StrengthGrid
    ) -> None:
        known = tuple(soils)
        self.names = (*(soil.name for soil in known), NONE)
        each = (1.0 - parameters.none_prior) / max(len(known), 1)
        # The densities are spread once instead of the cells each time: the sum of their products is the same.
        spread = [each * grid.expectation_of(*_density(parameters, soil, vehicle, grid)) for soil in known]
        self._densities = np.stack([*spread, np.full(grid.shape, parameters.none_prior)])

    def probabilities(self, cells: FloatArray) -> dict[str, float]:
        """Probability of each name, for those (moduli, limits) of the cells, of a flat prior."""
        # No BLAS: there the number of threads may change the last digits, and replay would differ from live.
        evidence = np.einsum("kij,ij->k", self._densities, cells)
        return dict(zip(self.names, (evidence / evidence.sum()).tolist(), strict=True))


def limit_of(soil: Soil, vehicle: Vehicle) -> float:
    """F_max of one track on a soil, N."""
    area = 2.0 * vehicle.track_width * vehicle.contact_length
    return float(thrust_limit(soil.cohesion, soil.friction_angle, area, vehicle.weight))


def _density(
    p: ClassesParameters, soil: Soil, vehicle: Vehicle, grid: StrengthGrid
) -> tuple[FloatArray, FloatArray]:
    """Density of a class over that of the flat prior, as factors (moduli,) and (limits,).

    A soil without K may have any.
    """
    along_limits = _normal(grid.log_limits, math.log(limit_of(soil, vehicle)), p.limit_spread)
    if soil.shear_modulus is None:
        along_moduli = np.ones(grid.moduli.size)
    else:
        along_moduli = _normal(grid.log_moduli, math.log(soil.shear_modulus), p.modulus_spread)
    return along_moduli, along_limits


def _normal(centres: FloatArray, mean: float, stddev: float) -> FloatArray:
    """Density of each cell (n,) over that of an even spread."""
    width = centres.size * (centres[1] - centres[0])
    density = np.exp(-0.5 * ((centres - mean) / stddev) ** 2) / (stddev * math.sqrt(2.0 * math.pi))
    return np.asarray(width * density)
