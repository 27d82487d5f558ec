# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The last minutes of all curves in the report's panels, in bounded memory."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_tools.report.panel import BLUE, Curve, Panel
from trackslip_tools.report.quantities import (
    FIELD_PANELS,
    QUANTITIES,
    Columns,
    FieldCurve,
    FieldPanel,
    Quantity,
)

MOTION = "motion"  # name of the columns from odometry and slips; other columns have the name of their topic
ROWS = 1920  # stored moments: four minutes
_PARTS = 3  # value, lower, upper
_DIGITS = 5


class Line(NamedTuple):
    """One curve of one panel."""

    panel: int
    quantity: Quantity | FieldCurve
    scale: float
    topic: str  # topic of its columns


PANELS: tuple[Quantity | FieldPanel, ...] = (*QUANTITIES, *FIELD_PANELS)  # panels in their order
LINES = [Line(k, quantity, quantity.scale, MOTION) for k, quantity in enumerate(QUANTITIES)] + [
    Line(k, curve, panel.scale, panel.topic)
    for k, panel in enumerate(FIELD_PANELS, len(QUANTITIES))
    for curve in panel.fields
]
"""Lines of all panels, in their order."""


def row_of(columns: Mapping[str, Columns]) -> FloatArray:
    """(lines, 3) value, lower and upper of every line; nan for topics without columns."""
    row = np.full((len(LINES), _PARTS), np.nan)
    for k, line in enumerate(LINES):
        if line.topic in columns:
            row[k] = _line_point(line, columns[line.topic])
    return row


class Strips:
    """A ring buffer of rows; each has value, lower and upper of every line, nan if missing."""

    def __init__(self, rows: int = ROWS) -> None:
        self._times = np.full(rows, np.nan)
        self._values = np.full((rows, len(LINES), _PARTS), np.nan)
        self._count = 0

    def add(self, time_ms: float, columns: Mapping[str, Columns]) -> FloatArray:
        """Add the columns of one moment; returns its row (lines, 3)."""
        at = self._count % len(self._times)
        self._times[at], self._values[at] = time_ms, row_of(columns)
        self._count += 1
        row: FloatArray = self._values[at]
        return row

    def stored_rows(self) -> tuple[FloatArray, FloatArray]:
        """Times (n,) in ms and values (n, lines, 3), oldest first."""
        filled = min(self._count, len(self._times))
        order = (np.arange(filled) + self._count - filled) % len(self._times)
        return self._times[order], self._values[order]

    def panels(self) -> list[Panel]:
        """The panels with the stored curves, as in a report."""
        times, values = self.stored_rows()
        curves: list[list[Curve]] = [[] for _ in PANELS]
        for k, line in enumerate(LINES):
            points = values[:, k]
            shown = line.quantity
            label, colour = ("estimate", BLUE) if isinstance(shown, Quantity) else (shown.label, shown.colour)
            has_band = isinstance(shown, Quantity) or np.isfinite(points[:, 1]).any() or not len(points)
            band = (points[:, 1], points[:, 2]) if has_band else None
            curves[line.panel].append(Curve(label, colour, times, points[:, 0], band=band))
        return [
            Panel(panel.title, panel.axis, panel_curves, limits=(0.0,))
            for panel, panel_curves in zip(PANELS, curves, strict=True)
        ]


def _line_point(line: Line, columns: Columns) -> tuple[float, float, float]:
    values, band = line.quantity.values_with_band(columns, line.scale)
    lower, upper = band if band is not None else (math.nan, math.nan)
    return _round_digits(values), _round_digits(lower), _round_digits(upper)


def _round_digits(value: FloatArray | float) -> float:
    return float(f"{float(value):.{_DIGITS}g}")
