# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Roles of topics: the type and frame of their messages, and the fields that columns fill."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from trackslip_common.errors import InputError

Group = tuple[str, ...]

JOINTS = "sensor_msgs/msg/JointState"
ODOMETRY = "nav_msgs/msg/Odometry"
IMU = "sensor_msgs/msg/Imu"
FIX = "sensor_msgs/msg/NavSatFix"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
VELOCITY = "geometry_msgs/msg/TwistWithCovarianceStamped"
HYDRAULICS = "trackslip_msgs/msg/TrackHydraulics"

_POSITION = ("length",)
_ANGLE = ("angle",)
_RATE = ("angular rate",)
_ACCELERATION = ("acceleration",)
_PRESSURE = ("pressure",)
NUMBER = ()  # without a unit


RATES = tuple(f"angular_velocity_{axis}" for axis in "xyz")
ACCELERATIONS = tuple(f"linear_acceleration_{axis}" for axis in "xyz")
QUATERNION = ("qx", "qy", "qz", "qw")
_VELOCITIES = ("left_velocity", "right_velocity")
_POSITIONS = ("left_position", "right_position")
_PLACE = ("latitude", "longitude")


@dataclass(frozen=True)
class Role:
    """Content of a topic of the bag.

    ``fields``: possible columns of a CSV log: name → quantities, one of which the unit must measure.
    ``choices``: groups of fields; in each choice, the given fields must be exactly one group. ``axes``: those
    with a standard deviation or covariance, and its quantity.
    """

    type_name: str
    frame: str
    fields: Mapping[str, Group]
    choices: tuple[tuple[Group, ...], ...]
    axes: Mapping[str, str]
    optional: tuple[str, ...] = ()  # fields, and axes, that a message may lack

    def required_fields(self, given: Iterable[str]) -> list[str]:
        """The given fields that a message cannot lack."""
        names = list(given)
        optional = self.optional if self.optional != _POSITIONS or _VELOCITIES[0] in names else ()
        return [name for name in names if name not in optional]

    def check(self, where: str, given: set[str]) -> None:
        """Check that the given fields form one group of each choice.

        Raises:
            InputError: they do not.
        """
        for groups in self.choices:
            in_choice = given.intersection(*[{field for group in groups for field in group}])
            if not any(in_choice == set(group) for group in groups):
                accepted = ", or ".join(" + ".join(group) for group in groups if group)
                stated = " + ".join(f for f in self.fields if f in in_choice) or "none of them"
                raise InputError(f"{where}: {stated} is not accepted; accepted: {accepted}")


ROLES: Mapping[str, Role] = {
    "sprockets": Role(
        type_name=JOINTS,
        frame="base_link",
        fields={
            **dict.fromkeys(_VELOCITIES, ("angular rate", "speed")),
            **dict.fromkeys(_POSITIONS, ("angle", "length")),
            "speed": ("speed",),
            "yaw_rate": _RATE,
        },
        choices=((_VELOCITIES, _VELOCITIES + _POSITIONS, _POSITIONS, ("speed", "yaw_rate")),),
        axes={},
        optional=_POSITIONS,
    ),
    "imu": Role(
        type_name=IMU,
        frame="imu_link",
        fields={**dict.fromkeys(RATES, _RATE), **dict.fromkeys(ACCELERATIONS, _ACCELERATION)},
        choices=((RATES, RATES[2:]), ((), ACCELERATIONS)),
        axes={**dict.fromkeys(RATES, "angular rate"), **dict.fromkeys(ACCELERATIONS, "acceleration")},
        optional=(*RATES[:2], *ACCELERATIONS),
    ),
    "pose": Role(
        type_name=POSE,
        frame="map",
        fields={
            "x": _POSITION,
            "y": _POSITION,
            **dict.fromkeys(_PLACE, _ANGLE),
            "altitude": _POSITION,
            "yaw": _ANGLE,
            "heading": _ANGLE,
            **dict.fromkeys(QUATERNION, NUMBER),
            "quality": NUMBER,
        },
        choices=(
            (("x", "y"), _PLACE, (*_PLACE, "altitude")),
            ((), ("yaw",), ("heading",), QUATERNION),
        ),
        axes={"x": "length", "y": "length", "yaw": "angle"},
        optional=("altitude", "yaw", "heading", *QUATERNION, "quality"),
    ),
    "heading": Role(
        type_name=IMU,
        frame="gnss_antenna",
        fields={"yaw": _ANGLE, "heading": _ANGLE, **dict.fromkeys(QUATERNION, NUMBER)},
        choices=((("yaw",), ("heading",), QUATERNION),),
        axes={"yaw": "angle"},
    ),
    "swing": Role(
        type_name=JOINTS,
        frame="base_link",
        fields={"angle": _ANGLE},
        choices=((("angle",),),),
        axes={},
    ),
    "fix": Role(
        type_name=FIX,
        frame="gnss_link",
        fields={**dict.fromkeys(_PLACE, _ANGLE), "altitude": _POSITION, "quality": NUMBER, "status": NUMBER},
        choices=((_PLACE, (*_PLACE, "altitude")), ((), ("quality",), ("status",))),
        axes={"x": "length", "y": "length", "z": "length"},
        optional=("altitude", "quality", "status"),
    ),
    "velocity": Role(
        type_name=VELOCITY,
        frame="gnss_antenna",
        fields={
            **dict.fromkeys(("east", "north", "speed", "forward"), ("speed",)),
            "course": _ANGLE,
        },
        choices=((("east", "north"), ("speed", "course"), ("forward",)),),
        axes={"x": "speed", "y": "speed"},
    ),
    "odometry": Role(
        type_name=ODOMETRY,
        frame="odom",
        fields={
            **dict.fromkeys(("x", "y", "z"), _POSITION),
            "yaw": _ANGLE,
            **dict.fromkeys(QUATERNION, NUMBER),
        },
        choices=((("x", "y"), ("x", "y", "z")), (("yaw",), QUATERNION)),
        axes={},
        optional=("z",),
    ),
    "hydraulics": Role(
        type_name=HYDRAULICS,
        frame="",
        fields={
            "left_pressure": _PRESSURE,
            "right_pressure": _PRESSURE,
            "left_spool": ("ratio",),
            "right_spool": ("ratio",),
            "supply_pressure": _PRESSURE,
        },
        choices=((("left_pressure", "right_pressure"),),),
        axes={},
        optional=("left_spool", "right_spool", "supply_pressure"),
    ),
}

ROLE_OF_TOPIC: Mapping[str, str] = {
    "sprockets": "sprockets",
    "imu/data_raw": "imu",
    "reference_pose": "pose",
    "box_pose": "pose",
    "gnss_pose": "pose",
    "fix": "fix",
    "heading": "heading",
    "fix_velocity": "velocity",
    "swing": "swing",
    "hydraulics": "hydraulics",
}
"""Default roles of topic names."""
