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
from trackslip_common.parameters import Group, checked_value, from_flat, parameter, to_flat
from trackslip_common.topics import FIX_VELOCITY
from trackslip_common.vehicle_files import ParametersWithVehicle, has_vehicle_name
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
    MountableSource,
    OdometrySource,
    PoseSource,
    Source,
    SwingSource,
    VelocitySource,
    YawRateSource,
    group_name,
    nonempty_names,
    source_groups,
)

NODE = "slip_estimator"
DEFAULT_FILES = ("slip_estimator.yaml",)
GNSS_POSE = "gnss_pose"  # topic with the lever arm of the vehicle's antenna, as FIX_VELOCITY
_ANTENNA = "vehicle.sensors.antenna"
_BOX = "vehicle.sensors.box.length"
_BOX_POSE = "box_pose"
_MOUNTS = {  # topic → sensor of the vehicle
    _BOX_POSE: "box",
    GNSS_POSE: "antenna",
    FIX_VELOCITY: "antenna",
    "heading": "antenna",
    "imu/data_raw": "imu",
}
_ENCODER = "vehicle.sensors.swing_encoder.stddev"

# start → default standard deviation of the heading, rad: uniform, or along the x axis of the map
_YAW_STDDEVS: Mapping[str, float] = MappingProxyType(
    {"first_fix": math.pi / math.sqrt(3.0), "initial_pose": 0.02}
)


