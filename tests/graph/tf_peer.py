# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A separate process of another package: publishes the mounting of the IMU, prints the links of /tf."""

import math

import rclpy
from geometry_msgs.msg import TransformStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from tf2_msgs.msg import TFMessage

# A mast turned a quarter turn to the left; the IMU hangs below its top plate.
LINKS = {("base_link", "mast"): (0.0, math.pi / 2.0), ("mast", "imu_link"): (math.pi, 0.0)}  # roll, yaw


def link(parent: str, child: str, roll: float, yaw: float) -> TransformStamped:
    transform = TransformStamped(child_frame_id=child)
    transform.header.frame_id = parent
    q = transform.transform.rotation  # of R_z(yaw) R_x(roll)
    q.x, q.y = math.cos(yaw / 2.0) * math.sin(roll / 2.0), math.sin(yaw / 2.0) * math.sin(roll / 2.0)
    q.z, q.w = math.sin(yaw / 2.0) * math.cos(roll / 2.0), math.cos(yaw / 2.0) * math.cos(roll / 2.0)
    return transform


def print_links(message: TFMessage) -> None:
    for transform in message.transforms:
        z, w = transform.transform.rotation.z, transform.transform.rotation.w
        print(transform.header.frame_id, transform.child_frame_id, 2.0 * math.atan2(z, w), flush=True)


rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = rclpy.create_node("tf_peer")
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
links = node.create_publisher(TFMessage, "/tf_static", latched)
links.publish(TFMessage(transforms=[link(*names, *angles) for names, angles in LINKS.items()]))
node.create_subscription(TFMessage, "/tf", print_links, 100)
rclpy.spin(node)
