# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the slip estimator (defaults: ``config/slip_estimator.yaml``, ``config/sources.yaml``)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.config_files import load_parameters, node_defaults
from trackslip_common.errors import InputError
from trackslip_common.parameters import Group, checked, from_flat, parameter, to_flat
from trackslip_common.topics import FIX_VELOCITY
from trackslip_common.vehicle_files import WithVehicle, names_vehicle
from trackslip_estimation.attitude.parameters import AttitudeParameters
from trackslip_estimation.slip.adaptation import AdaptationParameters
from trackslip_estimation.slip.bank.parameters import BankParameters, ReceiverParameters
from trackslip_estimation.slip.events import EventParameters
from trackslip_estimation.slip.ground import GroundParameters
from trackslip_estimation.slip.models.dispatch import ModelParameters
from trackslip_estimation.slip.models.model import MOST_SENSOR_ERRORS
from trackslip_estimation.slip.models.swing import SwingParameters
from trackslip_estimation.slip.motion import MotionParameters
from trackslip_estimation.slip.records import MOST_ODOMETRIES, TRACKS
from trackslip_estimation.slip.sources import (
    KINDS,
    SWINGS,
    HeadingSource,
    Mounted,
    OdometrySource,
    PoseSource,
    Source,
    SwingSource,
    VelocitySource,
    YawRateSource,
    group_name,
    named,
    source_groups,
)

NODE = "slip_estimator"
DEFAULT_FILES = ("slip_estimator.yaml",)
GNSS_POSE = "gnss_pose"  # a topic whose lever arm the vehicle states, as FIX_VELOCITY's
_ANTENNA = "vehicle.sensors.antenna"
_BOX = "vehicle.sensors.box.length"
_BOX_POSE = "box_pose"
_MOUNTS = {
    _BOX_POSE: "box",
    GNSS_POSE: "antenna",
    FIX_VELOCITY: "antenna",
    "heading": "antenna",
    "imu/data_raw": "imu",
}  # topics of them
_ENCODER = "vehicle.sensors.swing_encoder.stddev"

# rad, of a heading of which nothing is said: it may be any, or the map's x axis is where the machine looks
_YAW_STDDEVS: Mapping[str, float] = MappingProxyType(
    {"first_fix": math.pi / math.sqrt(3.0), "initial_pose": 0.02}
)


