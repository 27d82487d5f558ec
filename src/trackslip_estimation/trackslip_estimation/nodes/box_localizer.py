# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``box_localizer``: pose of the machine from laser scans of the box on its cab."""

import sys
import time
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from trackslip_common.make import stamp_ns_of
from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import OK, WARN, Health
from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.run import run
from trackslip_common.topics import ODOMETRY
from trackslip_estimation.box.fit import compile_fit
from trackslip_estimation.box.localizer import BoxFix, BoxLocalizer
from trackslip_estimation.box.odometry import Odometry, OdometryBuffer
from trackslip_estimation.box.parameters import DEFAULT_FILES, NODE, BoxNodeParameters
from trackslip_estimation.box.scan import Scan
from trackslip_estimation.box.search import Reason
from trackslip_estimation.box.track_file import TrackFile
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.measurements import PoseFix
from trackslip_estimation.slip.silence import SilenceMonitor

UNCERTAIN_TEXT = (
    "box not certain, no pose is published: drive on, or clear the site of what looks like the box"
)
_OTHER_THING_TEXT = "an object of another size or shape is in the place of the box: check sensors.box"
_MISFIT_TEXT = "fits are worse than the noise: check length and width in sensors.box, and range_stddev"
_NO_SCANS = "no scans: check the laser driver"
_LOST_TEXTS: Mapping[Reason | None, str] = MappingProxyType(
    {
        Reason.UNCERTAIN: UNCERTAIN_TEXT,
        Reason.SIZE: _OTHER_THING_TEXT,
        Reason.SHAPE: _OTHER_THING_TEXT,
    }
)
_SILENCE_TIMEOUT = 2.0  # s


class BoxLocalizerNode(TrackslipNode[BoxNodeParameters]):
    """Converts messages, calls the localizer, publishes its fixes."""

    def __init__(self) -> None:
        super().__init__(NODE, BoxNodeParameters, *DEFAULT_FILES)

    def configure(self) -> None:
        """Create the localizer; compile the fit, so that the first scan does not wait for it."""
        compile_fit()
        self._file = TrackFile(self.settings.track_file)
        self._localizer = BoxLocalizer(self.settings, self.settings.vehicle.box, self._file.read())
        self._odometry = OdometryBuffer(self._localizer.tally)
        self._fixes = 0
        self._scans = 0
        self._reason: Reason | None = None  # why the latest scan gave no fix
        self._reported_counts = (0, 0)
        self._silence = SilenceMonitor()
        self._result = (WARN, _NO_SCANS)  # of the latest scans
        self._poses = self.advertise(topic_class("box_pose"), "box_pose")
        self.subscribe(topic_class("scan"), "scan", self._on_scan)
        self.subscribe_packed(topic_class(ODOMETRY), ODOMETRY, self._on_odometry)

    def health(self) -> list[Health]:
        """Return the numbers of scans and fixes, and why scans gave no fix."""
        fixes_before, scans_before = self._reported_counts
        self._reported_counts = (self._fixes, self._scans)
        restarts = self._localizer.restarts
        values: dict[str, object] = {
            "scans": self._scans,
            "fixes": self._fixes,
            "restarts": restarts,
            **self._localizer.tally.values(),
        }
        values["track of the run before"] = "continued" if self._localizer.resumed else "not used"
        if self._file.failure:
            values["track file"] = self._file.failure
        values["misfit"] = f"{self._localizer.misfit:.2f}"
        if self._reason is Reason.UNCERTAIN:
            values["places"] = "; ".join(f"{x:.2f} {y:.2f}" for x, y in self._localizer.ambiguous_positions)
        if self._silence.is_silent(time.monotonic(), _SILENCE_TIMEOUT):
            self._result = WARN, _NO_SCANS
        elif self._fixes > fixes_before:
            is_misfit = self._localizer.misfit > self.settings.largest_misfit
            self._result = (WARN, _MISFIT_TEXT) if is_misfit else (OK, "running")
        elif self._scans > scans_before:
            self._result = WARN, _LOST_TEXTS.get(self._reason, "box not found; clear the view of the laser")
        return [Health(*self._result, values)]

    def _on_scan(self, message: Any) -> None:
        self._scans += 1
        self._silence.add(time.monotonic())
        ranges = np.array(message.ranges, dtype=np.float64)
        if message.range_max > 0.0:
            ranges[ranges >= message.range_max] = np.inf  # so some drivers mark a beam without a return
        geometry = (message.angle_min, message.angle_increment, message.time_increment)
        scan = Scan(stamp_ns_of(message), ranges, *geometry)
        fix = self._localizer.locate(scan, self._odometry.find_nearest(scan.stamp_ns))
        self._reason = fix if isinstance(fix, Reason) else None
        self._file.write(self._localizer.saved_state)
        if isinstance(fix, BoxFix):
            self._fixes += 1
            pose = PoseFix("box_pose", fix.stamp_ns, np.array((fix.x, fix.y, fix.yaw)), fix.covariance)
            self._poses.publish(conversions.pose_with_covariance(make, pose, self.settings.map_frame))

    def _on_odometry(self, message: Any) -> None:
        odometry = conversions.pose_fix(message, ODOMETRY)
        self._odometry.add(Odometry(odometry.stamp_ns, odometry.pose[:2], odometry.covariance[:2, :2]))


def main() -> None:
    """Entry point."""
    sys.exit(run(BoxLocalizerNode))
