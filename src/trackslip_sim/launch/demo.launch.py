# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The graph of ``make demo`` under ``ros2 launch``: emulated excavator, drivers, estimators, recorder."""

from datetime import datetime
from pathlib import Path

from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from trackslip_common.nodes.launching import Launched, declared, is_true, nodes
from trackslip_common.vehicle_files import ASSUMED
from trackslip_sim.demo.graph import LIVE, DemoOptions, demo_nodes

_OWN = {
    "duration": ("40.0", "seconds of driving"),
    "soil": ("sand", "a name of config/soils.yaml"),
    "scenario": ("thesis", "a name of config/scenarios, or a file"),
    "devices": ("/tmp/trackslip_devices", "directory of the emulated serial ports"),
    "can_port": ("43113", "UDP port of the emulated CAN bus"),
}


def generate_launch_description() -> LaunchDescription:
    """The machine starts to drive some seconds after its key is turned; the bag is written here."""
    return LaunchDescription([*declared(**_OWN), OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    given = {name: LaunchConfiguration(name).perform(context) for name in (*_OWN, "vehicle", "gnss")}
    options = DemoOptions(
        devices=Path(given["devices"]),
        bag=Path.cwd() / f"trackslip_{datetime.now():%Y%m%d_%H%M%S}",
        can_port=int(given["can_port"]),
        duration=float(given["duration"]),
        soil=given["soil"],
        scenario=given["scenario"],
        vehicle=given["vehicle"] or ASSUMED,
        autostart=True,
        gnss=is_true(given["gnss"]),
    )
    wanted = [Launched(node.package, node.executable, node.parameters) for node in demo_nodes(options)]
    return nodes(context, [*wanted, Launched(LIVE.package, LIVE.executable)])
