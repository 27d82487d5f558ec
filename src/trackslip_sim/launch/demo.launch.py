# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The graph of ``make demo`` under ``ros2 launch``: emulated excavator, drivers, estimators, recorder."""

from datetime import datetime
from pathlib import Path

from launch.actions import OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from trackslip_common.nodes.launching import (
    LaunchedNode,
    declare_arguments,
    enabled_nodes,
    is_switched_on,
    make_nodes,
    number_argument,
)
from trackslip_common.vehicle_files import DEFAULT_VEHICLE
from trackslip_sim.demo.graph import EXECUTABLES, LIVE_NODE, DemoOptions, demo_nodes

_ARGUMENTS = {
    "duration": ("40.0", "seconds of driving"),
    "soil": ("sand", "a name of config/soils.yaml"),
    "scenario": ("thesis", "a name of config/scenarios, or a file"),
    "devices": ("/tmp/trackslip_devices", "directory of the emulated serial ports"),
    "can_port": ("23113", "UDP port of the emulated CAN bus"),
}


def generate_launch_description() -> LaunchDescription:
    """Launch all nodes; the drive starts some seconds after power-on, the bag is in the working directory."""
    return LaunchDescription([*declare_arguments(EXECUTABLES, **_ARGUMENTS), OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    arguments = {name: LaunchConfiguration(name).perform(context) for name in (*_ARGUMENTS, "vehicle")}
    options = DemoOptions(
        devices=Path(arguments["devices"]),
        bag=Path.cwd() / f"trackslip_{datetime.now():%Y%m%d_%H%M%S}",
        can_port=int(number_argument(context, "can_port", int)),
        duration=number_argument(context, "duration", float),
        soil=arguments["soil"],
        scenario=arguments["scenario"],
        vehicle=arguments["vehicle"] or DEFAULT_VEHICLE,
        autostart=True,
        laser=is_switched_on(context, "laser"),
        gnss=is_switched_on(context, "gnss"),
    )
    specs = [*demo_nodes(options), LIVE_NODE]
    nodes = [LaunchedNode(spec.package, spec.executable, spec.parameters) for spec in specs]
    chosen = enabled_nodes(context, nodes)
    estimators = [one.executable for one in chosen if one.package == "trackslip_estimation"]
    emulator, *others = chosen
    emulator = emulator._replace(parameters={**emulator.parameters, "start_after": estimators})
    return make_nodes(context, [emulator, *others])
