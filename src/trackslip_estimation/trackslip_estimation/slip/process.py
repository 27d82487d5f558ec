# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Check measurements, insert them into the window, and publish estimates; compiled.

Live node and replay pass their measurements to ``process``, one by one or many at once. It contains the only
loop over measurements. After an insertion the loop continues from the inserted entry. Tuning, studies and
smoother run the loop over windows that they filled.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.clock_monitor import NEVER_NS, StampStatus, check_other, check_sample
from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.bank.rows import make_rows
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.model import YAW
from trackslip_estimation.slip.outputs import fill_estimate, fill_motion
from trackslip_estimation.slip.records import HEADING, MANUAL, POSE, SPROCKETS
from trackslip_estimation.slip.start import begin_estimate
from trackslip_estimation.slip.validity import measurement_fault
from trackslip_estimation.slip.window import (
    Records,
    Window,
    horizon_ns,
    insert,
    insertion_index,
    is_duplicate,
    is_full,
    is_same,
    last_sample,
    remove_settled_entries,
)

if TYPE_CHECKING:
    from trackslip_common.arrays import FloatArray
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import EstimateRecord, MeasurementRecord, Result

_ACCEPTED, _TOO_LATE, _DUPLICATE = int(Outcome.ACCEPTED), int(Outcome.TOO_LATE), int(Outcome.DUPLICATE)
_INVALID, _WAITING, _AHEAD = int(Outcome.INVALID), int(Outcome.WAITING), int(Outcome.AHEAD)
_JUMPED, _RESTARTED, _FROZEN = int(Outcome.JUMPED), int(Outcome.RESTARTED), int(Outcome.FROZEN)
_DIVERGED = int(Outcome.DIVERGED)
_STAMP_AHEAD, _STAMP_BEHIND = int(StampStatus.AHEAD), int(StampStatus.BEHIND)
_STAMP_BACK = int(StampStatus.BACK)


@compiled
def process(window: Window, arrivals: Records, results: Records, config: Records) -> int:
    """Process ``arrivals`` in order, and fill ``results``; return the number that the window had room for.

    Measurements that are already in the window get their states first.
    """
    status, c = window.status[0], config[0]
    measurements, arrival = window.measurements, window.measurements[window.measurements.size - 1]
    done, outcome, entry, previous_head_ns = 0, _WAITING, 0, NEVER_NS
    while True:
        count = status.count
        first, status.known = status.known if status.started else count, count
        if not make_rows(window, first, count, c):
            clear(window)
            status.divergences += 1
            outcome, entry = _DIVERGED, 0
        if done > 0:
            _fill_result(window, arrival, (outcome, entry), previous_head_ns, results[done - 1], c)
        if done == arrivals.size or (is_full(window) and not remove_settled_entries(window, c)):
            return done
        previous_head_ns = status.clock.head_ns if status.clock.running else NEVER_NS
        measurements[measurements.size - 1] = arrivals[done]
        outcome, entry = _accept(window, arrival, c)
        results[done].stamp_ns = arrival.stamp_ns
        done += 1


@inlined
def _accept(window: Window, measurement: MeasurementRecord, c: Config) -> tuple[int, int]:
    """Check a measurement and insert it, or start with it; return outcome and entry, 0: not inserted."""
    outcome = _check(window, measurement, c)
    if outcome not in (_ACCEPTED, _RESTARTED):
        return outcome, 0
    if window.status[0].started:
        return _insert_measurement(window, measurement, c)
    began = begin_estimate(window, measurement, c)
    return _RESTARTED if outcome == _RESTARTED else began, 0


@inlined
def _fill_result(
    window: Window,
    measurement: MeasurementRecord,
    insertion: tuple[int, int],
    previous_head_ns: int,
    result: Result,
    c: Config,
) -> None:
    """Fill the result of an arrival once all states are known; ``insertion``: outcome so far, entry."""
    status, (outcome, entry) = window.status[0], insertion
    result.published, result.dof, result.attitude = False, 0, 0
    result.fault = 0 if outcome != _INVALID else measurement_fault(measurement, c)
    result.nis = result.gate = np.nan
    if entry > 0:
        update = window.updates[entry]
        outcome = int(update.outcome)
        result.nis, result.gate, result.dof = update.nis, update.gate, update.dof
        result.attitude = update.attitude
    if status.started and outcome in (_ACCEPTED, _JUMPED, _RESTARTED):
        _publish(window, entry, previous_head_ns, result, c)
    result.outcome = outcome


