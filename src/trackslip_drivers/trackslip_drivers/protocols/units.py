# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Units in the notation of a DBC, and their SI values; a unit that is not in the table is rejected."""

import math
from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple


class Quantity(Enum):
    """Physical quantity of a unit."""

    PRESSURE = "pressure"
    ANGLE = "angle"
    COUNT = "counts of an encoder"
    ANGULAR_SPEED = "angular speed"
    SPEED = "speed"
    FLOW = "flow"
    RATIO = "ratio"


class Unit(NamedTuple):
    """A unit; ``factor`` is its SI value (in Pa, rad, rad/s, m/s, m³/s, 1; counts are unchanged)."""

    quantity: Quantity
    factor: float


_TURN = 2.0 * math.pi
_DEGREE = math.pi / 180.0
_PER_MINUTE = _TURN / 60.0
_LITRE = 1e-3

_TABLE: Mapping[Quantity, Mapping[float, tuple[str, ...]]] = {
    Quantity.PRESSURE: {
        1.0: ("Pa",),
        1e2: ("hPa", "mbar"),
        1e3: ("kPa", "kpa", "KPa"),
        1e5: ("bar", "Bar", "BAR"),
        1e6: ("MPa",),
        6894.757293168361: ("psi", "PSI", "lbf/in²"),
        98066.5: ("kgf/cm²", "kgf/cm2"),
    },
    Quantity.ANGLE: {
        1.0: ("rad",),
        1e-3: ("mrad",),
        _DEGREE: ("deg", "Deg", "DEG", "°", "degree", "degrees"),
        _TURN: ("rev", "turn", "turns"),
    },
    Quantity.COUNT: {
        1.0: ("count", "counts", "Counts", "cnt", "inc", "increments", "pulse", "pulses", "tick", "ticks"),
    },
    Quantity.ANGULAR_SPEED: {
        1.0: ("rad/s",),
        _DEGREE: ("deg/s", "°/s"),
        _PER_MINUTE: ("rpm", "RPM", "1/min", "rev/min", "min-1", "U/min"),
        _TURN: ("rev/s", "1/s", "Hz"),
    },
    Quantity.SPEED: {1.0: ("m/s",), 1e-3: ("mm/s",), 1.0 / 3.6: ("km/h", "kph", "kmh")},
    Quantity.FLOW: {
        1.0: ("m³/s", "m3/s"),
        _LITRE: ("l/s", "L/s"),
        _LITRE / 60.0: ("l/min", "L/min", "lpm", "LPM"),
        _LITRE / 3600.0: ("l/h", "L/h"),
    },
    Quantity.RATIO: {1.0: ("1", "-"), 1e-2: ("%", "percent"), 1e-3: ("‰", "permille")},
}

UNITS: Mapping[str, Unit] = {
    name: Unit(quantity, factor)
    for quantity, units in _TABLE.items()
    for factor, names in units.items()
    for name in names
}


def accepted_units(quantities: tuple[Quantity, ...]) -> str:
    """The units of these quantities, for messages."""
    return ", ".join(name for kind in quantities for name, unit in UNITS.items() if unit.quantity is kind)
