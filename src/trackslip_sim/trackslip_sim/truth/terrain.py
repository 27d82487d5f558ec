# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The shape of the ground: a sum of planes, ramps and hills, all smooth, and 0 m high at the origin.

    x, y    horizontal, site frame                              m
    h       height over the origin                              m
    d       distance along a feature's direction                m
    S       smoothstep 3 t² - 2 t³; 0 for t < 0, 1 for t > 1    1

Plane  h = d tan s                   Hill  h = H exp(-r²/(2 w²))
Ramp   dh/dd = tan s (S((d - a)/w) - S((d - a - l)/w)): level, bend of length w, slope s, bend, level
"""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.errors import InputError

MAX_SLOPE = math.radians(45.0)  # of one feature
_PLANE, _RAMP, _HILL = 0.0, 1.0, 2.0
_WIDTH = 6


@dataclass(frozen=True)
class Plane:
    """Ground that rises everywhere in one direction."""

    KIND: ClassVar[float] = _PLANE
    direction: float  # rad, counter-clockwise from x
    slope: float  # rad

    @property
    def radius(self) -> float:
        """Radius of the sharpest bend, m."""
        return math.inf


@dataclass(frozen=True)
class Ramp:
    """Ground that rises in one direction over a limited length."""

    KIND: ClassVar[float] = _RAMP
    direction: float  # rad, counter-clockwise from x
    slope: float  # rad
    start: float  # m along the direction
    length: float  # m from the beginning of one bend to the beginning of the other
    rounding: float  # m, length of a bend

    @property
    def radius(self) -> float:
        """Radius of the sharpest bend, m."""
        return self.rounding / (1.5 * abs(math.tan(self.slope))) if self.slope else math.inf


@dataclass(frozen=True)
class Hill:
    """A round hill; a hollow if ``height`` is negative."""

    KIND: ClassVar[float] = _HILL
    x: float  # m, its top
    y: float  # m
    height: float  # m
    width: float  # m from the top to the steepest point

    @property
    def slope(self) -> float:
        """Slope at the steepest point, rad."""
        return math.atan(math.exp(-0.5) * self.height / self.width)

    @property
    def radius(self) -> float:
        """Radius of the sharpest bend, which is at the top, m."""
        return self.width**2 / abs(self.height) if self.height else math.inf


Feature = Plane | Ramp | Hill


class TerrainMap(NamedTuple):
    """A terrain as arrays for kernels."""

    table: FloatArray  # (features, 6): kind, and the feature's numbers
    datum: float  # m, the sum's height at the origin


@dataclass(frozen=True)
class Terrain:
    """The sum of its features.

    Raises:
        InputError: a feature is steeper than ``MAX_SLOPE``.
    """

    name: str
    features: tuple[Feature, ...]

    def __post_init__(self) -> None:
        for feature in self.features:
            if not abs(feature.slope) <= MAX_SLOPE:
                raise InputError(
                    f"terrain '{self.name}': a slope of {math.degrees(feature.slope):.3g}° is refused;"
                    f" accepted: within ±{math.degrees(MAX_SLOPE):g}°"
                )

    @property
    def radius(self) -> float:
        """Radius of the sharpest bend of any single feature, m."""
        return min((feature.radius for feature in self.features), default=math.inf)

    @property
    def map(self) -> TerrainMap:
        """The terrain as arrays for kernels."""
        table = np.zeros((len(self.features), _WIDTH))
        for row, feature in zip(table, self.features, strict=True):
            numbers = astuple(feature)
            row[0], row[1 : 1 + len(numbers)] = feature.KIND, numbers
        shape = np.zeros(_WIDTH)
        shape_at(0.0, 0.0, TerrainMap(table, 0.0), shape)
        return TerrainMap(table, float(shape[0]))


FLAT = Terrain("flat", ())


@compiled
def shape_at(x: float, y: float, terrain: TerrainMap, shape: FloatArray) -> None:
    """Fill ``shape`` (6,): h, h_x, h_y, h_xx, h_xy, h_yy at a point."""
    shape[:] = 0.0
    shape[0] = -terrain.datum
    for k in range(len(terrain.table)):
        row = terrain.table[k]
        if row[0] == _HILL:
            a, b, width2 = x - row[1], y - row[2], row[4] * row[4]
            height = row[3] * math.exp(-0.5 * (a * a + b * b) / width2)
            shape[0] += height
            shape[1] -= height * a / width2
            shape[2] -= height * b / width2
            shape[3] += height * (a * a / width2 - 1.0) / width2
            shape[4] += height * a * b / width2**2
            shape[5] += height * (b * b / width2 - 1.0) / width2
        else:
            cos, sin, steep = math.cos(row[1]), math.sin(row[1]), math.tan(row[2])
            d = cos * x + sin * y
            height, slope, bend = d, 1.0, 0.0
            if row[0] == _RAMP:
                up, up_slope, up_bend = _rounding_profile((d - row[3]) / row[5])
                down, down_slope, down_bend = _rounding_profile((d - row[3] - row[4]) / row[5])
                height, slope = row[5] * (up - down), up_slope - down_slope
                bend = (up_bend - down_bend) / row[5]
            shape[0] += steep * height
            shape[1] += steep * slope * cos
            shape[2] += steep * slope * sin
            shape[3] += steep * bend * cos * cos
            shape[4] += steep * bend * cos * sin
            shape[5] += steep * bend * sin * sin


@compiled
def _rounding_profile(t: float) -> tuple[float, float, float]:
    """Integral of S up to t, S, and its derivative."""
    if t <= 0.0:
        return 0.0, 0.0, 0.0
    if t >= 1.0:
        return t - 0.5, 1.0, 0.0
    return t**3 * (1.0 - 0.5 * t), t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t)


def heights(terrain: Terrain, x: Sequence[float] | FloatArray, y: Sequence[float] | FloatArray) -> FloatArray:
    """h (n,), m, at points x, y (n,), m."""
    shape, ground = np.zeros(_WIDTH), terrain.map
    result = np.empty(len(x))
    for k, (x_k, y_k) in enumerate(zip(x, y, strict=True)):
        shape_at(float(x_k), float(y_k), ground, shape)
        result[k] = shape[0]
    return result
