# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Checks that the numbers of a vehicle are consistent: finds wrong units that the range of no number shows.

r/l, l/B               rolling radius over contact length, contact length over tread
W/(2 b l)              ground pressure
√(I_z/m)/l             radius of gyration over contact length
η_m V_m n_g p/(π r W)  thrust of both tracks at relief pressure over weight
2π η_V Q r/(V_m n_g)   top speed
m_u/m                  share of the mass that swings

The range of each covers machines from a tracked robot of 17 kg to a mining shovel, with a margin.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

from trackslip_common.errors import InputError
from trackslip_common.vehicle import VehicleParameters


class _DerivedQuantity(NamedTuple):
    """A quantity derived from several numbers, with its range over real machines."""

    what: str
    value: float
    unit: str
    least: float
    most: float
    inputs: str  # the numbers it is derived from, with their units


def check_consistency(vehicle: VehicleParameters, where: str) -> None:
    """Check a vehicle whose numbers are each in range.

    Raises:
        InputError: some numbers are inconsistent; the message names them, and their units.
    """
    for quantity in _derived_quantities(vehicle):
        if not quantity.least <= quantity.value <= quantity.most:
            value = f"{quantity.value:.3g} {quantity.unit}".rstrip()
            accepted = f"{quantity.least:g} to {quantity.most:g} {quantity.unit}".rstrip()
            raise InputError(
                f"{where}: {quantity.what} of {value}; accepted: {accepted}, by {quantity.inputs}"
            )


def _derived_quantities(vehicle: VehicleParameters) -> Iterator[_DerivedQuantity]:
    k, m, h, upper = vehicle.kinematics, vehicle.mass, vehicle.hydraulics, vehicle.upper_structure
    inputs = "kinematics.rolling_radius, contact_length and tread (m)"
    # two wheels of a side fit between the ends of the contact length
    radius = k.rolling_radius / k.contact_length
    yield _DerivedQuantity("rolling radius over contact length", radius, "", 0.01, 0.5, inputs)
    yield _DerivedQuantity("contact length over tread", k.contact_length / k.tread, "", 0.1, 10.0, inputs)
    if m is not None:
        pressure = m.weight / (2.0 * m.track_width * k.contact_length)
        inputs = "mass.mass (kg), mass.track_width and kinematics.contact_length (m)"
        yield _DerivedQuantity("ground pressure", pressure * 1e-3, "kPa", 0.5, 500.0, inputs)
        gyration = math.sqrt(m.yaw_inertia / m.mass) / k.contact_length
        inputs = "mass.yaw_inertia (kg m²), mass.mass (kg) and kinematics.contact_length (m)"
        yield _DerivedQuantity("radius of gyration over contact length", gyration, "", 0.1, 3.0, inputs)
    if h is not None:
        swept = h.motor_displacement * h.gear_ratio / (2.0 * math.pi * k.rolling_radius)  # m³ per m
        speed = h.volumetric_efficiency * h.pump_flow / swept
        inputs = "hydraulics.pump_flow (m³/s), motor_displacement (m³), gear_ratio, rolling_radius (m)"
        yield _DerivedQuantity("top speed", speed, "m/s", 0.01, 30.0, inputs)
        if m is not None:
            thrust = 2.0 * h.motor_efficiency * swept * h.relief_pressure / m.weight
            inputs = "mass.mass (kg), hydraulics.relief_pressure (Pa), motor_displacement (m³) and gear_ratio"
            yield _DerivedQuantity("thrust over weight", thrust, "", 0.03, 30.0, inputs)
    if m is not None and upper is not None:
        inputs = "upper_structure.mass and mass.mass (kg)"
        yield _DerivedQuantity("share of the mass that swings", upper.mass / m.mass, "", 0.01, 1.0, inputs)
