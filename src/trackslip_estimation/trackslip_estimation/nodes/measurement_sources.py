# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to the measurement topics: check the frame, convert, pass on to the estimator."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias

from rclpy.node import Node

from trackslip_common.errors import InputError, printable
from trackslip_common.message_fields import FrameFields
from trackslip_common.message_reading import read
from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.messages import message_class, topic_class
from trackslip_common.nodes.qos import latched_qos
from trackslip_common.topics import FIX_VELOCITY
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.measurements import POSE_SET, SET_POSE, Measurement, Outcome, Report
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.source_watch import reason_of
from trackslip_estimation.slip.sources import (
    HEADING_MESSAGES,
    KINDS,
    Rejection,
    YawRateSource,
    group_name,
    nonempty_names,
)
from trackslip_estimation.slip.static_frames import StaticFrames

Convert: TypeAlias = Callable[[Any], Measurement | Rejection]
_DEPTH = 100  # several publishers latch one message each
_UNUSABLE_STAMPS = (Outcome.TOO_LATE, Outcome.DUPLICATE, Outcome.AHEAD)
_LOG_PERIOD = 1.0  # s between lines about poses that were not used
_ANGLES = ("mounting_roll", "mounting_pitch", "mounting_yaw")


class StaticMountings:
    """IMU mountings from /tf_static, if an IMU needs it; each is determined once in a run."""

    def __init__(self, node: Node, base_frame: str, imus: Mapping[str, YawRateSource]) -> None:
        """``imus``: by topic.

        Raises:
            InputError: tf2_msgs is not installed, and an IMU needs it.
        """
        self._base, self._frames = base_frame, StaticFrames()
        self._imus = {source: None if imu.mounting_from_tf else imu for source, imu in imus.items()}
        self._stated = imus
        if any(imu is None for imu in self._imus.values()):
            try:
                kind = topic_class("tf")
            except ModuleNotFoundError as error:
                raise InputError("mounting_from_tf: tf2_msgs is not installed") from error
            node.create_subscription(kind, "/tf_static", self.add_transforms, latched_qos(_DEPTH))

    def add_transforms(self, message: Any) -> None:
        """Add the transforms of one message of /tf_static."""
        for link in message.transforms:
            q = link.transform.rotation
            self._frames.add(link.header.frame_id, link.child_frame_id, (q.x, q.y, q.z, q.w))

    def mounted_imu(self, source: str, frame: str) -> tuple[YawRateSource | None, dict[str, float]]:
        """Return an IMU with its mounting, None while that is unknown, and newly determined parameters."""
        imu = self._imus[source]
        if imu is not None:
            return imu, {}
        angles = self._frames.angles(self._base, frame)
        if angles is None:
            return None, {}
        roll, pitch, yaw = angles
        stated = self._stated[source]
        imu = replace(stated, mounting_roll=roll, mounting_pitch=pitch, mounting_yaw=yaw)
        self._imus[source] = imu
        group = f"sources.{group_name(source)}"
        return imu, {f"{group}.{name}": angle for name, angle in zip(_ANGLES, angles, strict=True)}


