# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Search for the best point of the unit cube: differential evolution, then the Nelder–Mead simplex.

Both are scipy's. Differential evolution finds the best region and scores a whole generation at once, on all
workers. The simplex finds the minimum there with few points. The points depend only on the seed and the
scores. The result therefore does not depend on the number of workers, and a search can resume from a journal.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import OptimizeResult, differential_evolution, minimize
from scipy.stats import qmc

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError

Costs = Callable[[FloatArray], FloatArray]
"""(k, d) points → (k,) costs."""

_EVOLUTION_SHARE = 0.7  # share of the points used by differential evolution
_MEMBERS = 8  # size of a generation, per dimension
_GENERATIONS = 5  # least number of generations; their size is reduced if necessary
_SIMPLEX_EDGE = 0.05  # edge of the first simplex
_COST_TOLERANCE = 1e-4  # negligible difference of costs


def search(costs: Costs, start: FloatArray, points: int, seed: int) -> FloatArray:
    """The best of about ``points`` points; ``start`` (d,) is one of them.

    Raises:
        InputError: ``costs`` raises it.
    """
    d = start.size
    members = max(5, min(_MEMBERS * d, int(_EVOLUTION_SHARE * points) // (_GENERATIONS + 1)))
    population = qmc.LatinHypercube(d, seed=seed).random(members)
    population[0] = start
    evolved = _evolve(costs, population, max(int(_EVOLUTION_SHARE * points) // members - 1, 1), seed)
    corners = np.vstack(
        [evolved.x, evolved.x + np.where(evolved.x > 0.5, -_SIMPLEX_EDGE, _SIMPLEX_EDGE) * np.eye(d)]
    )
    polished = minimize(
        lambda x: costs(x[np.newaxis])[0],
        evolved.x,
        method="Nelder-Mead",
        bounds=[(0.0, 1.0)] * d,
        options={
            "initial_simplex": corners,
            "maxfev": max(points - evolved.nfev * members, d + 1),  # scipy counts generations
            "xatol": 1e-3,
            "fatol": _COST_TOLERANCE,
        },
    )
    best: FloatArray = polished.x if polished.fun < evolved.fun else evolved.x
    return best


def _evolve(costs: Costs, population: FloatArray, generations: int, seed: int) -> OptimizeResult:
    """Result of differential evolution from a (k, d) population."""
    try:
        return differential_evolution(
            lambda x: costs(x.T),
            [(0.0, 1.0)] * population.shape[1],
            init=population,
            maxiter=generations,
            tol=0.0,
            atol=_COST_TOLERANCE,
            seed=seed,
            polish=False,
            updating="deferred",
            vectorized=True,
        )
    except RuntimeError as error:
        if isinstance(error.__cause__, InputError):  # scipy wraps it: it is a ValueError
            raise error.__cause__ from None
        raise
