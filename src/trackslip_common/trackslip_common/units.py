# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Units that files and users name, and their factors to SI."""

import math
from collections.abc import Mapping
from types import MappingProxyType

from trackslip_common.errors import InputError, did_you_mean

NS_PER_S = 1_000_000_000
GRAVITY = 9.80665  # m/s², standard gravity
_DEG = math.pi / 180.0
_RPM = math.pi / 30.0
_KMH = 1.0 / 3.6

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "time": {
            "s": 1.0,
            "ms": 1e-3,
            "us": 1e-6,
            "µs": 1e-6,
            "ns": 1e-9,
            "min": 60.0,
            "h": 3600.0,
            "d": 86400.0,
        },
        "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "in": 0.0254, "ft": 0.3048},
        "angle": {"rad": 1.0, "deg": _DEG, "°": _DEG, "gon": 0.9 * _DEG, "mrad": 1e-3, "rev": 2.0 * math.pi},
        "angular rate": {
            "rad/s": 1.0,
            "deg/s": _DEG,
            "°/s": _DEG,
            "rpm": _RPM,
            "1/min": _RPM,
            "rev/s": 2.0 * math.pi,
            "mrad/s": 1e-3,
            "deg/h": _DEG / 3600.0,
        },
        "speed": {
            "m/s": 1.0,
            "km/h": _KMH,
            "cm/s": 1e-2,
            "mm/s": 1e-3,
            "m/min": 1.0 / 60.0,
            "ft/s": 0.3048,
            "mph": 0.44704,
            "kn": 1852.0 / 3600.0,
        },
        "acceleration": {"m/s^2": 1.0, "m/s²": 1.0, "g": GRAVITY, "mg": GRAVITY * 1e-3},
        "pressure": {
            "Pa": 1.0,
            "hPa": 1e2,
            "kPa": 1e3,
            "MPa": 1e6,
            "bar": 1e5,
            "mbar": 1e2,
            "psi": 6894.757293168361,
        },
        "ratio": {"1": 1.0, "%": 1e-2},
    }
)
"""Quantity → unit → factor to SI."""


def factor_to_si(where: str, unit: object, *quantities: str) -> tuple[str, float]:
    """(quantity, factor) of a unit that must be one of these quantities; ``where`` begins the message.

    Raises:
        InputError: the unit is unknown, or of another quantity.
    """
    name = str(unit)
    for quantity in quantities:
        if name in UNITS[quantity]:
            return quantity, UNITS[quantity][name]
    accepted = [known_unit for quantity in quantities for known_unit in UNITS[quantity]]
    other = [quantity for quantity in UNITS if name in UNITS[quantity]]
    problem = f"is a unit of {other[0]}" if other else f"is unknown{did_you_mean(name, accepted)}"
    raise InputError(f"{where}: '{name}' {problem}; accepted: {', '.join(accepted)}")
