# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node ``watson_imu`` (values: ``config/watson_imu.yaml``)."""

from dataclasses import dataclass

from trackslip_common.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class WatsonParameters(Parameters):
    """Port, output that the unit is set to, and noise."""

    serial_port: str = parameter("device path or pyserial URL")
    serial_baud: int = parameter("line rate", unit="baud", gt=0)
    parity: str = parameter("parity of the line: N none, E even, O odd", choices=("N", "E", "O"))
    frame_id: str = parameter("frame of the unit: x forward, y left, z up")
    time_offset: float = parameter("added to the stamp of every line", unit="s")
    channels: tuple[str, ...] = parameter("the unit's labels of its channels, in the order sent")
    formats: tuple[str, ...] = parameter("format of each channel in a decimal line at zero, such as +00.0")
    full_scales: tuple[float, ...] = parameter(
        "full scale of each channel in the unit's own units (g, °/s, mG, °, km/h, V)", gt=0.0
    )
    linear_acceleration_stddev: float = parameter("noise per axis; 0: unknown", unit="m/s²", ge=0.0)
    angular_velocity_stddev: float = parameter("noise per axis; 0: unknown", unit="rad/s", ge=0.0)
    magnetic_field_stddev: float = parameter("noise per axis; 0: unknown", unit="T", ge=0.0)
