# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The cells over (ln K, ln F_max) on which the strength of the soil is looked for.

Errors that never average are spread over the cells as a distribution is looked at: one of the thrust's scale
is one of F_max, and one of slip, b, shifts each shear displacement by up to b l, and K with it.
"""

import math

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.soil.strength_parameters import StrengthParameters


class StrengthGrid:
    """Cells of even width in ln K and ln F_max."""

    def __init__(self, p: StrengthParameters, vehicle: Vehicle) -> None:
        self.parameters = p
        self.modulus_edges = _edges(p.lowest_modulus, p.highest_modulus, p.modulus_cells)
        lowest, highest = p.lowest_limit * vehicle.weight, p.highest_limit * vehicle.weight
        self.limit_edges = _edges(lowest, highest, p.limit_cells)
        self.log_moduli, self.log_limits = _centres(self.modulus_edges), _centres(self.limit_edges)
        self.moduli, self.limits = np.exp(self.log_moduli), np.exp(self.log_limits)  # m, N; both rise
        correlated = p.slip_bias_stddev * vehicle.contact_length / self.moduli
        self._spread_moduli = _spread(self.log_moduli, correlated)
        self._spread_limits = _spread(self.log_limits, np.full(p.limit_cells, p.thrust_scale_stddev))

    @property
    def shape(self) -> tuple[int, int]:
        """Of the cells: moduli, limits."""
        return len(self.moduli), len(self.limits)

    def of_moduli(self, cells: FloatArray) -> FloatArray:
        """(moduli,) probability of each K, for those (moduli, limits) of the cells."""
        return np.asarray(cells.sum(axis=1) @ self._spread_moduli)

    def of_limits(self, cells: FloatArray) -> FloatArray:
        """(limits,) probability of each F_max."""
        return np.asarray(cells.sum(axis=0) @ self._spread_limits)

    def spread(self, cells: FloatArray) -> FloatArray:
        """(moduli, limits) with the errors that never average."""
        return np.asarray(self._spread_moduli.T @ cells @ self._spread_limits)

    def expectation_of(self, along_moduli: FloatArray, along_limits: FloatArray) -> FloatArray:
        """(moduli, limits) for each cell the mean of the factors' product over where ``spread`` takes it."""
        return np.outer(self._spread_moduli @ along_moduli, self._spread_limits @ along_limits)


def _edges(lowest: float, highest: float, cells: int) -> FloatArray:
    """Of cells of even width in the logarithm (cells + 1,)."""
    return np.linspace(math.log(lowest), math.log(highest), cells + 1)


def _centres(edges: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (edges[1:] + edges[:-1]))


def _spread(centres: FloatArray, stddevs: FloatArray) -> FloatArray:
    """(n, n) matrix whose rows spread each cell like a Gaussian of its own width; they sum to 1."""
    width = centres[1] - centres[0]
    steps = (centres[None, :] - centres[:, None]) / np.maximum(stddevs, 1e-3 * width)[:, None]
    weights = np.exp(-0.5 * steps**2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
