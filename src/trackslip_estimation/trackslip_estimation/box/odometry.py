# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Odometry of base_link at the time of a scan."""

from collections import deque
from enum import Enum
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.tally import Tally
from trackslip_estimation.covariance import is_covariance

SPACING_NS = 50_000_000  # least time between two odometries in the buffer
BUFFER_SIZE = 60  # 3 s, for scans delayed by the serial line
LONGEST_OFFSET_NS = 1_000_000_000  # longest time between a scan and its odometry


class OdometryReason(Enum):
    """Why an odometry is rejected."""

    MALFORMED = "malformed"


class Odometry(NamedTuple):
    """Position (2,) of base_link in map, m; its covariance (2, 2), m²."""

    stamp_ns: int
    position: FloatArray
    covariance: FloatArray


class OdometryBuffer:
    """Buffer of the latest odometries; malformed ones are counted."""

    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._latest: deque[Odometry] = deque(maxlen=BUFFER_SIZE)

    def add(self, odometry: Odometry) -> None:
        """Append one ``SPACING_NS`` or more after the last; clear the buffer first if time went back 1 s."""
        if not np.isfinite(odometry.position).all() or not is_covariance(odometry.covariance):
            self._tally.add("odometry", OdometryReason.MALFORMED)
            return
        since_ns = odometry.stamp_ns - self._latest[-1].stamp_ns if self._latest else SPACING_NS
        if since_ns < -LONGEST_OFFSET_NS:
            self._latest.clear()
        elif since_ns < SPACING_NS:
            return
        self._latest.append(odometry)

    def find_nearest(self, stamp_ns: int) -> Odometry | None:
        """Return the odometry nearest in time; None if none is within ``LONGEST_OFFSET_NS``."""
        nearest = min(self._latest, key=lambda odometry: abs(odometry.stamp_ns - stamp_ns), default=None)
        if nearest is None or abs(nearest.stamp_ns - stamp_ns) > LONGEST_OFFSET_NS:
            return None
        return nearest
