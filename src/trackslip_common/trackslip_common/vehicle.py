# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The vehicle's constants: what a file of ``config/vehicles/`` holds, in groups, and a machine given whole.

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
    """What every vehicle must state: it is enough for pose and slips."""

    rolling_radius: float = parameter(
        "track travel per radian of sprocket r", unit="m", ge=0.005, le=2.0, basic=True
    )
    tread: float = parameter(
        "distance B between the track centre lines", unit="m", ge=0.02, le=20.0, basic=True
    )
    contact_length: float = parameter(
        "length l of one track on the ground", unit="m", ge=0.02, le=20.0, basic=True
    )


@dataclass(frozen=True, kw_only=True)
class CentreOfGravity(Parameters):
    """Of the whole machine, its upper structure straight ahead and the bucket empty."""

    x: float = parameter("ahead of base_link", unit="m", ge=-10.0, le=10.0)
    y: float = parameter("left of base_link", unit="m", ge=-10.0, le=10.0)
    z: float = parameter("height h_g above the ground", unit="m", ge=0.0, le=10.0)


@dataclass(frozen=True, kw_only=True)
class Bucket(Parameters):
    """Where a load is carried while driving, the upper structure straight ahead."""

    x: float = parameter("ahead of base_link", unit="m", ge=-30.0, le=30.0)
    z: float = parameter("above the ground", unit="m", ge=0.0, le=20.0)


@dataclass(frozen=True, kw_only=True)
class Mass(Parameters):
    """What presses on the ground, and where."""

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
    """Travel motors: from pressures to thrusts."""

    motor_displacement: float = parameter("oil per motor turn V_m", unit="m³", ge=1e-9, le=0.05)
    gear_ratio: float = parameter("motor turns per sprocket turn n_g", ge=0.01, le=1e3)
    motor_efficiency: float = parameter("pressure to torque η_m = η₀/η_V", ge=0.01, le=1.0)
    volumetric_efficiency: float = parameter("flow to speed η_V", ge=0.01, le=1.0)
    relief_pressure: float = parameter("highest pressure over a motor", unit="Pa", ge=1e6, le=1e8)
    pump_flow: float = parameter("flow of the pump of one track", unit="m³/s", ge=1e-9, le=0.1)


@dataclass(frozen=True, kw_only=True)
class SwingDrive(Parameters):
    """The motor that swings it."""

    rate: float = parameter("fastest that it swings", unit="rad/s", ge=1e-3, le=5.0)
    acceleration: float = parameter("at which it starts and brakes", unit="rad/s²", ge=1e-3, le=20.0)
    backlash: float = parameter("play of pinion and ring gear, at the cab", unit="rad", ge=0.0, le=0.1)


@dataclass(frozen=True, kw_only=True)
class UpperStructure(Parameters):
    """What swings: cab, engine and arm."""

    mass: float = parameter("share of the mass that swings", unit="kg", ge=0.1, le=2e6)
    swing_axis_x: float = parameter("swing axis ahead of base_link", unit="m", ge=-10.0, le=10.0)
    swing_axis_y: float = parameter("swing axis left of base_link", unit="m", ge=-10.0, le=10.0)
    centre_x: float = parameter("its centre of gravity ahead of the axis", unit="m", ge=-10.0, le=10.0)
    drive: SwingDrive | None


@dataclass(frozen=True, kw_only=True)
class Box(Parameters):
    """The upright box that a laser beside the machine sees."""

    length: float = parameter("side along x", unit="m", ge=0.01, le=15.0)
    width: float = parameter("side along y", unit="m", ge=0.01, le=15.0)
    x: float = parameter("its centre ahead of base_link", unit="m", ge=-20.0, le=20.0)
    y: float = parameter("its centre left of base_link", unit="m", ge=-20.0, le=20.0)


@dataclass(frozen=True, kw_only=True)
class Antenna(Parameters):
    """Phase centre of the GNSS antenna that gives the position."""

    x: float = parameter("ahead of base_link", unit="m", ge=-20.0, le=20.0)
    y: float = parameter("left of base_link", unit="m", ge=-20.0, le=20.0)
    z: float = parameter("above the ground", unit="m", ge=-20.0, le=20.0)


