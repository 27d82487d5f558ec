# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Terrains: shape of the ground (``config/terrains/*.yaml``); lengths in m, angles in ° (``_deg``)."""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from trackslip_common.errors import InputError
from trackslip_common.yaml_tree import check_keys, choice, number, text
from trackslip_sim.scenarios.record_files import load_record, read_list, record_names
from trackslip_sim.truth.terrain import FLAT, Feature, Hill, Plane, Ramp, Terrain

_MIN_LENGTH, _MAX_VALUE = 1e-3, 1e6  # smallest rounding or width, m; largest magnitude of any number


def terrain_names() -> list[str]:
    """Names of the terrains in ``config/terrains``, and ``flat``."""
    return [FLAT.name, *record_names("terrain")]


def load_terrain(name_or_file: str) -> Terrain:
    """A terrain by its name in ``config/terrains``, or from a user's file.

    Raises:
        InputError: the terrain is unknown, or its file is refused.
    """
    if name_or_file == FLAT.name:
        return FLAT
    return load_record("terrain", name_or_file, terrain_names(), parse_terrain)


def parse_terrain(tree: Mapping[str, Any]) -> Terrain:
    """A terrain from the mapping of its file.

    Raises:
        InputError: a key is missing or unknown, or a value is refused.
    """
    check_keys("terrain", tree, ("name",), ("features",))
    return Terrain(text("terrain: name", tree["name"]), tuple(read_list(tree, "features", _read_feature)))


def _read_feature(entry: Mapping[str, Any]) -> Feature:
    build, keys = _KINDS[choice("feature: kind", entry.get("kind"), _KINDS)]
    check_keys("feature", entry, ("kind", *keys), ())
    numbers = {key: number(f"feature: {key}", entry[key]) for key in keys}
    for key, value in numbers.items():
        if not abs(value) <= _MAX_VALUE:
            raise InputError(f"{key} = {value!r} is refused; accepted: within ±{_MAX_VALUE:g}")
        if key in ("rounding", "width") and not value >= _MIN_LENGTH:
            raise InputError(f"{key} = {value!r} is refused; accepted: at least {_MIN_LENGTH:g} m")
    if numbers.get("length", 0.0) < numbers.get("rounding", 0.0):
        raise InputError(f"length = {numbers['length']!r} is refused; accepted: >= rounding")
    return build(*(math.radians(value) if key.endswith("_deg") else value for key, value in numbers.items()))


_SLOPE_KEYS = ("direction_deg", "slope_deg")
_KINDS: Mapping[str, tuple[Callable[..., Feature], tuple[str, ...]]] = MappingProxyType(
    {
        "plane": (Plane, _SLOPE_KEYS),
        "ramp": (Ramp, (*_SLOPE_KEYS, "start", "length", "rounding")),
        "hill": (Hill, ("x", "y", "height", "width")),
    }
)
