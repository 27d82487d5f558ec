# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The lights of a recording: how each of them went, and what they tell, as the live page would have."""

from typing import Any

from trackslip_tools.report.events import Event, Events, same_text
from trackslip_tools.report.lights import SILENT_S, Light, Lights, statuses_of
from trackslip_tools.report.spells import Spell

_REPLAYED = ("slip_estimator", "soil_estimator")  # what they tell, a replay knows
_FALLEN_SILENT_S = 1.001 * SILENT_S  # a moment later


class LightLog:
    """Takes the messages of /diagnostics in the order of their times, s from the bag's first message."""

    def __init__(self, namespace: str = "") -> None:
        self._namespace = namespace
        self._lights, self._events = Lights(), Events()
        self._spells: dict[str, list[Spell]] = {}
        self._last_s = 0.0

    def add(self, message: Any, now_s: float) -> None:
        """One DiagnosticArray."""
        if self._spells and now_s - self._last_s > SILENT_S:
            self._see(min(self._last_s + _FALLEN_SILENT_S, now_s))
        self._lights.update(statuses_of(message, self._namespace), now_s)
        self._see(now_s)
        self._last_s = now_s

    def spells(self, stop_s: float) -> dict[str, list[Spell]]:
        """By name, in its order; of a recording until ``stop_s``."""
        if self._spells and stop_s > self._last_s:
            self._see(min(self._last_s + _FALLEN_SILENT_S, stop_s))
            self._see(stop_s)
        return {name: self._spells[name] for name in sorted(self._spells)}

    @property
    def events(self) -> list[Event]:
        """What was told; of the estimators' lights nothing, and no more than the live page keeps."""
        return list(self._events.kept)

    def _see(self, now_s: float) -> None:
        lights = self._lights.at(now_s)
        told = (light for light in lights if light.name.partition(": ")[0] not in _REPLAYED)
        self._events.see_lights(told, now_s, 1e3 * now_s)
        for light in lights:
            self._see_light(self._spells.setdefault(light.name, []), light, now_s)

    def _see_light(self, known: list[Spell], light: Light, now_s: float) -> None:
        lasts = bool(known) and known[-1].stop >= self._last_s  # else it was gone meanwhile
        if lasts:
            known[-1] = known[-1]._replace(stop=now_s)
        last = known[-1] if known else None
        if not lasts or last is None or last.state != light.level or not same_text(last.text, light.message):
            known.append(Spell(now_s, now_s, int(light.level), light.message))
