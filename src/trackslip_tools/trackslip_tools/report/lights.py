# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Lights: the last status of each node on /diagnostics, with its age.

Names and texts are external input: they are shortened, unprintable characters are escaped, and their number
is limited.
"""

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from enum import IntEnum
from typing import Any, NamedTuple

from trackslip_common.errors import printable

SILENT_S = 1.5  # timeout for the status that nodes publish once a second: the node has ended, or hangs
MAX_LIGHTS = 60  # largest number of lights
_MAX_CHARACTERS = 160  # characters of a text
_RATE, _AGE = "rate (Hz)", "age (s)"  # keys in the status of drivers


class Level(IntEnum):
    """Levels of DiagnosticStatus, and SILENT."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3
    SILENT = 4


class Status(NamedTuple):
    """One status of /diagnostics."""

    name: str  # of the node, or ``node: part``
    level: Level
    message: str
    values: Mapping[str, str]

    @property
    def node(self) -> str:
        """Name of the node."""
        return self.name.partition(": ")[0]


class Light(NamedTuple):
    """A status as it is shown."""

    name: str
    level: Level
    message: str
    rate: float  # Hz, nan if not reported
    age: float  # s since the last reading if reported, else since the last status


def statuses_of(message: Any, namespace: str = "") -> list[Status]:
    """The statuses of a DiagnosticArray (of rclpy or a bag) from nodes in a namespace, without its prefix."""
    prefix = f"{namespace.strip('/')}/" if namespace.strip("/") else ""
    return [_status(one, prefix) for one in message.status if one.name.startswith(prefix)]


def _status(one: Any, prefix: str) -> Status:
    level = one.level[0] if isinstance(one.level, bytes) else int(one.level)
    known_level = Level(level) if level in (Level.OK, Level.WARN, Level.ERROR, Level.STALE) else Level.ERROR
    values = {pair.key: pair.value for pair in one.values}
    return Status(_short_text(one.name.removeprefix(prefix)), known_level, _short_text(one.message), values)


def _short_text(text: str) -> str:
    return printable(text, _MAX_CHARACTERS)


class Lights:
    """Keeps the last status of each name; times are seconds of one monotonic clock."""

    def __init__(self) -> None:
        self._received: dict[str, tuple[Status, float]] = {}  # name → its last status, and when it came
        self._new_values: dict[str, Mapping[str, str]] = {}
        self.left_out = 0  # statuses beyond ``MAX_LIGHTS``

    def update(self, statuses: Iterable[Status], now_s: float) -> None:
        """Add a DiagnosticArray; parts of its nodes that it no longer contains are removed as recovered."""
        by_name = {status.name: status for status in statuses}
        nodes = {status.node for status in by_name.values()}
        for name, (status, _) in list(self._received.items()):
            if status.node in nodes and name not in by_name:
                del self._received[name]
        for name, status in by_name.items():
            if name in self._received or len(self._received) < MAX_LIGHTS:
                self._received[name] = status, now_s
                self._new_values[name] = status.values
            else:
                self.left_out += 1

    def pop_new_values(self) -> list[Mapping[str, str]]:
        """Values of the statuses received since the last call."""
        new_values, self._new_values = list(self._new_values.values()), {}
        return new_values

    def lights_at(self, now_s: float) -> list[Light]:
        """All lights, sorted by name."""
        return [_light(status, now_s - at_s) for _, (status, at_s) in sorted(self._received.items())]


def _light(status: Status, quiet_s: float) -> Light:
    rate, age = (_number(status.values.get(key, "")) for key in (_RATE, _AGE))
    age = quiet_s if math.isnan(age) else age + quiet_s
    if quiet_s > SILENT_S:
        return Light(status.name, Level.SILENT, "no status: the node has stopped or hangs", math.nan, age)
    return Light(status.name, status.level, status.message, rate, age)


def _number(text: str) -> float:
    with suppress(ValueError):
        if math.isfinite(value := float(text)):
            return value
    return math.nan
