# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the emulator (``config/emulator.yaml``, with the site and the vehicle)."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from trackslip_common.config_files import load_parameters
from trackslip_common.parameters import parameter
from trackslip_common.vehicle_files import ParametersWithVehicle
from trackslip_sim.devices.sick_device import SickDeviceParameters
from trackslip_sim.machine.emulation import BODY_FRAME
from trackslip_sim.machine.gnss_model import GnssParameters
from trackslip_sim.machine.scan_model import SiteParameters
from trackslip_sim.machine.sensors import SensorNoise

NODE = "emulator"
DEFAULT_FILES = ("site.yaml", "emulator.yaml")


@dataclass(frozen=True, kw_only=True)
class EmulatorParameters(ParametersWithVehicle):
    """One emulated drive."""

    site: SiteParameters
    noise: SensorNoise
    sick_start: SickDeviceParameters
    gnss: GnssParameters
    scenario: str = parameter("name in config/scenarios, or a file")
    soil: str = parameter("name in config/soils.yaml; empty: the scenario's own")
    terrain: str = parameter("name in config/terrains, or a file; empty: the scenario's own")
    mode: str = parameter("truth model", choices=("shear", "thesis"))
    duration: float = parameter(
        "of the drive, the scenario cut or repeated; 0: unchanged", unit="s", ge=0.0, le=3600.0
    )
    seed: int = parameter("seed of all noise", ge=0)
    lead_in: float = parameter("standstill after power-on", unit="s", ge=0.0)
    can_delay: float = parameter("from power-on to the first CAN frame", unit="s", ge=0.0)
    start_after: tuple[str, ...] = parameter(
        "nodes that must be active before the machine is switched on; '': none"
    )
    frame_prefix: str = parameter("prefix of base_link, such as 'one/' with several machines")
    device_directory: str = parameter("directory of the serial ports")
    can_interface: str = parameter("python-can interface")
    can_channel: str = parameter("device or multicast address")
    can_port: int = parameter("UDP port, for udp_multicast only", ge=1024, le=65535)

    def body_frame(self) -> str:
        """Name of the machine's body frame: base_link with its prefix."""
        return self.frame_prefix + BODY_FRAME

    def mounted_gnss(self) -> GnssParameters:
        """The receiver's parameters with the antenna position of the vehicle."""
        antenna = self.vehicle.sensors.antenna if self.vehicle.sensors is not None else None
        if antenna is None:
            return self.gnss
        return replace(self.gnss, antenna_x=antenna.x, antenna_y=antenna.y, antenna_z=antenna.z)


def load_emulator_parameters(values: Mapping[str, Any]) -> EmulatorParameters:
    """The defaults of ``config/``, replaced by the dotted names in ``values``.

    Raises:
        InputError: a name is unknown or a value refused.
    """
    return load_parameters(EmulatorParameters, NODE, DEFAULT_FILES, values)
