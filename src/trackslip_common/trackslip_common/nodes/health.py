# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Entries of a node on /diagnostics, and log lines of their changes."""

import re
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from trackslip_common.console import clear_line

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
ERROR, STALE = DiagnosticStatus.ERROR, DiagnosticStatus.STALE

_NUMBER = re.compile(r"\d+(\.\d+)?")
_PAUSE_S = 1.0  # s between two log lines about one part


@dataclass(frozen=True)
class Health:
    """One line of /diagnostics."""

    level: bytes
    message: str
    values: dict[str, Any] = field(default_factory=dict)
    part: str = ""  # of the node; empty for the node itself


def console_logger(logger: Any) -> Callable[[bytes, str], None]:
    """A function that logs a text by its level, on a line of its own; ``logger`` is a node's."""

    def log(level: bytes, text: str) -> None:
        clear_line()
        if level == OK:
            logger.info(text)
        elif level == WARN:
            logger.warning(text)
        else:
            logger.error(text)

    return log


class StateLog:
    """Logs each change of a state in one line: the new state, or its end.

    Other numbers in a message are no change. A state that comes and goes is logged once per ``_PAUSE_S``.
    """

    def __init__(
        self, log: Callable[[bytes, str], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._log, self._clock = log, clock
        self._logged: dict[str, tuple[bytes, str]] = {}  # part → last state logged
        self._logged_s: dict[str, float] = {}

    def log_changes(self, entries: Iterable[Health]) -> None:
        """Log the changes in the present entries."""
        present = {entry.part: entry for entry in entries}
        ended = {part: Health(OK, "is over", part=part) for part in self._logged.keys() - present.keys()}
        for part, entry in {**present, **ended}.items():
            state = entry.level, _NUMBER.sub("#", entry.message)
            time_s = self._clock()
            if state == self._logged.get(part) or time_s - self._logged_s.get(part, -_PAUSE_S) < _PAUSE_S:
                continue
            if part not in ended:
                self._logged[part], self._logged_s[part] = state, time_s
            elif self._logged.pop(part)[0] == OK:
                continue
            self._log(entry.level, f"{part}: {entry.message}" if part else entry.message)


def diagnostics(node: str, stamp: Time, entries: Iterable[Health], hardware: str) -> DiagnosticArray:
    """The message with these entries; ``hardware`` distinguishes the devices of nodes of one kind."""
    array = DiagnosticArray()
    array.header.stamp = stamp
    for entry in entries:
        status = DiagnosticStatus(level=entry.level, message=entry.message, hardware_id=hardware)
        status.name = f"{node}: {entry.part}" if entry.part else node
        status.values = [KeyValue(key=k, value=str(v)) for k, v in entry.values.items()]
        array.status.append(status)
    return array
