# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Time spans of a drive at standstill, straight, or in a turn."""

from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_estimation.slip.motion import Motion
from trackslip_tools.calibration.recording import Recording

LONGEST_GAP = 0.5  # s between readings; the motion within a longer gap is unknown
_MOST_BLOCKS = 10**9  # per recording
_SETTLING = 0.5  # s after a change of motion, in which the ground has not settled


class Span(NamedTuple):
    """A span of time with one kind of motion, s."""

    begin: float
    end: float


def motion_spans(
    recording: Recording, motion: Motion, least: float, settling: float = _SETTLING
) -> list[Span]:
    """Spans of ``motion`` without a gap in the sprockets, cut by ``settling`` at both ends, ≥ ``least`` s."""
    t = recording.sprockets.t
    same = (recording.motion[1:] == motion) & (np.diff(t) <= LONGEST_GAP)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], same, [False])).astype(np.int64)))
    spans = [Span(t[a] + settling, t[b] - settling) for a, b in edges.reshape(-1, 2)]
    return [span for span in spans if span.end - span.begin >= least]


def are_covered(t: FloatArray, begins: FloatArray, ends: FloatArray) -> BoolArray:
    """(n,) whether readings at ``t`` cover each span from start to end without a gap."""
    if not len(t):
        return np.zeros(len(begins), dtype=np.bool_)
    gaps = np.flatnonzero(np.diff(t) > LONGEST_GAP)
    starts, stops = t[np.concatenate(([0], gaps + 1))], t[np.concatenate((gaps, [len(t) - 1]))]
    piece = np.searchsorted(starts, begins, side="right") - 1
    covered: BoolArray = (piece >= 0) & (ends <= stops[piece])
    return covered


def block_numbers(t: FloatArray, length: float, recording: int) -> IntArray:
    """(n,) numbers of the blocks of ``length`` s in which the times of one recording lie."""
    return np.floor(t / length).astype(np.int64) + recording * _MOST_BLOCKS
