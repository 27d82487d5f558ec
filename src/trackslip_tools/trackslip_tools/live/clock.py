# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The clock that the page shows: that of this computer's place, whatever the browser thinks its own is."""

import time
from contextlib import suppress


def shown_ms(time_ns: int) -> float:
    """Milliseconds that a clock set to UTC must show to read as local time here."""
    seconds = time_ns * 1e-9
    offset = 0
    with suppress(OverflowError, OSError, ValueError):
        offset = time.localtime(seconds).tm_gmtoff
    return (seconds + offset) * 1e3
