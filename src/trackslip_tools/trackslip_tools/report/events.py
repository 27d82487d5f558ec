# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Finds events: changes of diagnostics, gate, soil and learned quantities, each reported once."""

import re
from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from trackslip_common.errors import printable
from trackslip_tools.report.lights import SILENT_S, Level, Light, Lights, statuses_of
from trackslip_tools.report.quantities import found_soil
from trackslip_tools.report.state_intervals import StateInterval

MAX_EVENTS = 200  # kept events
_MOST_VALUES = 500  # values read per status, and entries of each memory
_REPEAT_S = 10.0  # s in which the same text is not repeated
_CLEAR_S = 5.0  # s without a rejection, after which the next one is an event
_NUMBERS = re.compile(r"[-+]?\d+(\.\d+)?")
_LESS_PROBABLE = re.compile(r"\b\w+ explanations for [\d.]+ s: ([^(]*) \(.*")
_DURATIONS = re.compile(r" for \d+(\.\d+)? s")
_LOST_PREFIX = "nothing accepted of "
_GATED_SUFFIX = " gated"  # key of a count: ``source: gated``, in earlier bags ``source gated``
_NOT_OBSERVED = "not observed yet"  # value of a learned quantity before its first observation
_REPLAYED_NODES = ("slip_estimator", "soil_estimator")  # a replay computes their events itself
_JUST_SILENT_S = 1.001 * SILENT_S  # just after the timeout


class Event(NamedTuple):
    """One entry of the event list."""

    number: int  # running number of all events
    time_ms: float  # on the displayed clock
    level: Level
    text: str


class Events:
    """Finds events; times are seconds of one monotonic clock."""

    def __init__(self) -> None:
        self.recent: deque[Event] = deque(maxlen=MAX_EVENTS)
        self.count = 0  # all events since the start
        self._conditions: dict[str, tuple[Level, str]] = {}  # name of a status → its level and message
        self._shown_s: dict[tuple[Level, str], float] = {}
        self._gated: dict[str, int] = {}
        self._rejected_s: dict[str, float] = {}
        self._unknown: set[str] = set()  # unobserved learned quantities
        self._soil = ""

    def add(self, level: Level, text: str, now_s: float, time_ms: float) -> None:
        """Add an event, unless the same text was added recently."""
        key = (level, mask_numbers(text))
        if now_s - self._shown_s.get(key, -_REPEAT_S) >= _REPEAT_S:
            self.count += 1
            self.recent.append(Event(self.count, time_ms, level, printable(text)))
        self._shown_s = {k: s for k, s in self._shown_s.items() if now_s - s < _REPEAT_S} | {key: now_s}

    def add_light_changes(self, lights: Iterable[Light], now_s: float, time_ms: float) -> None:
        """Add events for lights whose level or text changed; changed numbers within a text do not count."""
        conditions = {light.name: (light.level, light.message) for light in lights}
        for name, (level, message) in conditions.items():
            before = self._conditions.get(name, (Level.OK, ""))
            if level == before[0] and (level is Level.OK or is_same_text(message, before[1])):
                continue
            self.add(level, _event_text(name, level, message, before[1]), now_s, time_ms)
        for name, (level, _) in self._conditions.items():
            if name not in conditions and level is not Level.OK:
                self.add(Level.OK, f"{name}: recovered", now_s, time_ms)
        self._conditions = conditions

    def add_value_changes(self, values: Mapping[str, str], now_s: float, time_ms: float) -> None:
        """Add events from the values of one status: gate rejections, and newly observed quantities."""
        for key, text in list(values.items())[:_MOST_VALUES]:
            if key.endswith(_GATED_SUFFIX):
                self._add_gate_rejection(
                    key.removesuffix(_GATED_SUFFIX).removesuffix(":"), text, now_s, time_ms
                )
            elif text == _NOT_OBSERVED and len(self._unknown) < _MOST_VALUES:
                self._unknown.add(key)
            elif key in self._unknown:
                self._unknown.discard(key)
                self.add(Level.OK, f"learned: {text}", now_s, time_ms)

    def add_soil_change(
        self, classes: Mapping[str, float], now_s: float, time_ms: float, *, is_identifiable: bool
    ) -> None:
        """Add an event when another soil is found."""
        name = found_soil(classes, is_identifiable=is_identifiable)
        if name not in ("", self._soil):
            what = "soil changed to" if self._soil else "soil found:"
            self._soil = name
            self.add(Level.OK, f"{what} {name}, {100 * classes[name]:.0f} %", now_s, time_ms)

    def _add_gate_rejection(self, source: str, text: str, now_s: float, time_ms: float) -> None:
        with suppress(ValueError):
            count = int(text)
            if source not in self._gated and len(self._gated) >= _MOST_VALUES:
                return
            new_rejections = count - self._gated.get(source, count)
            self._gated[source] = count
            if new_rejections > 0:
                if now_s - self._rejected_s.get(source, -_CLEAR_S) >= _CLEAR_S:
                    self.add(Level.WARN, f"gate rejects {source}", now_s, time_ms)
                self._rejected_s[source] = now_s


