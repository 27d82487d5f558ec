# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The estimates that a whole log gives: at each time from what came before and after it.

The slip estimator runs over the log in the order of the stamps, so that every state is settled; then
``kalman.smoother`` goes back over its states. Where one state does not follow from the one before it by the
model (a start, a manual pose, sprockets that were silent) nothing is carried back: each piece is smoothed by
itself. The filter is the extended Kalman filter, whichever the parameters name.

Memory is bounded: the first pass keeps the state at which each block begins, the second goes back through the
blocks, made anew from there, and keeps what is carried into each; the third makes them once more, in order.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.smoother import step_back
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.log import Block, Log, run_blocks
from trackslip_estimation.slip.models.dispatch import linearize
from trackslip_estimation.slip.models.model import YAW
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.process import fill_estimate
from trackslip_estimation.slip.records import ESTIMATE, SPROCKETS
from trackslip_estimation.slip.window import Records, Window, make_window


class Smoothed(NamedTuple):
    """Records of ``ESTIMATE`` at the stamps of sprocket samples; of both the same number."""

    filtered: Records  # settled: from all that has an earlier stamp
    smoothed: Records  # from all there is


class _Begin(NamedTuple):
    """Where a block begins, and how far it goes."""

    first: int
    last: int
    measurement: Records  # (1,)
    state: Records  # (1,)


def smooth(log: Log, p: SlipEstimatorParameters) -> Iterator[Smoothed]:
    """Filter and smoother over a log, block by block.

    What was asked of the estimator while it ran (to begin anew, to hold still, new parameters) is left out.
    """
    estimator = SlipEstimator(replace(p, filter="ekf"))
    estimator.process_records(log.begin)
    begins = [
        _Begin(b.first, b.first + len(b.states), b.window.measurements[:1].copy(), b.window.states[:1].copy())
        for b in run_blocks(log.rest, estimator.window, estimator.config)
    ]
    carried: Records | None = None  # into the block that was done last
    ends: list[Records | None] = []
    for begin in reversed(begins):
        ends.append(carried)
        block = _again(log, begin, estimator)
        _smooth(block.window, carried, estimator.config)
        carried = block.window.states[:1].copy()
    for begin, end in zip(begins, reversed(ends), strict=True):
        block = _again(log, begin, estimator)
        filtered = _estimates(block.window, estimator.config)
        _smooth(block.window, end, estimator.config)
        yield Smoothed(filtered, _estimates(block.window, estimator.config))


def _again(log: Log, begin: _Begin, estimator: SlipEstimator) -> Block:
    start = make_window(2)
    start.measurements[:1], start.states[:1] = begin.measurement, begin.state
    return next(run_blocks(log.rest[begin.first : begin.last], start, estimator.config))


def _smooth(window: Window, end: Records | None, config: Records) -> None:
    """The states of a window, smoothed; ``end`` (1,) is the last one, if something came after it."""
    last = window.count - 1
    if end is not None:
        window.states["mean"][last], window.states["covariance"][last] = end["mean"][0], end["covariance"][0]
    _smooth_back(window, last, config)


def _estimates(window: Window, config: Records) -> Records:
    """(s,) of ``ESTIMATE`` at the sprocket samples of a window, but for its first entry."""
    estimates = np.zeros(window.count, ESTIMATE)
    return estimates[: _fill_estimates(window, window.count, estimates, config)]


@compiled
def _smooth_back(window: Window, last: int, config: Records) -> None:
    c, states = config[0], window.states
    n = c.size
    x, P = states[last].mean[:n].copy(), states[last].covariance[:n, :n].copy()
    for k in range(last, 0, -1):
        before, update = states[k - 1], window.updates[k]
        filtered = before.mean[:n].copy(), before.covariance[:n, :n].copy()
        if update.follows:
            dt = (states[k].stamp_ns - before.stamp_ns) * 1e-9
            F = linearize(filtered[0], filtered[1], states[k], dt, c)[1]
            if update.renewed >= 0:
                F[update.renewed : update.renewed + 2] = 0.0
            predicted = update.prior_mean[:n].copy(), update.prior_covariance[:n, :n].copy()
            x, P = step_back(filtered, predicted, (x, P), F, YAW)
            before.mean[:n], before.covariance[:n, :n] = x, P
        else:
            x, P = filtered


@compiled
def _fill_estimates(window: Window, count: int, estimates: Records, config: Records) -> int:
    found = 0
    for k in range(1, count):
        if window.measurements[k].kind == SPROCKETS:
            fill_estimate(window.states[k], config[0], estimates[found])
            found += 1
    return found
