# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes of the demo and their parameters, shared by the demo and ``demo.launch.py``."""

from dataclasses import dataclass, field
from pathlib import Path

from trackslip_common.config_files import node_defaults
from trackslip_sim.devices.nmea_device import RECEIVER_RATE

EXECUTABLES = (  # of all nodes that a demo can have
    *("emulator", "can_driver", "watson_imu", "sick_pls", "nmea_gnss", "box_localizer", "gnss_localizer"),
    *("slip_estimator", "soil_estimator", "record", "live"),
)
_CAN = {"can_interface": "udp_multicast", "can_channel": "239.74.163.2"}


@dataclass(frozen=True)
class NodeSpec:
    """One executable with its parameters."""

    package: str
    executable: str
    parameters: dict[str, object] = field(default_factory=dict)
    is_needed: bool = True  # whether the demo ends when this node ends


LIVE_NODE = NodeSpec("trackslip_tools", "live", is_needed=False)


@dataclass(frozen=True)
class DemoOptions:
    """Options of a demo."""

    devices: Path  # directory of the emulated serial ports
    bag: Path  # output of the recorder; must not exist
    can_port: int
    duration: float  # s of driving
    soil: str
    scenario: str
    vehicle: str  # a name of config/vehicles, or a file
    autostart: bool  # of the emulator; False: the demo activates it
    laser: bool = True  # the scanner at the site, and the box on the machine
    gnss: bool = False  # a GNSS receiver with two antennas


def demo_nodes(options: DemoOptions) -> list[NodeSpec]:
    """Emulator, drivers, estimators and recorder; poses from laser, GNSS, or both."""
    can = {**_CAN, "can_port": options.can_port}
    vehicle: dict[str, object] = {"vehicle": options.vehicle}
    emulator = {
        **vehicle,
        **can,
        "autostart": options.autostart,
        "device_directory": str(options.devices),
        "duration": options.duration,
        "soil": options.soil,
        "scenario": options.scenario,
        "gnss.device.rate": RECEIVER_RATE if options.gnss else 0.0,
    }
    estimator = {**vehicle, **node_defaults("slip_estimator", "gnss.yaml")} if options.gnss else vehicle
    if options.gnss and options.laser:
        estimator = {**estimator, "pose_sources": ["box_pose", "gnss_pose"]}
    return [
        NodeSpec("trackslip_sim", "emulator", emulator),
        NodeSpec("trackslip_drivers", "can_driver", {**can, **vehicle}),
        NodeSpec("trackslip_drivers", "watson_imu", {"serial_port": str(options.devices / "watson")}),
        *(_laser_nodes(options, vehicle) if options.laser else ()),
        *(_receiver_nodes(options) if options.gnss else ()),
        NodeSpec("trackslip_estimation", "slip_estimator", estimator),
        NodeSpec("trackslip_estimation", "soil_estimator", vehicle),
        NodeSpec("trackslip_estimation", "record", {"output": str(options.bag)}),
    ]


def _laser_nodes(options: DemoOptions, vehicle: dict[str, object]) -> list[NodeSpec]:
    return [
        NodeSpec("trackslip_drivers", "sick_pls", {"serial_port": str(options.devices / "sick")}),
        NodeSpec("trackslip_estimation", "box_localizer", vehicle),
    ]


def _receiver_nodes(options: DemoOptions) -> list[NodeSpec]:
    """Nodes of the GNSS receiver; the map's origin is that of the emulated site, as for the truth."""
    site = node_defaults("emulator", "emulator.yaml")
    datum = {f"datum_{name}": site[f"gnss.{name}"] for name in ("latitude", "longitude", "altitude")}
    return [
        NodeSpec("trackslip_drivers", "nmea_gnss", {"serial_port": str(options.devices / "gnss")}),
        NodeSpec("trackslip_estimation", "gnss_localizer", datum),
    ]
