# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Grid of cells over (ln K, ln F_max) for the strength of the soil.

Constant errors do not average out; a distribution is convolved with them when it is read. A scale error of
the thrust is one of F_max. A slip bias b shifts each shear displacement by up to b l, and K by as much.
"""

import math

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.soil.strength_parameters import StrengthParameters


class StrengthGrid:
    """Cells of equal width in ln K and ln F_max."""

    def __init__(self, p: StrengthParameters, vehicle: Vehicle) -> None:
        self.parameters = p
        self.modulus_edges = _log_edges(p.lowest_modulus, p.highest_modulus, p.modulus_cells)
        lowest, highest = p.lowest_limit * vehicle.weight, p.highest_limit * vehicle.weight
        self.limit_edges = _log_edges(lowest, highest, p.limit_cells)
        self.log_moduli, self.log_limits = _centres(self.modulus_edges), _centres(self.limit_edges)
        self.moduli, self.limits = np.exp(self.log_moduli), np.exp(self.log_limits)  # m, N; ascending
        modulus_stddevs = p.slip_bias_stddev * vehicle.contact_length / self.moduli
        self._spread_moduli = _error_matrix(self.log_moduli, modulus_stddevs)
        self._spread_limits = _error_matrix(self.log_limits, np.full(p.limit_cells, p.thrust_scale_stddev))

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of moduli and limits."""
        return len(self.moduli), len(self.limits)

    def moduli_probabilities(self, cells: FloatArray) -> FloatArray:
        """Return the probability of each K (moduli,), for cell probabilities (moduli, limits)."""
        return np.asarray(cells.sum(axis=1) @ self._spread_moduli)

    def limit_probabilities(self, cells: FloatArray) -> FloatArray:
        """Return the probability of each F_max (limits,)."""
        return np.asarray(cells.sum(axis=0) @ self._spread_limits)

    def add_errors(self, cells: FloatArray) -> FloatArray:
        """Return the cell probabilities (moduli, limits) convolved with the constant errors."""
        return np.asarray(self._spread_moduli.T @ cells @ self._spread_limits)

    def expectation(self, along_moduli: FloatArray, along_limits: FloatArray) -> FloatArray:
        """Return the mean product of the factors for each cell (moduli, limits), as by ``add_errors``."""
        return np.outer(self._spread_moduli @ along_moduli, self._spread_limits @ along_limits)


def _log_edges(lowest: float, highest: float, cells: int) -> FloatArray:
    """Return the edges (cells + 1,) of cells of equal width in the logarithm."""
    return np.linspace(math.log(lowest), math.log(highest), cells + 1)


def _centres(edges: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (edges[1:] + edges[:-1]))


def _error_matrix(centres: FloatArray, stddevs: FloatArray) -> FloatArray:
    """Return (n, n): row k is a Gaussian about cell k with its standard deviation, of sum 1."""
    width = centres[1] - centres[0]
    steps = (centres[None, :] - centres[:, None]) / np.maximum(stddevs, 1e-3 * width)[:, None]
    weights = np.exp(-0.5 * steps**2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
