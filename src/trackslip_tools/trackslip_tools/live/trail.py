# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The path of a day in bounded memory: points a little apart, twice as far where there are too many."""

import math
from collections.abc import Iterator

MOST = 3000  # points
_CLOSEST = 0.02  # m between two points


class Trail:
    """Keeps where something was; ``thinned`` counts how often half of the points were dropped."""

    def __init__(self, most: int = MOST, closest: float = _CLOSEST) -> None:
        self._most, self._apart = most, closest
        self.points: list[tuple[float, float]] = []  # m
        self.thinned = 0

    def add(self, x: float, y: float) -> bool:
        """A place; whether it is far enough from the last one to be kept."""
        if not (math.isfinite(x) and math.isfinite(y)):
            return False
        if self.points and math.dist(self.points[-1], (x, y)) < self._apart:
            return False
        self.points.append((round(x, 3), round(y, 3)))
        if len(self.points) > self._most:
            self.points = self.points[::2]
            self._apart *= 2.0
            self.thinned += 1
        return True

    def columns(self) -> dict[str, list[float]]:
        """x and y of all points."""
        return {name: [point[axis] for point in self.points] for axis, name in enumerate("xy")}

    def __iter__(self) -> Iterator[tuple[float, float]]:
        return iter(self.points)
