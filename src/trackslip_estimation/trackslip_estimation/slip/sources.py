# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of each measurement source: the group ``sources.<name>``.

Each kind of source has a list of topics. The group of a topic is its name with ``_`` for ``/``:
``imu/data_raw`` has ``sources.imu_data_raw.sign``. ``config/sources.yaml`` has the defaults of each kind. A
new kind needs its list and dataclass in ``KINDS``, and its block in that file.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from trackslip_common.config_files import config_file, read_yaml
from trackslip_common.errors import InputError
from trackslip_common.parameters import Group, Parameters, parameter
from trackslip_common.vehicle import MOUNTS, UPPER
from trackslip_estimation.slip.mounting import Rotation, quaternion_from_angles, rotation

A = TypeVar("A", float, NDArray[np.float64])

_MOUNT = "part of the machine that carries it; upper: its lever arm is that at swing angle 0"
_FAULT_RATE = "rate of its faults: an offset, frozen or scattered measurements"
_YAW_OFFSET = "standard deviation of its yaw offset, which is estimated"
_JUMP_RATE = "rate of jumps of the measured state: the machine was moved, or turned"
_TIMEOUT = "time without an accepted measurement after which it counts as lost"


@dataclass(frozen=True, kw_only=True)
class Source(Parameters):
    """Parameters of all kinds."""

    timeout: float = parameter(_TIMEOUT, unit="s", ge=0.01, le=86400.0, read_only=False)
    frame_id: str = parameter("the only frame its messages may be in; empty: any")

    @property
    def timeout_ns(self) -> int:
        """Timeout in ns."""
        return round(self.timeout * 1e9)


@dataclass(frozen=True, kw_only=True)
class MountableSource(Source):
    """A sensor that may sit on the upper structure."""

    mount: str = parameter(_MOUNT, choices=MOUNTS)

    @property
    def above(self) -> bool:
        """Whether it is on the upper structure."""
        return self.mount == UPPER


@dataclass(frozen=True, kw_only=True)
class SourceWithLever(MountableSource):
    """A sensor with a lever arm."""

    lever_arm_x: float = parameter(
        "lever arm of its sensor in base_link, forward", unit="m", ge=-100.0, le=100.0, basic=True
    )
    lever_arm_y: float = parameter("to the left", unit="m", ge=-100.0, le=100.0, basic=True)
    lever_arm_z: float = parameter("above the ground", unit="m", ge=-100.0, le=100.0, basic=True)

    @property
    def lever(self) -> tuple[float, float, float]:
        """Lever arm of the sensor in base_link, m."""
        return self.lever_arm_x, self.lever_arm_y, self.lever_arm_z


@dataclass(frozen=True, kw_only=True)
class PoseSource(SourceWithLever):
    """Poses of one sensor."""

    use_heading: bool = parameter("whether its heading is a measurement too", basic=True)
    use_altitude: bool = parameter("whether its z, where it has a variance, measures the height too")
    position_floor: float = parameter(
        "smallest standard deviation of x and y that is accepted", unit="m", gt=0.0
    )
    heading_floor: float = parameter(
        "smallest standard deviation of the heading that is accepted", unit="rad", gt=0.0
    )
    heading_ceiling: float = parameter(
        "standard deviation of a heading beyond which it is not used", unit="rad", gt=0.0
    )
    yaw_offset_stddev: float = parameter(_YAW_OFFSET, unit="rad", ge=0.0, le=0.5)
    stamp_error: float = parameter(
        "standard deviation of a delay that all its stamps have, which is estimated",
        unit="s",
        ge=0.0,
        le=10.0,
    )

    fault_rate: float = parameter(_FAULT_RATE, unit="1/s", gt=0.0, le=1.0)
    jump_rate: float = parameter(_JUMP_RATE, unit="1/s", gt=0.0, le=1.0)
    standing_share: float = parameter(
        "share of a position's variance that all fixes of a standstill have in common",
        ge=0.0,
        lt=1.0,
    )


