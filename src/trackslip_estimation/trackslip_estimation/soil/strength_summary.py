# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Summary of a distribution over (ln K, ln F_max): medians, intervals, and whether they are identifiable."""

from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.soil.strength_grid import StrengthGrid
from trackslip_estimation.soil.strength_parameters import StrengthParameters

_SHARES = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class StrengthSummary:
    """Medians of the posterior, and the intervals from 5 to 95 %."""

    shear_modulus: float  # m
    shear_modulus_interval: tuple[float, float]
    thrust_limit: float  # N
    thrust_limit_interval: tuple[float, float]
    effective_samples: float
    identifiable: bool
    reason: str  # why not; empty if identifiable


def summarise_cells(grid: StrengthGrid, cells: FloatArray, effective_samples: float) -> StrengthSummary:
    """Return the summary of cell probabilities (moduli, limits)."""
    k_low, modulus, k_high = np.exp(_quantiles(grid.moduli_probabilities(cells), grid.modulus_edges)).tolist()
    f_low, limit, f_high = np.exp(_quantiles(grid.limit_probabilities(cells), grid.limit_edges)).tolist()
    moduli, limits = (k_low, k_high), (f_low, f_high)
    reason = _unidentified_reason(grid.parameters, moduli, limits, effective_samples)
    return StrengthSummary(modulus, moduli, limit, limits, effective_samples, not reason, reason)


def _unidentified_reason(
    p: StrengthParameters, moduli: tuple[float, float], limits: tuple[float, float], effective_samples: float
) -> str:
    """Return why the posterior does not identify the soil; empty if it does."""
    (k_low, k_high), (f_low, f_high) = moduli, limits
    if effective_samples < 1.0:
        return "too little driving yet"
    if f_high > p.widest_ratio * f_low:
        return "F_max: the thrusts are too small, only K/F_max is observable; drive a turn"
    if k_high > p.widest_ratio * k_low:
        return "K: the slips are below their uncertainty"
    if k_low < p.edge_ratio * p.lowest_modulus or k_high * p.edge_ratio > p.highest_modulus:
        return "K: at the limit of the searched range"
    return ""


def _quantiles(mass: FloatArray, edges: FloatArray) -> FloatArray:
    """Return where the cumulative mass (n,), uniform within each cell, reaches each of _SHARES."""
    return np.interp(_SHARES, np.concatenate(((0.0,), np.cumsum(mass))) / mass.sum(), edges)
