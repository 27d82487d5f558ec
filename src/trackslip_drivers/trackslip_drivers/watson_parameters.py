# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the node ``watson_imu`` (values: ``config/watson_imu.yaml``)."""

from dataclasses import dataclass

from trackslip_common.parameters import parameter
from trackslip_drivers.serial_parameters import SerialParameters


@dataclass(frozen=True, kw_only=True)
class WatsonParameters(SerialParameters):
    """Port, output that the unit is set to, and noise."""

    frame_id: str = parameter("frame of the unit: x forward, y left, z up")
    channels: tuple[str, ...] = parameter("the unit's labels of its channels, in the order sent")
    formats: tuple[str, ...] = parameter("format of each channel in a decimal line at zero, such as +00.0")
    full_scales: tuple[float, ...] = parameter(
        "full scale of each channel in the unit's own units (g, °/s, mG, °, km/h, V)", gt=0.0
    )
    linear_acceleration_stddev: float = parameter("noise per axis; 0: unknown", unit="m/s²", ge=0.0)
    angular_velocity_stddev: float = parameter("noise per axis; 0: unknown", unit="rad/s", ge=0.0)
    magnetic_field_stddev: float = parameter("noise per axis; 0: unknown", unit="T", ge=0.0)