@inlined
def _check(window: Window, measurement: MeasurementRecord, c: Config) -> int:
    """Return the outcome of checks of values and stamp; a clock that went back clears the window."""
    status = window.status[0]
    if measurement_fault(measurement, c) > 0:
        return _INVALID
    if status.frozen and measurement.kind in (POSE, HEADING) and measurement.source != MANUAL:
        return _FROZEN
    if measurement.source == MANUAL and measurement.kind == POSE and measurement.stamp_ns == 0:
        if not status.clock.running:
            return _WAITING  # for the first sprocket sample, as the current time is unknown
        measurement.stamp_ns = status.clock.head_ns
    if measurement.kind != SPROCKETS:
        ahead = check_other(status.clock, c.clock, measurement.stamp_ns) == _STAMP_AHEAD
        return _AHEAD if ahead else _ACCEPTED
    is_out_of_reach = _is_out_of_reach(window, measurement, c)
    stamp_status = check_sample(
        status.clock, c.clock, measurement.stamp_ns, horizon_ns(window, c), is_out_of_reach
    )
    if stamp_status == _STAMP_AHEAD:
        return _AHEAD
    if stamp_status == _STAMP_BEHIND:
        return _TOO_LATE
    if stamp_status == _STAMP_BACK:
        clear(window)
        status.restarts += 1
        status.clock.running = False
        check_sample(status.clock, c.clock, measurement.stamp_ns, horizon_ns(window, c), False)
        return _RESTARTED
    return _ACCEPTED


@compiled
def clear(window: Window) -> None:
    """Discard all measurements and states; the clock continues."""
    status = window.status[0]
    status.started, status.count, status.published_ns = False, 0, NEVER_NS


@compiled
def _is_out_of_reach(window: Window, sample: MeasurementRecord, c: Config) -> bool:
    """Whether angles of a late sample are out of reach from the previous sample at the maximum speed."""
    status, measurements = window.status[0], window.measurements
    if not status.clock.running or sample.stamp_ns > status.clock.head_ns or math.isnan(sample.left_angle):
        return False
    before = last_sample(measurements, status.count)
    while before >= 0 and measurements[before].stamp_ns > sample.stamp_ns:
        before = last_sample(measurements, before)
    if before < 0 or math.isnan(measurements[before].left_angle):
        return False
    elapsed_ns = sample.stamp_ns - measurements[before].stamp_ns
    left = abs(sample.left_angle - measurements[before].left_angle)
    right = abs(sample.right_angle - measurements[before].right_angle)
    furthest = c.max_sprocket_speed * elapsed_ns * 1e-9
    return bool(elapsed_ns <= c.sprocket_timeout_ns and max(left, right) > furthest)


@inlined
def _insert_measurement(window: Window, measurement: MeasurementRecord, c: Config) -> tuple[int, int]:
    """Insert a measurement; mark the states after it as unknown; return outcome and entry."""
    status, measurements = window.status[0], window.measurements
    if measurement.stamp_ns < horizon_ns(window, c):
        return _TOO_LATE, 0
    entry = max(insertion_index(measurements, status.count, measurement), 1)  # entry 0 is the start
    if is_duplicate(measurements, status.count, entry, measurement) or is_same(measurement, measurements[0]):
        return _DUPLICATE, 0
    insert(window, entry)
    if measurement.kind == SPROCKETS:  # also states extrapolated from the previous sample
        status.known = min(status.known, max(last_sample(measurements, entry) + 1, 1))
    return _ACCEPTED, entry


@inlined
def _publish(window: Window, entry: int, previous_head_ns: int, result: Result, c: Config) -> None:
    """Set ``published`` for the newest sprocket sample, or for a measurement that advances the clock."""
    status, measurement = window.status[0], window.measurements[entry]
    advances_clock = previous_head_ns < status.clock.head_ns == measurement.stamp_ns
    if measurement.stamp_ns <= status.published_ns or not (measurement.kind == SPROCKETS or advances_clock):
        return
    status.published_ns, result.published = measurement.stamp_ns, True
    fill_mixture(window, entry, c, result.estimate)


@compiled
def fill_mixture(window: Window, k: int, c: Config, estimate: EstimateRecord) -> None:
    """Fill the estimate of row k: most probable branch, with the covariance of the mixture about it."""
    fill_estimate(window.states[0, k], c, estimate)
    if window.counts[k] == 1:
        return
    other, total = window.other[0], 1.0
    for s in range(1, window.counts[k]):
        fill_motion(window.states[s, k], c, other)
        w = math.exp(window.branches[s, k].weight)
        total += w
        _add_spread(estimate.pose, other.pose, estimate.pose_covariance, other.pose_covariance, w, YAW)
        _add_spread(estimate.twist, other.twist, estimate.twist_covariance, other.twist_covariance, w, -1)
        _add_spread(estimate.slips, other.slips, estimate.slip_covariance, other.slip_covariance, w, -1)
    for i in range(3):
        for j in range(3):
            estimate.pose_covariance[i, j] /= total
            estimate.twist_covariance[i, j] /= total
            estimate.slip_covariance[i, j] /= total


@compiled
def _add_spread(
    mean: FloatArray, other: FloatArray, covariance: FloatArray, P: FloatArray, w: float, angle: int
) -> None:
    """Add the second moment about ``mean`` of another Gaussian, of weight w, to a covariance (3, 3).

    ``angle``: index of an angle; −1: none.
    """
    for i in range(3):
        for j in range(3):
            d, e = other[i] - mean[i], other[j] - mean[j]
            d, e = wrap(d) if i == angle else d, wrap(e) if j == angle else e
            covariance[i, j] += w * (P[i, j] + d * e)


@compiled
def fill_last_estimate(window: Window, config: Records, estimates: Records) -> None:
    """Fill (1,) of ``ESTIMATE`` with the estimate at the newest stamp."""
    last = window.status[0].count - 1
    fill_mixture(window, last, config[0], estimates[0])
