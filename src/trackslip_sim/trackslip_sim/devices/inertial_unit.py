# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""An inertial unit that is no Watson: each sample arrives as it is measured."""

from collections.abc import Callable

from trackslip_drivers.records import ImuSample


class InertialUnit:
    """Samples at ``rate`` Hz from ``start_ns`` on; ``measure`` has the readings at a stamp."""

    def __init__(self, rate: float, measure: Callable[[int], ImuSample], start_ns: int) -> None:
        self._period_ns = round(1e9 / rate)
        self._measure = measure
        self.next_ns = start_ns

    def step(self, now_ns: int, powered: bool) -> list[ImuSample]:
        """Those due by now; none where it has no power, or nobody hears it."""
        found = []
        while self.next_ns <= now_ns:
            if powered:
                found.append(self._measure(self.next_ns))
            self.next_ns += self._period_ns
        return found
