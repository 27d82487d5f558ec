# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Decide whether a branch gets children at a measurement, and which; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.bank.child import (
    add_angle_child,
    add_child,
    add_child_at_measurement,
    add_child_since_snapshot,
    distance_since_snapshot,
    log_measurement_interval,
    squared_jump,
)
from trackslip_estimation.slip.bank.course import is_heading_carried, update_course
from trackslip_estimation.slip.bank.earlier_children import (
    are_track_speeds_measured,
    correlated_penalty,
    has_recent_fix,
    make_earlier_children,
    make_failed_unit_child,
    make_failure_children,
    make_one_sprocket_children,
    make_recovered_sector_children,
    make_sector_children,
    make_source_fault_children,
)
from trackslip_estimation.slip.bank.hidden_changes import has_hidden_change, log_odds_of_hidden_change
from trackslip_estimation.slip.bank.offset_jumps import is_offset_jump_due, make_offset_jump_children
from trackslip_estimation.slip.bank.plausibility import (
    PERIOD,
    USUAL_PENALTY,
    implausibility,
    is_stuck,
    slip_range_penalty,
    total_turn_reduction,
    turn_range_penalty,
)
from trackslip_estimation.slip.bank.pool import copy_row_to_pool, update_of
from trackslip_estimation.slip.events import (
    ANGLES,
    BIASED,
    FAILED,
    HEADING_OFF,
    HEADING_REPEATS,
    HEADING_WANDERS,
    HEADINGS,
    HIDDEN,
    LATE,
    MEASURED,
    MOVED,
    OFFSET,
    OUTLIER,
    RECOVERED,
    REPEATS,
    SCATTERS,
    SKIDDED,
    SLIPPED,
    STAYS,
    SWUNG,
    TURNED,
)
from trackslip_estimation.slip.late_stamps import log_odds_of_delay
from trackslip_estimation.slip.levers import is_heading_unknown
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import YAW
from trackslip_estimation.slip.models.swing import is_free_to_swing, is_moved_by_swing
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.records import (
    BRAKE,
    GYROS,
    HEADING,
    MOST_SOURCES,
    OLDER,
    ON_SWING,
    POSE,
    SLIPS,
    TRACKS,
    VELOCITY,
)
from trackslip_estimation.slip.source_faults import (
    IS_HEALTHY,
    IS_OFFSET,
    IS_SCATTERING,
    can_be_repetition,
    has_failed_unit,
    has_hidden_heading_fault,
    has_wandering_offset,
    is_displacement_measured,
    is_failed,
    is_heading_repeated,
    is_repeated,
    is_same_fault,
    is_trusted,
    log_density_of_any_size,
    unknown_position_stddev,
)
from trackslip_estimation.slip.source_offsets import has_mostly_correlated_errors
from trackslip_estimation.slip.sprockets import shows_standstill
from trackslip_estimation.slip.weighing import contradiction_limit
from trackslip_estimation.slip.window import Window

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State

_GATED, _STANDING = int(Outcome.GATED), int(Motion.STANDING)


@compiled
def create_children(window: Window, k: int, c: Config) -> int:
    """Weigh the branches of row k, and add to the pool the children of those that measurement k contradicts.

    Returns the number of branches and children. The pool also holds the branches, if there are several or if
    they have children.
    """
    count = window.counts[k]
    for s in range(count):
        _subtract_fault_costs(window, s, k, c)
        if window.measurements[k].kind in (POSE, VELOCITY):
            update_course(window, s, k, c)
    needs_children = [_needs_children(window, s, k, c) for s in range(count)]
    if count == 1 and not needs_children[0]:
        return 1
    copy_row_to_pool(window, k)
    parents = [p for p in range(count) if needs_children[p]]
    comes_first = len(parents) > 0 and _are_sectors_due(window, k, c)
    if comes_first:
        _make_sector_children(window, parents[0], k, c)
    for p in parents:
        _make_children(window, p, k, c)
    for p in parents[1:] if comes_first else parents:
        _make_sector_children(window, p, k, c)
    for p in parents:
        if _is_likely(window, p, k, c):
            window.pool_branches[p].cusum[:] = 0.0
    return int(window.status[0].pooled)


@compiled
def _are_sectors_due(window: Window, k: int, c: Config) -> bool:
    """Whether the children by sector of the first parent come first: at every other fix without explanation.

    They repeat so many steps that little is left for others. With many parents nothing is left for them.
    """
    fixes = window.branches[0, k - 1].snapshots[OLDER].fixes
    return bool(fixes >= c.bank.look_back / 2.0 and fixes % 2 == 1)


