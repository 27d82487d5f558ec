# SPDX-License-Identifier: Apache-2.0
"""``slip_estimator``: sprockets, yaw rates and poses in; odometry, slips and a report on each input out."""

import sys
from functools import partial
from typing import Any

import yaml

from trackslip_common.nodes.base import OK, WARN, Health, TrackslipNode
from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.run import run
from trackslip_common.parameters import to_flat
from trackslip_estimation import conversions
from trackslip_estimation.measurements import Measurement, Outcome
from trackslip_estimation.slip_estimator import SlipEstimator
from trackslip_estimation.slip_parameters import DEFAULT_FILES, NODE, SlipEstimatorParameters


class SlipEstimatorNode(TrackslipNode[SlipEstimatorParameters]):
    """Converts, calls the estimator, publishes; all else is in ``SlipEstimator``."""

    def __init__(self) -> None:
        super().__init__(NODE, SlipEstimatorParameters, *DEFAULT_FILES)

    def configure(self) -> None:
        """Make the estimator, its outputs and its inputs."""
        p = self.settings
        self._estimator = SlipEstimator(p)
        self._taken = 0
        self._published = 0
        self._odometry = self.announce(topic_class("odometry"), "odometry")
        self._track_slip = self.announce(topic_class("track_slip"), "track_slip")
        self._reports = self.announce(topic_class("measurement_reports"), "measurement_reports")
        self._parameters_used = self.announce(
            topic_class("slip_estimator/parameters"), "slip_estimator/parameters"
        )
        self.listen(topic_class("sprockets"), "sprockets", self._on_sprockets)
        for source in filter(None, p.yaw_rate_sources):
            self.listen(topic_class("imu/data_raw"), source, partial(self._on_imu, source=source))
        for source in filter(None, p.pose_sources):
            self.listen(topic_class("box_pose"), source, partial(self._on_pose, source=source))

    def activate(self) -> None:
        """Say with which parameters the estimates of this run were made: a bag carries them along."""
        text = yaml.safe_dump({NODE: {"ros__parameters": to_flat(self.settings)}}, sort_keys=False)
        self._parameters_used.publish(make("std_msgs/msg/String", data=text))

    def health(self) -> list[Health]:
        """Waiting for a first fix, or running; what was not accepted, by source and reason."""
        refused = {f"{source} {reason}": n for (source, reason), n in sorted(self.tally.total.items())}
        values = {"measurements": self._taken, "estimates": self._published, **refused}
        if not self._estimator.started:
            return [Health(WARN, f"waiting for a fix on {', '.join(self.settings.pose_sources)}", values)]
        return [Health(OK, "running", values)]

    def _on_sprockets(self, message: Any) -> None:
        self._take(conversions.sprockets(message, "sprockets"))

    def _on_imu(self, message: Any, source: str) -> None:
        self._take(conversions.yaw_rate(message, source, self.settings.yaw_rate_stddev**2))

    def _on_pose(self, message: Any, source: str) -> None:
        self._take(conversions.pose_fix(message, source))

    def _take(self, measurement: Measurement) -> None:
        report, estimate = self._estimator.advance(measurement)
        if report.outcome is not Outcome.ACCEPTED:
            self.tally.add(report.source, report.outcome)
        self._reports.publish(conversions.measurement_report(make, report, self._taken))
        self._taken += 1
        if estimate is None:
            return
        p = self.settings
        self._odometry.publish(conversions.odometry(make, estimate, p.odom_frame, p.base_frame))
        self._track_slip.publish(conversions.track_slip(make, estimate, p.base_frame))
        self._published += 1


def main() -> None:
    """Entry point."""
    sys.exit(run(SlipEstimatorNode))
