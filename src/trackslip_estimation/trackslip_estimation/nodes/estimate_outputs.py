# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of an estimate: odometry, slips, machine state; attitude and swing with the sensors for them."""

from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.messages import make
from trackslip_common.nodes.outputs import PackedOutput
from trackslip_common.topics import LOCAL_ODOMETRY, MACHINE_STATE, SWING_ESTIMATE
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.estimator import Estimate
from trackslip_estimation.slip.local_odometry import LocalOdometry
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.transforms import blank_transforms, fill_transforms


class EstimateOutputs:
    """Advertises and publishes the topics of an estimate."""

    def __init__(self, node: TrackslipNode[SlipEstimatorParameters]) -> None:
        p, advertise, frames = node.settings, node.advertise_packed, conversions.Frames(*node.settings.frames)
        base, self._local = frames.base, LocalOdometry()
        self._odometry = advertise("odometry", conversions.blank_odometry(make, frames.map, base))
        self._local_odometry = advertise(LOCAL_ODOMETRY, conversions.blank_odometry(make, frames.odom, base))
        self._attitude = (
            advertise("attitude", conversions.blank_attitude(make, base)) if p.tilt_source else None
        )
        self._swing = advertise(SWING_ESTIMATE, conversions.blank_swing(make, base)) if p.swings else None
        self._track_slip = advertise("track_slip", conversions.blank_track_slip(make, base))
        blank_state = conversions.blank_machine_state(make, frames.map, base)
        self._machine_state = advertise(MACHINE_STATE, blank_state)
        self._tf = _advertise_tf(node, frames) if p.publish_tf else None

    def publish(self, estimate: Estimate) -> None:
        """Publish all outputs of an estimate, the odometry first."""
        conversions.fill_odometry(self._odometry.message, estimate)
        self._odometry.publish()
        conversions.fill_track_slip(self._track_slip.message, estimate)
        self._track_slip.publish()
        conversions.fill_machine_state(self._machine_state.message, estimate)
        self._machine_state.publish()
        tilt = estimate.outputs.tilt
        if self._attitude is not None and tilt is not None:
            conversions.fill_attitude(self._attitude.message, estimate, tilt)
            self._attitude.publish()
        swing = estimate.outputs.swing
        if self._swing is not None and swing is not None:
            conversions.fill_swing(self._swing.message, estimate, swing)
            self._swing.publish()
        local = self._local.estimate_in_odom(estimate)
        conversions.fill_odometry(self._local_odometry.message, local)
        self._local_odometry.publish()
        if self._tf is not None:
            fill_transforms(self._tf.message, estimate, local)
            self._tf.publish()


def _advertise_tf(
    node: TrackslipNode[SlipEstimatorParameters], frames: conversions.Frames
) -> PackedOutput | None:
    try:
        return node.advertise_packed("/tf", blank_transforms(make, frames))
    except ModuleNotFoundError:
        node.get_logger().info("tf2_msgs is not installed: no tf")
        return None
