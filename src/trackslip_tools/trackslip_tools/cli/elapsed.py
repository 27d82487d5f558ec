# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Waiting time of the user: since the start of Python and imports, or of a command in a running process."""

import os
import time
from contextvars import ContextVar
from pathlib import Path

# Index in /proc/self/stat after the name: clock ticks from boot to the start of the process.
_START_TIME_FIELD = 19
_LOADED_S = time.monotonic()
_BEGIN_S: ContextVar[float | None] = ContextVar("begin_s", default=None)  # of a command, monotonic


def begin_command() -> None:
    """Count from now on: a running process begins a command."""
    _BEGIN_S.set(time.monotonic())


def waiting_time_s() -> float:
    """Seconds since ``begin_command``, else since the process started; without /proc, since imports."""
    begin_s = _BEGIN_S.get()
    if begin_s is not None:
        return time.monotonic() - begin_s
    try:
        ticks = int(
            Path("/proc/self/stat").read_text(encoding="ascii").rpartition(")")[2].split()[_START_TIME_FIELD]
        )
        return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, AttributeError):
        return time.monotonic() - _LOADED_S
