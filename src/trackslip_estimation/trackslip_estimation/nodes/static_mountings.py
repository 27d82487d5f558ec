# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How IMUs are mounted, by /tf_static, for those whose parameters say so."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from rclpy.node import Node

from trackslip_common.errors import InputError
from trackslip_common.nodes.messages import topic_class
from trackslip_common.nodes.qos import latched
from trackslip_estimation.slip.sources import YawRateSource, group_name
from trackslip_estimation.slip.static_frames import StaticFrames

_DEPTH = 100  # several publishers keep one message each
_ANGLES = ("mounting_roll", "mounting_pitch", "mounting_yaw")


class StaticMountings:
    """Subscribes where an IMU needs it, and finds each mounting once: it stays until the next start."""

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
            node.create_subscription(kind, "/tf_static", self.take, latched(_DEPTH))

    def take(self, message: Any) -> None:
        """One message of /tf_static."""
        for link in message.transforms:
            q = link.transform.rotation
            self._frames.add(link.header.frame_id, link.child_frame_id, (q.x, q.y, q.z, q.w))

    def imu(self, source: str, frame: str) -> tuple[YawRateSource | None, dict[str, float]]:
        """What is stated of an IMU with its mounting, None while that is not known; parameters found now."""
        known = self._imus[source]
        if known is not None:
            return known, {}
        angles = self._frames.angles(self._base, frame)
        if angles is None:
            return None, {}
        roll, pitch, yaw = angles
        stated = self._stated[source]
        known = replace(stated, mounting_roll=roll, mounting_pitch=pitch, mounting_yaw=yaw)
        self._imus[source] = known
        group = f"sources.{group_name(source)}"
        return known, {f"{group}.{name}": angle for name, angle in zip(_ANGLES, angles, strict=True)}
