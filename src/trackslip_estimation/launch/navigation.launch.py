# SPDX-License-Identifier: Apache-2.0
"""Box localizer, slip and soil estimators, and recorder; with ``gnss:=true`` the GNSS localizer too."""

import os
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

PACKAGE = "trackslip_estimation"
_DEFAULT = "default"
EXECUTABLES = ("box_localizer", "slip_estimator", "soil_estimator", "record")


def generate_launch_description() -> LaunchDescription:
    """Defaults are the nodes' own; ``params_file`` goes over them."""
    about = "ROS parameter file over the defaults of config/"
    arguments = [
        DeclareLaunchArgument("params_file", default_value="", description=about),
        DeclareLaunchArgument("gnss", default_value="false", description="whether there is a GNSS receiver"),
        DeclareLaunchArgument(
            "state_file",
            default_value=_DEFAULT,
            description=f"keeps what was learned of the machine; '{_DEFAULT}': one of the namespace in "
            "$ROS_HOME/trackslip; 'none': nothing is kept",
        ),
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])


def _state_file(context: LaunchContext) -> str:
    """The path to give the slip estimator; empty for none."""
    chosen = LaunchConfiguration("state_file").perform(context)
    if chosen != _DEFAULT:
        return "" if chosen == "none" else chosen
    namespace = context.launch_configurations.get("ros_namespace", "").strip("/")
    home = Path(os.environ.get("ROS_HOME", "~/.ros"))
    return str(home / "trackslip" / namespace / "slip_estimator.yaml")


def _nodes(context: LaunchContext) -> list[Node]:
    params_file = LaunchConfiguration("params_file").perform(context)
    given = [params_file] if params_file else []
    has_gnss = LaunchConfiguration("gnss").perform(context).lower() == "true"
    executables = (*EXECUTABLES, *(["gnss_localizer"] if has_gnss else []))
    parameters = dict.fromkeys(executables, given)
    parameters["slip_estimator"] = [{"state_file": _state_file(context)}, *given]
    return [
        Node(package=PACKAGE, executable=name, name=name, parameters=parameters[name], output="screen")
        for name in executables
    ]
