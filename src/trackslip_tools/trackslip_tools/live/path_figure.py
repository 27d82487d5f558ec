# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The plot of where the machine is; the page's script fills its sources and moves its ranges."""

from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure

from trackslip_tools.report.panel import BLUE, GREEN, ORANGE, PURPLE
from trackslip_tools.report.plots import dress

_HEIGHT = 480


def path_figure() -> figure:
    """Sources ``trail`` and ``fixes`` (x, y), and one of each of ``live.outlines.NAMES``."""
    plot = figure(
        height=_HEIGHT,
        sizing_mode="stretch_width",
        tools=[],
        toolbar_location=None,
        x_range=Range1d(-5.0, 5.0),
        y_range=Range1d(-5.0, 5.0),
        x_axis_label="x, m",
        y_axis_label="y, m",
        min_border_left=60,
        min_border_right=12,
    )
    fixes = {"marker": "cross", "size": 7, "color": PURPLE, "alpha": 0.8}
    plot.scatter("x", "y", source=_source("fixes"), **fixes)
    box = {"color": GREEN, "line_width": 2.5}
    plot.line("x", "y", source=_source("box"), **box)
    plot.line("x", "y", source=_source("trail"), color=BLUE, line_width=2.5)
    ellipse = {"fill_color": BLUE, "fill_alpha": 0.3, "line_color": BLUE}
    plot.patch("x", "y", source=_source("ellipse"), **ellipse)
    machine = {"fill_color": BLUE, "fill_alpha": 0.15, "line_color": BLUE, "line_width": 2.5}
    plot.patch("x", "y", source=_source("machine"), **machine)
    plot.line("x", "y", source=_source("nose"), color=BLUE, line_width=3)
    upper = {"color": ORANGE, "line_width": 3}
    plot.line("x", "y", source=_source("upper"), **upper)
    dress(plot)
    return plot


def _source(name: str) -> ColumnDataSource:
    return ColumnDataSource({"x": [], "y": []}, name=name)
