# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Create children of a branch with an event since its snapshot; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.bank.child import (
    add_child,
    add_child_since_snapshot,
    add_sector_event,
    distance_since_snapshot,
    log_time_since_snapshot,
)
from trackslip_estimation.slip.bank.course import log_odds_against_turn
from trackslip_estimation.slip.bank.plausibility import is_stuck, is_turn_implausible, total_turn_reduction
from trackslip_estimation.slip.bank.pool import update_of
from trackslip_estimation.slip.correlated_errors import PRECISE, quality_of
from trackslip_estimation.slip.events import (
    BIASED,
    FAILED,
    HEADING_WANDERS,
    HEADINGS,
    NOISE,
    OFFSET,
    RECOVERED,
    REPEATS,
    REVERSED,
    SLID,
    SLIPPED,
    STAYS,
    STUCK,
    SWUNG,
    TURNED,
    WANDERS,
)
from trackslip_estimation.slip.levers import is_heading_undetermined, is_heading_unknown
from trackslip_estimation.slip.models.dispatch import has_velocity_errors
from trackslip_estimation.slip.models.model import YAW, X, Y
from trackslip_estimation.slip.models.slope import is_on_slope
from trackslip_estimation.slip.models.speed import COMMON_SLIP
from trackslip_estimation.slip.models.swing import is_free_to_swing, is_swing_braked
from trackslip_estimation.slip.records import (
    BRAKE,
    GYROS,
    MOST_SOURCES,
    OLDER,
    POSE,
    TRACKS,
    VELOCITY,
)
from trackslip_estimation.slip.source_faults import (
    IS_COUNTING_BACKWARDS,
    IS_COUNTING_HALF,
    IS_HEALTHY,
    IS_LEFT_FAILED,
    IS_REPEATING,
    IS_RIGHT_FAILED,
    IS_STAYING,
    can_be_repetition,
    has_fault,
    is_partly_failed,
    is_trusted,
)
from trackslip_estimation.slip.source_offsets import (
    has_mostly_correlated_errors,
    has_position_dependent_errors,
    pose_source_number,
)
from trackslip_estimation.slip.sprockets import shows_standstill
from trackslip_estimation.slip.window import Window

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, State

_LOG_SECTORS = math.log(HEADINGS)
_IMPOSSIBLE = 30.0  # ln of the odds against another heading, beyond which no other one is tried
_MISCOUNTS, _ONE_FAILED = (IS_COUNTING_HALF, IS_COUNTING_BACKWARDS), (IS_LEFT_FAILED, IS_RIGHT_FAILED)
_LOG_PARTS = math.log(2.0)
_FARTHER_FIXES = 3  # consecutive fixes that contradict the tracks: more than outliers do
_FARTHER_STDDEVS = 3.0  # standard deviations of that displacement, beyond which it is longer


@compiled
def make_earlier_children(window: Window, p: int, k: int, implausible: bool, c: Config) -> None:
    """Add children of p with an event since the snapshot; ``implausible``: its slip is outside its range."""
    m, before, update = window.measurements[k], window.states[p, k - 1], update_of(window, p, k)
    source, has_moved = m.source, distance_since_snapshot(window, p, k) > c.bank.least_distance
    penalty = correlated_penalty(window, p, k, c)
    if has_moved and has_velocity_errors(c):
        add_child_since_snapshot(window, p, k, SLIPPED, source, 0, -penalty, c)
        if not is_stuck(before, c):
            stuck = math.log(c.events.stuck_share) - penalty
            add_child_since_snapshot(window, p, k, SLIPPED, source, STUCK, stuck, c)
    if not implausible and _is_probably_outlier(window, p, k, c):
        return
    is_place = m.kind == POSE and is_trusted(before, source, POSE)
    may_stay = is_place and has_moved and are_track_speeds_measured(before)
    may_stay = may_stay and not before.is_sector and not is_heading_unknown(before)
    if may_stay and can_be_repetition(update, c):
        add_child_since_snapshot(window, p, k, STAYS, source, 0, 0.0, c)
    _make_wander_children(window, p, k, c)
    make_source_fault_children(window, p, k, penalty, c)
    if has_velocity_errors(c):
        make_failure_children(window, p, k, penalty, c)
    if before.fault[source] not in (IS_REPEATING, IS_STAYING) and update.coarse == 0:
        add_child_since_snapshot(window, p, k, NOISE, source, 0, 0.0, c)
    if is_on_slope(before) and has_velocity_errors(c):
        add_child_since_snapshot(window, p, k, SLID, source, 0, 0.0, c)