@dataclass(frozen=True, kw_only=True)
class SlipEstimatorParameters(ModelParameters, ParametersWithVehicle):
    """All parameters of the slip estimator."""

    motion: MotionParameters
    adaptation: AdaptationParameters
    events: EventParameters
    bank: BankParameters
    receivers: ReceiverParameters
    ground: GroundParameters
    attitude: AttitudeParameters
    swing: SwingParameters
    use_attitude: bool = parameter(
        "whether roll and pitch are estimated; else the ground is assumed to be flat"
    )
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
        "topics of TrackSlip that are measurements: [slip_seed] of the soil estimator feeds these slips "
        "back; '' names none"
    )
    heading_sources: tuple[str, ...] = parameter(
        "topics of headings, such as of a pair of antennas; '' names none. With one and start: first_fix, "
        "it gives the initial heading",
        basic=True,
    )
    swing_sources: tuple[str, ...] = parameter(
        "topics of JointState whose joint 'swing' is the angle of the upper structure; '' names none. Used "
        "where the vehicle has a sensors.swing_encoder and a sensor on the upper structure"
    )
    odometry_sources: tuple[str, ...] = parameter(
        "topics of Odometry of a laser or camera, of which differences are used; '' names none"
    )
    velocity_sources: tuple[str, ...] = parameter(
        "topics of TwistWithCovarianceStamped: velocity of an antenna or a radar; '' names none"
    )
    sources: Mapping[str, Source]
    encoder_resolution: float = parameter("sprocket angle of one count", unit="rad", ge=0.0, basic=True)
    start: str = parameter(
        "first measurement of the estimate", choices=("first_fix", "initial_pose"), basic=True
    )
    initial_x: float = parameter("x at the start, with start: initial_pose", unit="m")
    initial_y: float = parameter("y at the start", unit="m")
    initial_yaw: float = parameter("heading at the start, where the first fix has none", unit="rad")
    initial_position_stddev: float = parameter("standard deviation of x and y at the start", unit="m", gt=0.0)
    initial_yaw_stddev: float = parameter(
        "standard deviation of the heading at the start; beyond 1 rad it is unknown, and found from the "
        "first metres. 0: unknown with start: first_fix, 0.02 rad with initial_pose",
        unit="rad",
        ge=0.0,
    )
    history_window: float = parameter("largest delay of a measurement", unit="s", gt=0.0, le=60.0)
    max_gap: float = parameter(
        "stamps further ahead of the sprockets must be confirmed; at least history_window", unit="s", le=600.0
    )
    jump_confirmations: int = parameter("consecutive sprocket samples that confirm another time", ge=2)
    sprocket_timeout: float = parameter(
        "time for which sprocket speeds are extrapolated; then the pose is held and its covariance grows",
        unit="s",
        gt=0.0,
        le=3600.0,
    )
    max_sprocket_speed: float = parameter(
        "largest sprocket speed; positions that need more have jumped", unit="rad/s", gt=0.0, basic=True
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
        "consecutive measurements beyond the gate that must agree before they are accepted", ge=1
    )
    state_file: str = parameter(
        "file of the learned states for the next start; ~ is the home directory, '' for none"
    )
    publish_tf: bool = parameter("whether map → odom → base goes to /tf, where tf2_msgs is installed")

    def __post_init__(self) -> None:
        """Check also combinations of values.

        Raises:
            InputError: a value or a combination is invalid.
        """
        super().__post_init__()
        if self.max_gap < self.history_window:
            accepted = f"at least history_window, {self.history_window:g} s"
            raise InputError(f"{NODE}: max_gap: {self.max_gap:g} is out of range; accepted: {accepted}")
        if self.model == "free_slips":
            self._check_free_slips()
        if len(self.timeouts_ns()) > TRACKS:
            raise InputError(f"{NODE}: {len(self.timeouts_ns())} sources; accepted: {TRACKS} at the most")

        odometries, gyros = len(self.odometries()), max(len(self.gyros()) - 1, 0)
        turned = len(self.yaw_offsets())
        offsets = len(self.poses()) + len(self.velocities())
        states = odometries + gyros + turned + 2 * offsets + 2 * self.has_tilt_states
        if odometries > MOST_ODOMETRIES:
            raise InputError(
                f"{NODE}: odometry_sources: {odometries} sources; accepted: at most {MOST_ODOMETRIES}"
            )
        if states > MOST_SENSOR_ERRORS:
            parts = f"{gyros} gyros after the first one, {odometries} odometries, {turned} sources of"
            parts += f" headings or swing angles; {offsets} sources of poses and velocities and"
            parts += f" {int(self.has_tilt_states)} tilt of a high antenna, which count twice"
            raise InputError(f"{NODE}: {parts}; accepted: at most {MOST_SENSOR_ERRORS} together")

    def _check_free_slips(self) -> None:
        """Refuse what the thesis' model cannot tell apart.

        Raises:
            InputError: sensors are on the upper structure, or no source measures the heading.
        """
        if self.swings:
            above = ", ".join(topic for topic, source in self.mountable_sources().items() if source.above)
            fault = f"has no swing angle, and the upper structure carries {above}"
        elif self._has_free_slip_angle() and not self._measures_heading():
            fault = "cannot tell the slip angle from the heading, which no source measures"
        else:
            return
        raise InputError(f"{NODE}: model: 'free_slips' {fault}; accepted: turning, icr")

    def _has_free_slip_angle(self) -> bool:
        return max(self.noise.slip_angle_steady, self.noise.slip_angle_turning) > 0.0

    def _measures_heading(self) -> bool:
        """Whether a source measures the heading, or none measures positions that could contradict it."""
        poses = self.poses().values()
        return not poses or bool(self.compasses()) or any(pose.use_heading for pose in poses)

    @classmethod
    def groups_of(cls, values: Mapping[str, Any], where: str) -> Mapping[str, Mapping[str, Group]]:
        """A group for each source of the lists.

        Raises:
            InputError: a list is invalid, or names a source twice.
        """
        lists = {kind: checked_value(cls, kind, values[kind], where) for kind in KINDS if kind in values}
        antenna = {f"lever_arm_{axis}": values.get(f"{_ANTENNA}.{axis}") for axis in "xyz"}
        of_vehicle = {
            topic: {"mount": values.get(f"vehicle.sensors.mounts.{of}")} for topic, of in _MOUNTS.items()
        }
        for topic in (GNSS_POSE, FIX_VELOCITY):
            of_vehicle[topic] |= antenna
        if _ENCODER not in values:  # a vehicle without swing encoder
            lists.pop(SWINGS, None)
        of_vehicle |= {topic: {"stddev": values.get(_ENCODER)} for topic in lists.get(SWINGS, ())}
        of_vehicle = {
            topic: {key: value for key, value in settings.items() if value is not None}
            for topic, settings in of_vehicle.items()
        }
        return {"sources": source_groups(lists, of_vehicle, where)}

    @classmethod
    def overlay(cls, below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
        """Values with others over them; groups of sources that are no longer listed go.

        By default a named vehicle with an antenna, and without a box for a laser, is located by its receiver.
        """
        values = super().overlay(below, above)
        if has_vehicle_name(above) and "pose_sources" not in above and _is_located_by_receiver(values):
            above = {**_receiver_defaults(), **above}
            values |= above
        if above.keys().isdisjoint(KINDS):
            return values
        lists = [values.get(kind) for kind in KINDS]  # not checked yet
        listed = {
            group_name(str(topic)) for topics in lists if isinstance(topics, Sequence) for topic in topics
        }
        return {
            name: value
            for name, value in values.items()
            if name in above or not name.startswith("sources.") or name.split(".")[1] in listed
        }

    def sources_of_kind(self, kind: str) -> dict[str, Any]:
        """Topic → parameters of the sources in use of one list of ``KINDS``."""
        if kind == SWINGS and not (self.swings and self.vehicle.has_swing_encoder):
            return {}
        return {topic: self.sources[group_name(topic)] for topic in nonempty_names(getattr(self, kind))}

    def poses(self) -> dict[str, PoseSource]:
        """Topic → pose source."""
        return self.sources_of_kind("pose_sources")

    def gyros(self) -> dict[str, YawRateSource]:
        """Topic → gyro."""
        return self.sources_of_kind("yaw_rate_sources")

    def swing_encoders(self) -> dict[str, SwingSource]:
        """Topic → sensor of the swing."""
        return self.sources_of_kind(SWINGS)

    def mountable_sources(self) -> dict[str, MountableSource]:
        """Topic → source that may be on the upper structure."""
        return {**self.poses(), **self.gyros(), **self.compasses(), **self.velocities()}

    @property
    def swings(self) -> bool:
        """Whether a sensor is on the upper structure, so that the swing angle is a state."""
        return any(source.above for source in self.mountable_sources().values())

    def initial_swing(self) -> tuple[float, float]:
        """Mean and variance of the swing angle at the start; with a sensor of the swing it is uniform."""
        stddev = self.swing.initial_angle_stddev
        return self.swing.initial_angle, (max(stddev, math.pi) if self.swing_encoders() else stddev) ** 2

    @property
    def measures_height(self) -> bool:
        """Whether altitudes of fixes are used."""
        return any(pose.use_altitude for pose in self.poses().values())

    @property
    def has_tilt_states(self) -> bool:
        """Whether the tilt error affects a pose source, by the height of its lever arm."""
        varies = self.tilt_source is not None or self.attitude.unknown_slope > 0.0
        return varies and any(pose.lever_arm_z for pose in self.poses().values())

    @property
    def tilt_source(self) -> str | None:
        """Topic of the IMU of the attitude; None: the ground is assumed to be flat."""
        imus = self.gyros().items()
        oriented = [topic for topic, imu in imus if imu.use_orientation]
        candidates = [*oriented, *(topic for topic, imu in imus if imu.use_acceleration)]
        return candidates[0] if candidates and self.use_attitude else None

    def compasses(self) -> dict[str, HeadingSource]:
        """Topic → heading source."""
        return self.sources_of_kind("heading_sources")

    def yaw_offsets(self) -> dict[str, float]:
        """Topic of a source of headings or swing angles → standard deviation of its offset, rad."""
        compasses = {name: compass.yaw_offset_stddev for name, compass in self.compasses().items()}
        poses = {name: p.yaw_offset_stddev for name, p in self.poses().items() if p.use_heading}
        encoders = {name: encoder.yaw_offset_stddev for name, encoder in self.swing_encoders().items()}
        return compasses | poses | encoders

    def odometries(self) -> dict[str, OdometrySource]:
        """Topic → odometry."""
        return self.sources_of_kind("odometry_sources")

    def velocities(self) -> dict[str, VelocitySource]:
        """Topic → velocity source."""
        return self.sources_of_kind("velocity_sources")

    def timeouts_ns(self) -> dict[str, int]:
        """Topic → timeout of each source but the sprockets, ns."""
        return {topic: source.timeout_ns for topic, source in self._by_topic().items()}

    def frames_of_sources(self) -> dict[str, str]:
        """Topic → the only accepted frame of its messages, where one is stated."""
        return {topic: source.frame_id for topic, source in self._by_topic().items() if source.frame_id}

    def _by_topic(self) -> dict[str, Source]:
        return {topic: source for kind in KINDS for topic, source in self.sources_of_kind(kind).items()}

    def changed(self, values: Mapping[str, Any]) -> "SlipEstimatorParameters":
        """These parameters with other values; dotted names.

        Raises:
            InputError: a name is unknown or a value invalid.
        """
        return from_flat(type(self), self.overlay(to_flat(self), values), NODE)

    @property
    def frames(self) -> tuple[str, str, str]:
        """Names of map, odom and base_link, as messages have them."""
        return self.map_frame, self.frame_prefix + self.odom_frame, self.frame_prefix + self.base_frame

    def initial_pose(self) -> tuple[FloatArray, FloatArray]:
        """Initial pose (3,) x, y, heading, and its covariance (3, 3)."""
        is_measured = self.start == "first_fix" and bool(self.compasses())  # by a heading source
        yaw_stddev = math.pi if is_measured else self.initial_yaw_stddev or _YAW_STDDEVS[self.start]
        deviations = (self.initial_position_stddev, self.initial_position_stddev, yaw_stddev)
        pose = np.array((self.initial_x, self.initial_y, self.initial_yaw))
        return pose, np.diag(np.square(deviations))


def _is_located_by_receiver(values: Mapping[str, Any]) -> bool:
    """Whether the vehicle has no box for the laser, whose poses would be used, but an antenna."""
    return (
        f"{_ANTENNA}.x" in values and _BOX not in values and values.get("pose_sources") in (None, [_BOX_POSE])
    )


def _receiver_defaults() -> dict[str, Any]:
    """Settings of a receiver by ``config/gnss.yaml``, without its second antenna: a vehicle states none."""
    values = node_defaults(NODE, "gnss.yaml")
    of_pose = f"sources.{GNSS_POSE}."
    return {
        name: value for name, value in values.items() if name == "pose_sources" or name.startswith(of_pose)
    }


def load_slip_parameters(*layers: Mapping[str, Any]) -> SlipEstimatorParameters:
    """The defaults of ``config/`` with layers of dotted names over them, the last one on top.

    Raises:
        InputError: a name is unknown or a value invalid.
    """
    return load_parameters(SlipEstimatorParameters, NODE, DEFAULT_FILES, *layers)