@dataclass(frozen=True, kw_only=True)
class YawRateSource(MountableSource):
    """A gyro; its gate widens with each further timeout."""

    mounting_roll: float = parameter(
        "rotation of its axes relative to base_link: about x last",
        unit="rad",
        ge=-6.2832,
        le=6.2832,
    )
    mounting_pitch: float = parameter("about y, nose down positive", unit="rad", ge=-6.2832, le=6.2832)
    mounting_yaw: float = parameter("about z first, counter-clockwise", unit="rad", ge=-6.2832, le=6.2832)
    mounting_from_tf: bool = parameter(
        "whether its mounting is that of its frame in /tf_static; it is rejected until that is received"
    )
    sign: int = parameter(
        "1, or -1 for a gyro whose yaw rate has the wrong sign", choices=(1, -1), basic=True
    )
    scale: float = parameter("its reading at 1 rad/s: scale times the cosine of its tilt", gt=0.0)
    stddev: float = parameter("where its message gives no variance", unit="rad/s", gt=0.0)
    acceleration_stddev: float = parameter("where its message gives no variance", unit="m/s²", gt=0.0)

    use_acceleration: bool = parameter(
        "whether its accelerations correct roll and pitch; of several such IMUs the first is used"
    )
    use_orientation: bool = parameter(
        "whether its orientation corrects roll and pitch; of several such IMUs the first is used, "
        "before any with accelerations only"
    )
    orientation_time: float = parameter(
        "correlation time of its orientation error", unit="s", gt=0.0, le=3600.0
    )
    lever_arm_x: float = parameter("lever arm in base_link, forward", unit="m", ge=-100.0, le=100.0)
    lever_arm_y: float = parameter("to the left", unit="m", ge=-100.0, le=100.0)
    lever_arm_z: float = parameter("above the ground", unit="m", ge=-100.0, le=100.0)

    @property
    def lever(self) -> tuple[float, float, float]:
        """Lever arm in base_link, m."""
        return self.lever_arm_x, self.lever_arm_y, self.lever_arm_z

    @property
    def mounting(self) -> Rotation | None:
        """Rotation of vectors from its frame into base_link; None: identity."""
        return rotation(self.mounting_roll, self.mounting_pitch, self.mounting_yaw)


@dataclass(frozen=True, kw_only=True)
class SlipSource(Source):
    """Slips of another estimator; its gate widens with each further timeout."""


class Rejection(Enum):
    """Why a message of a source never becomes a measurement."""

    OTHER_FRAME = "of another frame"
    NO_RATE = "without angular velocity"
    NO_ORIENTATION = "without orientation"
    NO_MOUNTING = "of a frame without a transform to base_link in /tf_static"
    NO_VELOCITY = "whose covariance marks the velocity as absent"
    NO_POSE = "whose covariance marks the pose as absent"


CONVENTIONS = ("enu", "compass")  # of headings: from east, counter-clockwise; from north, clockwise
HEADING_MESSAGES = {"imu": "sensor_msgs/msg/Imu", "quaternion": "geometry_msgs/msg/QuaternionStamped"}


@dataclass(frozen=True, kw_only=True)
class HeadingSource(MountableSource):
    """A pair of antennas, or another compass."""

    message: str = parameter(
        "imu: sensor_msgs/Imu, its orientation; quaternion: geometry_msgs/QuaternionStamped",
        choices=tuple(HEADING_MESSAGES),
    )
    fault_rate: float = parameter(_FAULT_RATE, unit="1/s", gt=0.0, le=1.0)
    jump_rate: float = parameter(_JUMP_RATE, unit="1/s", gt=0.0, le=1.0)
    convention: str = parameter(
        "enu: angles from east, counter-clockwise; compass: from north, clockwise",
        choices=CONVENTIONS,
    )
    sign: int = parameter("1, or -1 for angles of the opposite direction", choices=(1, -1))
    offset: float = parameter(
        "direction of its axis in base_link, counter-clockwise: π/2 for a pair that points left",
        unit="rad",
        ge=-6.2832,
        le=6.2832,
        basic=True,
    )
    stddev: float = parameter("where its message gives no variance", unit="rad", gt=0.0)
    heading_floor: float = parameter("smallest standard deviation that is accepted", unit="rad", gt=0.0)
    yaw_offset_stddev: float = parameter(_YAW_OFFSET, unit="rad", ge=0.0, le=0.5)
    stamp_error: float = parameter(
        "standard deviation of a delay that all its stamps have, which is estimated: one for all sources",
        unit="s",
        ge=0.0,
        le=10.0,
    )

    def from_east(self, angle: A) -> A:
        """An angle of its messages, rad, or an array of them, from east, counter-clockwise."""
        angle = self.sign * angle
        return math.pi / 2.0 - angle if self.convention == "compass" else angle


SWINGS = "swing_sources"


@dataclass(frozen=True, kw_only=True)
class SwingSource(Source):
    """A sensor of the swing; its gate widens with each further timeout."""

    fault_rate: float = parameter(_FAULT_RATE, unit="1/s", gt=0.0, le=1.0)
    offset: float = parameter(
        "its reading while the upper structure looks forward", unit="rad", ge=-6.2832, le=6.2832
    )
    stddev: float = parameter("of one reading", unit="rad", gt=0.0)
    yaw_offset_stddev: float = parameter(_YAW_OFFSET, unit="rad", ge=0.0, le=0.5)


