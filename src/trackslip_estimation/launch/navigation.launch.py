# SPDX-License-Identifier: Apache-2.0
"""Box localizer, slip and soil estimators, and recorder."""

from launch.actions import OpaqueFunction

from launch import LaunchDescription
from trackslip_common.nodes.launching import Launched, declared, nodes

PACKAGE = "trackslip_estimation"
EXECUTABLES = ("box_localizer", "slip_estimator", "soil_estimator", "record")


def generate_launch_description() -> LaunchDescription:
    """Defaults are the nodes' own; ``params_file`` goes over them."""
    wanted = [Launched(PACKAGE, name) for name in EXECUTABLES]
    return LaunchDescription([*declared(), OpaqueFunction(function=nodes, args=[wanted])])
