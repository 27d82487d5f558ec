# SPDX-License-Identifier: Apache-2.0
"""``slip_estimator``: sprockets, yaw rates and poses in; odometry, slips and a report on each input out."""

import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from std_srvs.srv import SetBool, Trigger

from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import Health
from trackslip_common.nodes.messages import make, message_class, topic_class
from trackslip_common.nodes.run import run
from trackslip_common.vehicle import TOPIC as VEHICLE
from trackslip_common.vehicle import vehicle_text
from trackslip_estimation.nodes.estimator_health import estimator_health
from trackslip_estimation.nodes.state_keeper import StateKeeper
from trackslip_estimation.nodes.static_mountings import StaticMountings
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.local_odometry import LocalOdometry
from trackslip_estimation.slip.measurements import (
    FORGET,
    FREEZE,
    POSE_SET,
    RELOAD,
    RESET,
    SET_POSE,
    UNFREEZE,
    Command,
    Input,
    Measurement,
    Outcome,
    Reload,
)
from trackslip_estimation.slip.parameters import DEFAULT_FILES, NODE, SlipEstimatorParameters
from trackslip_estimation.slip.source_watch import SourceWatch
from trackslip_estimation.slip.sources import (
    HEADING_MESSAGES,
    OdometrySource,
    Refusal,
    named,
)

LOCAL, SWING = "odometry/local", "swing/estimate"


