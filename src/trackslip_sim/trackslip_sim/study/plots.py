# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Style and helpers of the figures in ``docs/figures``."""

import io
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from trackslip_common.atomic_files import write_atomically

COLOURS = ("#c2862d", "#6b4a2f", "#3b6ea5", "#b2483f", "#5f8f4e")
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
GREY = "#777777"
BAND = "#f0ede4"  # background of a range
STYLE: Mapping[str, Any] = MappingProxyType(
    {
        "figure.dpi": 150,
        "figure.constrained_layout.use": True,
        "font.size": 9,
        "axes.titlesize": 10,
        "axes.titlelocation": "left",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.edgecolor": GREY,
        "axes.grid": True,
        "grid.color": "#e4e4e4",
        "grid.linewidth": 0.6,
        "lines.linewidth": 1.5,
        "legend.frameon": False,
    }
)


def make_panels(columns: int) -> tuple[Figure, list[Axes]]:
    """A figure and its row of equal panels."""
    figure = Figure(figsize=(5.2 * columns, 3.6))
    return figure, list(figure.subplots(1, columns, squeeze=False)[0])


def label_axes(axes: Axes, title: str, x: str, y: str) -> None:
    """Set title and axis labels with units; draw a thin line at zero."""
    axes.set(title=title, xlabel=x, ylabel=y)
    axes.axhline(0.0, color=GREY, linewidth=0.6)


def save_figure(figure: Figure, file: Path) -> None:
    """Write a PNG whose bytes depend only on the content of the figure."""
    image = io.BytesIO()
    figure.savefig(image, format="png", metadata={"Software": None})
    write_atomically(file, image.getvalue())