@dataclass(frozen=True, kw_only=True)
class VelocitySource(SourceWithLever):
    """Velocity over the ground: a GNSS receiver's, or a radar's."""

    axes: str = parameter(
        "axes of its velocity: map: east and north; body: forward and left of the sensor",
        choices=("map", "body"),
    )
    mounting_yaw: float = parameter(
        "with axes: body, direction of its x axis in base_link, counter-clockwise",
        unit="rad",
        ge=-6.2832,
        le=6.2832,
    )
    latency: float = parameter(
        "delay of its stamps after the instant of its velocity", unit="s", ge=-1.0, le=10.0
    )
    stddev: float = parameter("where its message gives no variance", unit="m/s", gt=0.0)
    velocity_floor: float = parameter("smallest standard deviation that is accepted", unit="m/s", gt=0.0)
    fault_rate: float = parameter(_FAULT_RATE, unit="1/s", gt=0.0, le=1.0)

    @property
    def latency_ns(self) -> int:
        """Latency in ns."""
        return round(self.latency * 1e9)


COVARIANCES = ("twist", "pose", "declared")  # in the order of ``increments``
ODOMETRY_FIELDS = {  # by covariance: field that is read, field that marks its absence, rejection then
    "twist": ("twist_variances", "twist_absent", Rejection.NO_VELOCITY),
    "pose": ("pose_variances", "pose_absent", Rejection.NO_POSE),
    "declared": ("", "", Rejection.NO_POSE),
}
LEAN_TIME = 100.0  # s, correlation time of the tilt error, mostly accelerometer bias
DRIFT_TIME = 60.0  # s, correlation time of the drift of odometry
YAW_TIME = 300.0  # s, correlation time of a yaw offset


@dataclass(frozen=True, kw_only=True)
class OdometrySource(Source):
    """Odometry of a laser or camera: differences of its poses; its gate widens as that of a gyro."""

    lever_arm_x: float = parameter("lever arm in base_link, forward", unit="m", ge=-100.0, le=100.0)
    lever_arm_y: float = parameter("to the left", unit="m", ge=-100.0, le=100.0)
    lever_arm_z: float = parameter("above the ground", unit="m", ge=-100.0, le=100.0)
    mounting_roll: float = parameter(
        "rotation of its body axes relative to base_link: about x last",
        unit="rad",
        ge=-6.2832,
        le=6.2832,
    )
    mounting_pitch: float = parameter("about y, nose down positive", unit="rad", ge=-6.2832, le=6.2832)
    mounting_yaw: float = parameter("about z first, counter-clockwise", unit="rad", ge=-6.2832, le=6.2832)
    covariance: str = parameter(
        "its noise: the covariance of its twist, the growth of that of its pose, or the one declared here",
        choices=COVARIANCES,
    )
    velocity_stddev: float = parameter("where declared, or where its message has a zero", unit="m/s", gt=0.0)
    yaw_rate_stddev: float = parameter("the same", unit="rad/s", gt=0.0)
    drift: float = parameter("scale error of its distances, over minutes: 0.01 is 1 %", ge=0.0, le=0.5)
    max_gap: float = parameter("largest time between two poses that are compared", unit="s", gt=0.0, le=10.0)

    @property
    def lever(self) -> tuple[float, float, float]:
        """Lever arm in base_link, m."""
        return self.lever_arm_x, self.lever_arm_y, self.lever_arm_z

    @property
    def mounting(self) -> tuple[float, float, float, float]:
        """Quaternion x, y, z, w of the rotation from its frame into base_link."""
        return quaternion_from_angles(self.mounting_roll, self.mounting_pitch, self.mounting_yaw)


KINDS: Mapping[str, type[Source]] = {
    "pose_sources": PoseSource,
    "yaw_rate_sources": YawRateSource,
    "slip_sources": SlipSource,
    "heading_sources": HeadingSource,
    SWINGS: SwingSource,
    "odometry_sources": OdometrySource,
    "velocity_sources": VelocitySource,
}


def nonempty_names(sources: Sequence[str]) -> list[str]:
    """The sources of a parameter list without empty names."""
    return [source for source in sources if source]


def group_name(topic: str) -> str:
    """Name of the group under ``sources`` of a topic."""
    return topic.strip("/").replace("/", "_")


def source_groups(
    lists: Mapping[str, Sequence[str]], mounted: Mapping[str, Mapping[str, Any]], where: str
) -> dict[str, Group]:
    """Name → group of each source of the lists (name of a kind's list → topics).

    ``mounted``: topic → values of the vehicle for a source.

    Raises:
        InputError: two topics have one name.
    """
    topics: dict[str, str] = {}
    groups: dict[str, Group] = {}
    for kind in KINDS:
        for topic in nonempty_names(lists.get(kind, ())):
            name = group_name(topic)
            if name in groups:
                conflict = (
                    "one is named twice" if topics[name] == topic else f"'{topics[name]}' has the same name"
                )
                raise InputError(f"{where}: {kind}: '{topic}': {conflict}; accepted: each once")
            defaults = {**_defaults()[kind], **mounted.get(topic, {})}
            topics[name], groups[name] = topic, Group(KINDS[kind], defaults)
    return groups


@cache
def _defaults() -> Mapping[str, Mapping[str, Any]]:
    return read_yaml(config_file("sources.yaml"))
