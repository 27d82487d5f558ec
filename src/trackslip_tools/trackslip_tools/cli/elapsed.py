# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Waiting time of the user: the age of this process, including the start of Python and imports."""

import os
import time
from pathlib import Path

_START = 19  # index in /proc/self/stat after the name: clock ticks from boot to the start of the process
_LOADED_S = time.monotonic()


def waited_s() -> float:
    """Seconds since the process started, to 0.01 s; without /proc, since this module was loaded."""
    try:
        ticks = int(Path("/proc/self/stat").read_text(encoding="ascii").rpartition(")")[2].split()[_START])
        return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, AttributeError):
        return time.monotonic() - _LOADED_S
