# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""State of the live page, shared by all clients: messages in, frames out.

A frame has the changes since the previous frame, as JSON values; ``whole`` has all that a new page needs.
Memory is bounded for any input and duration.
"""

import math
import threading
import uuid
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from trackslip_common.errors import InputError, printable
from trackslip_common.topics import DIAGNOSTICS, ODOMETRY, SOIL
from trackslip_common.vehicle import VehicleParameters
from trackslip_common.vehicle_files import parse_vehicle
from trackslip_tools.live import inputs
from trackslip_tools.live.encoding import finite, outline
from trackslip_tools.live.facts import facts_of
from trackslip_tools.live.fixes import Fixes, timeouts_of_text
from trackslip_tools.live.outlines import outlines_of
from trackslip_tools.live.snapshot import Snapshot
from trackslip_tools.live.strips import Strips, row_of
from trackslip_tools.report.events import CERTAIN, Event, Events
from trackslip_tools.report.lights import Level, Light, Lights, statuses_of
from trackslip_tools.report.plots import visible

MOST_POINTS = 3000  # of the path
_CLOSEST = 0.02  # least distance between points, m
PERIOD = 0.125  # s between frames
_CLASSES = 3  # shown soil classes
_LONGEST_SETUP = 900  # characters
_JUDGE = "slip_estimator"  # name of its status on /diagnostics
_SETUP = f"{_JUDGE}: setup"  # status of the setup check
_VIEW_PERIOD_S = 1.0  # interval between updates of the panels' value ranges


class Trail:
    """The path of a day in bounded memory; beyond ``most`` points, half are dropped and the spacing doubles.

    ``thinned`` counts how often this happened.
    """

    def __init__(self, most: int = MOST_POINTS, closest: float = _CLOSEST) -> None:
        self._most, self._apart = most, closest
        self.points: list[tuple[float, float]] = []  # m
        self.thinned = 0

    def add(self, x: float, y: float) -> bool:
        """Add a position, m; returns whether it is kept: far enough from the last one."""
        if not (math.isfinite(x) and math.isfinite(y)):
            return False
        if self.points and math.dist(self.points[-1], (x, y)) < self._apart:
            return False
        self.points.append((round(x, 3), round(y, 3)))
        if len(self.points) > self._most:
            self.points = self.points[::2]
            self._apart *= 2.0
            self.thinned += 1
        return True

    def __iter__(self) -> Iterator[tuple[float, float]]:
        return iter(self.points)


class LiveState:
    """Converts messages to frames, thread-safe; times are seconds of one monotonic clock."""

    def __init__(
        self, source: str, vehicle: VehicleParameters, namespace: str = "", keeps_vehicle: bool = False
    ) -> None:
        """``source``: description of the origin of messages.

        ``vehicle``: valid until a message names another, or always with ``keeps_vehicle``.
        """
        self._source, self._vehicle, self._namespace = source, vehicle, namespace
        self._keeps_vehicle = keeps_vehicle
        self._run = uuid.uuid4().hex  # lets a page detect a restart
        self._lock = threading.Lock()
        self._now, self._lights, self._events = Snapshot(), Lights(), Events()
        self._strips, self._trail = Strips(), Trail()
        self._fixes = Fixes()
        self._number, self._reported = 0, 0  # frames, events
        self._views: list[tuple[float, float]] = []
        self._viewed_s = -_VIEW_PERIOD_S
        self._frame: dict[str, Any] = {}
        self._clock = (0.0, 0.0)  # now_s, time_ms
        self._setup = ""  # result of a bag's setup check

    @property
    def pose_sources(self) -> frozenset[str]:
        """Topics of poses to subscribe to."""
        return frozenset((*inputs.POSES, *self._fixes.timeouts))

    def expect(self, timeouts: Mapping[str, float]) -> None:
        """Set the pose sources and their timeouts, s."""
        self._fixes.expect(timeouts)

    def set_setup(self, text: str) -> None:
        """Set the mistakes found by the setup check of a whole bag, which replace those on /diagnostics."""
        with self._lock:
            self._setup = printable(text, _LONGEST_SETUP)

    def process(self, topic: str, message: Any, now_s: float) -> None:
        """Process a message of one of ``inputs.TYPES``, or a pose.

        Raises:
            Exception: the message is not of the topic's type.
        """
        with self._lock:
            if topic == DIAGNOSTICS:
                self._lights.update(statuses_of(message, self._namespace), now_s)
            elif topic == inputs.VEHICLE:
                self._take_vehicle(message.data)
            elif topic == inputs.PARAMETERS:
                self._take_parameters(message.data)
            else:
                record = self._now.process(topic, message, now_s)
                if topic not in inputs.RECORDS:
                    self._fixes.add(topic, record.x, record.y, now_s)

    def tick(self, now_s: float, time_ms: float) -> dict[str, Any]:
        """The next frame; ``time_ms`` is on the displayed clock."""
        with self._lock, np.errstate(invalid="ignore", over="ignore"):  # external numbers
            self._clock, self._number = (now_s, time_ms), self._number + 1
            lights = self._lights.at(now_s)
            self._see_events(lights, now_s, time_ms)
            frame = self._momentary(lights, now_s, time_ms)
            frame["row"] = finite(self._strips.add(time_ms, self._now.columns(now_s)))
            frame |= self._places(now_s)
            frame["events"] = [_line(event) for event in self._events.kept if event.number > self._reported]
            self._reported = self._events.count
            if now_s - self._viewed_s >= _VIEW_PERIOD_S:
                self._viewed_s = now_s
                self._views = [visible(panel) for panel in self._strips.panels()]
                frame["views"] = finite(self._views)
            self._frame = frame
            return frame

    def hold(self, reason: str) -> dict[str, Any]:
        """A frame of the last values of any age, with the ``reason`` why there are no new ones."""
        with self._lock, np.errstate(invalid="ignore", over="ignore"):
            now_s, time_ms = self._clock
            self._number += 1
            self._now.keeps_last = True
            frame = self._momentary(self._lights.at(now_s), now_s, time_ms)
            frame["row"] = finite(row_of(self._now.columns(now_s)))
            self._frame = frame | {"events": [], "ended": reason}
            return self._frame

    def whole(self) -> dict[str, Any]:
        """The newest frame with the stored history; empty before the first frame."""
        with self._lock:
            if not self._frame:
                return {}
            times, values = self._strips.whole()
            kept = {
                "run": self._run,
                "source": printable(self._source),
                "times": finite(times),
                "rows": finite(values),
                "views": finite(self._views),
                "trail": list(self._trail.points),
                "fixes": list(self._fixes.kept),
                "events": [_line(event) for event in self._events.kept],
            }
            return self._frame | kept

    def _take_vehicle(self, text: str) -> None:
        if self._keeps_vehicle:
            return
        try:
            self._vehicle = parse_vehicle(text, inputs.VEHICLE)
        except InputError as error:
            self._events.add(Level.WARN, str(error), *self._clock)

    def _take_parameters(self, text: str) -> None:
        try:
            self.expect(timeouts_of_text(text, inputs.PARAMETERS))
        except InputError as error:
            self._events.add(Level.WARN, str(error), *self._clock)

    def _see_events(self, lights: list[Light], now_s: float, time_ms: float) -> None:
        self._events.see_lights(lights, now_s, time_ms)
        if all(light.name != _JUDGE for light in lights):  # else it reports lost fixes itself
            self._fixes.see(self._events, now_s, time_ms)
        for values in self._lights.news():
            self._events.see_values(values, now_s, time_ms)
        if self._now.get(SOIL, now_s) is not None:
            self._events.see_soil(self._now.classes, now_s, time_ms)

    def _momentary(self, lights: list[Light], now_s: float, time_ms: float) -> dict[str, Any]:
        """The part of a frame that is sent in full."""
        drawn = outlines_of(self._now, now_s, self._vehicle)
        likely = sorted(self._now.classes.items(), key=lambda item: -item[1])[:_CLASSES]
        has_soil = self._now.get(SOIL, now_s) is not None
        return {
            "number": self._number,
            "time": round(time_ms),
            "facts": {**facts_of(self._now, now_s), "vehicle": printable(self._vehicle.name)},
            "outlines": {name: outline(points) for name, points in drawn.items()},
            "lights": [
                [one.name, int(one.level), one.message, *finite((one.rate, one.age))] for one in lights
            ],
            "setup": self._setup or _setup_of(lights),
            "left_out": self._lights.left_out,
            "classes": [[printable(name), *finite((p,)), p >= CERTAIN] for name, p in likely]
            if has_soil
            else [],
        }

    def _places(self, now_s: float) -> dict[str, Any]:
        """The new points of the path and the new fixes."""
        gained: dict[str, Any] = {}
        odometry, thinned = self._now.get(ODOMETRY, now_s), self._trail.thinned
        if odometry is not None and self._trail.add(odometry.x, odometry.y):
            gained["path"] = self._trail.points[-1]
            if self._trail.thinned != thinned:
                gained["trail"] = list(self._trail.points)
        if news := self._fixes.news():
            gained["new_fixes"] = news
        return gained


def _setup_of(lights: list[Light]) -> str:
    """The warning of the running estimator's setup check; empty: none."""
    return next((one.message for one in lights if one.name == _SETUP and one.level is Level.WARN), "")


def _line(event: Event) -> tuple[int, float, int, str]:
    return (event.number, round(event.time_ms), int(event.level), event.text)
