# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node ``can_driver`` (values: ``config/can_driver.yaml``)."""

from dataclasses import dataclass

from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class CanDriverParameters(Parameters):
    """Bus, contract, and how counts become motion."""

    can_interface: str = parameter(
        "python-can interface", choices=("socketcan", "udp_multicast", "virtual", "slcan", "socketcand")
    )
    can_channel: str = parameter("device or multicast address, as the interface names it")
    can_port: int = parameter("UDP port, for udp_multicast only", ge=1024, le=65535)
    dbc_file: str = parameter("contract of the frames; a path, or a name in config/")
    time_offset: float = parameter("added to the stamp of every frame", unit="s")
    belt_ratio: float = parameter("encoder turns per sprocket turn", gt=0.0)
    max_sprocket_speed: float = parameter("a reading that moved faster is refused", unit="rad/s", gt=0.0)
    velocity_window: int = parameter("readings in the velocity fit", ge=2, le=50)
    spool_timeout: float = parameter("oldest spool position to go with a pressure", unit="s", gt=0.0)
