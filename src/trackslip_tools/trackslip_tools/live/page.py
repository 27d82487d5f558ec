# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The files of the live page: HTML, styles, scripts, Bokeh's library, and the plots."""

import json
from importlib import resources
from typing import NamedTuple

from bokeh.document import Document
from bokeh.models import ColumnDataSource, DatetimeTicker, DatetimeTickFormatter, Range1d
from bokeh.plotting import figure
from bokeh.resources import Resources
from jinja2 import Environment, PackageLoader

from trackslip_tools.live.strips import LINES, PANELS, Line, Strips
from trackslip_tools.report.panel import BLUE, DARK, GREEN, ORANGE, PURPLE, Panel
from trackslip_tools.report.plots import style_plot, time_plot
from trackslip_tools.report.quantities import FieldCurve, Quantity

_STRIP_HEIGHT, _STRIP_BORDER = 190, 78  # pixels
_CLOCK = dict.fromkeys(("seconds", "minsec", "minutes", "hourmin", "hours", "days"), "%H:%M:%S")
_SLIP_RANGE, _RESERVE_RANGE = (-0.2, 1.0), (0.0, 1.0)  # ranges of gauges
_HEIGHT = 480


class ServedFile(NamedTuple):
    """A served file."""

    kind: str
    content: bytes


class Gauge(NamedTuple):
    """A bar that shows the newest point of a curve."""

    group: str
    label: str
    line: int  # index in ``LINES``
    panel: int
    unit: str
    low: float | None  # lower end of the range; None: that of the panel
    high: float | None


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
    gauges = [gauge for k, line in enumerate(LINES) if (gauge := _make_gauge(k, line)) is not None]
    groups = {name: [g for g in gauges if g.group == name] for name in ("Slip", "Thrust", "Reserve", "Soil")}
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


def _make_gauge(number: int, line: Line) -> Gauge | None:
    """Gauge of a curve; None for a curve without one."""
    quantity, panel = line.quantity, PANELS[line.panel]
    unit = panel.axis.rpartition(", ")[2]
    if isinstance(quantity, Quantity):
        side = quantity.true_column.partition("_")[0]
        low, high = (quantity.scale * end for end in _SLIP_RANGE)
        is_slip = quantity.true_column.endswith("_slip")
        return Gauge("Slip", side, number, line.panel, unit, low, high) if is_slip else None
    return _ground_gauge(quantity, line, number, unit)


def _ground_gauge(curve: FieldCurve, line: Line, number: int, unit: str) -> Gauge | None:
    side = curve.field.partition("_")[0]
    if curve.field.endswith("_thrust_reserve"):
        low, high = (line.scale * end for end in _RESERVE_RANGE)
        return Gauge("Reserve", side, number, line.panel, unit, low, high)
    if curve.field.endswith("_thrust"):
        return Gauge("Thrust", side, number, line.panel, unit, None, None)
    return Gauge("Soil", curve.label, number, line.panel, unit, None, None) if curve.interval else None


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
    style_plot(plot)
    return plot


def _source(name: str) -> ColumnDataSource:
    return ColumnDataSource({"x": [], "y": []}, name=name)
