# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Constants of the vehicle: the groups of a file of ``config/vehicles/``, and a complete machine.

m, I_z   mass, yaw inertia                 kg, kg m²
B        tread, between track centre lines m
l, b     contact length, track width       m
r        rolling radius of the sprocket    m
V_m, n_g motor displacement, gear ratio    m³/rev, 1
η_m      mechanical efficiency η₀/η_V      1
"""

from dataclasses import dataclass, fields

from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.units import GRAVITY


@dataclass(frozen=True, kw_only=True)
class Kinematics(Parameters):
    """Required of every vehicle, and sufficient for pose and slips."""

    rolling_radius: float = parameter(
        "rolling radius r: track travel per radian of sprocket", unit="m", ge=0.005, le=2.0, basic=True
    )
    tread: float = parameter(
        "distance B between the track centre lines", unit="m", ge=0.02, le=20.0, basic=True
    )
    contact_length: float = parameter(
        "length l of one track on the ground", unit="m", ge=0.02, le=20.0, basic=True
    )


@dataclass(frozen=True, kw_only=True)
class CentreOfGravity(Parameters):
    """Centre of gravity of the whole machine, upper structure straight ahead, bucket empty."""

    x: float = parameter("ahead of base_link", unit="m", ge=-10.0, le=10.0)
    y: float = parameter("left of base_link", unit="m", ge=-10.0, le=10.0)
    z: float = parameter("height h_g above the ground", unit="m", ge=0.0, le=10.0)


@dataclass(frozen=True, kw_only=True)
class Bucket(Parameters):
    """Position of a load that is carried while driving, upper structure straight ahead."""

    x: float = parameter("ahead of base_link", unit="m", ge=-30.0, le=30.0)
    z: float = parameter("above the ground", unit="m", ge=0.0, le=20.0)


@dataclass(frozen=True, kw_only=True)
class Mass(Parameters):
    """Mass, and its distribution on the ground."""

    mass: float = parameter("mass m", unit="kg", ge=1.0, le=2e6)
    yaw_inertia: float = parameter("moment of inertia I_z about the vertical", unit="kg m²", ge=1e-4, le=1e9)
    track_width: float = parameter("width b of one track", unit="m", ge=0.002, le=4.0)
    centre_of_gravity: CentreOfGravity | None
    bucket: Bucket | None

    @property
    def weight(self) -> float:
        """W = m g, N."""
        return self.mass * GRAVITY


@dataclass(frozen=True, kw_only=True)
class Hydraulics(Parameters):
    """Travel motors: conversion of pressures to thrusts."""

    motor_displacement: float = parameter("motor displacement V_m per turn", unit="m³", ge=1e-9, le=0.05)
    gear_ratio: float = parameter("gear ratio n_g: motor turns per sprocket turn", ge=0.01, le=1e3)
    motor_efficiency: float = parameter("mechanical efficiency η_m = η₀/η_V", ge=0.01, le=1.0)
    volumetric_efficiency: float = parameter("volumetric efficiency η_V", ge=0.01, le=1.0)
    relief_pressure: float = parameter("highest pressure over a motor", unit="Pa", ge=1e6, le=1e8)
    pump_flow: float = parameter("flow of the pump of one track", unit="m³/s", ge=1e-9, le=0.1)


@dataclass(frozen=True, kw_only=True)
class SwingDrive(Parameters):
    """Motor that swings the upper structure."""

    rate: float = parameter("highest swing rate", unit="rad/s", ge=1e-3, le=5.0)
    acceleration: float = parameter("acceleration when starting and braking", unit="rad/s²", ge=1e-3, le=20.0)
    backlash: float = parameter("backlash of pinion and ring gear, at the cab", unit="rad", ge=0.0, le=0.1)


@dataclass(frozen=True, kw_only=True)
class UpperStructure(Parameters):
    """The part that swings: cab, engine and arm."""

    mass: float = parameter("part of the mass that swings", unit="kg", ge=0.1, le=2e6)
    swing_axis_x: float = parameter("swing axis ahead of base_link", unit="m", ge=-10.0, le=10.0)
    swing_axis_y: float = parameter("swing axis left of base_link", unit="m", ge=-10.0, le=10.0)
    centre_x: float = parameter("centre of gravity ahead of the swing axis", unit="m", ge=-10.0, le=10.0)
    drive: SwingDrive | None


@dataclass(frozen=True, kw_only=True)
class Box(Parameters):
    """The upright box that a laser scanner beside the machine observes."""

    length: float = parameter("side along x", unit="m", ge=0.01, le=15.0)
    width: float = parameter("side along y", unit="m", ge=0.01, le=15.0)
    x: float = parameter("centre of the box ahead of base_link", unit="m", ge=-20.0, le=20.0)
    y: float = parameter("centre of the box left of base_link", unit="m", ge=-20.0, le=20.0)


@dataclass(frozen=True, kw_only=True)
class Antenna(Parameters):
    """Phase centre of the GNSS antenna whose position is measured."""

    x: float = parameter("ahead of base_link", unit="m", ge=-20.0, le=20.0)
    y: float = parameter("left of base_link", unit="m", ge=-20.0, le=20.0)
    z: float = parameter("above the ground", unit="m", ge=-20.0, le=20.0)


UNDERCARRIAGE, UPPER = MOUNTS = ("undercarriage", "upper")
_MOUNT = "part that carries the sensor; upper: its position in base_link is that with the cab forward"


@dataclass(frozen=True, kw_only=True)
class Mounts(Parameters):
    """Part of the machine that carries each sensor; by default the undercarriage."""

    box: str = parameter(_MOUNT, choices=MOUNTS)
    antenna: str = parameter(_MOUNT, choices=MOUNTS)
    imu: str = parameter(_MOUNT, choices=MOUNTS)


@dataclass(frozen=True, kw_only=True)
class SwingEncoder(Parameters):
    """Sensor of the upper structure's angle."""

    stddev: float = parameter("standard deviation of one reading", unit="rad", ge=1e-6, le=1.0)


