# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""All topics of the project: type, delivery and content."""

from dataclasses import dataclass
from enum import Enum


class Flow(Enum):
    """How messages of a topic are delivered."""

    SENSOR = "sensor"  # best effort is enough: a late reading is worth less than the next
    RELIABLE = "reliable"  # every message, in order
    LATCHED = "latched"  # reliable, and the last one is kept for later subscribers


@dataclass(frozen=True)
class Topic:
    """A topic's message type and flow, with publisher, rate, frame and content for its readers."""

    type_name: str
    flow: Flow
    publisher: str
    rate: str
    frame: str  # of the header; for a pose also that of the placed object
    content: str
    others: tuple[str, ...] = ()  # alternative types


TOPICS = {
    "sprockets": Topic(
        "sensor_msgs/msg/JointState",
        Flow.SENSOR,
        "can_driver, wheel_adapter",
        "100 Hz",
        "base_link",
        "`left_sprocket`, `right_sprocket`: position rad (continuous), velocity rad/s",
    ),
    "hydraulics": Topic(
        "trackslip_msgs/msg/TrackHydraulics",
        Flow.SENSOR,
        "can_driver",
        "100 Hz",
        "base_link",
        "differential and supply pressures Pa, spools −1…1",
    ),
    "swing": Topic(
        "sensor_msgs/msg/JointState",
        Flow.SENSOR,
        "can_driver",
        "as sent",
        "base_link",
        "`swing`: angle of the upper structure against the undercarriage rad, rad/s",
    ),
    "imu/data_raw": Topic(
        "sensor_msgs/msg/Imu",
        Flow.SENSOR,
        "watson_imu, or any IMU",
        "12 Hz",
        "imu_link",
        "m/s², rad/s, forward-left-up; no orientation",
    ),
    "imu/mag": Topic(
        "sensor_msgs/msg/MagneticField",
        Flow.SENSOR,
        "watson_imu",
        "12 Hz",
        "imu_link",
        "magnetic field, T",
    ),
    "scan": Topic(
        "sensor_msgs/msg/LaserScan",
        Flow.SENSOR,
        "sick_pls",
        "4 Hz at 38400 Bd",
        "laser",
        "ranges m; the scanner is stationary on the site",
    ),
    "fix": Topic(
        "sensor_msgs/msg/NavSatFix",
        Flow.SENSOR,
        "nmea_gnss, or any receiver",
        "5–20 Hz",
        "gnss_antenna",
        "°, m; [gnss.md](gnss.md)",
    ),
    "heading": Topic(
        "sensor_msgs/msg/Imu",
        Flow.SENSOR,
        "nmea_gnss",
        "per fix",
        "gnss_antenna",
        "orientation about the vertical: east 0, counter-clockwise",
        ("geometry_msgs/msg/QuaternionStamped",),
    ),
    "fix_velocity": Topic(
        "geometry_msgs/msg/TwistWithCovarianceStamped",
        Flow.SENSOR,
        "nmea_gnss, or a radar",
        "5–20 Hz",
        "map",
        "velocity of the antenna over the ground, east and north, m/s; [gnss.md](gnss.md)",
    ),
    "box_pose": Topic(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        Flow.RELIABLE,
        "box_localizer",
        "per scan",
        "map",
        "pose of base_link, m, rad; [box.md](box.md)",
    ),
    "gnss_pose": Topic(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        Flow.RELIABLE,
        "gnss_localizer",
        "per fix",
        "map",
        "antenna, m east and north of the datum",
    ),
    "gnss_localizer/datum": Topic(
        "sensor_msgs/msg/NavSatFix",
        Flow.LATCHED,
        "gnss_localizer",
        "at start",
        "map",
        "origin of the map",
    ),
    "odometry": Topic(
        "nav_msgs/msg/Odometry",
        Flow.RELIABLE,
        "slip_estimator",
        "per sprocket sample",
        "map → base_link",
        "best estimate: pose m, rad; twist m/s, rad/s; covariances",
    ),
    "odometry/local": Topic(
        "nav_msgs/msg/Odometry",
        Flow.RELIABLE,
        "slip_estimator",
        "per sprocket sample",
        "odom → base_link",
        "integral of the estimated twist; it never jumps (REP-105)",
    ),
    "attitude": Topic(
        "sensor_msgs/msg/Imu",
        Flow.RELIABLE,
        "slip_estimator",
        "per sprocket sample",
        "base_link",
        "orientation with covariance, rates without bias, specific force; [slopes.md](slopes.md)",
    ),
    "swing/estimate": Topic(
        "sensor_msgs/msg/JointState",
        Flow.RELIABLE,
        "slip_estimator",
        "per sprocket sample",
        "base_link",
        "`swing`: rad, rad/s; `swing_stddev`: their standard deviations; [swing.md](swing.md)",
    ),
    "machine_state": Topic(
        "trackslip_msgs/msg/MachineState",
        Flow.RELIABLE,
        "slip_estimator",
        "per sprocket sample",
        "map → base_link",
        "pose, twist, slips, attitude and swing of one instant, with covariances; input of the "
        "soil estimator",
    ),
    "track_slip": Topic(
        "trackslip_msgs/msg/TrackSlip",
        Flow.RELIABLE,
        "slip_estimator",
        "per sprocket sample",
        "base_link",
        "slips, slip angle rad, their covariance, motion state",
    ),
    "track_forces": Topic(
        "trackslip_msgs/msg/TrackForces",
        Flow.RELIABLE,
        "soil_estimator",
        "10 Hz",
        "base_link",
        "thrust and resistance of each track N, variances, thrust reserve; [soil.md](soil.md)",
    ),
    "soil": Topic(
        "trackslip_msgs/msg/SoilEstimate",
        Flow.RELIABLE,
        "soil_estimator",
        "1 Hz",
        "base_link",
        "μ_r, mobilised μ_l, K m, F_max N with 5 and 95 % points; identifiable, or the reason; classes",
    ),
    "slip_seed": Topic(
        "trackslip_msgs/msg/TrackSlip",
        Flow.RELIABLE,
        "soil_estimator",
        "once after a turn",
        "base_link",
        "slips in straight motion by thrust and soil; used only where `slip_sources` names it; "
        "[soil.md](soil.md)",
    ),
    "measurement_reports": Topic(
        "trackslip_msgs/msg/MeasurementReport",
        Flow.RELIABLE,
        "slip_estimator",
        "per measurement",
        "–",
        "outcome, normalised innovation squared, gate",
    ),
    "slip_estimator/set_pose": Topic(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        Flow.RELIABLE,
        "you",
        "–",
        "map",
        "pose of base_link; stamp 0 is now",
    ),
    "slip_estimator/pose_set": Topic(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        Flow.RELIABLE,
        "slip_estimator",
        "per pose set",
        "map",
        "repeats `set_pose` for recorders",
    ),
    "slip_estimator/parameters": Topic(
        "std_msgs/msg/String",
        Flow.LATCHED,
        "slip_estimator",
        "at changes",
        "–",
        "parameters of the run and what was learned before it, YAML",
    ),
    "soil_estimator/parameters": Topic(
        "std_msgs/msg/String",
        Flow.LATCHED,
        "soil_estimator",
        "at start",
        "–",
        "parameters of the run, YAML",
    ),
    "vehicle": Topic(
        "std_msgs/msg/String",
        Flow.LATCHED,
        "slip_estimator, emulator",
        "at start",
        "–",
        "the vehicle, YAML",
    ),
    "truth/odometry": Topic(
        "nav_msgs/msg/Odometry",
        Flow.RELIABLE,
        "emulator",
        "100 Hz",
        "map → base_link",
        "true pose and twist; for scoring, no estimator reads the truth",
    ),
    "truth/attitude": Topic(
        "sensor_msgs/msg/Imu",
        Flow.RELIABLE,
        "emulator",
        "100 Hz",
        "base_link",
        "true orientation",
    ),
    "truth/track_slip": Topic(
        "trackslip_msgs/msg/TrackSlip",
        Flow.RELIABLE,
        "emulator",
        "100 Hz",
        "base_link",
        "true slips and slip angle",
    ),
    "truth/track_forces": Topic(
        "trackslip_msgs/msg/TrackForces",
        Flow.RELIABLE,
        "emulator",
        "10 Hz",
        "base_link",
        "true thrust and resistance, N",
    ),
    "truth/swing": Topic(
        "sensor_msgs/msg/JointState",
        Flow.RELIABLE,
        "emulator",
        "100 Hz",
        "base_link",
        "true angle of the upper structure, rad, rad/s",
    ),
    "truth/soil": Topic(
        "trackslip_msgs/msg/SoilEstimate",
        Flow.RELIABLE,
        "emulator",
        "1 Hz",
        "base_link",
        "true μ, K m, F_max N",
    ),
    "emulator/fault": Topic(
        "std_msgs/msg/String",
        Flow.RELIABLE,
        "you",
        "–",
        "–",
        "a fault for the emulator, YAML; [faults.md](faults.md)",
    ),
    "diagnostics": Topic(
        "diagnostic_msgs/msg/DiagnosticArray",
        Flow.RELIABLE,
        "all nodes",
        "1 Hz",
        "–",
        "state, rates, ages, counts of rejections; "
        "[field-guide.md](field-guide.md#diagnostics-meaning-and-remedy)",
    ),
    "tf": Topic(
        "tf2_msgs/msg/TFMessage",
        Flow.RELIABLE,
        "slip_estimator",
        "per sprocket sample",
        "map → odom → base_link",
        "where tf2_msgs is installed and `publish_tf` is true",
    ),
}

ODOMETRY, LOCAL_ODOMETRY, ATTITUDE = "odometry", "odometry/local", "attitude"
FIX_VELOCITY = "fix_velocity"
TRACK_SLIP, FORCES, SOIL = "track_slip", "track_forces", "soil"
MACHINE_STATE, SWING_ESTIMATE, DIAGNOSTICS = "machine_state", "swing/estimate", "diagnostics"
TRUE_ODOMETRY, TRUE_SLIP, TRUE_SWING = "truth/odometry", "truth/track_slip", "truth/swing"
TRUE_FORCES, TRUE_SOIL = "truth/track_forces", "truth/soil"

COMMANDS = ("slip_estimator/set_pose", "emulator/fault")  # any publisher; all other topics have one
SENSOR_TOPICS = tuple(name for name, topic in TOPICS.items() if topic.flow is Flow.SENSOR)
LEFT_SPROCKET, RIGHT_SPROCKET = "left_sprocket", "right_sprocket"
SWING_JOINT = "swing"  # upper structure relative to the undercarriage
SWING_STDDEV_JOINT = "swing_stddev"  # in the estimate: standard deviations of angle and rate
