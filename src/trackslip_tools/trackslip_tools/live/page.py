# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The files of the live page: HTML, styles, scripts, Bokeh's library, and the plots."""

import json
from importlib import resources
from typing import Any, NamedTuple

from bokeh.document import Document
from bokeh.models import ColumnDataSource, DatetimeTicker, DatetimeTickFormatter, Range1d
from bokeh.plotting import figure
from bokeh.resources import Resources
from jinja2 import Environment, PackageLoader

from trackslip_tools.live.strips import LINES, PANELS, Strips
from trackslip_tools.report.panel import BLUE, DARK, GREEN, ORANGE, PURPLE, Panel
from trackslip_tools.report.plots import style_plot, time_plot

_STRIP_HEIGHT, _STRIP_BORDER = 190, 78  # pixels
_CLOCK = dict.fromkeys(("seconds", "minsec", "minutes", "hourmin", "hours", "days"), "%H:%M:%S")
_HEIGHT = 480


class ServedFile(NamedTuple):
    """A served file."""

    kind: str
    content: bytes


def page_files(title: str) -> dict[str, ServedFile]:
    """Name → file; the page itself has the name ``''``."""
    document, plots = _make_document()
    description = {
        "document": document.to_json(deferred=False),
        "plots": plots,
        "lines": [{"panel": line.panel} for line in LINES],
        "panels": len(PANELS),
    }
    environment = Environment(loader=PackageLoader(__package__), autoescape=True, trim_blocks=True)
    groups: dict[str, list[dict[str, Any]]] = {name: [] for name in ("Slip", "Thrust", "Reserve", "Soil")}
    for k, line in enumerate(LINES):
        if (gauge := line.quantity.gauge) is not None:
            unit = PANELS[line.panel].axis.rpartition(", ")[2]
            groups[gauge.group].append({**gauge._asdict(), "line": k, "panel": line.panel, "unit": unit})
    page = environment.get_template("live.html").render(
        title=title, groups=groups, strips=[f"strip-{k}" for k in range(len(PANELS))]
    )
    theme = f"const DARK = {json.dumps(DARK)}\n{_template_text('report', 'page.js')}"
    styles = _template_text("report", "page.css") + _template_text("live", "live.css")
    return {
        "": ServedFile("text/html; charset=utf-8", page.encode()),
        "live.css": ServedFile("text/css; charset=utf-8", styles.encode()),
        "live.js": ServedFile("text/javascript; charset=utf-8", _template_text("live", "live.js").encode()),
        "theme.js": ServedFile("text/javascript; charset=utf-8", theme.encode()),
        "page.json": ServedFile("application/json", json.dumps(description).encode()),
        "bokeh.js": ServedFile("text/javascript; charset=utf-8", _bokeh_script().encode()),
    }


def _bokeh_script() -> str:
    """Bokeh's script, without widgets and tables."""
    return "\n".join(Resources(mode="inline", components=["bokeh"], minified=True).js_raw)


def _make_document() -> tuple[Document, dict[str, str]]:
    """The plots without data, and name of the page's element → id of its plot."""
    document = Document()
    plots = {"path": path_figure()}
    panels = Strips().panels()
    first = 0
    for k, panel in enumerate(panels):
        plots[f"strip-{k}"] = _strip_plot(panel, k, first)
        first += len(panel.curves)
    for name, plot in plots.items():
        plot.name = name
        document.add_root(plot)
    return document, {name: plot.id for name, plot in plots.items()}


def _strip_plot(panel: Panel, number: int, first: int) -> figure:
    """A report's panel over clock time, without tools, so that a finger scrolls the page."""
    plot = time_plot(panel, Range1d(0.0, 1.0, name=f"time-{number}"), 1)
    plot.toolbar_location, plot.toolbar.tools, plot.js_event_callbacks = None, [], {}
    plot.min_border_left = _STRIP_BORDER
    plot.height, plot.y_range.name = _STRIP_HEIGHT, f"range-{number}"
    plot.title.text = panel.title.partition(":")[0]
    plot.xaxis.ticker = DatetimeTicker(desired_num_ticks=4)
    plot.xaxis.formatter = DatetimeTickFormatter(**_CLOCK)
    sources = {renderer.name: renderer.data_source for renderer in plot.renderers}
    for k, curve in enumerate(panel.curves):
        sources[curve.label].name = f"line-{first + k}"
    return plot


def _template_text(package: str, name: str) -> str:
    folder = resources.files(f"trackslip_tools.{package}").joinpath("templates")
    return folder.joinpath(name).read_text(encoding="utf-8")


def path_figure() -> figure:
    """The path plot; its data sources are ``trail``, ``fixes`` and ``OUTLINE_NAMES``, (x, y) each."""
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
    area, line = {"fill_color": BLUE, "line_color": BLUE}, {"line_width": 2.5}
    plot.scatter("x", "y", source=_source("fixes"), marker="cross", size=7, color=PURPLE, alpha=0.8)
    plot.line("x", "y", source=_source("box"), color=GREEN, **line)
    plot.line("x", "y", source=_source("trail"), color=BLUE, **line)
    plot.patch("x", "y", source=_source("ellipse"), fill_alpha=0.3, **area)
    plot.patch("x", "y", source=_source("machine"), fill_alpha=0.15, **area, **line)
    for name, colour in (("nose", BLUE), ("upper", ORANGE)):
        plot.line("x", "y", source=_source(name), color=colour, line_width=3)
    style_plot(plot)
    return plot


def _source(name: str) -> ColumnDataSource:
    return ColumnDataSource({"x": [], "y": []}, name=name)
