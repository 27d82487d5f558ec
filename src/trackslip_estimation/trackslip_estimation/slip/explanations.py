# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Describe the bank's branches to the user: possible events, their probabilities, and accepted events."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from trackslip_estimation.slip.events import Event
from trackslip_estimation.slip.models.speed import COMMON_SLIP
from trackslip_estimation.slip.records import HISTORY
from trackslip_estimation.slip.source_faults import SourceFault
from trackslip_estimation.slip.window import Window

if TYPE_CHECKING:
    from trackslip_estimation.slip.records import Branch, EventRecord, State

_RECENT_NS = 30_000_000_000  # age up to which an event is an explanation; a machine is stuck until it grips
_STUCK = 0.8  # i₀ of a machine that is stuck
_LEAST_PROBABILITY = 0.005  # smallest probability of an explanation
_CALM_PROBABILITY = 0.9  # probability of no event from which on no explanations compete
_MOST_NAMED = 3  # largest number of explanations by name
_COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
_MOST_LISTED = 8  # latest events on /diagnostics
NOTHING_HAPPENED = "nothing happened"
EXPLANATIONS = "explanations"  # key of a sentence on /diagnostics


class Explanation(NamedTuple):
    """One of the competing explanations."""

    text: str  # "gnss_pose is 1.0 m off"
    probability: float
    since_ns: int  # stamp of the explained measurement
    is_ongoing: bool = True  # False: an event at that time


class CompetingExplanations(NamedTuple):
    """Competing explanations at one time."""

    stamp_ns: int
    explanations: Sequence[Explanation]  # most probable first

    @property
    def number_competing(self) -> int:
        """Number of explanations that compete; 0 if most probably nothing happened."""
        calm = sum(e.probability for e in self.explanations if e.text == NOTHING_HAPPENED)
        return len(self.explanations) if self.explanations and calm < _CALM_PROBABILITY else 0

    @property
    def seconds(self) -> float:
        """Time since the latest measurement that an event explains, s."""
        since_ns = max(
            (e.since_ns for e in self.explanations if e.text != NOTHING_HAPPENED), default=self.stamp_ns
        )
        return max(self.stamp_ns - since_ns, 0) * 1e-9

    @property
    def text(self) -> str:
        """``sentence`` of the explanations; empty if none compete."""
        return sentence(self.explanations, self.seconds) if self.number_competing else ""


class AcceptedEvent(NamedTuple):
    """An event of the most probable branch."""

    stamp_ns: int  # of the explained measurement
    event: Event
    source: str  # name of the affected source
    probability: float  # of the branch, at its latest evaluation
    is_sector: bool = False  # whether the event assigned a sector to an unknown heading
    is_swing_source: bool = False  # whether the source measures swing angles

    @property
    def text(self) -> str:
        """The event in the user's words."""
        return (
            _HEADING_WAS_UNKNOWN
            if self.is_sector
            else _event_text(self.event, self.source, self.is_swing_source)
        )


class Sources(NamedTuple):
    """Sources of an estimator."""

    names: Mapping[int, str]  # number → name
    offsets: Sequence[int]  # first state of the position or velocity offset, by number; −1: none
    yaw_offsets: Sequence[int]  # state of the offset of headings or swing angles, by number; −1: none
    velocities: Collection[str]  # names of sources whose offset is in m/s
    swings: Collection[str]  # names of sources of swing angles


