# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of normalised innovations squared, which are χ² distributed.

scipy.special has them for all degrees of freedom; its import takes a seventh of the time of an estimator's
imports.
"""

import math
from collections.abc import Callable

_TAIL_PROBABILITY: dict[int, Callable[[float], float]] = {
    1: lambda x: math.erfc(math.sqrt(x / 2.0)),
    2: lambda x: math.exp(-x / 2.0),
    3: lambda x: math.erfc(math.sqrt(x / 2.0)) + math.sqrt(2.0 * x / math.pi) * math.exp(-x / 2.0),
}
_BISECTIONS = 100  # to the last bit


def upper_limit(dof: int, tail: float) -> float:
    """Value that χ² of 1, 2 or 3 degrees of freedom exceeds with the probability ``tail``, 0 < tail < 1."""
    tail_probability = _TAIL_PROBABILITY[dof]
    low, high = 0.0, 6.0 - 3.0 * math.log(tail)  # above all three limits (Laurent & Massart 2000, lemma 1)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if tail_probability(middle) > tail else (low, middle)
    return high


def confidence_interval(dof: int) -> tuple[float, float]:
    """The 95 % interval of χ² with ``dof`` degrees of freedom (1 or more).

    After Wilson & Hilferty (1931); both bounds are within 0.1 of the true ones.
    """
    mean, stddev = 1.0 - 2.0 / (9.0 * dof), math.sqrt(2.0 / (9.0 * dof))
    low, high = (max(0.0, mean + z * stddev) for z in (-1.96, 1.96))
    return dof * low**3, dof * high**3