def is_same_text(message: str, other: str) -> bool:
    """Whether two texts differ only in numbers and less probable explanations."""
    return mask_numbers(message) == mask_numbers(other)


def mask_numbers(text: str) -> str:
    """The text with # for numbers, and only the most probable of competing explanations."""
    return _NUMBERS.sub("#", _LESS_PROBABLE.sub(r"explanations: \1", text))


def _event_text(name: str, level: Level, message: str, before: str) -> str:
    if message.startswith(_LOST_PREFIX):
        return f"fix lost: {_DURATIONS.sub('', message.removeprefix(_LOST_PREFIX))}"
    if level is Level.OK and before.startswith(_LOST_PREFIX):
        return f"fix back: {_DURATIONS.sub('', before.removeprefix(_LOST_PREFIX))}"
    return f"{name}: {message}"


class LightLog:
    """Collects the messages of /diagnostics in order of time, s from the bag's first message."""

    def __init__(self, namespace: str = "") -> None:
        self._namespace = namespace
        self._lights, self._events = Lights(), Events()
        self._intervals: dict[str, list[StateInterval]] = {}
        self._last_s = 0.0

    def add(self, message: Any, now_s: float) -> None:
        """Add a DiagnosticArray."""
        if self._intervals and now_s - self._last_s > SILENT_S:
            self._record_lights(min(self._last_s + _JUST_SILENT_S, now_s))
        self._lights.update(statuses_of(message, self._namespace), now_s)
        self._record_lights(now_s)
        self._last_s = now_s

    def intervals(self, stop_s: float) -> dict[str, list[StateInterval]]:
        """Name → intervals of its level until ``stop_s``, sorted by name."""
        if self._intervals and stop_s > self._last_s:
            self._record_lights(min(self._last_s + _JUST_SILENT_S, stop_s))
            self._record_lights(stop_s)
        return {name: self._intervals[name] for name in sorted(self._intervals)}

    @property
    def events(self) -> list[Event]:
        """The last ``MAX_EVENTS`` events, without those of the estimators' own diagnostics."""
        return list(self._events.recent)

    def _record_lights(self, now_s: float) -> None:
        lights = self._lights.lights_at(now_s)
        others = (light for light in lights if light.name.partition(": ")[0] not in _REPLAYED_NODES)
        self._events.add_light_changes(others, now_s, 1e3 * now_s)
        for light in lights:
            self._record_light(self._intervals.setdefault(light.name, []), light, now_s)

    def _record_light(self, intervals: list[StateInterval], light: Light, now_s: float) -> None:
        if intervals and intervals[-1].stop >= self._last_s:  # the name was present without interruption
            last = intervals[-1] = intervals[-1]._replace(stop=now_s)
            is_same = last.state == light.level and is_same_text(last.text, light.message)
        else:
            is_same = False
        if not is_same:
            intervals.append(StateInterval(now_s, now_s, int(light.level), light.message))
