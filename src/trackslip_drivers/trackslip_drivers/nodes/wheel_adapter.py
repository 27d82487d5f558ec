# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``wheel_adapter``: converts joint states or a base controller's speeds to ``sprockets``."""

import sys
from typing import Any

from trackslip_common.errors import printable
from trackslip_common.make import stamp_ns_of
from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import OK, WARN, Health
from trackslip_common.nodes.messages import make, message_class
from trackslip_common.nodes.run import run
from trackslip_drivers import conversions
from trackslip_drivers.protocols.wheel_motion import JointMotion, Rejection, sample_of_speeds
from trackslip_drivers.records import SprocketSample
from trackslip_drivers.wheel_parameters import MESSAGES, NODE, WheelParameters

SPROCKETS = "sprockets"


class WheelAdapterNode(TrackslipNode[WheelParameters]):
    """Converts messages; one without a stamp (Twist) is stamped at its arrival."""

    def __init__(self) -> None:
        super().__init__(NODE, WheelParameters, f"{NODE}.yaml")

    def configure(self) -> None:
        """Create the subscription and the publisher."""
        p = self.settings
        self._joints = JointMotion(p)
        self._received = self._published = 0
        self._reported = (0, 0)  # received and published, at the last report
        self._sprockets = self.advertise_packed(SPROCKETS, conversions.blank_joint_state(make, p.frame_id))
        self.subscribe(message_class(MESSAGES[p.message]), p.topic, self._on_message)

    def health(self) -> list[Health]:
        """Counts of messages received and published, and of rejections by reason."""
        (received, published), self._reported = self._reported, (self._received, self._published)
        values = {"received": self._received, "published": self._published, **self.tally.values()}
        if self._received == received:
            return [Health(WARN, f"nothing on {self.settings.topic}", values)]
        new_rejections = self.tally.new_counts()
        if self._published == published:
            reasons = ", ".join(map(self.tally.detail_or_reason, new_rejections))
            return [Health(WARN, f"all rejected: {reasons}", values)]
        return [Health(OK, "running", values)]

    def _on_message(self, message: Any) -> None:
        self._received += 1
        sample = self._sample(message)
        if isinstance(sample, Rejection):
            has_joints = sample is Rejection.MISSING_JOINT
            detail = f"{sample.value}, as they are {printable(', '.join(message.name))}" if has_joints else ""
            self.tally.add(self.settings.topic, sample, detail=detail)
            return
        self._published += 1
        conversions.fill_joint_state(self._sprockets.message, sample)
        self._sprockets.publish()

    def _sample(self, message: Any) -> SprocketSample | Rejection:
        now_ns = self.get_clock().now().nanoseconds
        stamp_ns = stamp_ns_of(message) if hasattr(message, "header") else now_ns
        if self.settings.message == "joints":
            return self._joints.sample(
                stamp_ns, list(message.name), list(message.position), list(message.velocity)
            )
        twist = message
        while hasattr(twist, "twist"):
            twist = twist.twist
        return sample_of_speeds(stamp_ns, twist.linear.x, twist.angular.z, self.settings)


def main() -> None:
    """Entry point."""
    sys.exit(run(WheelAdapterNode))