@dataclass(frozen=True, kw_only=True)
class SlipEstimatorParameters(ModelParameters, WithVehicle):
    """All parameters of the slip estimator."""

    motion: MotionParameters
    adaptation: AdaptationParameters
    events: EventParameters
    bank: BankParameters
    receivers: ReceiverParameters
    ground: GroundParameters
    attitude: AttitudeParameters
    swing: SwingParameters
    use_attitude: bool = parameter("whether roll and pitch are estimated; else the ground counts as flat")
    filter: str = parameter("extended Kalman filter, or the thesis' Fig. 4.3", choices=("ekf", "daf"))
    kappa: float = parameter("of the daf: scales the higher moments of its points", gt=-7.0, le=100.0)
    map_frame: str = parameter("site frame of the estimate and of the pose sources")
    odom_frame: str = parameter("frame of odometry/local, which never jumps")
    base_frame: str = parameter("frame of the machine, at the track-contact centre")
    frame_prefix: str = parameter("before odom_frame and base_frame, such as 'one/' where there are several")
    pose_sources: tuple[str, ...] = parameter(
        "topics of PoseWithCovarianceStamped; '' names none", basic=True
    )
    yaw_rate_sources: tuple[str, ...] = parameter(
        "topics of Imu whose z rate is a measurement; '' names none", basic=True
    )
    slip_sources: tuple[str, ...] = parameter(
        "topics of TrackSlip that are measurements: [slip_seed], the soil estimator's, which rests on these "
        "very slips and so feeds back; '' names none"
    )
    heading_sources: tuple[str, ...] = parameter(
        "topics of headings, such as a pair of antennas shows; '' names none. With one and start: first_fix, "
        "the start heading is what it says",
        basic=True,
    )
    swing_sources: tuple[str, ...] = parameter(
        "topics of JointState whose joint 'swing' is the angle of the upper structure; '' names none. Used "
        "where the vehicle has a sensors.swing_encoder, and something sits above"
    )
    odometry_sources: tuple[str, ...] = parameter(
        "topics of Odometry of a laser or camera: what it moved counts, never where it is; '' names none"
    )
    velocity_sources: tuple[str, ...] = parameter(
        "topics of TwistWithCovarianceStamped: velocity of an antenna or a radar; '' names none"
    )
    sources: Mapping[str, Source]
    encoder_resolution: float = parameter("sprocket angle of one count", unit="rad", ge=0.0, basic=True)
    start: str = parameter("what the estimate starts from", choices=("first_fix", "initial_pose"), basic=True)
    initial_x: float = parameter("x at the start, with start: initial_pose", unit="m")
    initial_y: float = parameter("y at the start", unit="m")
    initial_yaw: float = parameter("heading at the start, where the first fix shows none", unit="rad")
    initial_position_stddev: float = parameter("its standard deviation, x and y", unit="m", gt=0.0)
    initial_yaw_stddev: float = parameter(
        "its standard deviation, heading; beyond 1 rad it is unknown, and found from the first metres. "
        "0: as start implies, unknown with first_fix, 0.02 rad with initial_pose",
        unit="rad",
        ge=0.0,
    )
    history_window: float = parameter("how late a measurement may come", unit="s", gt=0.0, le=60.0)
    max_gap: float = parameter(
        "stamps further ahead of the sprockets must be confirmed; at least history_window", unit="s", le=600.0
    )
    jump_confirmations: int = parameter("sprocket samples in a row that make another time accepted", ge=2)
    sprocket_timeout: float = parameter(
        "how long sprocket speeds are taken to go on; then the pose is held and its uncertainty grows",
        unit="s",
        gt=0.0,
        le=3600.0,
    )
    max_sprocket_speed: float = parameter(
        "fastest a sprocket can turn; positions asking for more have jumped", unit="rad/s", gt=0.0, basic=True
    )
    gate_probability: float = parameter(
        "χ² probability inside which a measurement is accepted", gt=0.0, lt=1.0, read_only=False
    )
    gate_relaxation: float = parameter(
        "factor by which the gate of yaw rates or slips widens with each further timeout of its source",
        ge=1.0,
        le=1e3,
        read_only=False,
    )
    gate_confirmations: int = parameter(
        "measurements in a row that must agree with each other before what the gate refuses is accepted", ge=1
    )
    state_file: str = parameter(
        "file that keeps what was learned until the next start; ~ is the home directory, '' for none"
    )
    publish_tf: bool = parameter("whether map → odom → base goes to /tf, where tf2_msgs is installed")

    def __post_init__(self) -> None:
        """Check also what belongs together.

        Raises:
            InputError: a value is refused, or two do not go together.
        """
        super().__post_init__()
        if self.max_gap < self.history_window:
            accepted = f"at least history_window, {self.history_window:g} s"
            raise InputError(f"{NODE}: max_gap: {self.max_gap:g} is out of range; accepted: {accepted}")
        if self.swings and self.model == "free_slips":
            above = ", ".join(topic for topic, source in self.mounted().items() if source.above)
            raise InputError(
                f"{NODE}: model: 'free_slips' knows no swing, and {above} sits above; accepted: turning, icr"
            )
        if len(self.timeouts_ns()) > TRACKS:
            raise InputError(f"{NODE}: {len(self.timeouts_ns())} sources; accepted: {TRACKS} at the most")

        odometries, gyros = len(self.odometries()), max(len(self.gyros()) - 1, 0)
        turned = len(self.yaw_offsets())
        offsets = len(self.poses()) + len(self.velocities())
        own = odometries + gyros + turned + 2 * offsets + 2 * self.leans
        if odometries > MOST_ODOMETRIES:
            raise InputError(
                f"{NODE}: odometry_sources: {odometries} sources; accepted: at most {MOST_ODOMETRIES}"
            )
        if own > MOST_SENSOR_ERRORS:
            parts = f"{gyros} gyros after the first one, {odometries} odometries, {turned} sources of"
            parts += f" headings or swing angles; {offsets} sources of poses and velocities and"
            parts += f" {int(self.leans)} tilt of a high antenna, which count twice"
            raise InputError(f"{NODE}: {parts}; accepted: at most {MOST_SENSOR_ERRORS} together")

    @classmethod
    def groups_of(cls, values: Mapping[str, Any], where: str) -> Mapping[str, Mapping[str, Group]]:
        """One for each source that the lists name.

        Raises:
            InputError: a list is none, or names one twice.
        """
        lists = {kind: checked(cls, kind, values[kind], where) for kind in KINDS if kind in values}
        antenna = {f"lever_arm_{axis}": values.get(f"{_ANTENNA}.{axis}") for axis in "xyz"}
        mounted = {
            topic: {"mount": values.get(f"vehicle.sensors.mounts.{of}")} for topic, of in _MOUNTS.items()
        }
        for topic in (GNSS_POSE, FIX_VELOCITY):
            mounted[topic] |= antenna
        if _ENCODER not in values:  # nothing is stated of what there is not
            lists.pop(SWINGS, None)
        mounted |= {topic: {"stddev": values.get(_ENCODER)} for topic in lists.get(SWINGS, ())}
        mounted = {
            topic: {key: value for key, value in stated.items() if value is not None}
            for topic, stated in mounted.items()
        }
        return {"sources": source_groups(lists, mounted, where)}

    @classmethod
    def overlaid(cls, below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
        """Values with others over them; with other lists of sources, the groups of those that went go too.

        A vehicle that is named, and has an antenna and no box for a laser, is located by its receiver where
        nothing else is said.
        """
        values = super().overlaid(below, above)
        if names_vehicle(above) and "pose_sources" not in above and _is_located_by_receiver(values):
            above = {**_receiver(), **above}
            values |= above
        if above.keys().isdisjoint(KINDS):
            return values
        lists = [values.get(kind) for kind in KINDS]  # unchecked as yet
        there = {
            group_name(str(topic)) for topics in lists if isinstance(topics, Sequence) for topic in topics
        }
        return {
            name: value
            for name, value in values.items()
            if name in above or not name.startswith("sources.") or name.split(".")[1] in there
        }

    def of_kind(self, kind: str) -> dict[str, Any]:
        """Topic → what is stated of it, of the sources of one of the lists of ``KINDS`` that are in use."""
        if kind == SWINGS and not (self.swings and self.vehicle.has_swing_encoder):
            return {}
        return {topic: self.sources[group_name(topic)] for topic in named(getattr(self, kind))}

    def poses(self) -> dict[str, PoseSource]:
        """By topic."""
        return self.of_kind("pose_sources")

    def gyros(self) -> dict[str, YawRateSource]:
        """By topic."""
        return self.of_kind("yaw_rate_sources")

    def angles(self) -> dict[str, SwingSource]:
        """By topic, the sensors of the swing."""
        return self.of_kind(SWINGS)

    def mounted(self) -> dict[str, Mounted]:
        """By topic, what may sit on the upper structure."""
        return {**self.poses(), **self.gyros(), **self.compasses(), **self.velocities()}

    @property
    def swings(self) -> bool:
        """Whether anything sits on the upper structure, whose angle then is a part of the state."""
        return any(source.above for source in self.mounted().values())

    def initial_swing(self) -> tuple[float, float]:
        """Mean and variance of its angle at the start; a sensor that is still to tell it knows it better."""
        stddev = self.swing.initial_angle_stddev
        return self.swing.initial_angle, (max(stddev, math.pi) if self.angles() else stddev) ** 2

    @property
    def measures_height(self) -> bool:
        """Whether altitudes of fixes are wanted."""
        return any(pose.use_altitude for pose in self.poses().values())

    @property
    def leans(self) -> bool:
        """Whether a sensor of poses sits so high that what the tilt is off by shows in them."""
        return self.tilt_source is not None and any(pose.lever_arm_z for pose in self.poses().values())

    @property
    def tilt_source(self) -> str | None:
        """Topic of the IMU that tells the attitude; None: the ground counts as flat."""
        imus = self.gyros().items()
        oriented = [topic for topic, imu in imus if imu.use_orientation]
        able = [*oriented, *(topic for topic, imu in imus if imu.use_acceleration)]
        return able[0] if able and self.use_attitude else None

    def compasses(self) -> dict[str, HeadingSource]:
        """By topic."""
        return self.of_kind("heading_sources")

    def yaw_offsets(self) -> dict[str, float]:
        """By topic of a source of headings or swing angles: the standard deviation of their offset, rad."""
        compasses = {name: compass.yaw_offset_stddev for name, compass in self.compasses().items()}
        poses = {name: p.yaw_offset_stddev for name, p in self.poses().items() if p.has_yaw_offset}
        return compasses | poses | {name: angle.yaw_offset_stddev for name, angle in self.angles().items()}

    def odometries(self) -> dict[str, OdometrySource]:
        """By topic."""
        return self.of_kind("odometry_sources")

    def velocities(self) -> dict[str, VelocitySource]:
        """By topic."""
        return self.of_kind("velocity_sources")

    def timeouts_ns(self) -> dict[str, int]:
        """Of each source but the sprockets, by topic."""
        return {topic: source.timeout_ns for topic, source in self._by_topic().items()}

    def frames_of_sources(self) -> dict[str, str]:
        """The only frame that messages of a source may be in, by topic, of those that have one."""
        return {topic: source.frame_id for topic, source in self._by_topic().items() if source.frame_id}

    def _by_topic(self) -> dict[str, Source]:
        return {topic: source for kind in KINDS for topic, source in self.of_kind(kind).items()}

    def changed(self, values: Mapping[str, Any]) -> "SlipEstimatorParameters":
        """These parameters with other values; dotted names.

        Raises:
            InputError: a name is unknown or a value refused.
        """
        return from_flat(type(self), self.overlaid(to_flat(self), values), NODE)

    @property
    def frames(self) -> tuple[str, str, str]:
        """Names of map, odom and base_link, as messages have them."""
        return self.map_frame, self.frame_prefix + self.odom_frame, self.frame_prefix + self.base_frame

    def initial_pose(self) -> tuple[FloatArray, FloatArray]:
        """(3,) x, y, heading to start from, and (3, 3) covariance."""
        waits = self.start == "first_fix" and bool(self.compasses())  # for one of these to say the heading
        yaw_stddev = math.pi if waits else self.initial_yaw_stddev or _YAW_STDDEVS[self.start]
        deviations = (self.initial_position_stddev, self.initial_position_stddev, yaw_stddev)
        pose = np.array((self.initial_x, self.initial_y, self.initial_yaw))
        return pose, np.diag(np.square(deviations))


def _is_located_by_receiver(values: Mapping[str, Any]) -> bool:
    """Whether the vehicle has no box for the laser, whose poses would be used, but an antenna."""
    return (
        f"{_ANTENNA}.x" in values and _BOX not in values and values.get("pose_sources") in (None, [_BOX_POSE])
    )


def _receiver() -> dict[str, Any]:
    """What ``config/gnss.yaml`` says of a receiver; of a second antenna a vehicle says nothing."""
    values = node_defaults(NODE, "gnss.yaml")
    of_pose = f"sources.{GNSS_POSE}."
    return {
        name: value for name, value in values.items() if name == "pose_sources" or name.startswith(of_pose)
    }


def load_slip_parameters(*layers: Mapping[str, Any]) -> SlipEstimatorParameters:
    """The defaults of ``config/`` with layers of dotted names over them, the last one on top.

    Raises:
        InputError: a name is unknown or a value refused.
    """
    return load_parameters(SlipEstimatorParameters, NODE, DEFAULT_FILES, *layers)
