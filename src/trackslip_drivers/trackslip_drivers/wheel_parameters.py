# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node ``wheel_adapter`` (values: ``config/wheel_adapter.yaml``)."""

from dataclasses import dataclass

from trackslip_common.errors import InputError
from trackslip_common.parameters import parameter
from trackslip_common.vehicle_files import ParametersWithVehicle

NODE = "wheel_adapter"
MESSAGES = {
    "joints": "sensor_msgs/msg/JointState",
    "odometry": "nav_msgs/msg/Odometry",
    "twist": "geometry_msgs/msg/Twist",
    "twist_stamped": "geometry_msgs/msg/TwistStamped",
}


@dataclass(frozen=True, kw_only=True)
class WheelParameters(ParametersWithVehicle):
    """Source of the motion, and its conversion to that of the vehicle's two sprockets."""

    topic: str = parameter("topic to subscribe to")
    message: str = parameter(
        "joints: JointState; odometry, twist, twist_stamped: speeds of a base controller",
        choices=tuple(MESSAGES),
    )
    frame_id: str = parameter("frame of the sprockets' messages")
    left_joints: tuple[str, ...] = parameter("joints of the left side; their mean is used")
    right_joints: tuple[str, ...] = parameter("joints of the right side")
    left_sign: int = parameter(
        "1, or -1 if the left joints turn backward when the machine drives forward", choices=(1, -1)
    )
    right_sign: int = parameter("the same for the right joints", choices=(1, -1))
    joint_ratio: float = parameter("turns of a joint per turn of the sprocket, or of the wheel", gt=0.0)
    uses: str = parameter("fields of a JointState that are used", choices=("both", "positions", "velocities"))
    wheel_separation: float = parameter("wheel separation set in the base controller", unit="m", gt=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        names = [*self.left_joints, *self.right_joints]
        if not (self.left_joints and self.right_joints) or len(set(names)) < len(names) or "" in names:
            raise InputError(
                f"WheelParameters: left_joints {list(self.left_joints)} and right_joints "
                f"{list(self.right_joints)} are refused; accepted: one or more on each side, each once"
            )
