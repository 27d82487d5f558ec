# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""JSON encoding of numbers, and times in the time zone of this computer."""

import math
import time
from contextlib import suppress
from typing import Any

import numpy as np

from trackslip_common.arrays import FloatArray


def replace_nonfinite(value: Any) -> Any:
    """The value in types of JSON, arrays as lists; null for each number in it that is not finite."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: replace_nonfinite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [replace_nonfinite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def outline_coordinates(points: FloatArray) -> tuple[list[float], list[float]]:
    """x and y of (n, 2) points, rounded to the millimetre; empty if one is not finite."""
    rounded = np.round(points, 3)  # overflows to infinity for the largest numbers
    x, y = rounded.T.tolist() if len(rounded) and np.isfinite(rounded).all() else ([], [])
    return x, y


def local_clock_ms(time_ns: int) -> float:
    """Milliseconds that a UTC clock must show to read as local time here, in a browser of any time zone."""
    seconds = time_ns * 1e-9
    offset = 0
    with suppress(OverflowError, OSError, ValueError):
        offset = time.localtime(seconds).tm_gmtoff
    return (seconds + offset) * 1e3
