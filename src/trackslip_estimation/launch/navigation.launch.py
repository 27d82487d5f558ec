# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Box and GNSS localizers, slip and soil estimators, recorder, live page: those that the switches say."""

import os
from pathlib import Path

from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from trackslip_common.nodes.launching import LaunchedNode, declare_arguments, is_switched_on, make_nodes

PACKAGE = "trackslip_estimation"
LIVE = LaunchedNode("trackslip_tools", "live")
_DEFAULT = "default"
EXECUTABLES = ("box_localizer", "slip_estimator", "soil_estimator", "gnss_localizer", "record")


def generate_launch_description() -> LaunchDescription:
    """Defaults are the nodes' own; ``params_file`` goes over them."""
    state_file = (
        _DEFAULT,
        (
            f"keeps what was learned; '{_DEFAULT}': one a namespace, in $ROS_HOME/trackslip, with the track "
            "of the box; 'none': nothing"
        ),
    )
    record = ("true", "record all topics; false where a recorder of its own runs")
    arguments = declare_arguments([*EXECUTABLES, LIVE.executable], state_file=state_file, record=record)
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    state_file = _state_file(context)
    track_file = str(Path(state_file).with_name("box_localizer.json")) if state_file else ""
    own = {"slip_estimator": {"state_file": state_file}, "box_localizer": {"track_file": track_file}}
    requested = EXECUTABLES if is_switched_on(context, "record") else EXECUTABLES[:-1]
    launched = [LaunchedNode(PACKAGE, name, own.get(name, {})) for name in requested]
    return make_nodes(context, [*launched, LIVE])


def _state_file(context: LaunchContext) -> str:
    """The path to give the slip estimator; empty for none."""
    chosen = LaunchConfiguration("state_file").perform(context)
    if chosen != _DEFAULT:
        return "" if chosen == "none" else chosen
    outer = context.launch_configurations.get("ros_namespace", "")
    namespace = "/".join((outer, LaunchConfiguration("namespace").perform(context))).strip("/")
    home = Path(os.environ.get("ROS_HOME", "~/.ros"))
    return str(home / "trackslip" / namespace / "slip_estimator.yaml")
