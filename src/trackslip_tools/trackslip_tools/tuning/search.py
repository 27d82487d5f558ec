# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The search for the best point of the unit cube: differential evolution, then Nelder and Mead's simplex.

Both are scipy's. The first finds the valley among many and has a whole generation scored at once, by as many
workers as there are; the second finds its bottom with few points. The points depend on the seed and on the
scores alone, so one worker finds what a hundred find, and a search that begins again from a journal goes on.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import OptimizeResult, differential_evolution, minimize
from scipy.stats import qmc

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError

Costs = Callable[[FloatArray], FloatArray]
"""(k, d) points → (k,) costs."""

_EVOLUTION = 0.7  # share of the points for differential evolution
_MEMBERS = 8  # of a generation, for each dimension
_GENERATIONS = 5  # at least, if need be of fewer members
_SIMPLEX = 0.05  # size of the first simplex
_SMALL = 1e-4  # difference of costs that does not matter


def search(costs: Costs, start: FloatArray, points: int, seed: int) -> FloatArray:
    """The best of about ``points`` points, ``start`` (d,) among them.

    Raises:
        InputError: whatever ``costs`` raises as such.
    """
    d = start.size
    members = max(5, min(_MEMBERS * d, int(_EVOLUTION * points) // (_GENERATIONS + 1)))
    population = qmc.LatinHypercube(d, seed=seed).random(members)
    population[0] = start
    evolved = _evolved(costs, population, max(int(_EVOLUTION * points) // members - 1, 1), seed)
    corners = np.vstack([evolved.x, evolved.x + np.where(evolved.x > 0.5, -_SIMPLEX, _SIMPLEX) * np.eye(d)])
    polished = minimize(
        lambda x: costs(x[np.newaxis])[0],
        evolved.x,
        method="Nelder-Mead",
        bounds=[(0.0, 1.0)] * d,
        options={
            "initial_simplex": corners,
            "maxfev": max(points - evolved.nfev * members, d + 1),  # scipy counts generations
            "xatol": 1e-3,
            "fatol": _SMALL,
        },
    )
    best: FloatArray = polished.x if polished.fun < evolved.fun else evolved.x
    return best


def _evolved(costs: Costs, population: FloatArray, generations: int, seed: int) -> OptimizeResult:
    """By differential evolution from a (k, d) population on."""
    try:
        return differential_evolution(
            lambda x: costs(x.T),
            [(0.0, 1.0)] * population.shape[1],
            init=population,
            maxiter=generations,
            tol=0.0,
            atol=_SMALL,
            seed=seed,
            polish=False,
            updating="deferred",
            vectorized=True,
        )
    except RuntimeError as error:
        if isinstance(error.__cause__, InputError):  # which scipy, as it is a ValueError, takes for a mistake
            raise error.__cause__ from None
        raise