_FINDING_HEADING, _HEADING_WAS_UNKNOWN = "the heading is being found from fixes", "the heading was unknown"
_JUMPS = (Event.MOVED, Event.BECAME_JUMP, Event.TURNED, Event.SWUNG)
_OFFSETS = (Event.OFFSET, Event.HEADING_OFF, Event.HEADING_WANDERS)
_FAULTS = (
    *_OFFSETS,
    Event.WANDERS,
    Event.REPEATS,
    Event.HEADING_REPEATS,
    Event.STAYS,
    Event.SCATTERS,
    Event.FAILED,
)
_ENDED = (*_FAULTS, Event.OUTLIER, Event.RECOVERED)  # of a branch in which no source is at fault
_MISCOUNTS = {
    SourceFault.COUNTS_HALF: "{source} count half of the distance",
    SourceFault.COUNTS_BACKWARDS: "{source} count backwards",
    SourceFault.LEFT_FAILED: "the left sprocket and motion disagree",
    SourceFault.RIGHT_FAILED: "the right sprocket and motion disagree",
}
_FAILURES, BRAKE_NAME = "{source} and motion disagree", "swing brake"
_BRAKE_WORDS = {
    Event.FAILED: "the upper structure swings while the tracks drive",
    Event.RECOVERED: "the upper structure has stopped",
}
_WORDS = {
    Event.NONE: NOTHING_HAPPENED,
    Event.OUTLIER: "one measurement of {source} is an outlier",
    Event.OFFSET: "{source} is off",
    Event.HEADING_OFF: "angles of {source} are off",
    Event.HEADING_WANDERS: "angles of {source} drift",
    Event.WANDERS: "{source} drifts",
    Event.REPEATS: "{source} repeats one measurement",
    Event.HEADING_REPEATS: "{source} repeats one heading",
    Event.STAYS: "{source} is frozen",
    Event.SCATTERS: "{source} scatters",
    Event.RECOVERED: "{source} has recovered",
    Event.MOVED: "the machine was moved",
    Event.TURNED: "the heading was wrong",
    Event.SWUNG: "the swing angle jumped",
    Event.SLIPPED: "the slip of both tracks changed",
    Event.SLID: "the machine slides",
    Event.SKIDDED: "the machine skidded",
    Event.FAILED: _FAILURES,
    Event.BIASED: "the bias of the gyro changed",
    Event.LATE: "stamps of {source} are late or early",
    Event.NOISE: "{source} is noisier than before",
    Event.BECAME_JUMP: "the machine was moved",
}
_PERMANENT_OFFSET = "angles of {source} have a permanent offset"


def describe_branches(window: Window, sources: Sources) -> list[Explanation]:
    """Explanations of the newest row, most probable first; those that differ in numbers only are merged."""
    last = window.count - 1
    weights = np.exp(window.branches["weight"][: int(window.counts[last]), last])
    probabilities = weights / weights.sum()
    branches = window.branches[:, last]
    is_heading_known = len({_sector_number(branches[s]) for s in range(len(weights))}) == 1
    by_kind: dict[str, Explanation] = {}
    for s in np.argsort(-probabilities, kind="stable").tolist():
        kind, explanation = _branch_explanation(
            window.states[s, last], branches[s], sources, is_heading_known
        )
        merged = by_kind.get(kind, explanation)
        by_kind[kind] = merged._replace(probability=merged.probability + float(probabilities[s]))
    likely = [e for e in by_kind.values() if e.probability >= _LEAST_PROBABILITY]
    return sorted(likely, key=lambda e: -e.probability)


def sentence(explanations: Sequence[Explanation], seconds: float) -> str:
    """As "two explanations for 2.0 s: gnss_pose is 1.0 m off (90 %), the machine was moved (10 %)"."""
    if len(explanations) == 1:
        return f"{explanations[0].text}, " + (
            f"for {seconds:.1f} s" if explanations[0].is_ongoing else f"{seconds:.1f} s ago"
        )
    count = _COUNTS[len(explanations)] if len(explanations) < len(_COUNTS) else str(len(explanations))
    named = [(e.text, e.probability) for e in explanations[:_MOST_NAMED]]
    if len(explanations) > _MOST_NAMED:
        named.append(("others", sum(e.probability for e in explanations[_MOST_NAMED:])))
    listed = ", ".join(f"{text} ({100.0 * probability:.0f} %)" for text, probability in named)
    return f"{count} explanations for {seconds:.1f} s: {listed}"


def recent_events_text(events: Sequence[AcceptedEvent]) -> str:
    """The latest events, without outliers, with stamps of the explained measurements, for /diagnostics."""
    latest = [e for e in events if e.event is not Event.OUTLIER][-_MOST_LISTED:]
    if not latest:
        return "none"
    listed = "; ".join(f"{e.stamp_ns * 1e-9:.2f} {e.text}" for e in latest)
    return f"{listed}; probability {100.0 * latest[-1].probability:.0f} %"


def accepted_events(
    branch: Branch, sources: Sources, earlier: list[AcceptedEvent], probability: float
) -> list[AcceptedEvent]:
    """Events of a record of ``BRANCH``: the latest ones from the record, earlier ones from ``earlier``.

    ``probability``: of the branch.
    """
    count = int(branch["events"])
    events = earlier[: max(min(count - HISTORY, len(earlier)), 0)]
    for n in range(max(count - HISTORY, 0), count):
        e = branch["history"][n % HISTORY]
        name = sources.names.get(int(e["source"]), "")
        details = name, probability, _is_sector_event(e), name in sources.swings
        events.append(AcceptedEvent(int(e["decided_ns"]), Event(e["event"]), *details))
    return events


