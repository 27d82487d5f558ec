# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The topics of an estimate: odometry, slips, and what a machine's sensors give beside them."""

from typing import Any

from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.messages import make, topic_class
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.estimator import Estimate
from trackslip_estimation.slip.local_odometry import LocalOdometry
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.transforms import transforms

LOCAL, SWING = "odometry/local", "swing/estimate"


class EstimateOutputs:
    """Advertises and publishes; messages are made once and filled anew, which is several times faster."""

    def __init__(self, node: TrackslipNode[SlipEstimatorParameters]) -> None:
        p, advertise = node.settings, node.advertise
        self._frames = conversions.Frames(*p.frames)
        self._odometry = advertise(topic_class("odometry"), "odometry")
        self._pose_and_twist = conversions.blank_odometry(make, self._frames.map, self._frames.base)
        self._local, self._local_odometry = LocalOdometry(), advertise(topic_class(LOCAL), LOCAL)
        self._local_message = conversions.blank_odometry(make, self._frames.odom, self._frames.base)
        self._attitude = advertise(topic_class("attitude"), "attitude") if p.tilt_source else None
        self._attitude_message = conversions.blank_attitude(make, self._frames.base)
        self._swing = advertise(topic_class(SWING), SWING) if p.swings else None
        self._swing_message = conversions.blank_swing(make, self._frames.base)
        self._track_slip = advertise(topic_class("track_slip"), "track_slip")
        self._tf = _advertise_tf(node) if p.publish_tf else None

    def publish(self, estimate: Estimate) -> None:
        """All that there is of an estimate, the odometry first."""
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
            self._tf.publish(transforms(make, estimate, local, self._frames))


def _advertise_tf(node: TrackslipNode[SlipEstimatorParameters]) -> Any:
    try:
        return node.advertise(topic_class("tf"), "/tf")
    except ModuleNotFoundError:
        node.get_logger().info("tf2_msgs is not installed: no tf")
        return None
