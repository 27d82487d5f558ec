# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node ``can_driver`` (values: ``config/can_driver.yaml``)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trackslip_common.errors import InputError
from trackslip_common.parameters import parameter
from trackslip_common.vehicle_files import ParametersWithVehicle
from trackslip_common.yaml_text import parse_yaml

NODE = "can_driver"
DEFAULT_FILES = ("can_driver.yaml",)

_OVER_NETWORK = ("udp_multicast", "socketcand")  # python-can's interfaces with a port
_INTERFACES = (
    *("socketcan", "udp_multicast", "virtual", "slcan", "socketcand", "pcan", "kvaser", "vector", "ixxat"),
    *("serial", "gs_usb", "cantact", "canalystii", "etas", "iscan", "neousys", "neovi", "nican", "nixnet"),
    *("robotell", "seeedstudio", "systec", "usb2can"),
)


@dataclass(frozen=True, kw_only=True)
class CanDriverParameters(ParametersWithVehicle):
    """Bus, frames, roles of their signals, and conversion to motion."""

    can_interface: str = parameter("python-can interface", choices=_INTERFACES)
    can_channel: str = parameter("device or multicast address, as the interface names it")
    can_port: int = parameter("UDP port of udp_multicast, TCP port of socketcand", ge=1024, le=65535)
    can_host: str = parameter("host of socketcand; empty: none")
    can_bitrate: int = parameter("bit rate that python-can sets; 0: as it is", unit="bit/s", ge=0)
    can_options: tuple[str, ...] = parameter("further settings of python-can, NAME=VALUE each; '' is ignored")
    frame_prefix: str = parameter("prefix of base_link, such as 'one/' with several machines")
    dbc_file: str = parameter("DBC file of the frames; a path, or a name in config/")
    roles_file: str = parameter("file with the roles of the signals; a path, or a name in config/")
    canopen_start: bool = parameter("whether CANopen nodes that wait for a start are started")
    time_offset: float = parameter("added to the stamp of every frame", unit="s")
    max_sprocket_speed: float = parameter("faster readings are rejected", unit="rad/s", gt=0.0)
    velocity_window: int = parameter("readings in the velocity fit", ge=2, le=50)
    pairing_timeout: float = parameter("greatest age of a value used with other frames", unit="s", gt=0.0)

    def bus_options(self) -> Mapping[str, Any]:
        """Arguments of python-can's ``Bus`` beside interface and channel.

        Raises:
            InputError: an option is not of the form NAME=VALUE.
        """
        options: dict[str, Any] = {}
        if self.can_interface in _OVER_NETWORK:
            options["port"] = self.can_port
        if self.can_host:
            options["host"] = self.can_host
        if self.can_bitrate:
            options["bitrate"] = self.can_bitrate
        for text in filter(None, self.can_options):
            name, equals, value = text.partition("=")
            if not equals or not name.isidentifier():
                raise InputError(
                    f"{NODE}: can_options: '{text}'; accepted: NAME=VALUE, as python-can names it"
                )
            options[name] = parse_yaml(value, f"{NODE}: can_options: {name}")
        return options
