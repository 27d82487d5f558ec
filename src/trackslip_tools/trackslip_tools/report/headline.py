# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Key numbers of a run, for the head of a report."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.topics import SOIL
from trackslip_estimation.slip.motion import Motion
from trackslip_tools.replay.stuck_tracks import SIDES
from trackslip_tools.report.events import Event
from trackslip_tools.report.lights import Level
from trackslip_tools.report.quantities import PERCENT, found_soil
from trackslip_tools.report.run import Run
from trackslip_tools.report.timeline import stuck_track_intervals, stuck_tracks_text
from trackslip_tools.report.verdict import State, Verdict, VerdictLimits
from trackslip_tools.terminal_text import NO_VALUE

_LEAST_TIME_S = 0.5  # shortest duration of a slip, s


class Fact(NamedTuple):
    """One key number."""

    name: str
    value: str
    note: str = ""
    state: State = State.UNKNOWN  # rating, if the number can be rated


def facts_of(
    run: Run, limits: VerdictLimits, checks: Mapping[str, Verdict], events: Sequence[Event]
) -> list[Fact]:
    """All key numbers, in display order."""
    travel = run.replay.travel
    straight, turning = (travel.seconds[motion] for motion in (Motion.STRAIGHT, Motion.TURNING))
    distance, driving, standing, durations = NO_VALUE, NO_VALUE, NO_VALUE, ""
    if run.states is not None:
        distance, driving = f"{travel.distance:.1f} m", f"{straight + turning:.0f} s"
        standing = f"{travel.seconds[Motion.STANDING]:.0f} s"
        durations = f"{straight:.0f} s straight, {turning:.0f} s turning"
    return [
        _verdict_fact(checks),
        Fact("Distance", distance),
        Fact("Driving", driving, durations),
        Fact("Standing", standing),
        _largest_slip_fact(run, limits),
        _stuck_tracks_fact(run),
        _soil_fact(run),
        _events_fact(events),
    ]


def _verdict_fact(checks: Mapping[str, Verdict]) -> Fact:
    bad = [name for name, check in checks.items() if check.state is State.ATTENTION]
    count = sum(check.state is not State.UNKNOWN for check in checks.values())
    value = f"{count - len(bad)} of {count} checks ok"
    if not bad:
        return Fact("Verdict", value, "", State.OK)
    return Fact("Verdict", value, f"look at: {', '.join(bad)}", State.ATTENTION)


def _largest_slip_fact(run: Run, limits: VerdictLimits) -> Fact:
    """The largest slip among estimates whose slip has a small standard deviation."""
    name = "Largest slip"
    if run.states is None:
        return Fact(name, NO_VALUE)
    states = run.states
    sigmas = np.sqrt(np.diagonal(states.rows["slip_covariance"], axis1=1, axis2=2)[:, :2])
    is_known = states.is_moving[:, np.newaxis] & (sigmas <= limits.slip_stddev)
    never_known = f"never known to {PERCENT * limits.slip_stddev:g} %"
    if not is_known.any():
        return Fact(name, NO_VALUE, never_known)
    times = run.recording.seconds(states.path.stamps_ns)
    known_slips = np.where(is_known, states.rows["slips"][:, :2], np.nan)
    slips = np.column_stack([persistent_slips(times, of_side) for of_side in known_slips.T])
    if not np.isfinite(slips).any():
        return Fact(name, NO_VALUE, f"{never_known} for {_LEAST_TIME_S:g} s")
    sizes = np.where(np.isfinite(slips), np.abs(slips), -1.0)
    k, side = np.unravel_index(np.argmax(sizes), sizes.shape)
    note = f"{SIDES[side]} track at {times[k]:.1f} s, ± {2.0 * PERCENT * sigmas[k, side]:.0f} %"
    return Fact(name, f"{PERCENT * slips[k, side]:.0f} %", note)


def persistent_slips(times: FloatArray, slips: FloatArray) -> FloatArray:
    """(n,) medians over ``_LEAST_TIME_S`` of (n,) slips at times in s; nan if one of them is nan."""
    period = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    size = round(_LEAST_TIME_S / period) | 1 if period > 0.0 else 1
    if size >= len(slips):
        size = 1
    medians = np.median(np.lib.stride_tricks.sliding_window_view(slips, size), axis=1)
    edge = np.full(size // 2, np.nan)
    return np.concatenate((edge, medians, edge))


def _stuck_tracks_fact(run: Run) -> Fact:
    name, intervals = "Stalled or stuck", stuck_track_intervals(run)
    if not intervals:
        return Fact(name, NO_VALUE, "no hydraulics in the bag")
    troubles = stuck_tracks_text(intervals)
    return Fact(name, "yes", troubles, State.ATTENTION) if troubles else Fact(name, "no", "", State.OK)


def _soil_fact(run: Run) -> Fact:
    numbers = run.numbers.get(SOIL)
    if numbers is None:
        return Fact("Soil", NO_VALUE, "neither hydraulics nor soil estimates in the bag")
    last = numbers.rows[-1]
    note = f"K {100.0 * last['shear_modulus']:.1f} cm, F_max {1e-3 * last['max_tractive_effort']:.1f} kN"
    chances = numbers.classes_at(-1)
    if not chances:
        return Fact("Soil", "not classified", note)
    likely = max(chances, key=lambda name: chances[name])
    soil = f"{likely.replace('_', ' ')}, {PERCENT * chances[likely]:.0f} %"
    if found_soil(chances, is_identifiable=bool(last["identifiable"])):
        return Fact("Soil", soil, note)
    return Fact("Soil", "undetermined", f"likeliest: {soil}; {note}")


def _events_fact(events: Sequence[Event]) -> Fact:
    bad = sum(event.level is not Level.OK for event in events)
    return Fact("Events", str(len(events)), f"{bad} of them warnings or errors" if bad else "")
