# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One measurement after the other into the window: checked, put in its place, published; compiled.

Live node and replay hand their measurements to ``process``, one by one or many at once.
"""

import math
from typing import Any

import numpy as np

from trackslip_common.clock_monitor import NEVER_NS, StampStatus, check_other, check_sample
from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.observation import fill_outputs
from trackslip_estimation.slip.records import HEADING, MANUAL, POSE, SPROCKETS
from trackslip_estimation.slip.start import begin
from trackslip_estimation.slip.swing import fill_swing
from trackslip_estimation.slip.tilt import fill_tilt
from trackslip_estimation.slip.usable import is_usable
from trackslip_estimation.slip.window import (
    SPARE,
    Records,
    Window,
    horizon_ns,
    insert,
    is_at,
    is_same,
    last_sample,
    place_of,
    run,
    trim,
)

_NO_DIRECTION = math.pi**2 / 12.0  # rad², variance of a direction that may be any of half a turn

_ACCEPTED, _TOO_LATE, _DUPLICATE = int(Outcome.ACCEPTED), int(Outcome.TOO_LATE), int(Outcome.DUPLICATE)
_INVALID, _WAITING, _AHEAD = int(Outcome.INVALID), int(Outcome.WAITING), int(Outcome.AHEAD)
_JUMPED, _RESTARTED, _FROZEN = int(Outcome.JUMPED), int(Outcome.RESTARTED), int(Outcome.FROZEN)
_STAMP_AHEAD, _STAMP_BEHIND = int(StampStatus.AHEAD), int(StampStatus.BEHIND)
_STAMP_BACK = int(StampStatus.BACK)


@compiled
def process(window: Window, arrivals: Records, results: Records, c: Any) -> int:
    """Measurements in the order of their arrival; returns how many there was room for."""
    for k in range(arrivals.size):
        if window.status[0].count + SPARE >= window.states.size and not trim(window, c[0]):
            return k
        window.measurements[window.measurements.size - 1] = arrivals[k]
        _process(window, window.measurements[window.measurements.size - 1], results[k], c[0])
    return int(arrivals.size)


@inlined
def _process(window: Window, measurement: Any, result: Any, c: Any) -> None:
    status = window.status[0]
    result.published, result.dof, result.attitude = False, 0, 0
    result.nis = result.gate = np.nan
    was_head_ns = status.clock.head_ns if status.clock.running else NEVER_NS
    outcome = _check(window, measurement, c)
    if outcome in (_ACCEPTED, _RESTARTED):
        if status.started:
            outcome, entry = _add(window, measurement, c)
        else:
            began = begin(window, measurement, c)
            outcome, entry = _RESTARTED if outcome == _RESTARTED else began, 0
            if entry + 1 < status.count and began == _ACCEPTED:
                run(window, entry + 1, status.count, c)
        if status.started and outcome in (_ACCEPTED, _JUMPED, _RESTARTED):
            _publish(window, entry, was_head_ns, result, c)
        if status.started and outcome != _TOO_LATE and outcome != _DUPLICATE and entry > 0:
            update = window.updates[entry]
            result.nis, result.gate, result.dof = update.nis, update.gate, update.dof
            result.attitude = update.attitude
    result.stamp_ns, result.outcome = measurement.stamp_ns, outcome


@inlined
def _check(window: Window, measurement: Any, c: Any) -> int:
    """What its numbers and its stamp say; a clock that goes back clears the window."""
    status = window.status[0]
    if not is_usable(measurement, c):
        return _INVALID
    if status.frozen and measurement.kind in (POSE, HEADING) and measurement.source != MANUAL:
        return _FROZEN
    if measurement.source == MANUAL and measurement.kind == POSE and measurement.stamp_ns == 0:
        if not status.clock.running:
            return _WAITING  # for the first sprocket sample: now is not known yet
        measurement.stamp_ns = status.clock.head_ns
    if measurement.kind != SPROCKETS:
        ahead = check_other(status.clock, c.clock, measurement.stamp_ns) == _STAMP_AHEAD
        return _AHEAD if ahead else _ACCEPTED
    contradicts = _contradicts(window, measurement, c)
    found = check_sample(status.clock, c.clock, measurement.stamp_ns, horizon_ns(window, c), contradicts)
    if found == _STAMP_AHEAD:
        return _AHEAD
    if found == _STAMP_BEHIND:
        return _TOO_LATE
    if found == _STAMP_BACK:
        clear(window)
        status.restarts += 1
        status.clock.running = False
        check_sample(status.clock, c.clock, measurement.stamp_ns, horizon_ns(window, c), False)
        return _RESTARTED
    return _ACCEPTED


@compiled
def clear(window: Window) -> None:
    """Forget all measurements and all that was learned; the clock goes on."""
    status = window.status[0]
    status.started, status.count, status.published_ns = False, 0, NEVER_NS


@compiled
def _contradicts(window: Window, sample: Any, c: Any) -> bool:
    """Whether positions of a late sample cannot be reached from those of the last one up to its stamp."""
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
def _add(window: Window, measurement: Any, c: Any) -> tuple[int, int]:
    """Outcome and entry of a measurement in its place, with all done again that depends on it."""
    status, measurements = window.status[0], window.measurements
    if measurement.stamp_ns < horizon_ns(window, c):
        return _TOO_LATE, 0
    entry = max(place_of(measurements, status.count, measurement), 1)  # nothing comes before the start
    if is_at(measurements, status.count, entry, measurement) or is_same(measurement, measurements[0]):
        return _DUPLICATE, 0
    insert(window, entry)
    first = entry
    if measurement.kind == SPROCKETS:  # what was extrapolated from the sample before it
        first = max(last_sample(measurements, entry) + 1, 1)
    run(window, first, status.count, c)
    return int(window.updates[entry].outcome), entry


@inlined
def _publish(window: Window, entry: int, was_head_ns: int, result: Any, c: Any) -> None:
    """The estimate at the newest sprocket sample, or at what carries the clock on while they are silent."""
    status, measurement = window.status[0], window.measurements[entry]
    carries = was_head_ns < status.clock.head_ns == measurement.stamp_ns
    if measurement.stamp_ns <= status.published_ns or not (measurement.kind == SPROCKETS or carries):
        return
    status.published_ns, result.published = measurement.stamp_ns, True
    fill_estimate(window.states[entry], c, result.estimate)


@inlined
def fill_estimate(state: Any, c: Any, estimate: Any) -> None:
    """What is published of a state, into a record of ``ESTIMATE``."""
    fill_outputs(state, c, estimate)
    fill_tilt(state, estimate)
    fill_swing(state, estimate.swing, c)
    estimate.stamp_ns, estimate.motion = state.stamp_ns, state.motion.motion
    estimate.pose[:], estimate.pose_covariance[:] = state.mean[:3], state.covariance[:3, :3]
    if estimate.slip_covariance[2, 2] == 0.0:  # at a standstill there is no direction
        estimate.slip_covariance[2, 2] = _NO_DIRECTION


@compiled
def fill_last_estimate(window: Window, config: Records, estimates: Records) -> None:
    """What is known at the newest stamp, into (1,) of ``ESTIMATE``."""
    fill_estimate(window.states[window.status[0].count - 1], config[0], estimates[0])
