# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""State of the live page, shared by all clients: messages in, frames out.

A frame has the changes since the previous frame, as JSON values. ``full_state`` has all that a new page
needs. Memory is bounded for any input and duration.
"""

import math
import threading
import uuid
from collections.abc import Mapping
from typing import Any

import numpy as np

from trackslip_common.errors import InputError, printable
from trackslip_common.topics import DIAGNOSTICS, ODOMETRY, SOIL
from trackslip_common.vehicle import VehicleParameters
from trackslip_common.vehicle_files import parse_vehicle
from trackslip_tools.live import inputs
from trackslip_tools.live.encoding import outline_coordinates, replace_nonfinite
from trackslip_tools.live.fixes import Fixes, timeouts_of_text
from trackslip_tools.live.snapshot import Snapshot, facts_of, outlines_of
from trackslip_tools.live.strips import Strips, row_of
from trackslip_tools.report.events import Event, Events
from trackslip_tools.report.lights import Level, Light, Lights, statuses_of
from trackslip_tools.report.plots import visible_range
from trackslip_tools.report.quantities import found_soil

MOST_POINTS = 3000  # of the path
_MIN_SPACING = 0.02  # least distance between points, m
PERIOD = 0.125  # s between frames
_MAX_CLASSES = 3  # shown soil classes
_LONGEST_SETUP = 900  # characters
_ESTIMATOR = "slip_estimator"  # name of its status on /diagnostics
_SETUP_STATUS = f"{_ESTIMATOR}: setup"  # status of the setup check
_VIEW_PERIOD_S = 1.0  # interval between updates of the panels' value ranges


class Trail:
    """The path of a day in bounded memory; beyond ``most`` points, half are dropped and the spacing doubles.

    ``thinning_count`` counts how often this happened.
    """

    def __init__(self, most: int = MOST_POINTS, closest: float = _MIN_SPACING) -> None:
        self._most, self._spacing = most, closest
        self.points: list[tuple[float, float]] = []  # m
        self.thinning_count = 0

    def add(self, x: float, y: float) -> bool:
        """Add a position, m; returns whether it is kept: far enough from the last one."""
        if not (math.isfinite(x) and math.isfinite(y)):
            return False
        if self.points and math.dist(self.points[-1], (x, y)) < self._spacing:
            return False
        self.points.append((round(x, 3), round(y, 3)))
        if len(self.points) > self._most:
            self.points = self.points[::2]
            self._spacing *= 2.0
            self.thinning_count += 1
        return True


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

    def set_timeouts(self, timeouts: Mapping[str, float]) -> None:
        """Set the pose sources and their timeouts, s."""
        self._fixes.set_timeouts(timeouts)

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
                self._process_vehicle(message.data)
            elif topic == inputs.PARAMETERS:
                self._process_parameters(message.data)
            else:
                record = self._now.process(topic, message, now_s)
                if topic not in inputs.RECORDS:
                    self._fixes.add(topic, record.x, record.y, now_s)

    def next_frame(self, now_s: float, time_ms: float) -> dict[str, Any]:
        """The next frame; ``time_ms`` is on the displayed clock."""
        with self._lock, np.errstate(invalid="ignore", over="ignore"):  # external numbers
            self._clock, self._number = (now_s, time_ms), self._number + 1
            lights = self._lights.lights_at(now_s)
            self._update_events(lights, now_s, time_ms)
            frame = self._current_values(lights, now_s, time_ms)
            frame["row"] = replace_nonfinite(self._strips.add(time_ms, self._now.columns(now_s)))
            frame |= self._new_positions(now_s)
            frame["events"] = [
                _event_row(event) for event in self._events.recent if event.number > self._reported
            ]
            self._reported = self._events.count
            if now_s - self._viewed_s >= _VIEW_PERIOD_S:
                self._viewed_s = now_s
                self._views = [visible_range(panel) for panel in self._strips.panels()]
                frame["views"] = replace_nonfinite(self._views)
            self._frame = frame
            return frame

    def final_frame(self, reason: str) -> dict[str, Any]:
        """A frame of the last values of any age, with the ``reason`` why there are no new ones."""
        with self._lock, np.errstate(invalid="ignore", over="ignore"):
            now_s, time_ms = self._clock
            self._number += 1
            self._now.keeps_last = True
            frame = self._current_values(self._lights.lights_at(now_s), now_s, time_ms)
            frame["row"] = replace_nonfinite(row_of(self._now.columns(now_s)))
            self._frame = frame | {"events": [], "ended": reason}
            return self._frame

    def full_state(self) -> dict[str, Any]:
        """The newest frame with the stored history; empty before the first frame."""
        with self._lock:
            if not self._frame:
                return {}
            times, values = self._strips.stored_rows()
            history = {
                "run": self._run,
                "source": printable(self._source),
                "times": replace_nonfinite(times),
                "rows": replace_nonfinite(values),
                "views": replace_nonfinite(self._views),
                "trail": list(self._trail.points),
                "fixes": list(self._fixes.shown),
                "events": [_event_row(event) for event in self._events.recent],
            }
            return self._frame | history

    def _process_vehicle(self, text: str) -> None:
        if self._keeps_vehicle:
            return
        try:
            self._vehicle = parse_vehicle(text, inputs.VEHICLE)
        except InputError as error:
            self._events.add(Level.WARN, str(error), *self._clock)

    def _process_parameters(self, text: str) -> None:
        try:
            self.set_timeouts(timeouts_of_text(text, inputs.PARAMETERS))
        except InputError as error:
            self._events.add(Level.WARN, str(error), *self._clock)

    def _update_events(self, lights: list[Light], now_s: float, time_ms: float) -> None:
        self._events.add_light_changes(lights, now_s, time_ms)
        if all(light.name != _ESTIMATOR for light in lights):  # else it reports lost fixes itself
            self._fixes.add_silence_events(self._events, now_s, time_ms)
        for values in self._lights.pop_new_values():
            self._events.add_value_changes(values, now_s, time_ms)
        if (soil := self._now.get(SOIL, now_s)) is not None:
            classes, is_identifiable = self._now.classes, bool(soil.identifiable)
            self._events.add_soil_change(classes, now_s, time_ms, is_identifiable=is_identifiable)

    def _current_values(self, lights: list[Light], now_s: float, time_ms: float) -> dict[str, Any]:
        """The part of a frame that is sent in full."""
        outlines = outlines_of(self._now, now_s, self._vehicle)
        soil = self._now.get(SOIL, now_s)
        classes = self._now.classes if soil is not None else {}
        found = found_soil(classes, is_identifiable=soil is not None and bool(soil.identifiable))
        likely = sorted(classes.items(), key=lambda item: -item[1])[:_MAX_CLASSES]
        return {
            "number": self._number,
            "time": round(time_ms),
            "facts": {**facts_of(self._now, now_s), "vehicle": printable(self._vehicle.name)},
            "outlines": {name: outline_coordinates(points) for name, points in outlines.items()},
            "lights": [
                [one.name, int(one.level), one.message, *replace_nonfinite((one.rate, one.age))]
                for one in lights
            ],
            "setup": self._setup or _setup_warning(lights),
            "left_out": self._lights.left_out,
            "classes": [[printable(name), *replace_nonfinite((p,)), name == found] for name, p in likely],
        }

    def _new_positions(self, now_s: float) -> dict[str, Any]:
        """The new points of the path and the new fixes."""
        new: dict[str, Any] = {}
        odometry, thinned = self._now.get(ODOMETRY, now_s), self._trail.thinning_count
        if odometry is not None and self._trail.add(odometry.x, odometry.y):
            new["path"] = self._trail.points[-1]
            if self._trail.thinning_count != thinned:
                new["trail"] = list(self._trail.points)
        if new_fixes := self._fixes.pop_new_fixes():
            new["new_fixes"] = new_fixes
        return new


def _setup_warning(lights: list[Light]) -> str:
    """The warning of the running estimator's setup check; empty: none."""
    return next((one.message for one in lights if one.name == _SETUP_STATUS and one.level is Level.WARN), "")


def _event_row(event: Event) -> tuple[int, float, int, str]:
    return (event.number, round(event.time_ms), int(event.level), event.text)
