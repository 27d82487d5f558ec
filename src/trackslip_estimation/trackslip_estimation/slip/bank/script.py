# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Record the events of a branch, and replay them in a scripted run; compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.bank.event_effects import apply_event
from trackslip_estimation.slip.records import HISTORY
from trackslip_estimation.slip.source_faults import IS_HEALTHY, IS_IGNORED
from trackslip_estimation.slip.window import Window

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import Branch, EventRecord, MeasurementRecord


@compiled
def record_event(
    branch: Branch,
    event: int,
    source: int,
    part: int,
    value: float,
    explained: MeasurementRecord,
    step: MeasurementRecord,
    after: int,
) -> EventRecord:
    """Add an event that explains a measurement to a branch; return it. ``step``: where it opens states."""
    e = branch.history[branch.events % HISTORY]
    e.event, e.source, e.part, e.value, e.decided_ns = event, source, part, value, explained.stamp_ns
    e.stamp_ns, e.step_kind, e.step_source, e.after = step.stamp_ns, step.kind, step.source, after
    branch.events += 1
    return e


@compiled
def apply_scripted_events(window: Window, k: int, after: int, c: Config) -> None:
    """Apply the script's events before (0) or ``after`` (1) the step to measurement k to the only branch."""
    script, status, m = window.script, window.status[0], window.measurements[k]
    state, update = window.states[0, k], window.updates[k]
    for s in range(len(state.fault)):
        if after == 1 and state.fault[s] == IS_IGNORED:
            state.fault[s] = IS_HEALTHY
    while status.played < script.size:
        e = script[status.played]
        if e.stamp_ns != m.stamp_ns or e.step_kind != m.kind or e.step_source != m.source or e.after != after:
            return
        update.event = e.event
        update.reset_states |= apply_event(state, e, c)
        status.played += 1
