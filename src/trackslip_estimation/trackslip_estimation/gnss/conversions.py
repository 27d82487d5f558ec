# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Conversions between messages and the localizer's records."""

import math
from typing import Any

import numpy as np

from trackslip_common.make import MessageFactory, header
from trackslip_common.message_fields import NavSatFields
from trackslip_common.message_reading import read
from trackslip_estimation.gnss.localizer import AntennaPosition, Datum, Fix
from trackslip_estimation.slip.conversions import pose_with_covariance
from trackslip_estimation.slip.measurements import UNOBSERVED, PoseFix

_DIAGONAL_COVARIANCE = 2


def fix(message: Any) -> Fix:
    """Return the record of a sensor_msgs/NavSatFix."""
    return Fix(*read(NavSatFields, message))


def pose(make: MessageFactory, antenna: AntennaPosition, topic: str, frame: str) -> Any:
    """Return a geometry_msgs/PoseWithCovarianceStamped of an antenna, with unobserved heading."""
    covariance = np.diag((0.0, 0.0, UNOBSERVED))
    covariance[:2, :2] = antenna.covariance
    position = np.array((antenna.east, antenna.north, 0.0))
    altitude = (0.0, UNOBSERVED) if math.isnan(antenna.up) else (antenna.up, antenna.up_variance)
    return pose_with_covariance(
        make, PoseFix(topic, antenna.stamp_ns, position, covariance, *altitude), frame
    )


def datum(make: MessageFactory, origin: Datum, stamp_ns: int, frame: str) -> Any:
    """Return a sensor_msgs/NavSatFix of the map's origin, which is exact."""
    return make(
        "sensor_msgs/msg/NavSatFix",
        header=header(make, stamp_ns, frame),
        status=make("sensor_msgs/msg/NavSatStatus", status=0, service=0),
        latitude=origin.latitude,
        longitude=origin.longitude,
        altitude=origin.altitude,
        position_covariance=np.zeros(9),
        position_covariance_type=_DIAGONAL_COVARIANCE,
    )
