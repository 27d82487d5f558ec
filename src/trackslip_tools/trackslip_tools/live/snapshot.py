# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The newest record of each topic while it is fresh, and the columns for the panels."""

from typing import Any

import numpy as np

from trackslip_common.message_fields import PoseFields
from trackslip_common.message_reading import read
from trackslip_common.topics import FORCES, ODOMETRY, SOIL, TRACK_SLIP
from trackslip_tools.live import inputs
from trackslip_tools.live.strips import MOTION
from trackslip_tools.report.quantities import Columns, classes_of

STANDING = 1  # motion_state of TrackSlip
_MAX_AGE_S = 1.0
_MAX_AGE_OF_TOPIC_S = {SOIL: 5.0, FORCES: 1.5, inputs.BOX_POSE: 1.5}  # s, of slower topics


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
