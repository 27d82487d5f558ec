# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Launches the drivers: CAN, Watson IMU, SICK PLS; with ``gnss:=true`` also a GNSS receiver."""

from launch.actions import OpaqueFunction

from launch import LaunchDescription
from trackslip_common.nodes.launching import LaunchedNode, declare_arguments, make_nodes

PACKAGE = "trackslip_drivers"
EXECUTABLES = ("can_driver", "watson_imu", "sick_pls", "nmea_gnss")


def generate_launch_description() -> LaunchDescription:
    """The launch description; ``params_file`` overrides the nodes' own defaults."""
    requested = [LaunchedNode(PACKAGE, name) for name in EXECUTABLES]
    return LaunchDescription(
        [*declare_arguments(EXECUTABLES), OpaqueFunction(function=make_nodes, args=[requested])]
    )
