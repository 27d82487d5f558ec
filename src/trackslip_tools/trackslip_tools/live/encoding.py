# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers as JSON takes them: what is not finite is null."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray


def finite(values: Any) -> Any:
    """Nested lists of the same shape."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if isinstance(values, (list, tuple)):
        return [finite(value) for value in values]
    return values if math.isfinite(values) else None


def outline(points: NDArray[np.float64]) -> tuple[list[float], list[float]]:
    """x and y of (n, 2) points, to the millimetre; none of them where one is not finite."""
    rounded = np.round(points, 3)  # the largest numbers become infinite
    x, y = rounded.T.tolist() if len(rounded) and np.isfinite(rounded).all() else ([], [])
    return x, y
