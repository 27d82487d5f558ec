# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Every topic of the project: its type and how it travels. The one place for these facts."""

from dataclasses import dataclass
from enum import Enum


class Flow(Enum):
    """How messages of a topic are delivered."""

    SENSOR = "sensor"  # a subscriber may do with best effort: a late reading is worth less than the next
    RELIABLE = "reliable"  # every message, in order
    LATCHED = "latched"  # reliable, and the last one is kept for later subscribers


@dataclass(frozen=True)
class Topic:
    """A topic's message type and flow."""

    type_name: str
    flow: Flow
    others: tuple[str, ...] = ()  # types that it may have instead


TOPICS = {
    "sprockets": Topic("sensor_msgs/msg/JointState", Flow.SENSOR),
    "hydraulics": Topic("trackslip_msgs/msg/TrackHydraulics", Flow.SENSOR),
    "swing": Topic("sensor_msgs/msg/JointState", Flow.SENSOR),
    "imu/data_raw": Topic("sensor_msgs/msg/Imu", Flow.SENSOR),
    "imu/mag": Topic("sensor_msgs/msg/MagneticField", Flow.SENSOR),
    "scan": Topic("sensor_msgs/msg/LaserScan", Flow.SENSOR),
    "fix": Topic("sensor_msgs/msg/NavSatFix", Flow.SENSOR),
    "heading": Topic("sensor_msgs/msg/Imu", Flow.SENSOR, ("geometry_msgs/msg/QuaternionStamped",)),
    "fix_velocity": Topic("geometry_msgs/msg/TwistWithCovarianceStamped", Flow.SENSOR),
    "box_pose": Topic("geometry_msgs/msg/PoseWithCovarianceStamped", Flow.RELIABLE),
    "gnss_pose": Topic("geometry_msgs/msg/PoseWithCovarianceStamped", Flow.RELIABLE),
    "gnss_localizer/datum": Topic("sensor_msgs/msg/NavSatFix", Flow.LATCHED),
    "odometry": Topic("nav_msgs/msg/Odometry", Flow.RELIABLE),
    "odometry/local": Topic("nav_msgs/msg/Odometry", Flow.RELIABLE),
    "attitude": Topic("sensor_msgs/msg/Imu", Flow.RELIABLE),
    "swing/estimate": Topic("sensor_msgs/msg/JointState", Flow.RELIABLE),
    "machine_state": Topic("trackslip_msgs/msg/MachineState", Flow.RELIABLE),
    "track_slip": Topic("trackslip_msgs/msg/TrackSlip", Flow.RELIABLE),
    "track_forces": Topic("trackslip_msgs/msg/TrackForces", Flow.RELIABLE),
    "soil": Topic("trackslip_msgs/msg/SoilEstimate", Flow.RELIABLE),
    "slip_seed": Topic("trackslip_msgs/msg/TrackSlip", Flow.RELIABLE),
    "measurement_reports": Topic("trackslip_msgs/msg/MeasurementReport", Flow.RELIABLE),
    "slip_estimator/set_pose": Topic("geometry_msgs/msg/PoseWithCovarianceStamped", Flow.RELIABLE),
    "slip_estimator/pose_set": Topic("geometry_msgs/msg/PoseWithCovarianceStamped", Flow.RELIABLE),
    "slip_estimator/parameters": Topic("std_msgs/msg/String", Flow.LATCHED),
    "soil_estimator/parameters": Topic("std_msgs/msg/String", Flow.LATCHED),
    "vehicle": Topic("std_msgs/msg/String", Flow.LATCHED),
    "truth/odometry": Topic("nav_msgs/msg/Odometry", Flow.RELIABLE),
    "truth/attitude": Topic("sensor_msgs/msg/Imu", Flow.RELIABLE),
    "truth/track_slip": Topic("trackslip_msgs/msg/TrackSlip", Flow.RELIABLE),
    "truth/track_forces": Topic("trackslip_msgs/msg/TrackForces", Flow.RELIABLE),
    "truth/swing": Topic("sensor_msgs/msg/JointState", Flow.RELIABLE),
    "truth/soil": Topic("trackslip_msgs/msg/SoilEstimate", Flow.RELIABLE),
    "emulator/fault": Topic("std_msgs/msg/String", Flow.RELIABLE),
    "diagnostics": Topic("diagnostic_msgs/msg/DiagnosticArray", Flow.RELIABLE),
    "tf": Topic("tf2_msgs/msg/TFMessage", Flow.RELIABLE),
}

ODOMETRY, LOCAL_ODOMETRY, ATTITUDE = "odometry", "odometry/local", "attitude"
FIX_VELOCITY = "fix_velocity"
TRACK_SLIP, FORCES, SOIL = "track_slip", "track_forces", "soil"
MACHINE_STATE, SWING_ESTIMATE, DIAGNOSTICS = "machine_state", "swing/estimate", "diagnostics"
TRUE_ODOMETRY, TRUE_SLIP, TRUE_SWING = "truth/odometry", "truth/track_slip", "truth/swing"
TRUE_FORCES, TRUE_SOIL = "truth/track_forces", "truth/soil"

COMMANDS = ("slip_estimator/set_pose", "emulator/fault")  # that anybody may give; else one publisher a topic
SENSOR_TOPICS = tuple(name for name, topic in TOPICS.items() if topic.flow is Flow.SENSOR)
LEFT_SPROCKET, RIGHT_SPROCKET = "left_sprocket", "right_sprocket"
SWING_JOINT = "swing"  # of the upper structure against the undercarriage
SWING_STDDEV_JOINT = "swing_stddev"  # in what is estimated: standard deviations of its angle and rate
