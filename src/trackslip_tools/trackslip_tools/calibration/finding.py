# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One calibrated number, or the reason why the bags do not determine it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """A value with its 95 % interval; both None with a ``reason``."""

    unit: str
    value: float | None
    interval: tuple[float, float] | None
    basis: str = ""  # evidence
    reason: str = ""

    @property
    def has_value(self) -> bool:
        """Whether there is a value."""
        return self.value is not None

    @property
    def spread(self) -> float:
        """From the value to the upper end of its interval; 0 without a value."""
        return 0.0 if self.value is None or self.interval is None else self.interval[1] - self.value

    def contains(self, number: float) -> bool:
        """Whether the interval contains a number; False without a value."""
        return self.interval is not None and self.interval[0] <= number <= self.interval[1]

    @property
    def decimals(self) -> int:
        """Decimals that give half the interval two significant digits; 0 for an interval of no width."""
        half = 0.0 if self.interval is None else (self.interval[1] - self.interval[0]) / 2.0
        return 1 - math.floor(math.log10(half)) if 0.0 < half < math.inf else 0

    @property
    def rounded_value(self) -> float | None:
        """The value, rounded to ``decimals``."""
        return None if self.value is None else round_value(self.value, self.decimals)


def round_value(value: float, decimals: int) -> float:
    """The rounded value; never −0."""
    return round(value, decimals) + 0.0


def make_finding(value: float, spread: float, unit: str, basis: str) -> Finding:
    """A finding from a value and half the width of its 95 % interval; no value if either is not finite."""
    if not (math.isfinite(value) and math.isfinite(spread)):
        return empty_finding("the data do not determine a value", unit)
    return Finding(unit, float(value), (float(value - spread), float(value + spread)), basis)


def empty_finding(reason: str, unit: str = "") -> Finding:
    """A finding without a value."""
    return Finding(unit, None, None, reason=reason)


def empty_findings(reason: str, units: Mapping[str, str]) -> dict[str, Finding]:
    """Findings without values, by name; ``units``: name → unit."""
    return {name: empty_finding(reason, unit) for name, unit in units.items()}
