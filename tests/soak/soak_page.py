# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a soak: growth of each quantity per hour, with a confidence interval.

x_k    mean of a quantity over the k-th of n equal sections of the run after settling
b      slope of x over time, least squares; its interval is b ± t(0.975; n − 2) s_b

Successive samples have correlated errors; those of means over long sections are almost independent.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import linregress
from scipy.stats import t as student

from trackslip_common.arrays import FloatArray

SECTIONS = 10
_SETTLING, _SETTLING_S = 0.1, 120.0  # of the run, and s: one-time allocations are done by then
_CONFIDENCE = 0.95
_HOUR = 3600.0  # s


class Sample(NamedTuple):
    """Values of all quantities at one time."""

    time_s: float  # since the start
    values: Mapping[tuple[str, str], float]  # (node, quantity) → value


class Growth(NamedTuple):
    """Growth of one quantity."""

    first: float
    last: float
    per_hour: float
    uncertainty: float  # half the interval; nan if the run is too short

    @property
    def is_certain(self) -> bool:
        """Whether the interval lies above zero."""
        return self.per_hour - self.uncertainty > 0.0


def growth(times_s: FloatArray, values: FloatArray) -> Growth:
    """Slope of (n,) values over their times; NaN values are ignored."""
    is_finite = np.isfinite(values)
    if not is_finite.any():
        return Growth(math.nan, math.nan, math.nan, math.nan)
    times_s, values = times_s[is_finite], values[is_finite]
    length_s = times_s[-1] - times_s[0]
    settled = times_s >= times_s[0] + max(_SETTLING * length_s, _SETTLING_S)
    if np.count_nonzero(settled) < 2 * SECTIONS:
        return Growth(float(values[0]), float(values[-1]), math.nan, math.nan)
    times_s, values = times_s[settled], values[settled]
    parts = zip(np.array_split(times_s, SECTIONS), np.array_split(values, SECTIONS), strict=True)
    at_s, means = np.array([(t.mean(), v.mean()) for t, v in parts]).T
    if np.ptp(means) == 0.0:
        return Growth(float(means[0]), float(means[-1]), 0.0, 0.0)
    fit = linregress(at_s, means)
    quantile = student.ppf(0.5 + _CONFIDENCE / 2.0, SECTIONS - 2)
    return Growth(
        float(means[0]), float(means[-1]), _HOUR * float(fit.slope), _HOUR * float(quantile * fit.stderr)
    )


def growths(samples: Sequence[Sample]) -> dict[tuple[str, str], Growth]:
    """Growth of each quantity that all samples contain."""
    names = [name for name in samples[0].values if all(name in sample.values for sample in samples)]
    times_s = np.array([sample.time_s for sample in samples])
    return {name: growth(times_s, np.array([s.values[name] for s in samples])) for name in names}


def page(samples: Sequence[Sample], counts: Mapping[str, float], heading: str) -> str:
    """Markdown page; ``counts``: totals at the end."""
    by_quantity = growths(samples)
    lines = [
        "# Soak",
        "",
        heading,
        "",
        *(f"- {name}: {value:.0f}" for name, value in counts.items()),
        "",
        "| node | quantity | at first | at last | growth in an hour (95 %) |",
        "|---|---|--:|--:|--:|",
    ]
    for (node, quantity), g in by_quantity.items():
        rate = (
            "run too short"
            if math.isnan(g.per_hour)
            else f"{_rounded(g.per_hour)} ± {_rounded(g.uncertainty)}"
        )
        lines.append(f"| {node} | {quantity} | {_rounded(g.first)} | {_rounded(g.last)} | {rate} |")
    return "\n".join(lines) + "\n"


def _rounded(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 100.0 else f"{value:.0f}"
