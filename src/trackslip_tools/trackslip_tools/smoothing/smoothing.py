# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The estimates that a whole log gives: at each time from what came before and after it.

The slip estimator runs over the log in the order of the stamps, so that every state is settled: once to find
the events that explain contradictions, then with these as its script, in one branch. ``kalman.smoother`` goes
back over the states of that branch. A state that an event replaced does not follow from the one before. Where
no state does (a start, a manual pose, silent sprockets) nothing is carried back: each piece is smoothed by
itself. The filter is the extended Kalman filter, whichever the parameters name.

Memory is bounded: the first pass keeps the state at which each block begins, the second goes back through the
blocks, made again from there, and keeps what is carried into each; the third makes them once more, in order.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.smoother import step_back
from trackslip_estimation.slip.log import Block, Log, begin_log, run_blocks, script_of
from trackslip_estimation.slip.models.dispatch import linearize
from trackslip_estimation.slip.models.model import YAW
from trackslip_estimation.slip.outputs import fill_estimate
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import ESTIMATE, SPROCKETS
from trackslip_estimation.slip.source_offsets import set_offset_transition
from trackslip_estimation.slip.window import Records, Window, copy_first, make_like, prior_of


class Smoothed(NamedTuple):
    """Records of ``ESTIMATE`` at the stamps of sprocket samples; of both the same number."""

    filtered: Records  # settled: from all that has an earlier stamp
    smoothed: Records  # from all there is


class _Begin(NamedTuple):
    """Where a block begins, and how far it goes."""

    first: int
    last: int
    start: Window  # whose first entry is the last one before it


def smooth(log: Log, p: SlipEstimatorParameters) -> Iterator[Smoothed]:
    """Filter and smoother over a log, block by block.

    What was asked of the estimator while it ran (to restart, to hold still, new parameters) is left out.
    """
    p = replace(p, filter="ekf")
    start, config = begin_log(log, p, script_of(log, p))
    begins = [
        _Begin(b.first, b.first + len(b.states), _first_row(b.window))
        for b in run_blocks(log.rest, start, config)
    ]
    carried: Records | None = None  # into the block that was done last
    ends: list[Records | None] = []
    for begin in reversed(begins):
        ends.append(carried)
        block = _again(log, begin, config)
        _smooth(block.window, carried, config)
        carried = block.window.best[:1].copy()
    for begin, end in zip(begins, reversed(ends), strict=True):
        block = _again(log, begin, config)
        filtered = _estimates(block.window, config)
        _smooth(block.window, end, config)
        yield Smoothed(filtered, _estimates(block.window, config))


def _first_row(window: Window) -> Window:
    """A window of the first entry only."""
    first = make_like(window, 2)
    first.status["played"] = window.status["begun"]
    copy_first(first, window)
    return first


def _again(log: Log, begin: _Begin, config: Records) -> Block:
    return next(run_blocks(log.rest[begin.first : begin.last], begin.start, config))


def _smooth(window: Window, end: Records | None, config: Records) -> None:
    """The states of a window, smoothed; ``end`` (1,) is the last one, if something came after it."""
    last, states = window.count - 1, window.best
    if end is not None:
        states["mean"][last], states["covariance"][last] = end["mean"][0], end["covariance"][0]
    _smooth_back(window, last, config)


def _estimates(window: Window, config: Records) -> Records:
    """(s,) of ``ESTIMATE`` at the sprocket samples of a window, but for its first entry."""
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
            x, P = step_back(filtered, predicted, (x, P), F, YAW)
            before.mean[:n], before.covariance[:n, :n] = x, P
        else:
            x, P = filtered


@compiled
def _fill_estimates(window: Window, count: int, estimates: Records, config: Records) -> int:
    found = 0
    for k in range(1, count):
        if window.measurements[k].kind == SPROCKETS:
            fill_estimate(window.states[0, k], config[0], estimates[found])
            found += 1
    return found
