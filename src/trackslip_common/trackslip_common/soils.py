# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Soils as frozen records; ``config/soils.yaml`` has Tables 2.1, 2.2 and 6.1 of the thesis.

c, ϕ      apparent cohesion, angle of internal shearing resistance   Pa, rad
K         shear deformation modulus                                  m
μ_r, μ_l  coefficients of longitudinal and lateral resistance        1
n, k_c, k_ϕ   Bekker's sinkage parameters (2.5)                      1, N/m^(n+1), N/m^(n+2)
k_0, A_u  unloading and reloading stiffness (2.7)                    Pa/m, Pa/m²
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from trackslip_common.config_files import config_file, read_yaml
from trackslip_common.errors import InputError, suggestion
from trackslip_common.parameter_spec import Spec

_COHESION = Spec("apparent cohesion c", unit="Pa", ge=0.0)
_ANGLE = Spec("angle of internal shearing resistance ϕ", unit="rad", ge=0.0, lt=math.pi / 2)
_MODULUS = Spec("shear deformation modulus K", unit="m", gt=0.0, le=1.0)

RANGES: Mapping[str, Spec] = MappingProxyType(
    {
        "cohesion": _COHESION,
        "friction_angle": _ANGLE,
        "shear_modulus": _MODULUS,
        "mu_r": Spec("coefficient of longitudinal resistance μ_r", ge=0.0),
        "mu_l": Spec("coefficient of lateral resistance μ_l", gt=0.0),
        "n": Spec("sinkage exponent", gt=0.0),
        "k_c": Spec("cohesive modulus of sinkage", unit="N/m^(n+1)", ge=0.0),
        "k_phi": Spec("frictional modulus of sinkage", unit="N/m^(n+2)", ge=0.0),
        "k_0": Spec("unloading stiffness at the surface", unit="Pa/m", ge=0.0),
        "a_u": Spec("growth of the unloading stiffness with sinkage", unit="Pa/m²", ge=0.0),
        "rubber_cohesion": _COHESION,
        "rubber_friction_angle": _ANGLE,
        "rubber_shear_modulus": _MODULUS,
    }
)

_FILE_UNITS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {"_kPa": ("Pa", 1e3), "_kN": ("N", 1e3), "_cm": ("m", 0.01), "_deg": ("rad", math.pi / 180)}
)  # suffix in the file → start of its SI unit, factor


@dataclass(frozen=True, kw_only=True)
class Soil:
    """One soil, in SI units and radians; None where its table has no value (see ``value``).

    Raises:
        InputError: a value is impossible; the message names field, value and accepted range.
    """

    name: str
    cohesion: float
    friction_angle: float
    shear_modulus: float | None = None
    mu_r: float | None = None
    mu_l: float | None = None
    n: float | None = None
    k_c: float | None = None
    k_phi: float | None = None
    k_0: float | None = None
    a_u: float | None = None
    rubber_cohesion: float | None = None
    rubber_friction_angle: float | None = None
    rubber_shear_modulus: float | None = None
    source: str = ""

    def __post_init__(self) -> None:
        """Check every field against ``RANGES``."""
        for field, spec in RANGES.items():
            value = getattr(self, field)
            if value is None and field not in ("cohesion", "friction_angle"):
                continue
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not spec.accepts(value):
                raise InputError(
                    f"soil '{self.name}': {field} = {value!r} is refused; accepted: {spec.accepted_range()}"
                )
        if self.cohesion == 0.0 and self.friction_angle == 0.0:
            raise InputError(
                f"soil '{self.name}': cohesion = friction_angle = 0 carries no thrust; accepted: one above 0"
            )

    def value(self, field: str) -> float:
        """A property that the caller needs.

        Raises:
            InputError: the property is unknown, or this soil has no value of it.
        """
        if field not in RANGES:
            raise InputError(f"soil '{self.name}': no property '{field}'; accepted: {', '.join(RANGES)}")
        value = getattr(self, field)
        if value is None:
            raise InputError(
                f"soil '{self.name}': {field} = None, but it is needed here; accepted: "
                f"{RANGES[field].accepted_range()} (give it in soils.yaml, or take a soil that has it)"
            )
        return float(value)


def load_soils(file: str = "soils.yaml") -> dict[str, Soil]:
    """All soils of a file, by name; ``file`` is a name in ``config/`` or a path of the user.

    Raises:
        InputError: the file or one of its values cannot be used.
    """
    path = config_file(file)
    soils = {name: _parse_soil(path, str(name), entry) for name, entry in read_yaml(path).items()}
    if not soils:
        raise InputError(f"{path}: no soils in it; accepted: at least one name with its values")
    return soils


def soil(name: str) -> Soil:
    """The soil of that name in ``config/soils.yaml``.

    Raises:
        InputError: there is no such soil; the message suggests names.
    """
    soils = _default_soils()
    if name not in soils:
        raise InputError(f"soil: '{name}' is unknown{suggestion(name, soils)}")
    return soils[name]


@lru_cache(maxsize=1)
def _default_soils() -> Mapping[str, Soil]:
    return MappingProxyType(load_soils())


def _parse_soil(path: Path, name: str, entry: Any) -> Soil:
    """Build one record from its YAML mapping, whose names carry units."""
    if not isinstance(entry, Mapping):
        raise InputError(f"{path}: soil '{name}': {entry!r} is not a mapping of properties to values")
    values: dict[str, Any] = {"source": str(entry.get("source", ""))}
    for key, number in entry.items():
        if key == "source":
            continue
        field, factor = _field_and_factor(path, name, str(key))
        if field in values:
            raise InputError(f"{path}: soil '{name}': {field} is given twice; accepted: one unit")
        if type(number) not in (int, float) or not RANGES[field].accepts(number * factor):
            raise InputError(
                f"{path}: soil '{name}': {key} = {number!r} is refused; "
                f"accepted: {field} {RANGES[field].accepted_range()}"
            )
        values[field] = number * factor
    for field in ("cohesion", "friction_angle"):
        if field not in values:
            raise InputError(
                f"{path}: soil '{name}': {field} is missing; accepted: {RANGES[field].accepted_range()}"
            )
    return Soil(name=name, **values)


def _field_and_factor(path: Path, name: str, key: str) -> tuple[str, float]:
    """'cohesion_kPa' → ('cohesion', 1000.0)."""
    if key in RANGES:
        return key, 1.0
    for suffix, (unit, factor) in _FILE_UNITS.items():
        field = key.removesuffix(suffix)
        if field != key and field in RANGES and RANGES[field].unit.startswith(unit):
            return field, factor
    raise InputError(
        f"{path}: soil '{name}': unknown property '{key}'; accepted: {', '.join(RANGES)} in SI units, "
        f"or with the suffix of another unit: {', '.join(_FILE_UNITS)}"
    )
