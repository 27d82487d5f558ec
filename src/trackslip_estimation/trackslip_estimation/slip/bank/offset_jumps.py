# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Try whether a lasting offset of a source is a jump of the machine; compiled.

An offset of positions and headings by one fault is no jump while gyros measure all turns.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.bank.child import add_angle_child, add_child
from trackslip_estimation.slip.bank.course import is_heading_carried
from trackslip_estimation.slip.events import ANGLES, BECAME_JUMP, MOVED, OFFSET
from trackslip_estimation.slip.models.model import YAW
from trackslip_estimation.slip.records import MOST_SOURCES, POSE
from trackslip_estimation.slip.source_faults import (
    IS_HEADING_OFF,
    IS_HEADING_WANDERING,
    IS_OFFSET,
    IS_WANDERING,
    has_fault,
    is_same_fault,
    is_trusted,
)
from trackslip_estimation.slip.source_offsets import pose_source_number
from trackslip_estimation.slip.weighing import contradiction_limit
from trackslip_estimation.slip.window import Window

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State

_HEADING_OFFSETS = IS_HEADING_OFF, IS_HEADING_WANDERING
_WANDER_TIMES = 3.0  # fault times: an offset that wandered may stay for a while, and return


@compiled
def is_offset_jump_due(window: Window, s: int, k: int, c: Config) -> bool:
    """Whether to try an offset of the source's positions or angles in branch s as a jump."""
    return bool(_is_position_jump_due(window, s, k, c) or _is_heading_jump_due(window, s, k, c))


@compiled
def make_offset_jump_children(window: Window, p: int, k: int, c: Config) -> None:
    """Add the children of branch p in which an offset is a jump, where it is due."""
    source, before = window.measurements[k].source, window.states[p, k - 1]
    if _is_heading_jump_due(window, p, k, c):
        prior = _log_prior_of_jump(window, k, before.heading_fault_ns[source], c)
        if is_same_fault(before, source):
            add_angle_child(window, p, k, BECAME_JUMP, 0, BECAME_JUMP, ANGLES, prior, c)
        else:
            add_child(window, p, k, BECAME_JUMP, source, ANGLES, False, prior, c)
    elif _is_position_jump_due(window, p, k, c):
        prior = _log_prior_of_jump(window, k, before.fault_ns[source], c)
        add_child(window, p, k, BECAME_JUMP, source, 0, False, prior, c)


@compiled
def _log_prior_of_jump(window: Window, k: int, since_ns: int, c: Config) -> float:
    """ln of the prior of an offset since ``since_ns`` as a jump: it does not pay for its duration."""
    m = window.measurements[k]
    age = (m.stamp_ns - since_ns) * 1e-9 / c.events.fault_time
    return float(age + c.log_rates[MOVED, m.source] - c.log_rates[OFFSET, m.source])


@compiled
def _is_position_jump_due(window: Window, s: int, k: int, c: Config) -> bool:
    """Whether to try the offset of the source's positions as a jump, once each fault time or three."""
    source, before = window.measurements[k].source, window.states[s, k - 1]
    fault, since_ns = before.fault[source], before.fault_ns[source]
    if s != 0 or fault not in (IS_OFFSET, IS_WANDERING) or pose_source_number(source, c) < 0:
        return False
    if is_same_fault(before, source):  # not without its heading
        return False
    for other in range(MOST_SOURCES):
        shows = other != source and pose_source_number(other, c) >= 0 and is_trusted(before, other, POSE)
        if shows and before.consistent_ns[other] > since_ns and _is_precise(before, other, source, c):
            return False  # this other source measures no jump
    return _begins_period(window, s, k, since_ns, _WANDER_TIMES if fault == IS_WANDERING else 1.0, c)


@compiled
def _is_precise(state: State, other: int, source: int, c: Config) -> bool:
    """Whether fixes of an ``other`` source would contradict a jump by the offset of ``source``."""
    wander, first = state.offsets[pose_source_number(source, c)].wander, c.offsets[source]
    east, north = state.mean[first], state.mean[first + 1]
    if state.fault[source] == IS_WANDERING:
        east, north = wander.east, wander.north
    by_other = state.offsets[pose_source_number(other, c)]
    variance = by_other.stddev * by_other.stddev + by_other.variance
    return bool(east * east + north * north > contradiction_limit(YAW, c) * variance)


@compiled
def _is_heading_jump_due(window: Window, s: int, k: int, c: Config) -> bool:
    """Whether to try the offset of the source's angles as a jump, once each fault time."""
    source, before = window.measurements[k].source, window.states[s, k - 1]
    since_ns = before.heading_fault_ns[source]
    if s != 0 or before.heading_fault[source] not in _HEADING_OFFSETS:
        return False
    if is_same_fault(before, source) and is_heading_carried(before, c):
        return False
    for other in range(MOST_SOURCES):
        same_angle = c.yaw_offsets[other] >= 0 and c.measures_swing[other] == c.measures_swing[source]
        shows = other != source and same_angle and not has_fault(before, other)
        if shows and before.consistent_ns[other] > since_ns:
            return False  # this other source measures no jump
    return _begins_period(window, s, k, since_ns, 1.0, c)


@compiled
def _begins_period(window: Window, s: int, k: int, since_ns: int, times: float, c: Config) -> bool:
    """Whether measurement k is the first one of its source in another ``times`` fault times."""
    m, period_ns = window.measurements[k], times * c.events.fault_time * 1e9
    latest_ns = window.states[s, k - 1].weighed_ns[m.source]
    periods = math.floor((m.stamp_ns - since_ns) / period_ns)
    return bool(periods > math.floor((latest_ns - since_ns) / period_ns))
