# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``gnss_localizer``: positions of a GNSS antenna in metres east and north, from fixes of its receiver."""

import sys
import time
from typing import Any

from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import OK, WARN, Health
from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.run import run
from trackslip_estimation.gnss import conversions
from trackslip_estimation.gnss.localizer import FIX, GnssLocalizer, Reason
from trackslip_estimation.gnss.parameters import NODE, GnssLocalizerParameters
from trackslip_estimation.slip.silence import SilenceMonitor

POSE, DATUM = "gnss_pose", "gnss_localizer/datum"

_SILENCE_TIMEOUT = 2.0  # s


class GnssLocalizerNode(TrackslipNode[GnssLocalizerParameters]):
    """Converts fixes, calls the localizer, publishes its positions."""

    def __init__(self) -> None:
        super().__init__(NODE, GnssLocalizerParameters, f"{NODE}.yaml")

    def configure(self) -> None:
        """Create the localizer."""
        self._localizer = GnssLocalizer(self.settings)
        self._fixes = self._poses = 0
        self._reported_poses = 0
        self._silence = SilenceMonitor()
        self._result = (WARN, "no fixes")  # of the latest fixes
        self._published_datum = False
        self._pose = self.advertise(topic_class(POSE), POSE)
        self._datum = self.advertise(topic_class(DATUM), DATUM)
        self.subscribe(topic_class(FIX), FIX, self._on_fix)

    def activate(self) -> None:
        """Publish the datum if it is given by parameters."""
        if self._localizer.datum is not None:
            self._publish_datum(self.get_clock().now().nanoseconds)

    def health(self) -> list[Health]:
        """Return the numbers of fixes and poses, the datum, and why fixes gave no pose."""
        poses_before, self._reported_poses = self._reported_poses, self._poses
        datum = self._localizer.datum
        datum_text = "none yet" if datum is None else "{:.9f}° {:.9f}° {:.3f} m".format(*datum)
        values = {
            "fixes": self._fixes,
            "poses": self._poses,
            "datum": datum_text,
            **self._localizer.tally.values(),
        }
        new_rejections = self._localizer.tally.new_counts()
        if self._silence.is_silent(time.monotonic(), _SILENCE_TIMEOUT):
            self._result = WARN, "no fixes"
        elif self._poses == poses_before and new_rejections:
            self._result = WARN, f"all fixes rejected: {', '.join(why for _, why in new_rejections)}"
        elif new_rejections:
            self._result = WARN, f"{sum(new_rejections.values())} rejected"
        elif self._poses > poses_before:
            self._result = OK, "running"
        return [Health(*self._result, values)]

    def _on_fix(self, message: Any) -> None:
        self._fixes += 1
        self._silence.add(time.monotonic())
        position = self._localizer.locate(conversions.fix(message))
        if isinstance(position, Reason):
            return
        if not self._published_datum:
            self._publish_datum(position.stamp_ns)
        self._poses += 1
        self._pose.publish(conversions.pose(make, position, POSE, self.settings.map_frame))

    def _publish_datum(self, stamp_ns: int) -> None:
        """Publish the datum; log it as parameters for a later run with the same map."""
        datum = self._localizer.datum
        assert datum is not None
        names = ("latitude", "longitude", "altitude")
        text = ", ".join(f"datum_{name}: {value:.11g}" for name, value in zip(names, datum, strict=True))
        self.get_logger().info(text)
        self._datum.publish(conversions.datum(make, datum, stamp_ns, self.settings.map_frame))
        self._published_datum = True


def main() -> None:
    """Entry point."""
    sys.exit(run(GnssLocalizerNode))
