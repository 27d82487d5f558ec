# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Distance travelled, and time in each state of motion, over the parts of a replay."""

import numpy as np

from trackslip_common.arrays import Rows
from trackslip_estimation.slip.motion import Motion
from trackslip_tools.report.state_intervals import LONGEST_STEP_S


class Travel:
    """Distance of the track-contact centre from estimated speeds, and durations.

    An interval has speed and state of the estimate at its end. Gaps and steps back in time add nothing.
    """

    def __init__(self) -> None:
        self.distance = 0.0  # m
        self.seconds = dict.fromkeys(Motion, 0.0)
        self._last_ns: int | None = None

    def add(self, estimates: Rows) -> None:
        """Add (n,) ESTIMATE in order of publication."""
        if not len(estimates):
            return
        stamps_ns, motion = estimates["stamp_ns"], estimates["motion"]
        before_ns = stamps_ns[0] if self._last_ns is None else self._last_ns
        dt = np.diff(stamps_ns, prepend=before_ns) * 1e-9
        dt[(dt < 0.0) | (dt > LONGEST_STEP_S)] = 0.0
        speeds = np.hypot(*estimates["twist"][:, :2].T)
        self.distance += float((speeds * dt)[motion != Motion.STANDING].sum())
        for state in Motion:
            self.seconds[state] += float(dt[motion == state].sum())
        self._last_ns = int(stamps_ns[-1])
