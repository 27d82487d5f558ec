# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The newest record of each topic while it is fresh, and what is shown of them: columns, texts, outlines."""

import math
from contextlib import suppress
from typing import Any

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import printable
from trackslip_common.message_fields import PoseFields
from trackslip_common.message_reading import read
from trackslip_common.orientations import heading_text, tilt_of
from trackslip_common.topics import ATTITUDE, FORCES, ODOMETRY, SOIL, TRACK_SLIP
from trackslip_common.vehicle import VehicleParameters
from trackslip_tools.live import inputs
from trackslip_tools.live.strips import MOTION
from trackslip_tools.report.panel import SIGMAS
from trackslip_tools.report.plan_shapes import (
    box_outline,
    ellipses,
    machine_size,
    rectangle,
    transform_points,
)
from trackslip_tools.report.quantities import Columns, classes_of

STANDING = 1  # motion_state of TrackSlip
_MAX_AGE_S = 1.0
_MAX_AGE_OF_TOPIC_S = {SOIL: 5.0, FORCES: 1.5, inputs.BOX_POSE: 1.5}  # s, of slower topics

_MOTION_TEXTS = {1: "standing", 2: "straight", 3: "turning"}  # by motion_state
_UNKNOWN = "–"
FACT_NAMES = ("position", "heading", "motion", "speed", "roll", "pitch", "swing", "soil_reason")
OUTLINE_NAMES = ("ellipse", "machine", "nose", "upper", "box")


class Snapshot:
    """The newest record of each topic; times are seconds of one monotonic clock."""

    def __init__(self) -> None:
        self._records: dict[str, tuple[Any, float]] = {}
        self.keeps_last = False  # whether records stay fresh for ever, at the end of a bag
        self.classes: dict[str, float] = {}  # soil → probability
        self.reason = ""  # why the soil cannot be identified

    def process(self, topic: str, message: Any, now_s: float) -> Any:
        """Store and return the record of a message of one of ``inputs.RECORDS``, or of a pose.

        Raises:
            Exception: the message is not of the topic's type.
        """
        record = read(inputs.RECORDS.get(topic, PoseFields), message)
        if topic in inputs.TYPES:  # other pose sources are drawn only as fixes
            self._records[topic] = (record, now_s)
        if topic == SOIL:
            self.classes, self.reason = classes_of(message), str(message.reason)
        return record

    def get(self, topic: str, now_s: float) -> Any | None:
        """The record of a topic; None if missing or too old."""
        record, at_s = self._records.get(topic, (None, -np.inf))
        is_fresh = now_s - at_s <= _MAX_AGE_OF_TOPIC_S.get(topic, _MAX_AGE_S)
        return record if is_fresh or self.keeps_last else None

    def columns(self, now_s: float) -> dict[str, Columns]:
        """Topic (or ``MOTION``) → columns for the panels, of fresh records."""
        columns: dict[str, Columns] = {
            topic: record._asdict()
            for topic in (FORCES, SOIL)
            if (record := self.get(topic, now_s)) is not None
        }
        motion = self._motion_columns(now_s)
        return columns | ({MOTION: motion} if motion is not None else {})

    def _motion_columns(self, now_s: float) -> Columns | None:
        """Columns of twist and slips as in the report; slips are nan at standstill."""
        odometry, slip = self.get(ODOMETRY, now_s), self.get(TRACK_SLIP, now_s)
        if odometry is None:
            return None
        columns = {
            "twist": np.array((odometry.v_x, odometry.v_y, odometry.yaw_rate)),
            "twist_covariance": odometry.twist_covariance,
            "slips": np.full(3, np.nan),
            "slip_covariance": np.full((3, 3), np.nan),
        }
        if slip is not None and slip.motion_state != STANDING:
            columns["slips"] = np.array((slip.left_slip, slip.right_slip, slip.slip_angle))
            columns["slip_covariance"] = slip.covariance
        return columns


def facts_of(now: Snapshot, now_s: float) -> dict[str, str]:
    """Name of ``FACT_NAMES`` → text; a dash if unknown."""
    facts = dict.fromkeys(FACT_NAMES, _UNKNOWN)
    facts["soil_reason"] = printable(now.reason)
    odometry, slip = now.get(ODOMETRY, now_s), now.get(TRACK_SLIP, now_s)
    if odometry is not None:
        x, y, heading = inputs.pose_of(odometry)
        radius = SIGMAS * math.sqrt(max(float(np.max(_eigenvalues(odometry.covariance[:2, :2]))), 0.0))
        facts["position"] = f"{x:.2f}, {y:.2f} m ± {radius:.{2 if radius >= 0.1 else 3}f}"
        facts["heading"] = heading_text(heading, float(odometry.covariance[2, 2]), SIGMAS)
        facts["speed"] = f"{odometry.v_x:.2f} m/s"
    if slip is not None:
        facts["motion"] = _MOTION_TEXTS.get(slip.motion_state, "no motion known")
    attitude = now.get(ATTITUDE, now_s)
    if attitude is not None and attitude.covariance[0] >= 0.0:
        sigmas = SIGMAS * np.sqrt(attitude.covariance)
        for name, angle, sigma in zip(("roll", "pitch"), tilt_of(attitude), sigmas, strict=True):
            facts[name] = f"{math.degrees(angle):.1f}° ± {math.degrees(float(sigma)):.1f}"
    swing = now.get(inputs.SWING, now_s)
    if swing is not None and math.isfinite(swing.angle):
        facts["swing"] = f"{math.degrees(math.remainder(swing.angle, 2.0 * math.pi)):.1f}°"
    return facts


def _eigenvalues(covariance: np.ndarray) -> np.ndarray:
    with np.errstate(all="ignore"):
        eigenvalues = np.linalg.eigvalsh(covariance) if np.isfinite(covariance).all() else np.zeros(1)
    return np.asarray(eigenvalues)


def outlines_of(now: Snapshot, now_s: float, vehicle: VehicleParameters) -> dict[str, FloatArray]:
    """Name of ``OUTLINE_NAMES`` → (n, 2) outline; no points if unknown."""
    outlines = dict.fromkeys(OUTLINE_NAMES, np.empty((0, 2)))
    odometry = now.get(ODOMETRY, now_s)
    if odometry is not None:
        pose = inputs.pose_of(odometry)
        length, width = machine_size(vehicle)
        outlines["machine"] = rectangle(pose, (length, width), (0.0, 0.0))
        outlines["nose"] = transform_points(pose, np.array(((0.0, 0.0), (0.9 * length, 0.0))))
        with suppress(np.linalg.LinAlgError):  # invalid covariance
            outlines["ellipse"] = ellipses(pose[np.newaxis, :2], odometry.covariance[np.newaxis, :2, :2])[0]
        swing = now.get(inputs.SWING, now_s)
        if swing is not None:
            outlines["upper"] = _upper_structure_line(pose, swing.angle, vehicle)
    fix, sensors = now.get(inputs.BOX_POSE, now_s), vehicle.sensors
    if fix is not None and sensors is not None and sensors.box is not None:
        outlines["box"] = box_outline(sensors.box, inputs.pose_of(fix))
    return outlines


def _upper_structure_line(pose: FloatArray, angle: float, vehicle: VehicleParameters) -> FloatArray:
    """(2, 2) line from the swing axis in the direction of the upper structure."""
    upper = vehicle.upper_structure
    axis = np.array((upper.swing_axis_x, upper.swing_axis_y)) if upper is not None else np.zeros(2)
    reach = vehicle.kinematics.contact_length * np.array((np.cos(angle), np.sin(angle)))
    return transform_points(pose, np.array((axis, axis + reach)))
