# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Terrains: shape of the ground (``config/terrains/*.yaml``); lengths in m, angles in ° (``_deg``)."""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from trackslip_common.errors import InputError
from trackslip_sim.scenarios.checks import each, load, named, number, refuse_unknown, text
from trackslip_sim.truth.terrain import FLAT, Feature, Hill, Plane, Ramp, Terrain

_LEAST_M, _MOST = 1e-3, 1e6  # smallest rounding or width, m; largest magnitude of any number


def terrain_names() -> list[str]:
    """Names of the terrains in ``config/terrains``, and ``flat``."""
    return [FLAT.name, *named("terrain")]


def load_terrain(name_or_file: str) -> Terrain:
    """A terrain by its name in ``config/terrains``, or from a user's file.

    Raises:
        InputError: the terrain is unknown, or its file is refused.
    """
    if name_or_file == FLAT.name:
        return FLAT
    return load("terrain", name_or_file, terrain_names(), parse_terrain)


def parse_terrain(tree: Mapping[str, Any]) -> Terrain:
    """A terrain from the mapping of its file.

    Raises:
        InputError: a key is missing or unknown, or a value is refused.
    """
    refuse_unknown(tree, ("name", "features"))
    return Terrain(text(tree, "name"), tuple(each(tree, "features", _feature)))


def _feature(entry: Mapping[str, Any]) -> Feature:
    kind = text(entry, "kind")
    if kind not in _KINDS:
        raise InputError(f"kind = {kind!r} is refused; accepted: {', '.join(_KINDS)}")
    build, keys = _KINDS[kind]
    refuse_unknown(entry, ("kind", *keys))
    numbers = {key: _moderate(entry, key) for key in keys}
    for key in ("rounding", "width"):
        if key in numbers and not numbers[key] >= _LEAST_M:
            raise InputError(f"{key} = {numbers[key]!r} is refused; accepted: at least {_LEAST_M:g} m")
    if numbers.get("length", 0.0) < numbers.get("rounding", 0.0):
        raise InputError(f"length = {numbers['length']!r} is refused; accepted: >= rounding")
    return build(*(math.radians(value) if key.endswith("_deg") else value for key, value in numbers.items()))


def _moderate(entry: Mapping[str, Any], key: str) -> float:
    value = number(entry, key)
    if not abs(value) <= _MOST:
        raise InputError(f"{key} = {value!r} is refused; accepted: within ±{_MOST:g}")
    return value


_DIRECTED = ("direction_deg", "slope_deg")
_KINDS: Mapping[str, tuple[Callable[..., Feature], tuple[str, ...]]] = MappingProxyType(
    {
        "plane": (Plane, _DIRECTED),
        "ramp": (Ramp, (*_DIRECTED, "start", "length", "rounding")),
        "hill": (Hill, ("x", "y", "height", "width")),
    }
)
