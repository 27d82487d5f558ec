# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Where in a drive the machine stands, goes straight, or turns, long enough to be of use."""

from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_estimation.slip.motion import Motion
from trackslip_tools.calibration.recording import Recording

LONGEST_GAP = 0.5  # s between readings, beyond which what happened in between is unknown
_MOST_BLOCKS = 10**9  # in one recording
_SETTLING = 0.5  # s at a change of motion, in which the ground still answers


class Span(NamedTuple):
    """A stretch of time with one kind of motion, s."""

    begin: float
    end: float


def spans(recording: Recording, motion: Motion, least: float, settling: float = _SETTLING) -> list[Span]:
    """Stretches of ``motion`` without a gap in the sprockets, ``settling`` s less at both ends."""
    t = recording.sprockets.t
    same = (recording.motion[1:] == motion) & (np.diff(t) <= LONGEST_GAP)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], same, [False])).astype(np.int64)))
    found = [Span(t[a] + settling, t[b] - settling) for a, b in edges.reshape(-1, 2)]
    return [span for span in found if span.end - span.begin >= least]


def unbroken(t: FloatArray, begins: FloatArray, ends: FloatArray) -> BoolArray:
    """Whether readings at ``t`` cover each stretch from begin to end without a gap."""
    if not len(t):
        return np.zeros(len(begins), dtype=np.bool_)
    gaps = np.flatnonzero(np.diff(t) > LONGEST_GAP)
    starts, stops = t[np.concatenate(([0], gaps + 1))], t[np.concatenate((gaps, [len(t) - 1]))]
    piece = np.searchsorted(starts, begins, side="right") - 1
    covered: BoolArray = (piece >= 0) & (ends <= stops[piece])
    return covered


def blocks(t: FloatArray, length: float, recording: int) -> IntArray:
    """(n,) numbers of the stretches of ``length`` s in which these times of one recording lie."""
    return np.floor(t / length).astype(np.int64) + recording * _MOST_BLOCKS
