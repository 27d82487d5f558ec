# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The ground of a run: terrain shape, one base soil, and rectangular patches of other soils."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.compiled import compiled
from trackslip_common.errors import InputError, suggestion
from trackslip_common.soils import Soil
from trackslip_sim.truth.terrain import FLAT, Terrain


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A rectangle of another soil, site frame, m.

    Raises:
        InputError: the rectangle is empty.
    """

    soil: str
    from_x: float
    to_x: float
    from_y: float
    to_y: float

    def __post_init__(self) -> None:
        for low, high in (("from_x", "to_x"), ("from_y", "to_y")):
            if not getattr(self, low) < getattr(self, high):
                raise InputError(
                    f"patch of '{self.soil}' is empty: {high} = {getattr(self, high)!r};"
                    f" accepted: > {low} = {getattr(self, low)!r} m"
                )


class SoilMap(NamedTuple):
    """The soils as arrays for kernels: soil 0 lies outside all patches; later patches cover earlier ones."""

    table: FloatArray  # (soils, 4): c Pa, tan ϕ, K m, μ_r
    edges: FloatArray  # (patches, 4): from_x, to_x, from_y, to_y
    patch_soil: IntArray  # (patches,), index into table


@dataclass(frozen=True, eq=False)
class Ground:
    """The soils of a run, their places, and the terrain."""

    soils: tuple[Soil, ...]
    map: SoilMap
    terrain: Terrain = FLAT

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the soils."""
        return tuple(soil.name for soil in self.soils)


def build_ground(
    base: Soil, patches: Sequence[Patch], soils: dict[str, Soil], terrain: Terrain = FLAT
) -> Ground:
    """The ground of a base soil, patches (their names looked up in ``soils``) and a terrain.

    Raises:
        InputError: a patch names an unknown soil, or a soil lacks K or μ_r.
    """
    names = [base.name]
    for patch in patches:
        if patch.soil not in soils:
            raise InputError(f"patch: soil '{patch.soil}' is unknown{suggestion(patch.soil, soils)}")
        if patch.soil not in names:
            names.append(patch.soil)
    records = [base, *(soils[name] for name in names[1:])]
    table = [
        [s.cohesion, math.tan(s.friction_angle), s.value("shear_modulus"), s.value("mu_r")] for s in records
    ]
    edges = [[patch.from_x, patch.to_x, patch.from_y, patch.to_y] for patch in patches]
    soil_map = SoilMap(
        table=np.array(table, dtype=np.float64),
        edges=np.array(edges, dtype=np.float64).reshape(-1, 4),
        patch_soil=np.array([names.index(patch.soil) for patch in patches], dtype=np.int64),
    )
    return Ground(tuple(records), soil_map, terrain)


@compiled
def soil_at(x: float, y: float, ground: SoilMap) -> int:
    """Index of the soil at a point of the site frame."""
    edges = ground.edges
    for k in range(len(ground.patch_soil) - 1, -1, -1):
        if edges[k, 0] <= x < edges[k, 1] and edges[k, 2] <= y < edges[k, 3]:
            return int(ground.patch_soil[k])
    return 0