@dataclass(frozen=True, kw_only=True)
class InertialUnit(Parameters):
    """An inertial unit other than the Watson, for the emulator."""

    rate: float = parameter("sample rate", unit="Hz", ge=1.0, le=1000.0)


@dataclass(frozen=True, kw_only=True)
class Sensors(Parameters):
    """Sensors on the machine, and their positions."""

    box: Box | None
    antenna: Antenna | None
    imu: InertialUnit | None
    mounts: Mounts | None
    swing_encoder: SwingEncoder | None


@dataclass(frozen=True, kw_only=True)
class Vehicle(Kinematics, Mass, Hydraulics):
    """A machine with known kinematics, mass and hydraulics; SI units."""


@dataclass(frozen=True, kw_only=True)
class VehicleParameters(Parameters):
    """A vehicle file; all groups except the kinematics are optional."""

    name: str = parameter("name of the vehicle")
    kinematics: Kinematics
    mass: Mass | None
    hydraulics: Hydraulics | None
    upper_structure: UpperStructure | None
    sensors: Sensors | None

    @property
    def box(self) -> Box:
        """The box that the laser scanner observes.

        Raises:
            InputError: the vehicle has no box.
        """
        if self.sensors is None or self.sensors.box is None:
            raise InputError(f"vehicle '{self.name}' has no sensors.box for the laser; accepted: one with it")
        return self.sensors.box

    def mount_of(self, sensor: str) -> str:
        """Part of the machine that carries a sensor (a field of ``Mounts``), one of ``MOUNTS``."""
        mounts = self.sensors.mounts if self.sensors is not None else None
        return UNDERCARRIAGE if mounts is None else str(getattr(mounts, sensor))

    @property
    def has_receiver(self) -> bool:
        """Whether the vehicle has a GNSS receiver: the position of an antenna is given."""
        return self.sensors is not None and self.sensors.antenna is not None

    @property
    def has_swing_encoder(self) -> bool:
        """Whether a sensor measures the angle of the upper structure."""
        return self.sensors is not None and self.sensors.swing_encoder is not None

    @property
    def swing_axis(self) -> tuple[float, float]:
        """Swing axis in base_link, m; the origin of base_link if it is not given."""
        upper = self.upper_structure
        return (0.0, 0.0) if upper is None else (upper.swing_axis_x, upper.swing_axis_y)

    @property
    def swing_balance(self) -> float:
        """Backward shift of the centre of gravity as the upper structure turns by π/2, m_u c/m, m."""
        upper, mass = self.upper_structure, self.mass
        return 0.0 if upper is None or mass is None else upper.mass * upper.centre_x / mass.mass

    @property
    def missing_groups_message(self) -> str:
        """Message about the groups that a complete machine needs but this vehicle lacks; empty if none."""
        missing = [name for name in ("mass", "hydraulics") if getattr(self, name) is None]
        return f"vehicle '{self.name}' has no {' and no '.join(missing)}" if missing else ""

    def whole(self) -> Vehicle:
        """The complete machine.

        Raises:
            InputError: mass or hydraulics are missing.
        """
        if self.mass is None or self.hydraulics is None:
            raise InputError(f"{self.missing_groups_message}; accepted: one whose file has them")
        groups = (self.kinematics, self.mass, self.hydraulics)
        return Vehicle(**{f.name: getattr(group, f.name) for group in groups for f in fields(group)})