@compiled
def make_sector_children(
    window: Window, p: int, k: int, contradicts: bool, implausible: bool, c: Config
) -> None:
    """Add children of p with the heading or the swing angle in each sector of the circle.

    A heading that was known has been wrong since an event; an unknown one is in each sector as likely.
    ``contradicts``: measurement k contradicts p; ``implausible`` as above.
    """
    m, before, update = window.measurements[k], window.states[p, k - 1], update_of(window, p, k)
    source, has_moved = m.source, distance_since_snapshot(window, p, k) > c.bank.least_distance
    if not implausible and _is_probably_outlier(window, p, k, c):
        return
    if contradicts and is_free_to_swing(before, source, c):
        for part in range(HEADINGS):
            add_child_since_snapshot(window, p, k, SWUNG, source, part, -_LOG_SECTORS, c)
    if (contradicts and update.dof > YAW) or ((contradicts or implausible) and has_moved):
        prior = -_LOG_SECTORS
        if not is_heading_unknown(before):
            prior += log_time_since_snapshot(window, p, k, c) + c.log_rates[TURNED, source]
            prior -= correlated_penalty(window, p, k, c)
        for part in range(HEADINGS):
            log_prior = _log_prior_without_slip(window, p, k, prior) if part == REVERSED else prior
            against = log_odds_against_turn(window, p, k, part, c)
            if against < _IMPOSSIBLE:
                add_child(window, p, k, TURNED, source, part, True, log_prior - against, c)


@compiled
def make_recovered_sector_children(window: Window, p: int, k: int, c: Config) -> None:
    """Add children of p in which failed sprockets measure the motion again, with another heading.

    Fixes alone show the course, not whether the machine drives ahead. An unknown heading is in each sector.
    """
    source, is_unknown = window.measurements[k].source, is_heading_unknown(window.states[p, k - 1])
    for part in range(HEADINGS):
        against = log_odds_against_turn(window, p, k, part, c)
        if not (is_unknown or part == REVERSED) or against >= _IMPOSSIBLE:
            continue
        count = window.status[0].pooled
        add_child_since_snapshot(window, p, k, RECOVERED, TRACKS, 0, -_LOG_SECTORS - against, c)
        if window.status[0].pooled > count:
            add_sector_event(window, count, source, part, k, window.pool_branches[count].first, 0, c)


@compiled
def _is_probably_outlier(window: Window, p: int, k: int, c: Config) -> bool:
    """Whether a first contradiction by a source is an outlier: an earlier event affects the next one too."""
    is_first = window.branches[p, k - 1].snapshots[OLDER].fixes == 0
    is_calm = window.branches[p, k].cusum.max() <= c.bank.cusum_limit
    share = window.states[p, k - 1].outlier_share[window.measurements[k].source]
    return bool(is_first and is_calm and share > c.bank.often_outliers)


@compiled
def _make_wander_children(window: Window, p: int, k: int, c: Config) -> None:
    """Add children in which precise fixes drift: those of this source, or any ones beside a velocity."""
    m, before, now = window.measurements[k], window.states[p, k - 1], window.states[p, k]
    is_velocity = m.kind == VELOCITY and has_recent_fix(before, m, c)
    for source in range(MOST_SOURCES):
        number = pose_source_number(source, c)
        if number < 0 or not (is_velocity or source == m.source):
            continue
        stddev, is_sound = now.offsets[number].stddev, is_trusted(before, source, POSE)
        is_precise = stddev > 0.0 and quality_of(stddev, c) == PRECISE
        if is_precise and is_sound and not has_position_dependent_errors(source, c):
            add_child_since_snapshot(window, p, k, WANDERS, source, 0, 0.0, c)


