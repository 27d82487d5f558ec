# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The bank's branches in the user's words: what may have happened, how probably, and what did."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from trackslip_estimation.slip.events import Event, SourceFault
from trackslip_estimation.slip.models.speed import COMMON_SLIP
from trackslip_estimation.slip.records import HISTORY
from trackslip_estimation.slip.window import Window

_RECENT_NS = 30_000_000_000  # for which an event still explains what is seen
_LEAST = 0.005  # probability that is worth a word
AS_BEFORE = "nothing happened"


class Explanation(NamedTuple):
    """One of those that compete."""

    text: str  # "gnss_pose is 1.0 m off"
    probability: float
    since_ns: int  # stamp of the measurement that it explains


class Happened(NamedTuple):
    """An event of the most probable branch."""

    stamp_ns: int  # of the measurement that it explains
    event: Event
    source: str  # of that measurement
    probability: float  # of the branch that has it, when it was last looked at

    @property
    def text(self) -> str:
        """As a user says it."""
        return _WORDS[self.event].format(source=self.source)


class Sources(NamedTuple):
    """Of an estimator."""

    names: Mapping[int, str]  # number → name
    offsets: Sequence[int]  # places of their offsets in the state, by number; −1: it has none
    compasses: Collection[str]  # names of those whose offset is an angle


_WORDS = {
    Event.NONE: AS_BEFORE,
    Event.OUTLIER: "one measurement of {source} is an outlier",
    Event.OFFSET: "{source} is off",
    Event.REPEATS: "{source} repeats itself",
    Event.SCATTERS: "{source} scatters",
    Event.SOUND: "{source} is sound again",
    Event.MOVED: "the machine was moved",
    Event.TURNED: "the heading was wrong",
    Event.SWUNG: "the upper structure has swung",
    Event.SLIPPED: "the slip of both tracks changed",
    Event.SLID: "the machine slides",
    Event.SKIDDED: "the machine skidded",
    Event.NOISE: "{source} is noisier than before",
    Event.FOLDED: "the machine was moved",
}


def explanations(window: Window, sources: Sources) -> list[Explanation]:
    """Those of the newest row, the most probable one first; those that say the same are one."""
    last = window.count - 1
    count = int(window.counts[last])
    weights = np.exp(window.branches["weight"][:count, last])
    found: dict[str, Explanation] = {}
    for s, probability in enumerate((weights / weights.sum()).tolist()):
        text, since_ns = _text_of(window.states[s, last], window.branches[s, last], sources)
        before = found.get(text, Explanation(text, 0.0, since_ns))
        found[text] = before._replace(probability=before.probability + probability)
    likely = [e for e in found.values() if e.probability >= _LEAST]
    return sorted(likely, key=lambda e: -e.probability)


def sentence(found: Sequence[Explanation], now_ns: int) -> str:
    """For /diagnostics and pages; empty where nothing has to be explained."""
    if not found or (len(found) == 1 and found[0].text == AS_BEFORE):
        return ""
    seconds = max(now_ns - max(e.since_ns for e in found), 0) * 1e-9
    listed = ", ".join(f"{e.text} ({100.0 * e.probability:.0f} %)" for e in found)
    if len(found) == 1:
        return f"{found[0].text}, for {seconds:.1f} s"
    return f"{len(found)} explanations for {seconds:.1f} s: {listed}"


def history(branch: Any, sources: Sources, known: list[Happened], probability: float) -> list[Happened]:
    """Events of a record of ``BRANCH``, the last ones read from it, those before from ``known``.

    ``probability``: that of the branch.
    """
    count = int(branch["events"])
    found = known[: max(min(count - HISTORY, len(known)), 0)]
    for n in range(max(count - HISTORY, 0), count):
        e = branch["history"][n % HISTORY]
        name = sources.names.get(int(e["source"]), "")
        found.append(Happened(int(e["decided_ns"]), Event(e["event"]), name, probability))
    return found


def _text_of(state: Any, branch: Any, sources: Sources) -> tuple[str, int]:
    """What a branch assumes, and since when."""
    for number, fault in enumerate(state["fault"].tolist()):
        if fault != SourceFault.SOUND and number in sources.names:
            return _fault_text(state, number, SourceFault(fault), sources), int(state["fault_ns"][number])
    for n in range(int(branch["events"]) - 1, max(int(branch["events"]) - HISTORY, 0) - 1, -1):
        e = branch["history"][n % HISTORY]
        event, stamp_ns = Event(e["event"]), int(e["decided_ns"])
        if state["stamp_ns"] - stamp_ns > _RECENT_NS:
            break
        if event is Event.SLIPPED:
            return f"both tracks slip {100.0 * state['mean'][COMMON_SLIP]:.0f} %", stamp_ns
        if event not in (Event.OUTLIER, Event.SOUND):
            return _WORDS[event].format(source=sources.names.get(int(e["source"]), "")), stamp_ns
    return AS_BEFORE, int(state["stamp_ns"])


def _fault_text(state: Any, number: int, fault: SourceFault, sources: Sources) -> str:
    name, own = sources.names[number], sources.offsets[number]
    if fault is SourceFault.REPEATS:
        return f"{name} repeats itself"
    if fault is not SourceFault.OFFSET or own < 0:
        return f"{name} scatters"
    if name in sources.compasses:
        return f"{name} is {abs(math.degrees(state['mean'][own])):.0f} ° off"
    return f"{name} is {math.hypot(*state['mean'][own : own + 2]):.1f} m off"