class SlipEstimatorNode(TrackslipNode[SlipEstimatorParameters]):
    """Converts, calls the estimator, publishes; all else is in ``SlipEstimator``."""

    realtime_priority = 10  # somebody steers by it
    parameters_topic = RELOAD

    def __init__(self) -> None:
        super().__init__(NODE, SlipEstimatorParameters, *DEFAULT_FILES)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/forget", self._on_forget)
        self.create_service(SetBool, "~/freeze", self._on_freeze)

    def configure(self) -> None:
        """Make the estimator, its outputs and its inputs."""
        p = self.settings
        self._kept = StateKeeper(self, lambda: self._estimator)
        self._estimator = SlipEstimator(p, learned=self._kept.learned)
        self._watch = SourceWatch(p.timeouts_ns())
        self._taken = self._estimates = 0
        self._heard: float | None = None  # s, steady: when the last sprocket sample came
        self._odometry = self.advertise(topic_class("odometry"), "odometry")
        self._frames = conversions.Frames(*p.frames)
        self._pose_and_twist = conversions.blank_odometry(make, self._frames.map, self._frames.base)
        self._local, self._local_odometry = LocalOdometry(), self.advertise(topic_class(LOCAL), LOCAL)
        self._local_message = conversions.blank_odometry(make, self._frames.odom, self._frames.base)
        self._attitude = self.advertise(topic_class("attitude"), "attitude") if p.tilt_source else None
        self._attitude_message = conversions.blank_attitude(make, self._frames.base)
        self._swing = self.advertise(topic_class(SWING), SWING) if p.swings else None
        self._swing_message = conversions.blank_swing(make, self._frames.base)
        self._track_slip = self.advertise(topic_class("track_slip"), "track_slip")
        self._vehicle = self.advertise(topic_class(VEHICLE), VEHICLE)
        self._reports = self.advertise(topic_class("measurement_reports"), "measurement_reports")
        self._tf = self._advertise_tf() if p.publish_tf else None
        self.subscribe(topic_class("sprockets"), "sprockets", self._on_sprockets)
        self._pose_set = self.advertise(topic_class(POSE_SET), POSE_SET)
        self.subscribe(topic_class(SET_POSE), SET_POSE, self._on_set_pose)
        self._frames_of_sources = p.frames_of_sources()
        self._mountings = StaticMountings(self, self._frames.base, p.gyros())
        for source in p.gyros():
            self._listen(topic_class("imu/data_raw"), source, partial(self._on_imu, source=source))
        for source in named(p.pose_sources):
            self._listen(topic_class("box_pose"), source, partial(self._on_pose, source=source))
        for source, compass in p.compasses().items():
            on_heading = partial(self._on_heading, source=source, variance=compass.stddev**2)
            self._listen(message_class(HEADING_MESSAGES[compass.message]), source, on_heading)
        for source, angle in p.angles().items():
            on_swing = partial(self._on_swing, source=source, variance=angle.stddev**2)
            self._listen(topic_class("swing"), source, on_swing)
        for source, stated in p.odometries().items():
            on_odometry = partial(self._on_odometry, source=source, stated=stated)
            self._listen(topic_class("odometry"), source, on_odometry)
        for source in named(p.slip_sources):
            self._listen(topic_class("slip_seed"), source, partial(self._on_slips, source=source))

    def activate(self) -> None:
        """State which vehicle the estimates are of."""
        self._vehicle.publish(make("std_msgs/msg/String", data=vehicle_text(self.settings.vehicle)))

    def reload(self, values: dict[str, Any]) -> None:
        """Before its first run, the estimator is made anew; later it goes on with other values."""
        if self.has_run:
            self._process(Reload(values))
        else:
            self._estimator = SlipEstimator(self.settings, learned=self._kept.learned)
        self._watch.expect(self.settings.timeouts_ns())

    def started_from(self) -> dict[str, Any]:
        """What was learned before: a bag carries it along."""
        return self._kept.started_from()

    def deactivate(self) -> None:
        """Keep what was learned."""
        self._kept.finish()

    def health(self) -> list[Health]:
        """Waiting, running, or what is missing; what was not accepted, innovations, and what was learned."""
        refused = {f"{source} {reason}": n for (source, reason), n in sorted(self.tally.total.items())}
        counts = {"measurements": self._taken, "estimates": self._estimates, **refused}
        silent = None if self._heard is None else time.monotonic() - self._heard
        return [estimator_health(self._estimator, self._watch, silent, counts), *self._kept.health()]

    def _listen(self, kind: type, source: str, callback: Callable[[Any], None]) -> None:
        """Subscribe to a source; what is in another frame than it may be in is refused."""

        def when_in_frame(message: Any) -> None:
            if self._frames_of_sources.get(source) in (None, message.header.frame_id):
                callback(message)
            else:
                self.tally.add(source, Refusal.OTHER_FRAME)

        self.subscribe(kind, source, when_in_frame)

    def _on_sprockets(self, message: Any) -> None:
        self._heard = time.monotonic()
        self._process(conversions.sprockets(message, "sprockets"))

    def _on_imu(self, message: Any, source: str) -> None:
        imu, found = self._mountings.imu(source, message.header.frame_id)
        if found:  # a bag has them from now on
            self.settings = self.settings.changed(found)
            self.publish_parameters()
        self._use(source, Refusal.NO_MOUNTING if imu is None else conversions.yaw_rate(message, source, imu))

    def _on_pose(self, message: Any, source: str) -> None:
        self._process(conversions.pose_fix(message, source))

    def _on_set_pose(self, message: Any) -> None:
        """Repeated first: a recorder knows this node, and may never have met who set the pose."""
        self._pose_set.publish(message)
        self._on_pose(message, SET_POSE)

    def _on_heading(self, message: Any, source: str, variance: float) -> None:
        self._use(source, conversions.heading_fix(message, source, variance))

    def _on_swing(self, message: Any, source: str, variance: float) -> None:
        self._process(conversions.swing_angle(message, source, variance))

    def _on_odometry(self, message: Any, source: str, stated: OdometrySource) -> None:
        self._use(source, conversions.odometry_pose(message, source, stated))

    def _on_slips(self, message: Any, source: str) -> None:
        self._process(conversions.slip_fix(message, source))

    def _on_reset(self, _: Any, response: Any) -> Any:
        return self._obey(Command(RESET), response, "the estimate begins anew; what was learned is kept")

    def _on_forget(self, _: Any, response: Any) -> Any:
        if self.active:
            self._kept.forget()
        return self._obey(Command(FORGET), response, "the estimate begins anew, with nothing learned")

    def _on_freeze(self, request: Any, response: Any) -> Any:
        text = "poses are ignored from now on" if request.data else "poses are used again"
        return self._obey(Command(FREEZE if request.data else UNFREEZE), response, text)

    def _obey(self, command: Command, response: Any, text: str) -> Any:
        if self.active:
            self._process(command)
            self._watch.clear()
        response.success, response.message = self.active, text if self.active else "the node is not active"
        return response

    def _advertise_tf(self) -> Any:
        try:
            return self.advertise(topic_class("tf"), "/tf")
        except ModuleNotFoundError:
            self.get_logger().info("tf2_msgs is not installed: no tf")
            return None

    def _use(self, source: str, given: Measurement | Refusal) -> None:
        if isinstance(given, Refusal):
            self.tally.add(source, given)
        else:
            self._process(given)

    def _process(self, given: Input) -> None:
        report, estimate = self._estimator.process(given)
        if estimate is not None:  # first: somebody steers by it
            self._publish(estimate)
        self._reports.publish(conversions.measurement_report(make, report, self._taken))
        self._taken += 1
        self._watch.add(report)
        if report.outcome is not Outcome.ACCEPTED:
            self.tally.add(report.source, report.outcome)

    def _publish(self, estimate: Estimate) -> None:
        conversions.fill_odometry(self._pose_and_twist, estimate)
        self._odometry.publish(self._pose_and_twist)
        self._track_slip.publish(conversions.track_slip(make, estimate, self._frames.base))
        tilt = estimate.outputs.tilt
        if self._attitude is not None and tilt is not None:
            conversions.fill_attitude(self._attitude_message, estimate, tilt)
            self._attitude.publish(self._attitude_message)
        swing = estimate.outputs.swing
        if self._swing is not None and swing is not None:
            conversions.fill_swing(self._swing_message, estimate, swing)
            self._swing.publish(self._swing_message)
        local = self._local.after(estimate)
        conversions.fill_odometry(self._local_message, local)
        self._local_odometry.publish(self._local_message)
        if self._tf is not None:
            self._tf.publish(conversions.transforms(make, estimate, local, self._frames))
        self._estimates += 1


def main() -> None:
    """Entry point."""
    sys.exit(run(SlipEstimatorNode))
