# SPDX-License-Identifier: Apache-2.0
"""The drivers: CAN, Watson IMU, SICK PLS; with ``gnss:=true`` a GNSS receiver too."""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

PACKAGE = "trackslip_drivers"
EXECUTABLES = ("can_driver", "watson_imu", "sick_pls")


def generate_launch_description() -> LaunchDescription:
    """Defaults are the nodes' own; ``params_file`` goes over them."""
    about = "ROS parameter file over the defaults of config/"
    arguments = [
        DeclareLaunchArgument("params_file", default_value="", description=about),
        DeclareLaunchArgument("gnss", default_value="false", description="whether there is a GNSS receiver"),
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    params_file = LaunchConfiguration("params_file").perform(context)
    parameters = [params_file] if params_file else []
    has_gnss = LaunchConfiguration("gnss").perform(context).lower() == "true"
    return [
        Node(package=PACKAGE, executable=name, name=name, parameters=parameters, output="screen")
        for name in (*EXECUTABLES, *(["nmea_gnss"] if has_gnss else []))
    ]