def _event_text(event: Event, source: str, is_swing_source: bool) -> str:
    words = _PERMANENT_OFFSET if is_swing_source and event is Event.BECAME_JUMP else _WORDS[event]
    if source == BRAKE_NAME:
        words = _BRAKE_WORDS.get(event, words)
    return words.format(source=source)


def _is_sector_event(e: EventRecord) -> bool:
    """Whether a record of ``EVENT`` assigned a sector of an unknown heading to the branch."""
    return bool(e["event"] == Event.TURNED and e["after"] == 1)


def _sector_number(branch: Branch) -> int:
    """Number of a branch's sector of an unknown heading; −1: none in its history."""
    events = branch["history"][: int(branch["events"])]
    return next((int(e["part"]) for e in events if _is_sector_event(e)), -1)


def _branch_explanation(
    state: State, branch: Branch, sources: Sources, is_heading_known: bool
) -> tuple[str, Explanation]:
    """Kind of a branch's explanation without numbers, and the explanation, of probability 0.

    ``is_heading_known``: whether an initially unknown heading is known.
    """
    for faults, since in (("fault", "fault_ns"), ("heading_fault", "heading_fault_ns")):
        for number, fault in enumerate(state[faults].tolist()):
            if fault != SourceFault.HEALTHY and number in sources.names:
                text = _fault_text(state, number, SourceFault(fault), sources)
                kind = SourceFault.HEADING_OFF if fault == SourceFault.HEADING_WANDERS else fault
                return f"{kind} {number}", Explanation(text, 0.0, int(state[since][number]))
    count = int(branch["events"])
    events = [branch["history"][n % HISTORY] for n in range(max(count - HISTORY, 0), count)]
    slip = float(state["mean"][COMMON_SLIP])
    for n, e in reversed(list(enumerate(events))):
        event, source, stamp_ns = Event(e["event"]), int(e["source"]), int(e["decided_ns"])
        is_stuck = event is Event.SLIPPED and slip > _STUCK
        if state["stamp_ns"] - stamp_ns > _RECENT_NS and not is_stuck:
            continue
        if event is Event.SLIPPED:
            text = f"both tracks slip {100.0 * slip:.0f} %"
            text = f"the machine is stuck: {text}" if is_stuck else text
            return event.name, Explanation(text, 0.0, stamp_ns)
        if _is_sector_event(e):
            if not is_heading_known:
                return _FINDING_HEADING, Explanation(_FINDING_HEADING, 0.0, stamp_ns)
        elif event not in _ENDED:
            name = sources.names.get(source, "")
            text = _event_text(event, name, name in sources.swings)
            if event is Event.BECAME_JUMP:
                stamp_ns = _offset_start_ns(events[:n], source, stamp_ns)
            return text, Explanation(text, 0.0, stamp_ns, event not in _JUMPS)
    return NOTHING_HAPPENED, Explanation(NOTHING_HAPPENED, 0.0, int(state["stamp_ns"]))


def _offset_start_ns(events: Sequence[Any], source: int, stamp_ns: int) -> int:
    """Stamp at the start of an offset that became a jump at ``stamp_ns``."""
    starts = (e for e in reversed(events) if e["source"] == source and e["event"] in _OFFSETS)
    return int(next(starts, {"decided_ns": stamp_ns})["decided_ns"])


def _fault_text(state: State, number: int, fault: SourceFault, sources: Sources) -> str:
    name, first = sources.names[number], sources.offsets[number]
    if fault is SourceFault.FAILED:
        return _event_text(Event.FAILED, name, is_swing_source=False)
    if fault in _MISCOUNTS:
        return _MISCOUNTS[fault].format(source=name)
    if fault in (SourceFault.REPEATS, SourceFault.HEADING_REPEATS, SourceFault.STAYS, SourceFault.WANDERS):
        return _WORDS[Event[fault.name]].format(source=name)
    if fault in (SourceFault.HEADING_OFF, SourceFault.HEADING_WANDERS):
        off = abs(math.degrees(math.remainder(state["mean"][sources.yaw_offsets[number]], math.tau)))
        return f"{name} is {off:.0f} ° off"
    if fault is not SourceFault.OFFSET or first < 0:
        return f"{name} scatters"
    unit = "m/s" if name in sources.velocities else "m"
    return f"{name} is {math.hypot(*state['mean'][first : first + 2]):.1f} {unit} off"