@compiled
def _make_sector_children(window: Window, p: int, k: int, c: Config) -> None:
    """Add the children of branch p with the heading or the swing angle in each sector, if it is likely."""
    if _is_likely(window, p, k, c) and _can_have_earlier_event(window, p, k, c):
        implausible = _is_slip_implausible(window, p, k, c)
        make_sector_children(window, p, k, _is_contradicted(window, p, k, c), implausible, c)


@compiled
def create_failure_children(window: Window, k: int, c: Config) -> int:
    """Add to the pool the branches of row k, and children of those that reject yaw rate or odometry k.

    In each child a unit does not measure the motion, or a machine that was stuck grips again. Returns the
    number of branches and children.
    """
    copy_row_to_pool(window, k)
    shows_motion = window.measurements[k].kind != SLIPS
    for p in range(window.counts[k]):
        is_rejected = update_of(window, p, k).evidence != 0.0 and _is_likely(window, p, k, c)
        if is_rejected and shows_motion and has_velocity_errors(c):
            make_failure_children(window, p, k, 0.0, c)
            if is_stuck(window.states[p, k - 1], c):
                add_child_since_snapshot(window, p, k, SLIPPED, window.measurements[k].source, 0, 0.0, c)
    return int(window.status[0].pooled)


@compiled
def _subtract_fault_costs(window: Window, s: int, k: int, c: Config) -> None:
    """Lower the weight of branch s of row k by lasting faults and an implausible motion; update its CUSUM."""
    measurement = window.measurements[k]
    branch, state, update = window.branches[s, k], window.states[s, k], update_of(window, s, k)
    source, fault = measurement.source, state.fault[measurement.source]
    elapsed_s = (measurement.stamp_ns - window.states[s, k - 1].weighed_ns[source]) * 1e-9
    branch.fresh = 0
    faults = int(fault != IS_HEALTHY) + int(state.heading_fault[source] != IS_HEALTHY)
    faults -= int(is_same_fault(state, source))
    if measurement.kind in (POSE, VELOCITY):
        for unit in range(MOST_SOURCES):
            faults += int(is_failed(state.fault[unit]) and _can_recover(state, unit, c))
    branch.weight -= faults * elapsed_s / c.events.fault_time
    periods = min(elapsed_s / PERIOD, 1.0)
    slip_cost = slip_range_penalty(state, c) * periods
    branch.slip_cost = branch.slip_cost + slip_cost if slip_cost > 0.0 else 0.0
    if state.motion.motion != _STANDING and not state.motion.changing:  # else the machine lags behind
        paid, excess = total_turn_reduction(branch.turn_cost), turn_range_penalty(state, c) - USUAL_PENALTY
        branch.turn_cost = max(branch.turn_cost + excess * periods, 0.0)
        branch.weight -= total_turn_reduction(branch.turn_cost) - paid
    branch.weight -= implausibility(state, c) * periods
    follows = measurement.kind == POSE and is_displacement_measured(fault)
    if measurement.kind == VELOCITY:  # at standstill slip is not observable
        follows = fault == IS_HEALTHY and state.motion.motion != _STANDING
    if follows and not has_mostly_correlated_errors(state, source, c):
        for i in range(4):
            e = update.whitened[i // 2] * (1.0 - 2.0 * (i % 2))
            branch.cusum[i] = max(branch.cusum[i] + min(e, c.bank.cusum_largest) - c.bank.cusum_drift, 0.0)


@compiled
def _is_likely(window: Window, p: int, k: int, c: Config) -> bool:
    """Whether branch p was likely enough before k for another event; the end of its fault needs less."""
    return bool(window.branches[p, k - 1].weight >= -c.bank.spawns)


@compiled
def _is_contradicted(window: Window, s: int, k: int, c: Config) -> bool:
    """Whether measurement k contradicts branch s, or the branch rejects it."""
    before, update = window.states[s, k - 1], update_of(window, s, k)
    m = window.measurements[k]
    is_gated = update.outcome == _GATED and is_trusted(before, m.source, m.kind)
    return bool(update.nis > contradiction_limit(update.dof, c) or is_gated)


@compiled
def _needs_children(window: Window, s: int, k: int, c: Config) -> bool:
    """Whether branch s of row k gets children."""
    m, before = window.measurements[k], window.states[s, k - 1]
    if before.fault[m.source] == IS_SCATTERING:
        return bool(m.kind == POSE or update_of(window, s, k).nis <= c.gate_limits[1])
    if _is_contradicted(window, s, k, c) or is_offset_jump_due(window, s, k, c):
        return True
    if has_hidden_change(window, s, k, c) or _log_odds_of_stamp_delay(m, before, c) > 0.0:
        return True
    if has_failed_unit(before) and m.kind in (POSE, VELOCITY):
        return True
    if has_wandering_offset(before, m.source, c) or has_hidden_heading_fault(before, m.source):
        return True
    if _is_slip_implausible(window, s, k, c) or _is_turn_cost_due(window, s, k, c):
        return True
    shows_motion = m.kind in (POSE, VELOCITY) and is_trusted(before, m.source, m.kind)
    if shows_motion and _is_repeated_in_motion(window, s, k, c):
        return True
    return _is_sum_contradicted(window, s, k, c)


@compiled
def _is_sum_contradicted(window: Window, s: int, k: int, c: Config) -> bool:
    """Whether recent displacements or velocities up to measurement k contradict branch s in their sum."""
    m, before = window.measurements[k], window.states[s, k - 1]
    shows = m.kind == VELOCITY and is_trusted(before, m.source, VELOCITY)
    if m.kind == POSE:
        shows = is_displacement_measured(before.fault[m.source])
    return bool(shows and window.branches[s, k].cusum.max() > c.bank.cusum_limit)


@compiled
def _log_odds_of_stamp_delay(m: MeasurementRecord, before: State, c: Config) -> float:
    """ln of the odds that all fixes up to this one have late or early stamps; −∞ of other measurements."""
    is_fix = m.kind == POSE and is_trusted(before, m.source, POSE) and not is_stuck(before, c)
    return log_odds_of_delay(before, m.source, c) if is_fix else -math.inf


@compiled
def _is_sensor_moving(before: State, source: int, c: Config) -> bool:
    """Whether the sensor of a source moves, so that its fixes cannot be identical."""
    return bool(before.motion.motion != _STANDING or is_moved_by_swing(before, source, c))


@compiled
def _is_repeated_in_motion(window: Window, s: int, k: int, c: Config) -> bool:
    """Whether measurement k equals the previous one although branch s has moved its sensor."""
    is_moving = _is_sensor_moving(window.states[s, k - 1], window.measurements[k].source, c)
    return bool(is_moving and is_repeated(update_of(window, s, k), c))


@compiled
def _make_children(window: Window, p: int, k: int, c: Config) -> None:
    """Add the children of branch p at measurement k."""
    m, before = window.measurements[k], window.states[p, k - 1]
    source, fault, contradicts = m.source, before.fault[m.source], _is_contradicted(window, p, k, c)
    _make_recovery_children(window, p, k, contradicts, c)
    if fault == IS_SCATTERING or not _is_likely(window, p, k, c):
        return
    _make_unit_recovery_children(window, p, k, c)
    for event in (SLIPPED, BIASED):
        odds = log_odds_of_hidden_change(window, p, k, event, c)
        if odds > -c.bank.spawns:
            add_child(window, p, k, event, source, 0, False, odds, c)
    failed = log_odds_of_hidden_change(window, p, k, FAILED, c)
    if failed > -c.bank.spawns:
        add_child(window, p, k, FAILED, TRACKS, HIDDEN, True, failed, c)
    if _is_turn_cost_due(window, p, k, c):
        make_one_sprocket_children(window, p, k, 0.0, c)
        make_failed_unit_child(window, p, k, GYROS, 0.0, c)
    late = _log_odds_of_stamp_delay(m, before, c)
    if late > 0.0:
        add_child(window, p, k, LATE, source, 0, False, late, c)
    if m.kind == POSE:
        _make_fix_children(window, p, k, contradicts, c)
    elif contradicts:
        _make_angle_children(window, p, k, c)
    elif m.kind == VELOCITY and fault == IS_HEALTHY and _is_repeated_in_motion(window, p, k, c):
        add_child_at_measurement(window, p, k, REPEATS, source, 0.0, c)
    if _can_have_earlier_event(window, p, k, c):
        make_earlier_children(window, p, k, _is_slip_implausible(window, p, k, c), c)


@compiled
def _can_have_earlier_event(window: Window, p: int, k: int, c: Config) -> bool:
    """Whether an event since the snapshot of p, a likely branch, may explain measurement k."""
    m, before = window.measurements[k], window.states[p, k - 1]
    if m.kind not in (POSE, VELOCITY) or before.fault[m.source] == IS_SCATTERING:
        return False
    shows = _is_sum_contradicted(window, p, k, c)
    return bool(shows or _is_contradicted(window, p, k, c) or _is_slip_implausible(window, p, k, c))


@compiled
def _is_slip_implausible(window: Window, p: int, k: int, c: Config) -> bool:
    """Whether k is a fix, and the slip of branch p is 1 σ outside its physical range before it."""
    is_fix = window.measurements[k].kind == POSE
    return bool(is_fix and slip_range_penalty(window.states[p, k - 1], c) > 0.5)


@compiled
def _is_turn_cost_due(window: Window, p: int, k: int, c: Config) -> bool:
    """Whether an implausible turn has cost branch p another multiple of what a failed sprocket would."""
    failed = -c.log_rates[FAILED, TRACKS]
    now, before = window.branches[p, k].turn_cost // failed, window.branches[p, k - 1].turn_cost // failed
    return bool(window.measurements[k].kind in (POSE, VELOCITY) and now > before)


@compiled
def _make_scatter_end_children(window: Window, p: int, k: int, c: Config) -> None:
    """Add children in which scattering has ended, with or without a jump of the machine meanwhile."""
    m, before = window.measurements[k], window.states[p, k - 1]
    add_child_at_measurement(window, p, k, RECOVERED, m.source, 0.0, c)
    if m.kind == POSE:
        scattered = math.log(max((m.stamp_ns - before.fault_ns[m.source]) * 1e-9, c.bank.shortest_time))
        moved = scattered + c.log_rates[MOVED, m.source] + _log_odds_of_any_size(m, before, c)
        ended = log_measurement_interval(window, p, k, c) + c.log_rates[RECOVERED, m.source]
        add_child(window, p, k, MOVED, m.source, 0, False, ended + moved, c)


@compiled
def _make_recovery_children(window: Window, p: int, k: int, contradicts: bool, c: Config) -> None:
    """Add children in which a fault of the source has ended."""
    m, before = window.measurements[k], window.states[p, k - 1]
    source, fault = m.source, before.fault[m.source]
    if fault == IS_SCATTERING:
        _make_scatter_end_children(window, p, k, c)
        return
    recovered = log_measurement_interval(window, p, k, c) + c.log_rates[RECOVERED, source]
    if fault != IS_HEALTHY and (contradicts or has_wandering_offset(before, source, c)):
        add_child(window, p, k, RECOVERED, source, 0, False, recovered, c)
    if before.heading_fault[source] != IS_HEALTHY and (
        contradicts or has_hidden_heading_fault(before, source)
    ):
        add_child(window, p, k, RECOVERED, source, ANGLES, False, recovered, c)
        if fault != IS_HEALTHY:
            add_angle_child(window, p, k, RECOVERED, 0, RECOVERED, ANGLES, recovered, c)
    make_offset_jump_children(window, p, k, c)


@compiled
def _make_unit_recovery_children(window: Window, p: int, k: int, c: Config) -> None:
    """Add children in which a motion sensor has measured the motion again since the snapshot."""
    before = window.states[p, k - 1]
    for unit in range(MOST_SOURCES):
        if window.measurements[k].kind not in (POSE, VELOCITY) or not is_failed(before.fault[unit]):
            continue
        if not _can_recover(before, unit, c):
            continue
        if unit == TRACKS:
            make_recovered_sector_children(window, p, k, c)
        if unit != TRACKS or not is_heading_unknown(before):
            add_child_since_snapshot(window, p, k, RECOVERED, unit, 0, 0.0, c)


@compiled
def _can_recover(state: State, unit: int, c: Config) -> bool:
    """Whether a failed unit may measure the motion again: failed encoders often show 0."""
    return unit != TRACKS or not shows_standstill(state.sample, c)


@compiled
def _make_fix_children(window: Window, p: int, k: int, contradicts: bool, c: Config) -> None:
    """Add children with an event just before a fix."""
    before, update = window.states[p, k - 1], update_of(window, p, k)
    source = window.measurements[k].source
    if is_trusted(before, source, POSE) and _is_sensor_moving(before, source, c):
        if is_repeated(update, c):
            add_child_at_measurement(window, p, k, REPEATS, source, 0.0, c)
        if contradicts and can_be_repetition(update, c) and are_track_speeds_measured(before):
            add_child_at_measurement(window, p, k, STAYS, source, 0.0, c)
    if contradicts:
        _make_jump_children(window, p, k, c)


@compiled
def _make_jump_children(window: Window, p: int, k: int, c: Config) -> None:
    """Add children with a jump of source or machine just before a fix that contradicts branch p."""
    m, before, update = window.measurements[k], window.states[p, k - 1], update_of(window, p, k)
    source, size = m.source, _log_odds_of_any_size(m, before, c)
    if is_trusted(before, source, POSE):
        if update.outcome != _GATED:
            add_child(window, p, k, OUTLIER, source, 0, False, 0.0, c)
        if before.sole_fix_source != source:
            add_child_at_measurement(window, p, k, SCATTERS, source, 0.0, c)
            add_child_at_measurement(window, p, k, OFFSET, source, size, c)
            if update.dof > YAW and before.heading_fault[source] == IS_HEALTHY:
                _make_heading_offset_child(window, p, k, c)
                off = log_measurement_interval(window, p, k, c) + c.log_rates[OFFSET, source] + size
                add_angle_child(window, p, k, OFFSET, 0, HEADING_OFF, 0, off, c)
    elif before.fault[source] == IS_OFFSET:  # a different offset
        add_child_at_measurement(window, p, k, OFFSET, source, size, c)
    moved = log_measurement_interval(window, p, k, c) + c.log_rates[MOVED, source]
    if before.sole_fix_source == source:  # the position depends on one fix, which may be the outlier too
        moved = max(moved, math.log(before.outlier_share[source]))
    add_child(window, p, k, MOVED, source, 0, False, size + moved, c)
    if update.dof > YAW and before.heading_fault[source] == IS_HEALTHY and not is_heading_carried(before, c):
        turned = size + moved - math.log(HEADINGS)
        add_angle_child(window, p, k, MOVED, 0, TURNED, MEASURED, turned, c)
    if (
        distance_since_snapshot(window, p, k) > c.bank.least_distance
        and update.stated <= c.events.skid_stddev
    ):
        skidded = (
            min(log_measurement_interval(window, p, k, c), math.log(c.events.skid_time))
            + c.log_rates[SKIDDED, source]
        )
        penalty = correlated_penalty(window, p, k, c)
        add_child(window, p, k, SKIDDED, source, 0, False, skidded - penalty, c)


@compiled
def _make_heading_offset_child(window: Window, p: int, k: int, c: Config) -> None:
    """Add children in which the angles of the source are off, if the state has their offset."""
    source = window.measurements[k].source
    if c.yaw_offsets[source] >= 0:
        for event in (HEADING_OFF, HEADING_WANDERS):
            add_child_at_measurement(window, p, k, event, source, 0.0, c)
        if window.measurements[k].kind == POSE and is_heading_repeated(update_of(window, p, k), c):
            add_child_at_measurement(window, p, k, HEADING_REPEATS, source, 0.0, c)


@compiled
def _log_odds_of_any_size(m: MeasurementRecord, before: State, c: Config) -> float:
    """ln of the density of a jump of any size to a fix, over that of the position as the event resets it."""
    squared = squared_jump(m, before)
    any_size = log_density_of_any_size(max(squared, c.bank.least_jump**2), c)
    return any_size + math.log(2.0 * math.pi * unknown_position_stddev(squared) ** 2)


@compiled
def _make_angle_children(window: Window, p: int, k: int, c: Config) -> None:
    """Add the children of branch p at a heading, a swing angle or a velocity that contradicts it."""
    m, before, update = window.measurements[k], window.states[p, k - 1], update_of(window, p, k)
    source = m.source
    if is_trusted(before, source, m.kind):
        if update.outcome != _GATED:
            add_child(window, p, k, OUTLIER, source, 0, False, 0.0, c)
        add_child_at_measurement(window, p, k, SCATTERS, source, 0.0, c)
        if is_repeated(update, c):
            add_child_at_measurement(window, p, k, REPEATS, source, 0.0, c)
        _make_heading_offset_child(window, p, k, c)
        if m.kind == VELOCITY and has_recent_fix(before, m, c):
            add_child_at_measurement(window, p, k, OFFSET, source, 0.0, c)
    jumped = log_measurement_interval(window, p, k, c) + c.log_rates[MOVED, source]
    if m.kind == ON_SWING or (m.kind == HEADING and is_free_to_swing(before, source, c)):
        add_child(window, p, k, SWUNG, source, MEASURED, False, jumped, c)
    if m.kind in (HEADING, ON_SWING):
        make_source_fault_children(window, p, k, 0.0, c)
    if m.kind == HEADING:
        add_child(window, p, k, TURNED, source, MEASURED, False, jumped, c)
        for unit in (GYROS, BRAKE):
            make_failed_unit_child(window, p, k, unit, 0.0, c)
