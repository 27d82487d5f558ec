# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the launch files share: their arguments, and what each means for a node."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext
from trackslip_common.config_files import config_file

_COMMON = {
    "vehicle": ("", "a name of config/vehicles, or a file (empty: pc05 is assumed)"),
    "params_file": ("", "ROS parameter file over the defaults of config/ and all other arguments"),
    "namespace": ("", "of all nodes and their topics, and before the frames odom and base_link"),
    "use_sim_time": ("false", "time from /clock, as a replay publishes it"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
    "respawn": ("false", "start a node that ended anew"),
    "laser": ("true", "scanner and box on the machine"),
    "imu": ("true", "inertial unit"),
    "hydraulics": ("true", "pressures: forces and soil"),
    "gnss": ("false", "satellite receiver"),
    "live": ("false", "serve the live page, at http://127.0.0.1:5006/ unless params_file says otherwise"),
}
_RANGE, _PEERS = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"), ("ROS_STATIC_PEERS", "")
_PROFILES = {  # of Fast DDS 2 and 3, each by a variable of its own
    "FASTRTPS_DEFAULT_PROFILES_FILE": "fastrtps.xml",
    "FASTDDS_DEFAULT_PROFILES_FILE": "fastdds.xml",
}
_OF_SWITCH = {
    "sick_pls": "laser",
    "box_localizer": "laser",
    "watson_imu": "imu",
    "soil_estimator": "hydraulics",
    "nmea_gnss": "gnss",
    "gnss_localizer": "gnss",
    "live": "live",
}
_WITH_PREFIX = ("slip_estimator", "soil_estimator")
_WITH_VEHICLE = ("slip_estimator", "soil_estimator", "box_localizer", "can_driver", "emulator")


class Launched(NamedTuple):
    """One node to launch, with parameters beside those that the arguments give."""

    package: str
    executable: str
    parameters: Mapping[str, Any] = {}


def declared(**own: tuple[str, str]) -> list[DeclareLaunchArgument | SetEnvironmentVariable]:
    """Arguments of every launch file, its ``own``: name=(default, description), and who may look in."""
    arguments = {**_COMMON, **own}
    return [
        *(
            DeclareLaunchArgument(name, default_value=default, description=about)
            for name, (default, about) in arguments.items()
        ),
        *_discovery(),
    ]


def _discovery() -> list[DeclareLaunchArgument | SetEnvironmentVariable]:
    """This computer alone hears the graph, and the peers that are named; what is set already stays.

    Fast DDS gets our profile, which tells why.
    """
    about = "addresses of further computers, such as an operator's laptop, parted by ;"
    set_range, set_peers = (
        EnvironmentVariable(name, default_value=default) for name, default in (_RANGE, _PEERS)
    )
    return [
        DeclareLaunchArgument("peers", default_value=set_peers, description=about),
        SetEnvironmentVariable(_RANGE[0], set_range),
        SetEnvironmentVariable(_PEERS[0], LaunchConfiguration("peers")),
        *(
            SetEnvironmentVariable(name, EnvironmentVariable(name, default_value=str(config_file(file))))
            for name, file in _PROFILES.items()
        ),
    ]


def nodes(context: LaunchContext, wanted: Iterable[Launched]) -> list[Node]:
    """Those of ``wanted`` that the switches say."""
    given = {name: LaunchConfiguration(name).perform(context) for name in _COMMON}
    switched_on = {name for name in _OF_SWITCH.values() if is_true(given[name])}
    return [
        _node(one, given, switched_on)
        for one in wanted
        if one.executable not in _OF_SWITCH or _OF_SWITCH[one.executable] in switched_on
    ]


def _node(one: Launched, given: Mapping[str, str], sensors: set[str]) -> Node:
    parameters = {"use_sim_time": is_true(given["use_sim_time"]), **one.parameters}
    if one.executable in _WITH_VEHICLE and given["vehicle"]:
        parameters["vehicle"] = given["vehicle"]
    files = [given["params_file"]] if given["params_file"] else []
    receiver = []
    if one.executable == "slip_estimator":
        parameters |= _sources(sensors)
        receiver = [str(config_file("gnss.yaml"))] if "gnss" in sensors else []
    if one.executable in _WITH_PREFIX and given["namespace"]:
        parameters["frame_prefix"] = given["namespace"].strip("/") + "/"
    return Node(
        package=one.package,
        executable=one.executable,
        name=one.executable,
        namespace=given["namespace"],
        parameters=[*receiver, parameters, *files],
        arguments=["--ros-args", "--log-level", given["log_level"], "--enclave", _enclave(one, given)],
        respawn=is_true(given["respawn"]),
        output="screen",
    )


def _enclave(one: Launched, given: Mapping[str, str]) -> str:
    """Where its keys are in the keystore, if there is one: as ``deploy/security/policy.xml`` names it."""
    return "/".join(("", *filter(None, given["namespace"].split("/")), one.executable))


def _sources(sensors: set[str]) -> dict[str, Any]:
    """What the slip estimator listens to; without any pose it starts where its parameters say."""
    if {"laser", "imu"} <= sensors and "gnss" not in sensors:
        return {}  # its own defaults
    poses = [topic for sensor, topic in (("laser", "box_pose"), ("gnss", "gnss_pose")) if sensor in sensors]
    start = {} if poses else {"start": "initial_pose"}
    return {
        "pose_sources": poses or [""],
        "yaw_rate_sources": ["imu/data_raw" if "imu" in sensors else ""],
        **start,
    }


def is_true(text: str) -> bool:
    """Whether the text of an argument says yes."""
    return text.lower() in ("true", "1", "yes", "on")
