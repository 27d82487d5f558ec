# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Smoothed estimates of a whole log: each state from the measurements before and after it.

The slip estimator processes the log in the order of the stamps, so that every state is final: a first pass
finds the events that explain contradictions, later passes take these events as a script, in one branch.
``kalman.smoother`` runs backwards over the states of that branch. A state that an event replaced does not
follow from the state before. Where a state does not follow (a start, a manual pose, silent sprockets) nothing
is carried back: each piece is smoothed by itself. The filter is always the extended Kalman filter.

Memory is bounded. The first pass keeps the state at the start of each block. The second pass goes backwards,
recomputes each block from there and keeps the smoothed state that enters each block. The third pass
recomputes the blocks in order.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.smoother import smooth_step
from trackslip_estimation.slip.log import Block, Log, best_branch_script, run_blocks, start_of_log
from trackslip_estimation.slip.models.dispatch import linearize
from trackslip_estimation.slip.models.model import YAW
from trackslip_estimation.slip.outputs import fill_estimate
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import ESTIMATE, SPROCKETS
from trackslip_estimation.slip.source_offsets import set_offset_transition
from trackslip_estimation.slip.window import Records, Window, copy_first_entry, make_like, prior_of


class Smoothed(NamedTuple):
    """Records of ``ESTIMATE`` at the stamps of sprocket samples; both have the same length."""

    filtered: Records  # from measurements with earlier stamps
    smoothed: Records  # from all measurements


class _BlockStart(NamedTuple):
    """Range of a block in the log, and the state at its start."""

    first: int
    last: int
    start: Window  # its first entry is the last entry of the block before


def smooth(log: Log, p: SlipEstimatorParameters) -> Iterator[Smoothed]:
    """Filter and smoother over a log, block by block.

    Commands at run time (restart, hold still, new parameters) are left out.
    """
    p = replace(p, filter="ekf")
    start, config = start_of_log(log, p, best_branch_script(log, p))
    starts = [
        _BlockStart(b.first, b.first + len(b.states), _first_entry(b.window))
        for b in run_blocks(log.rest, start, config)
    ]
    carried: Records | None = None  # smoothed first entry of the last block done
    ends: list[Records | None] = []
    for block_start in reversed(starts):
        ends.append(carried)
        block = _recompute_block(log, block_start, config)
        _smooth(block.window, carried, config)
        carried = block.window.best[:1].copy()
    for block_start, end in zip(starts, reversed(ends), strict=True):
        block = _recompute_block(log, block_start, config)
        filtered = _estimates(block.window, config)
        _smooth(block.window, end, config)
        yield Smoothed(filtered, _estimates(block.window, config))


def _first_entry(window: Window) -> Window:
    """A window of the first entry only."""
    first = make_like(window, 2)
    first.status["played"] = window.status["begun"]
    copy_first_entry(first, window)
    return first


def _recompute_block(log: Log, block_start: _BlockStart, config: Records) -> Block:
    return next(run_blocks(log.rest[block_start.first : block_start.last], block_start.start, config))


def _smooth(window: Window, end: Records | None, config: Records) -> None:
    """Smooth the states of a window; ``end`` (1,) is the smoothed last state, None at the end of the log."""
    last, states = window.count - 1, window.best
    if end is not None:
        states["mean"][last], states["covariance"][last] = end["mean"][0], end["covariance"][0]
    _smooth_back(window, last, config)


def _estimates(window: Window, config: Records) -> Records:
    """(s,) of ``ESTIMATE`` at the sprocket samples of a window, without its first entry."""
    estimates = np.zeros(window.count, ESTIMATE)
    return estimates[: _fill_estimates(window, window.count, estimates, config)]


@compiled
def _smooth_back(window: Window, last: int, config: Records) -> None:
    c, end = config[0], window.states[0, last]
    n = c.size
    x, P = end.mean[:n].copy(), end.covariance[:n, :n].copy()
    for k in range(last, 0, -1):
        before, state, update = window.states[0, k - 1], window.states[0, k], window.updates[k]
        prior = prior_of(window, k)
        filtered = before.mean[:n].copy(), before.covariance[:n, :n].copy()
        if update.follows:
            dt = (state.stamp_ns - before.stamp_ns) * 1e-9
            F = linearize(filtered[0], filtered[1], state, dt, c)[1]
            set_offset_transition(F, state, dt, c)
            for i in range(n):
                if update.reset_states >> i & 1:
                    F[i] = 0.0
            predicted = prior.mean[:n].copy(), prior.covariance[:n, :n].copy()
            x, P = smooth_step(filtered, predicted, (x, P), F, YAW)
            before.mean[:n], before.covariance[:n, :n] = x, P
        else:
            x, P = filtered


@compiled
def _fill_estimates(window: Window, count: int, estimates: Records, config: Records) -> int:
    size = 0
    for k in range(1, count):
        if window.measurements[k].kind == SPROCKETS:
            fill_estimate(window.states[0, k], config[0], estimates[size])
            size += 1
    return size
