# SPDX-License-Identifier: Apache-2.0
"""Which nodes the demo runs, and with which parameters: shared by the demo and by ``demo.launch.py``."""

from dataclasses import dataclass, field
from pathlib import Path

SENSOR_TOPICS = ("sprockets", "hydraulics", "imu/data_raw", "imu/mag", "scan")  # of the emulated machine

_CAN = {"can_interface": "udp_multicast", "can_channel": "239.74.163.2"}


@dataclass(frozen=True)
class NodeSpec:
    """One executable with its parameters."""

    package: str
    executable: str
    parameters: dict[str, object] = field(default_factory=dict)
    is_needed: bool = True  # whether its end is the end of the demo


LIVE = NodeSpec("trackslip_tools", "live", is_needed=False)


@dataclass(frozen=True)
class DemoOptions:
    """What differs from one demo to the next."""

    devices: Path  # where the emulated serial ports appear
    bag: Path  # where the recorder writes; must not exist
    can_port: int
    duration: float  # s of driving
    soil: str
    scenario: str
    vehicle: str  # a name of config/vehicles, or a file
    autostart: bool  # of the emulator: False where somebody else turns the key


def demo_nodes(options: DemoOptions) -> list[NodeSpec]:
    """The emulator, three drivers, the estimators and the recorder."""
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
    }
    return [
        NodeSpec("trackslip_sim", "emulator", emulator),
        NodeSpec("trackslip_drivers", "can_driver", {**can, **vehicle}),
        NodeSpec("trackslip_drivers", "watson_imu", {"serial_port": str(options.devices / "watson")}),
        NodeSpec("trackslip_drivers", "sick_pls", {"serial_port": str(options.devices / "sick")}),
        NodeSpec("trackslip_estimation", "box_localizer", vehicle),
        NodeSpec("trackslip_estimation", "slip_estimator", vehicle),
        NodeSpec("trackslip_estimation", "soil_estimator", vehicle),
        NodeSpec("trackslip_estimation", "record", {"output": str(options.bag)}),
    ]