@compiled
def make_source_fault_children(window: Window, p: int, k: int, penalty: float, c: Config) -> None:
    """Add children in which angles or velocities of another source are off."""
    before = window.states[p, k - 1]
    if not has_recent_fix(before, window.measurements[k], c):
        return
    for other in range(MOST_SOURCES):
        if has_fault(before, other):
            continue
        if c.yaw_offsets[other] >= 0:
            add_child_since_snapshot(window, p, k, HEADING_WANDERS, other, 0, -penalty, c)
        elif c.offsets[other] >= 0 and pose_source_number(other, c) < 0:
            add_child_since_snapshot(window, p, k, OFFSET, other, 0, -penalty, c)


@compiled
def has_recent_fix(before: State, m: MeasurementRecord, c: Config) -> bool:
    """Whether recent fixes separate wrong velocities or angles from slip or a wrong heading."""
    is_fixed = m.stamp_ns - before.fixed_ns < c.bank.look_back_time * 1e9
    return bool(is_fixed and not is_heading_undetermined(before))


@compiled
def make_failure_children(window: Window, p: int, k: int, penalty: float, c: Config) -> None:
    """Add children in which a unit has failed: sprockets, gyros, an odometry, swing brake or encoder.

    Sensors on the upper structure show a swing that a frozen encoder does not.
    """
    before = window.states[p, k - 1]
    for unit in range(MOST_SOURCES):
        make_failed_unit_child(window, p, k, unit, penalty, c)
    if not _can_show_failure(window, p, k, GYROS, c):
        return
    if c.shows_motion[GYROS] == 1 and before.fault[GYROS] == IS_HEALTHY:
        add_child_since_snapshot(window, p, k, BIASED, GYROS, 0, -penalty, c)
    for other in range(MOST_SOURCES):
        if c.measures_swing[other] == 1 and not has_fault(before, other):
            add_child_since_snapshot(window, p, k, REPEATS, other, 0, -penalty, c)
    if before.fault[TRACKS] == IS_HEALTHY and not shows_standstill(before.sample, c):
        _make_miscounting_children(window, p, k, penalty, c)
        if is_turn_implausible(before, c):
            make_one_sprocket_children(window, p, k, penalty, c)


@compiled
def make_one_sprocket_children(window: Window, p: int, k: int, penalty: float, c: Config) -> None:
    """Add children in which one sprocket has not measured the motion since the snapshot."""
    odds = _turn_cost_at_snapshot(window, p, k) - _LOG_PARTS - penalty
    for part in _ONE_FAILED:
        add_child_since_snapshot(window, p, k, FAILED, TRACKS, part, odds, c)


@compiled
def _turn_cost_at_snapshot(window: Window, p: int, k: int) -> float:
    """Cost of an implausible turn up to the snapshot, which children do not pay that explain it."""
    return float(total_turn_reduction(window.branches[p, k - 1].snapshots[OLDER].turn_cost))


@compiled
def _make_miscounting_children(window: Window, p: int, k: int, penalty: float, c: Config) -> None:
    """Add children in which the sprockets measure the motion to a factor.

    A slip nearer to −1 than to its range indicates lost counts; their event replaces the slip event in the
    prior of the branch.
    """
    slip = window.states[p, k - 1].mean[COMMON_SLIP]
    rate = c.log_rates[FAILED, TRACKS] - _LOG_PARTS
    prior = log_time_since_snapshot(window, p, k, c) + rate - penalty
    for part in _MISCOUNTS:
        log_prior = prior
        if part == IS_COUNTING_BACKWARDS:
            log_prior = _log_prior_without_slip(window, p, k, prior)
        elif part == IS_COUNTING_HALF and slip < (c.bank.least_slip - 1.0) / 2.0:
            log_prior = rate - c.log_rates[SLIPPED, window.measurements[k].source]
        add_child(window, p, k, FAILED, TRACKS, part, True, log_prior, c)


