# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Recent fixes of all pose sources, and detection of silent sources."""

import math
from collections import defaultdict, deque
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from trackslip_common.config_files import node_parameters
from trackslip_common.yaml_text import parse_mapping
from trackslip_estimation.slip.silence import SilenceMonitor
from trackslip_estimation.slip.sources import group_name
from trackslip_tools.live import inputs
from trackslip_tools.report.events import Events
from trackslip_tools.report.lights import Level

MAX_FIXES = 400  # shown fixes
_MOST_SOURCES = 12  # largest number of sources
_NODE = "slip_estimator"

Position = tuple[float, float]  # x, y, m


class Fixes:
    """Recent fixes and lost sources; times are seconds of one monotonic clock."""

    def __init__(self) -> None:
        self.shown: deque[Position] = deque(maxlen=MAX_FIXES)
        self.timeouts: dict[str, float] = {}  # source of the slip estimator → timeout, s
        self._new_fixes: deque[Position] = deque(maxlen=MAX_FIXES)
        self._silences: dict[str, SilenceMonitor] = defaultdict(SilenceMonitor)
        self._lost: set[str] = set()

    def set_timeouts(self, timeouts: Mapping[str, float]) -> None:
        """Set the timeouts, s, by source, from which ``silence`` derives its limits; forget other sources."""
        self.timeouts = dict(list(timeouts.items())[:_MOST_SOURCES])
        known = {*inputs.POSES, *self.timeouts}
        self._silences = defaultdict(
            SilenceMonitor, {k: one for k, one in self._silences.items() if k in known}
        )
        self._lost &= known

    def add(self, source: str, x: float, y: float, now_s: float) -> None:
        """Add a fix, m."""
        self._silences[source].add(now_s)
        if math.isfinite(x) and math.isfinite(y):
            self._new_fixes.append((round(x, 3), round(y, 3)))

    def pop_new_fixes(self) -> list[Position]:
        """Return the fixes since the last call, and keep them as shown."""
        new_fixes, self._new_fixes = list(self._new_fixes), deque(maxlen=MAX_FIXES)
        self.shown += new_fixes
        return new_fixes

    def add_silence_events(self, events: Events, now_s: float, time_ms: float) -> None:
        """Add an event for each source that is newly lost, or back."""
        for source, timeout in self.timeouts.items():
            is_lost = self._silences[source].is_silent(now_s, timeout)
            if is_lost and source not in self._lost:
                events.add(Level.WARN, f"fix lost: {source}", now_s, time_ms)
            elif not is_lost and source in self._lost:
                events.add(Level.OK, f"fix back: {source}", now_s, time_ms)
            (self._lost.add if is_lost else self._lost.discard)(source)


def timeouts_of(values: Mapping[str, Any]) -> dict[str, float]:
    """Pose source → timeout, s, from the slip estimator's parameters by dotted name."""
    sources = values.get("pose_sources")
    timeouts = {}
    for source in sources if isinstance(sources, list) else ():
        with suppress(TypeError, ValueError):
            timeouts[str(source)] = float(values.get(f"sources.{group_name(str(source))}.timeout", math.inf))
    return {source: timeout for source, timeout in timeouts.items() if source and not math.isnan(timeout)}


def timeouts_of_text(text: str, where: str) -> dict[str, float]:
    """Pose source → timeout, s, from the text of a parameter file.

    Raises:
        InputError: the text is no parameter file.
    """
    return timeouts_of(node_parameters(parse_mapping(text, where), _NODE, where))