class MeasurementSources:
    """Passes each measurement to ``process``, and each message that is none to ``reject``."""

    def __init__(
        self,
        node: TrackslipNode[SlipEstimatorParameters],
        process: Callable[[Measurement], Report],
        reject: Callable[[str, Rejection], None],
    ) -> None:
        p = node.settings
        self._node, self._process, self._reject = node, process, reject
        self._used_s: float | None = None  # steady: of the first or the last usable sprocket sample
        self.sprocket_fault = ""  # of the last sprocket sample, with the remedy; empty if it is usable
        self._frames = p.frames_of_sources()
        node.subscribe_packed(topic_class("sprockets"), "sprockets", self._on_sprockets)
        self._pose_set = node.advertise(topic_class(POSE_SET), POSE_SET)
        node.subscribe(topic_class(SET_POSE), SET_POSE, self._on_set_pose)
        self._mountings = StaticMountings(node, conversions.Frames(*p.frames).base, p.gyros())
        for source in p.gyros():
            self._subscribe(topic_class("imu/data_raw"), source, partial(self._yaw_rate, source=source))
        for source in nonempty_names(p.pose_sources):
            self._subscribe(topic_class("box_pose"), source, partial(conversions.pose_fix, source=source))
        for source, compass in p.compasses().items():
            heading = partial(conversions.heading_fix, source=source, compass=compass)
            self._subscribe(message_class(HEADING_MESSAGES[compass.message]), source, heading, packed=False)
        for source, encoder in p.swing_encoders().items():
            angle = partial(conversions.swing_angle, source=source, variance=encoder.stddev**2)
            self._subscribe(topic_class("swing"), source, angle)
        for source, stated in p.odometries().items():
            pose = partial(conversions.odometry_pose, source=source, odometry_=stated)
            self._subscribe(topic_class("odometry"), source, pose)
        for source, receiver in p.velocities().items():
            velocity = partial(conversions.velocity_fix, source=source, velocity_source=receiver)
            self._subscribe(topic_class(FIX_VELOCITY), source, velocity)
        for source in nonempty_names(p.slip_sources):
            self._subscribe(topic_class("slip_seed"), source, partial(conversions.slip_fix, source=source))
        _require_own_topics(node)

    @property
    def sprocket_silence_s(self) -> float | None:
        """Time since the last usable sprocket sample, s; None before the first one."""
        return None if self._used_s is None else time.monotonic() - self._used_s

    def _subscribe(self, kind: type, source: str, convert: Convert, *, packed: bool = True) -> None:
        """Subscribe to a source; reject messages in another frame than the configured one."""

        def on_message(message: Any) -> None:
            is_in_frame = self._frames.get(source) in (None, read(FrameFields, message).frame)
            result = convert(message) if is_in_frame else Rejection.OTHER_FRAME
            if isinstance(result, Rejection):
                self._reject(source, result)
            else:
                self._process(result)

        subscribe = self._node.subscribe_packed if packed else self._node.subscribe
        subscribe(kind, source, on_message)

    def _on_sprockets(self, message: Any) -> None:
        report = self._process(conversions.sprockets(message, "sprockets"))
        reason = reason_of(report)
        if report.outcome in _UNUSABLE_STAMPS:
            self.sprocket_fault = f"{reason}: check the stamps of their publisher"
        elif report.outcome is Outcome.INVALID:
            self.sprocket_fault = f"{reason}: check names, positions and velocities of their publisher"
        else:
            self.sprocket_fault = ""
        if self._used_s is None or not self.sprocket_fault:
            self._used_s = time.monotonic()

    def _on_set_pose(self, message: Any) -> None:
        """Use a pose in the frame of the map, which a message without a frame is in too.

        It is republished before: a recorder may not have discovered its publisher in time. Its sender gets
        no answer, so a pose that is not used is logged.
        """
        frame, map_frame = read(FrameFields, message).frame, self._node.settings.map_frame
        if frame.removeprefix("/") in ("", map_frame):
            self._pose_set.publish(message)
            report = self._process(conversions.pose_fix(message, SET_POSE))
            fault = reason_of(report) if report.outcome.is_rejected else ""
        else:
            self._reject(SET_POSE, Rejection.OTHER_FRAME)
            fault = f"its frame is '{printable(frame)}'"
        if fault:
            accepted = f"accepted: frame '{map_frame}' or none, finite numbers, variances of x, y and heading"
            text = f"{SET_POSE}: pose is not used ({fault}); {accepted}"
            self._node.get_logger().warning(text, throttle_duration_sec=_LOG_PERIOD)

    def _yaw_rate(self, message: Any, source: str) -> Measurement | Rejection:
        """Return the yaw rate of an IMU; publish its mounting once that is determined."""
        imu, parameters = self._mountings.mounted_imu(source, read(FrameFields, message).frame)
        if parameters:  # published, so that a bag contains them
            self._node.settings = self._node.settings.changed(parameters)
            self._node.publish_parameters()
        return Rejection.NO_MOUNTING if imu is None else conversions.yaw_rate(message, source, imu)


def _require_own_topics(node: TrackslipNode[SlipEstimatorParameters]) -> None:
    """Check that no two sources of one kind are one topic, by remapping: each message would count twice.

    Raises:
        InputError: two sources are one topic.
    """
    for kind in KINDS:
        names: dict[str, str] = {}  # full name → source
        for source in node.settings.sources_of_kind(kind):
            full_name = node.resolve_topic_name(source)
            if full_name in names:
                text = f"'{names[full_name]}' and '{source}' are both {full_name}"
                raise InputError(f"{node.get_name()}: {kind}: {text}; accepted: each a topic of its own")
            names[full_name] = source