UNDERCARRIAGE, UPPER = MOUNTS = ("undercarriage", "upper")
_MOUNT = "what it sits on; upper: its place is that in base_link with the cab looking forward"


@dataclass(frozen=True, kw_only=True)
class Mounts(Parameters):
    """On which part of the machine each sensor sits; where this is not said, on the undercarriage."""

    box: str = parameter(_MOUNT, choices=MOUNTS)
    antenna: str = parameter(_MOUNT, choices=MOUNTS)
    imu: str = parameter(_MOUNT, choices=MOUNTS)


@dataclass(frozen=True, kw_only=True)
class SwingEncoder(Parameters):
    """What measures the angle of the upper structure."""

    stddev: float = parameter("of one reading", unit="rad", ge=1e-6, le=1.0)


@dataclass(frozen=True, kw_only=True)
class InertialUnit(Parameters):
    """The inertial unit, where it is no Watson; for the emulator."""

    rate: float = parameter("of its samples", unit="Hz", ge=1.0, le=1000.0)


@dataclass(frozen=True, kw_only=True)
class Sensors(Parameters):
    """What is mounted on the machine, and where."""

    box: Box | None
    antenna: Antenna | None
    imu: InertialUnit | None
    mounts: Mounts | None
    swing_encoder: SwingEncoder | None


@dataclass(frozen=True, kw_only=True)
class Vehicle(Kinematics, Mass, Hydraulics):
    """A machine whose ground, mass and hydraulics are all known; SI units."""


@dataclass(frozen=True, kw_only=True)
class VehicleParameters(Parameters):
    """A vehicle file: all but the kinematics may be left out."""

    name: str = parameter("what it is called")
    kinematics: Kinematics
    mass: Mass | None
    hydraulics: Hydraulics | None
    upper_structure: UpperStructure | None
    sensors: Sensors | None

    @property
    def box(self) -> Box:
        """That the laser sees.

        Raises:
            InputError: there is none.
        """
        if self.sensors is None or self.sensors.box is None:
            raise InputError(f"vehicle '{self.name}' has no sensors.box for the laser; accepted: one with it")
        return self.sensors.box

    def mount_of(self, sensor: str) -> str:
        """Of a field of ``Mounts``, one of ``MOUNTS``."""
        mounts = self.sensors.mounts if self.sensors is not None else None
        return UNDERCARRIAGE if mounts is None else str(getattr(mounts, sensor))

    @property
    def has_receiver(self) -> bool:
        """Whether it finds its position by GNSS: the place of an antenna is stated."""
        return self.sensors is not None and self.sensors.antenna is not None

    @property
    def has_swing_encoder(self) -> bool:
        """Whether something measures the angle of the upper structure."""
        return self.sensors is not None and self.sensors.swing_encoder is not None

    @property
    def swing_axis(self) -> tuple[float, float]:
        """In base_link, m; its origin where the vehicle does not say."""
        upper = self.upper_structure
        return (0.0, 0.0) if upper is None else (upper.swing_axis_x, upper.swing_axis_y)

    @property
    def swing_balance(self) -> float:
        """How far the centre of gravity goes back as the upper structure turns by π/2, m_u c/m, m."""
        upper, mass = self.upper_structure, self.mass
        return 0.0 if upper is None or mass is None else upper.mass * upper.centre_x / mass.mass

    @property
    def lacks(self) -> str:
        """What of a whole machine is not given, in words; empty if nothing."""
        missing = [name for name in ("mass", "hydraulics") if getattr(self, name) is None]
        return f"vehicle '{self.name}' has no {' and no '.join(missing)}" if missing else ""

    def whole(self) -> Vehicle:
        """The machine whole.

        Raises:
            InputError: mass or hydraulics are not given.
        """
        if self.mass is None or self.hydraulics is None:
            raise InputError(f"{self.lacks}; accepted: one whose file has them")
        groups = (self.kinematics, self.mass, self.hydraulics)
        return Vehicle(**{f.name: getattr(group, f.name) for group in groups for f in fields(group)})
