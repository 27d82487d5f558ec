# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the page takes: numbers as JSON has them, and times of this computer's place."""

import math
import time
from contextlib import suppress
from typing import Any

import numpy as np

from trackslip_common.arrays import FloatArray


def finite(values: Any) -> Any:
    """Nested lists of the same shape; what is not finite is null."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if isinstance(values, (list, tuple)):
        return [finite(value) for value in values]
    return values if math.isfinite(values) else None


def outline(points: FloatArray) -> tuple[list[float], list[float]]:
    """x and y of (n, 2) points, to the millimetre; none of them where one is not finite."""
    rounded = np.round(points, 3)  # the largest numbers become infinite
    x, y = rounded.T.tolist() if len(rounded) and np.isfinite(rounded).all() else ([], [])
    return x, y


def shown_ms(time_ns: int) -> float:
    """Milliseconds that a clock set to UTC must show to read as local time here, whatever a browser's is."""
    seconds = time_ns * 1e-9
    offset = 0
    with suppress(OverflowError, OSError, ValueError):
        offset = time.localtime(seconds).tm_gmtoff
    return (seconds + offset) * 1e3
