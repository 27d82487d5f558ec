# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Stalled or stuck tracks, and the longest time without fixes, for the summary of a run."""

import numpy as np

from trackslip_common.arrays import FloatArray, Rows
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.records import POSE
from trackslip_estimation.soil.stall import TrackCondition
from trackslip_tools.report.state_intervals import StateInterval, state_intervals

SIDES = ("left", "right")
TROUBLE_TEXTS = {TrackCondition.STALLED: "stalled", TrackCondition.STUCK: "getting stuck"}
_LEAST_S = 0.5  # shortest listed trouble, s


def stuck_track_intervals(times: FloatArray, forces: Rows) -> dict[str, list[StateInterval]]:
    """Side → intervals in which its track was stalled or stuck; ``times`` (n,) of the forces, s."""
    return {
        side: [
            interval
            for interval in state_intervals(times, forces["trouble"][:, k])
            if interval.state != TrackCondition.NONE
        ]
        for k, side in enumerate(SIDES)
    }


def stuck_track_lines(forces: Rows, start_ns: int) -> list[str]:
    """A line for each interval in which a track stalled or got stuck, in s from the bag's first message."""
    return [
        f"{side} track {TROUBLE_TEXTS[TrackCondition(state)]} for {stop - start:.1f} s, "
        f"from {start:.1f} to {stop:.1f} s"
        for side, intervals in stuck_track_intervals((forces["stamp_ns"] - start_ns) * 1e-9, forces).items()
        for start, stop, state, _ in intervals
        if stop - start >= _LEAST_S
    ]


class FixGaps:
    """Finds the longest time without an accepted fix, over the parts of a replay."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._longest_ns: tuple[int, int] | None = None

    def add(self, arrivals: Rows, results: Rows) -> None:
        """Add a part."""
        accepted = (arrivals["kind"] == POSE) & (results["outcome"] == Outcome.ACCEPTED)
        for stamp_ns in np.sort(results["stamp_ns"][accepted]).tolist():
            self._end_gap(stamp_ns)

    def longest_gap(self, stop_ns: int, start_ns: int) -> tuple[float, float] | None:
        """Begin and end of the longest gap, s from ``start_ns``; it may end at ``stop_ns``. None: no fix."""
        if self._longest_ns is None:
            return None
        self._end_gap(stop_ns)
        begin, end = self._longest_ns
        return (begin - start_ns) * 1e-9, (end - start_ns) * 1e-9

    def _end_gap(self, stamp_ns: int) -> None:
        last_ns = stamp_ns if self._last_ns is None else self._last_ns
        begin, end = self._longest_ns or (last_ns, last_ns)
        self._longest_ns = (last_ns, stamp_ns) if stamp_ns - last_ns > end - begin else (begin, end)
        self._last_ns = max(last_ns, stamp_ns)
