# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Shared by the launch files: their arguments, and the effect of these on a node."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from launch.actions import DeclareLaunchArgument, EmitEvent, SetEnvironmentVariable
from launch.events.process import ProcessExited, ShutdownProcess
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext
from trackslip_common.config_files import config_file
from trackslip_common.errors import ExitCode, InputError

_RESPAWN_DELAY = 2.0  # s, so that a node that ends at once does not fill log and processor
_ARGUMENTS = {  # each is declared by the launch files whose nodes use it
    "vehicle": ("", "a name of config/vehicles, or a file (empty: pc05 is assumed)"),
    "params_file": ("", "ROS parameter file over the defaults of config/ and all other arguments"),
    "namespace": ("", "of all nodes and their topics, and before the frames odom and base_link"),
    "use_sim_time": ("false", "time from /clock, as a replay publishes it"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
    "respawn": (
        "false",
        f"restart a node {_RESPAWN_DELAY:g} s after its end, unless it refused its input",
    ),
    "laser": ("true", "scanner and box on the machine"),
    "imu": ("true", "inertial unit"),
    "hydraulics": ("true", "pressures: forces and soil"),
    "gnss": ("false", "satellite receiver"),
    "live": ("false", "serve the live page, at http://127.0.0.1:5006/ unless params_file says otherwise"),
}
_COMMON_ARGUMENTS = ("params_file", "namespace", "use_sim_time", "log_level", "respawn")
_YES, _NO = ("true", "1", "yes", "on"), ("false", "0", "no", "off")
_RANGE, _PEERS = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"), ("ROS_STATIC_PEERS", "")
_PROFILES = {  # of Fast DDS 2 and 3, each with its own variable
    "FASTRTPS_DEFAULT_PROFILES_FILE": "fastrtps.xml",
    "FASTDDS_DEFAULT_PROFILES_FILE": "fastdds.xml",
}
_SWITCH_OF_NODE = {
    "sick_pls": "laser",
    "box_localizer": "laser",
    "watson_imu": "imu",
    "soil_estimator": "hydraulics",
    "nmea_gnss": "gnss",
    "gnss_localizer": "gnss",
    "live": "live",
}
_SOURCE_SWITCHES = ("laser", "imu", "gnss")  # possible sources of the slip estimator
_NODES_WITH_PREFIX = ("slip_estimator", "soil_estimator", "can_driver", "emulator")
_NODES_WITH_VEHICLE = ("slip_estimator", "soil_estimator", "box_localizer", "can_driver", "emulator")


class LaunchedNode(NamedTuple):
    """One node to launch, with parameters beside those of the arguments."""

    package: str
    executable: str
    parameters: Mapping[str, Any] = {}


def declare_arguments(
    executables: Iterable[str], **own: tuple[str, str]
) -> list[DeclareLaunchArgument | SetEnvironmentVariable]:
    """Arguments that a launch file of these nodes uses, and settings of the DDS discovery.

    ``own`` are arguments of this file alone: name=(default, description).
    """
    arguments = {**{name: _ARGUMENTS[name] for name in _used_arguments(executables)}, **own}
    return [
        *(
            DeclareLaunchArgument(name, default_value=default, description=about)
            for name, (default, about) in arguments.items()
        ),
        *_discovery_settings(),
    ]


def _used_arguments(executables: Iterable[str]) -> list[str]:
    """Names of the arguments that affect one of these nodes, in the order of ``_ARGUMENTS``."""
    used = set(_COMMON_ARGUMENTS)
    for executable in executables:
        used |= {_SWITCH_OF_NODE[executable]} if executable in _SWITCH_OF_NODE else set()
        used |= {"vehicle"} if executable in _NODES_WITH_VEHICLE else set()
        used |= set(_SOURCE_SWITCHES) if executable == "slip_estimator" else set()
    return [name for name in _ARGUMENTS if name in used]


def _discovery_settings() -> list[DeclareLaunchArgument | SetEnvironmentVariable]:
    """Limit discovery to this computer and the named peers; variables that are set already are kept.

    Fast DDS gets our profile, which states the reason.
    """
    description = "addresses of further computers, such as an operator's laptop, separated by ;"
    range_value, peers = (
        EnvironmentVariable(name, default_value=default) for name, default in (_RANGE, _PEERS)
    )
    return [
        DeclareLaunchArgument("peers", default_value=peers, description=description),
        SetEnvironmentVariable(_RANGE[0], range_value),
        SetEnvironmentVariable(_PEERS[0], LaunchConfiguration("peers")),
        *(
            SetEnvironmentVariable(name, EnvironmentVariable(name, default_value=str(config_file(file))))
            for name, file in _PROFILES.items()
        ),
    ]


def make_nodes(context: LaunchContext, requested: Iterable[LaunchedNode]) -> list[Node]:
    """The nodes of ``requested`` that are switched on.

    Raises:
        InputError: the value of an argument is rejected.
    """
    enabled = enabled_nodes(context, requested)
    names = _used_arguments(node.executable for node in enabled)
    arguments = {name: LaunchConfiguration(name).perform(context) for name in names}
    arguments["params_file"] = _parameter_file(arguments["params_file"])
    switches = {name: is_switched_on(context, name) for name in names if _is_switch(name)}
    return [_make_node(node, arguments, switches) for node in enabled]


def enabled_nodes(context: LaunchContext, requested: Iterable[LaunchedNode]) -> list[LaunchedNode]:
    """Those of ``requested`` whose switch is on, or that have none.

    Raises:
        InputError: a switch is neither on nor off.
    """
    return [
        node
        for node in requested
        if node.executable not in _SWITCH_OF_NODE or is_switched_on(context, _SWITCH_OF_NODE[node.executable])
    ]


def is_switched_on(context: LaunchContext, name: str) -> bool:
    """Whether the argument ``name`` is on.

    Raises:
        InputError: its text is neither on nor off.
    """
    text = LaunchConfiguration(name).perform(context)
    if text.lower() not in (*_YES, *_NO):
        raise InputError(f"{name}: '{text}' is refused; accepted: {', '.join((*_YES, *_NO))}")
    return text.lower() in _YES


def number_argument(context: LaunchContext, name: str, kind: type[int] | type[float]) -> float:
    """The value of the argument ``name``.

    Raises:
        InputError: its text is no such number.
    """
    text = LaunchConfiguration(name).perform(context)
    try:
        return kind(text)
    except ValueError:
        accepted = "a whole number" if kind is int else "a number"
        raise InputError(f"{name}: '{text}' is refused; accepted: {accepted}") from None


def _is_switch(name: str) -> bool:
    return _ARGUMENTS[name][0] in ("true", "false")


def _parameter_file(name: str) -> str:
    """The path of this name, or empty. Launch would only warn of a missing file, and start without it."""
    path = Path(name).expanduser()
    if name and not path.is_file():
        raise InputError(f"params_file: '{name}' is not a file; accepted: the path of a ROS parameter file")
    return str(path) if name else ""


def _make_node(node: LaunchedNode, arguments: Mapping[str, str], switches: Mapping[str, bool]) -> Node:
    parameters = {"use_sim_time": switches["use_sim_time"], **node.parameters}
    if node.executable in _NODES_WITH_VEHICLE and arguments["vehicle"]:
        parameters["vehicle"] = arguments["vehicle"]
    files = [arguments["params_file"]] if arguments["params_file"] else []
    receiver = []
    if node.executable == "slip_estimator":
        parameters |= _source_parameters({name for name in _SOURCE_SWITCHES if switches[name]})
        receiver = [str(config_file("gnss.yaml"))] if switches["gnss"] else []
    if node.executable in _NODES_WITH_PREFIX and arguments["namespace"].strip("/"):
        parameters["frame_prefix"] = arguments["namespace"].strip("/") + "/"
    return Node(
        package=node.package,
        executable=node.executable,
        name=node.executable,
        namespace=arguments["namespace"],
        parameters=[*receiver, parameters, *files],
        arguments=[
            "--ros-args",
            "--log-level",
            arguments["log_level"],
            "--enclave",
            _enclave(node, arguments),
        ],
        output="screen",
        **(_respawn_options() if switches["respawn"] else {}),
    )


def _respawn_options() -> dict[str, Any]:
    """Options for a restart; launch restarts a node after any exit code, even after rejected input."""
    return {"respawn": True, "respawn_delay": _RESPAWN_DELAY, "on_exit": _cancel_respawn}


def _cancel_respawn(event: ProcessExited, _context: LaunchContext) -> EmitEvent | None:
    """The event that cancels a respawn within its delay, if the node rejected its input."""
    if event.returncode != ExitCode.BAD_INPUT:
        return None
    return EmitEvent(event=ShutdownProcess(process_matcher=lambda action: action is event.action))


def _enclave(node: LaunchedNode, arguments: Mapping[str, str]) -> str:
    """Enclave of the node's keys in the keystore, as in ``deploy/security/policy.xml``."""
    return "/".join(("", *filter(None, arguments["namespace"].split("/")), node.executable))


def _source_parameters(sensors: set[str]) -> dict[str, Any]:
    """Sources of the slip estimator; without a pose source it starts at the pose in its parameters."""
    if {"laser", "imu"} <= sensors and "gnss" not in sensors:
        return {}  # its own defaults
    poses = [topic for sensor, topic in (("laser", "box_pose"), ("gnss", "gnss_pose")) if sensor in sensors]
    start = {} if poses else {"start": "initial_pose"}
    return {
        "pose_sources": poses or [""],
        "yaw_rate_sources": ["imu/data_raw" if "imu" in sensors else ""],
        **start,
    }