@compiled
def _log_prior_without_slip(window: Window, p: int, k: int, log_prior: float) -> float:
    """Prior of a child of p that drives in the other direction: without the slip above 1 that cost p."""
    cost = window.branches[p, k - 1].slip_cost if window.states[p, k - 1].mean[COMMON_SLIP] > 1.0 else 0.0
    return float(max(log_prior, min(log_prior + cost, 0.0)))


@compiled
def make_failed_unit_child(window: Window, p: int, k: int, unit: int, penalty: float, c: Config) -> None:
    """Add the child of p in which a unit has not measured the motion, if measurement k can show it."""
    fault = window.states[p, k - 1].fault[unit]
    if c.shows_motion[unit] == 0 or not _can_show_failure(window, p, k, unit, c):
        return
    if fault == IS_HEALTHY:
        paid = _turn_cost_at_snapshot(window, p, k) if unit in (TRACKS, GYROS) else 0.0
        add_child_since_snapshot(window, p, k, FAILED, unit, 0, paid - penalty, c)
    elif is_partly_failed(fault):  # by another fault
        add_child(window, p, k, FAILED, unit, 0, True, 0.0, c)


@compiled
def _can_show_failure(window: Window, p: int, k: int, unit: int, c: Config) -> bool:
    """Whether measurement k can show to branch p that a unit fails; with an infinite gate everything is used.

    Only sensors on the upper structure show that the swing brake fails. While the heading is unknown, no fix
    or velocity shows a failure, as a wrong heading explains the same ones, unless fixes show a longer
    displacement than the sprockets: it has the same length at any heading.
    """
    before, m = window.states[p, k - 1], window.measurements[k]
    if math.isinf(c.gate_limits[1]):
        return False
    if unit == BRAKE and not (is_swing_braked(before) and c.above[m.source] == 1):
        return False
    is_unknown = m.kind in (POSE, VELOCITY) and is_heading_undetermined(before)
    return bool(not is_unknown or (unit == TRACKS and _is_farther_than_tracks(window, p, k, c)))


@compiled
def _is_farther_than_tracks(window: Window, p: int, k: int, c: Config) -> bool:
    """Whether consecutive fixes up to k show to branch p a longer displacement than tracks with any slip."""
    snapshot, before = window.branches[p, k - 1].snapshots[OLDER], window.states[p, k - 1]
    if window.measurements[k].kind != POSE or snapshot.fixes < _FARTHER_FIXES:
        return False
    then, update = window.states[snapshot.slot, snapshot.entry], update_of(window, p, k)
    by_tracks = math.hypot(
        before.displacement[X] - then.displacement[X], before.displacement[Y] - then.displacement[Y]
    )
    by_fixes = math.hypot(
        update.measured_position[X] - then.mean[X], update.measured_position[Y] - then.mean[Y]
    )
    variance = then.covariance[X, X] + then.covariance[Y, Y] + update.stated * update.stated
    return bool(by_fixes > (1.0 - c.bank.least_slip) * by_tracks + _FARTHER_STDDEVS * math.sqrt(variance))


@compiled
def are_track_speeds_measured(before: State) -> bool:
    """Whether the track speeds are measured, not extrapolated."""
    return bool(before.time_since_sample == 0.0 and not before.coasting)


@compiled
def correlated_penalty(window: Window, p: int, k: int, c: Config) -> float:
    """Reduction of ln of the prior of machine events, if errors of the source's fixes are time-correlated."""
    is_correlated = has_mostly_correlated_errors(window.states[p, k - 1], window.measurements[k].source, c)
    return float(c.bank.correlated_penalty if is_correlated else 0.0)
