# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of the live page, and the fields that it reads."""

from typing import Annotated, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.message_fields import (
    ForceFields,
    OdometryFields,
    PoseFields,
    SlipFields,
    SoilFields,
    SwingFields,
)
from trackslip_common.message_reading import FieldPath, RecordClass
from trackslip_common.orientations import heading_of
from trackslip_common.topics import ATTITUDE, DIAGNOSTICS, FORCES, ODOMETRY, SOIL, TOPICS, TRACK_SLIP

SWING, VEHICLE = "swing", "vehicle"
PARAMETERS = "slip_estimator/parameters"
BOX_POSE = "box_pose"
POSES = (BOX_POSE, "gnss_pose", "reference_pose")  # in addition to the slip estimator's sources
_IMU = "sensor_msgs/msg/Imu"


class AttitudeFields(NamedTuple):
    """Orientation and its covariance in sensor_msgs/Imu."""

    qx: Annotated[float, FieldPath("orientation.x")]
    qy: Annotated[float, FieldPath("orientation.y")]
    qz: Annotated[float, FieldPath("orientation.z")]
    qw: Annotated[float, FieldPath("orientation.w")]
    covariance: Annotated[
        FloatArray, FieldPath("orientation_covariance", (0, 4), (2,))
    ]  # of roll, pitch, rad²


RECORDS: dict[str, RecordClass] = {
    ODOMETRY: OdometryFields,
    TRACK_SLIP: SlipFields,
    FORCES: ForceFields,
    SOIL: SoilFields,
    ATTITUDE: AttitudeFields,
    SWING: SwingFields,
}
"""Record class of each topic; other topics are poses, texts or DiagnosticArrays."""

POSE_TYPE = TOPICS[BOX_POSE].type_name
TYPES = {
    topic: TOPICS[topic].type_name if topic in TOPICS else _IMU
    for topic in (*RECORDS, VEHICLE, PARAMETERS, DIAGNOSTICS)
} | dict.fromkeys(POSES, POSE_TYPE)
"""Message type of each topic that the page always reads."""

LATCHED_TOPICS = (VEHICLE, PARAMETERS)
EVERY_MESSAGE = (DIAGNOSTICS, *LATCHED_TOPICS)  # of other topics only the newest message is needed


def pose_of(record: PoseFields | OdometryFields) -> FloatArray:
    """(3,) x, y, heading."""
    return np.array((record.x, record.y, heading_of(record)))
