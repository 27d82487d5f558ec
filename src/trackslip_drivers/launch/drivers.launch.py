# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The drivers: CAN, Watson IMU, SICK PLS; with ``gnss:=true`` a GNSS receiver too."""

from launch.actions import OpaqueFunction

from launch import LaunchDescription
from trackslip_common.nodes.launching import Launched, declared, nodes

PACKAGE = "trackslip_drivers"
EXECUTABLES = ("can_driver", "watson_imu", "sick_pls", "nmea_gnss")


def generate_launch_description() -> LaunchDescription:
    """Defaults are the nodes' own; ``params_file`` goes over them."""
    requested = [Launched(PACKAGE, name) for name in EXECUTABLES]
    return LaunchDescription([*declared(EXECUTABLES), OpaqueFunction(function=nodes, args=[requested])])
