# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Start of the estimate: the first measurement, and the initial state; compiled into ``process``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.clock_monitor import NEVER_NS
from trackslip_common.compiled import inlined
from trackslip_estimation.attitude.start import reset_attitude
from trackslip_estimation.slip.adaptation import begin_adaptation, resume_adaptation
from trackslip_estimation.slip.bank.receivers import add_first_fix
from trackslip_estimation.slip.bank.rows import begin_row, is_moving_without_heading, split_unknown_heading
from trackslip_estimation.slip.bank.script import apply_scripted_events
from trackslip_estimation.slip.late_stamps import reset_delay
from trackslip_estimation.slip.levers import to_sensor
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.model import SWING, YAW
from trackslip_estimation.slip.motion import reset_motion
from trackslip_estimation.slip.observations.odometry import begin_odometry
from trackslip_estimation.slip.observations.pose import raise_to_floors
from trackslip_estimation.slip.records import MANUAL, MOST_SOURCES, POSE, SPROCKETS
from trackslip_estimation.slip.source_faults import IS_HEALTHY
from trackslip_estimation.slip.source_offsets import begin_offset, to_sensor_heading
from trackslip_estimation.slip.sprockets import set_zero_speeds, store_sample
from trackslip_estimation.slip.validity import has_heading
from trackslip_estimation.slip.window import Window, insert, insertion_index, is_duplicate, remove_entries

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State

_ACCEPTED, _DUPLICATE, _WAITING = int(Outcome.ACCEPTED), int(Outcome.DUPLICATE), int(Outcome.WAITING)


@inlined
def begin_estimate(window: Window, measurement: MeasurementRecord, c: Config) -> int:
    """Begin with a fix, a manual pose, or the initial pose at the first sprocket sample; else wait."""
    status, measurements = window.status[0], window.measurements
    entry = insertion_index(measurements, status.count, measurement)
    begins = measurement.kind == POSE and (c.starts_with_fix or measurement.source == MANUAL)
    if measurement.kind == SPROCKETS:
        begins = not c.starts_with_fix
        if is_duplicate(measurements, status.count, entry, measurement):
            return _DUPLICATE
    if not begins:
        if measurement.kind == SPROCKETS:
            insert(window, entry)
        return _WAITING
    insert(window, entry)
    state, sample = window.states[0, 0], window.states[0, 0].sample
    sample.seen = sample.known = False
    set_zero_speeds(sample.speeds)
    for k in range(entry + 1):
        if measurements[k].kind == SPROCKETS:
            store_sample(state, measurements[k], c)
    status.known = 0
    remove_entries(window, entry, entry)
    begin_row(window, 0, c)
    _set_initial_state(window.states[0, 0], measurements[0], c)
    add_first_fix(window, c)
    window.updates[0].outcome, window.updates[0].follows = _ACCEPTED, False
    if status.scripted:
        apply_scripted_events(window, 0, 1, c)
    elif is_moving_without_heading(window.states[0, 0], c):
        split_unknown_heading(window, 0, c)
    status.started, status.known = True, 1
    return _ACCEPTED


@inlined
def _set_initial_state(state: State, measurement: MeasurementRecord, c: Config) -> None:
    """Set the initial state; a fix without heading starts with that of the parameters."""
    x, P, stamp_ns = state.mean[:], state.covariance[:], measurement.stamp_ns
    reset_attitude(state.attitude)
    for number in range(c.poses):
        state.offsets[number].variance = state.offsets[number].stddev = 0.0
    x[:] = c.prior_mean
    P[:] = c.prior_covariance
    x[:3], P[:3, :3] = c.initial_pose, c.initial_covariance
    if measurement.kind == POSE:
        source = measurement.source
        rows = 3 if has_heading(measurement) else 2
        P[:3, :3] = 0.0
        P[YAW, YAW] = c.initial_covariance[YAW, YAW]
        x[:rows], P[:rows, :rows] = measurement.value[:rows], measurement.noise[:rows, :rows]
        if source != MANUAL:
            raise_to_floors(P, rows, source, c)
            begin_offset(state, source, c)
            if rows > YAW:
                to_sensor_heading(x, P, source, -1.0, c)
            if rows <= YAW and c.above[source] == 1:  # its heading is the sum of heading and swing
                x[YAW] += x[SWING]
                P[YAW, YAW] += P[SWING, SWING]
                P[YAW, SWING] = P[SWING, YAW] = P[SWING, SWING]
            to_sensor(x[: c.size], P, state.attitude.level, source, -1.0, c)
    set_zero_speeds(state.speeds)
    reset_motion(state.motion)
    state.shear[:] = 0.0
    state.stamp_ns, state.coasting = stamp_ns, False
    if not state.sample.seen:
        state.sample.stamp_ns = stamp_ns
    begin_adaptation(state.adaptation, c)
    if c.resumes:
        resume_adaptation(state.adaptation, c.start)
    begin_odometry(state)
    reset_delay(state, c)
    if measurement.kind != POSE:
        state.fixed_ns = NEVER_NS
    state.track_distance = state.learned_downhill = state.displacement[:] = 0.0
    state.is_sector, state.sole_fix_source, state.sole_fix_heading = False, -1, False
    state.fault_ns[:] = state.heading_fault_ns[:] = stamp_ns
    state.fault[:] = state.heading_fault[:] = IS_HEALTHY
    state.outlier_share[:], state.last_value[:] = c.bank.initial_outlier_share, math.nan
    if measurement.kind == POSE and measurement.source != MANUAL:
        state.last_value[measurement.source] = measurement.value[:3]
        state.sole_fix_source, state.sole_fix_heading = measurement.source, has_heading(measurement)
    for k in range(MOST_SOURCES):
        state.consistent_ns[k], state.received_ns[k] = stamp_ns, NEVER_NS
        state.readings[k].stamp_ns, state.readings[k].value = NEVER_NS, math.nan
        state.readings[k].first_ns, state.readings[k].longest_ns = NEVER_NS, 0
        state.rejected_ns[k], state.weighed_ns[k], state.standstills[k].count = 0, stamp_ns, 0
        state.streaks[k].count, state.streaks[k].value = 0, 0.0
