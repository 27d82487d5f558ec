# SPDX-License-Identifier: Apache-2.0
"""The vehicle's constants, as one frozen record (``config/pc05.yaml`` holds the excavator's).

m, I_z   mass, yaw inertia                 kg, kg m²
B        tread, between track centre lines m
l, b     contact length, track width       m
r        rolling radius of the sprocket    m
V_m, n_g motor displacement, gear ratio    m³/rev, 1
η_m      mechanical efficiency η₀/η_V      1
"""

from dataclasses import dataclass

from trackslip_common.parameters import Parameters, parameter

GRAVITY = 9.80665  # m/s²


@dataclass(frozen=True, kw_only=True)
class Vehicle(Parameters):
    """Geometry, mass, hydraulics and marker of one tracked machine; SI units."""

    mass: float = parameter("mass m", unit="kg", gt=0.0)
    yaw_inertia: float = parameter("moment of inertia I_z about the vertical", unit="kg m²", gt=0.0)
    tread: float = parameter("distance B between the track centre lines", unit="m", gt=0.0)
    contact_length: float = parameter("length l of one track on the ground", unit="m", gt=0.0)
    track_width: float = parameter("width b of one track", unit="m", gt=0.0)
    rolling_radius: float = parameter("track travel per radian of sprocket r", unit="m", gt=0.0)
    motor_displacement: float = parameter("oil per motor turn V_m", unit="m³", gt=0.0)
    gear_ratio: float = parameter("motor turns per sprocket turn n_g", gt=0.0)
    motor_efficiency: float = parameter("pressure to torque η_m = η₀/η_V", gt=0.0, le=1.0)
    volumetric_efficiency: float = parameter("flow to speed η_V", gt=0.0, le=1.0)
    relief_pressure: float = parameter("highest pressure over a motor", unit="Pa", gt=0.0)
    pump_flow: float = parameter("flow of the pump of one track", unit="m³/s", gt=0.0)
    box_length: float = parameter("side of the laser box along x", unit="m", gt=0.0)
    box_width: float = parameter("side of the laser box along y", unit="m", gt=0.0)
    box_x: float = parameter("centre of the laser box ahead of base_link", unit="m")
    box_y: float = parameter("centre of the laser box left of base_link", unit="m")

    @property
    def weight(self) -> float:
        """W = m g, N."""
        return self.mass * GRAVITY
