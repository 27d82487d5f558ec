# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Probabilities of the known soil classes, or of none of them, from the strength posterior.

    P(class) ∝ π Σ p/p₀ N(ln K; class) N(ln F_max; class)        'none of these': flat over the grid, like p₀

    c, ϕ     apparent cohesion, angle of internal shearing resistance       Pa, rad
    A, W     contact area of both tracks 2 b l, weight                      m², N

c and ϕ are not separately observable at one load: all pairs with A c + W tan ϕ = 2 F_max have that F_max.
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
    """Spread of the soils within a class, and prior of the soils in no class."""

    modulus_spread: float = parameter("standard deviation of ln K within a class", gt=0.0)
    limit_spread: float = parameter("standard deviation of ln F_max within a class", gt=0.0)
    none_prior: float = parameter("prior probability of a soil outside the known classes", gt=0.0, lt=1.0)


class SoilClasses:
    """Known soil classes as densities over the cells of a grid."""

    def __init__(
        self, parameters: ClassesParameters, soils: Iterable[Soil], vehicle: Vehicle, grid: StrengthGrid
    ) -> None:
        known = tuple(soils)
        self.names = (*(soil.name for soil in known), NONE)
        class_prior = (1.0 - parameters.none_prior) / max(len(known), 1)
        # Spreading the densities once gives the same sums of products as spreading the cells each time.
        densities = [
            class_prior * grid.expectation(*_class_density(parameters, soil, vehicle, grid)) for soil in known
        ]
        self._densities = np.stack([*densities, np.full(grid.shape, parameters.none_prior)])

    def probabilities(self, cells: FloatArray) -> dict[str, float]:
        """Return the probability of each name, for cell probabilities (moduli, limits) from a flat prior."""
        # No BLAS: its last digits may depend on the number of threads, and replay would differ from live.
        evidence = np.einsum("kij,ij->k", self._densities, cells)
        return dict(zip(self.names, (evidence / evidence.sum()).tolist(), strict=True))


def soil_thrust_limit(soil: Soil, vehicle: Vehicle) -> float:
    """Return F_max of one track on a soil, N."""
    area = 2.0 * vehicle.track_width * vehicle.contact_length
    return float(thrust_limit(soil.cohesion, soil.friction_angle, area, vehicle.weight))


def _class_density(
    p: ClassesParameters, soil: Soil, vehicle: Vehicle, grid: StrengthGrid
) -> tuple[FloatArray, FloatArray]:
    """Return the density of a class over that of the flat prior, as factors (moduli,) and (limits,).

    A class without K is flat in ln K.
    """
    along_limits = _relative_density(
        grid.log_limits, math.log(soil_thrust_limit(soil, vehicle)), p.limit_spread
    )
    if soil.shear_modulus is None:
        along_moduli = np.ones(grid.moduli.size)
    else:
        along_moduli = _relative_density(grid.log_moduli, math.log(soil.shear_modulus), p.modulus_spread)
    return along_moduli, along_limits


def _relative_density(centres: FloatArray, mean: float, stddev: float) -> FloatArray:
    """Return the Gaussian density at each cell (n,) over that of a uniform distribution."""
    width = centres.size * (centres[1] - centres[0])
    density = np.exp(-0.5 * ((centres - mean) / stddev) ** 2) / (stddev * math.sqrt(2.0 * math.pi))
    return np.asarray(width * density)
