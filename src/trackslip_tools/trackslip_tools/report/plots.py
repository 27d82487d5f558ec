# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Plots over time with Bokeh, on a common x axis, with no more samples than a screen shows."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    CustomJS,
    FixedTicker,
    GlyphRenderer,
    HoverTool,
    PanTool,
    Range1d,
    ResetTool,
    SaveTool,
    Span,
    WheelZoomTool,
)
from bokeh.plotting import figure
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import printable
from trackslip_tools.report.panel import GRID, INK, PAPER, Curve, Form, Panel
from trackslip_tools.report.state_intervals import StateInterval, Strip, Style

if TYPE_CHECKING:
    from trackslip_tools.report.recording import Recording


_HEIGHT = 230
_DASHES = {Form.LINE: "solid", Form.DASHED: "dashed", Form.DOTTED: "dotted"}
_VALUE_PERCENTILES, _BAND_PERCENTILES = (0.5, 99.5), (10.0, 90.0)  # of values and band edges: stay visible
_LEGEND_WIDTH, _LEGEND_ROW = 100, 22  # characters, pixels
_FRAME_HEIGHT = 165  # height of a plot's frame, pixels
_TITLE, _LABEL, _ROW_NAME = 70, 32, 18  # characters shown of titles, labels and row names
_STRIP_HEAD, _STRIP_ROW, _BORDER = 86, 20, 112  # pixels; row names lie in the border
_MARGIN = 0.1  # margin about the values, share of their range


def time_range(recordings: Sequence["Recording"]) -> Range1d:
    """Initial time range of all plots."""
    start, stop = (min(r.start_s for r in recordings), max(r.stop_s for r in recordings))
    return Range1d(start, max(stop, start + 1e-3))


def time_plot(panel: Panel, x_range: Range1d, samples: int) -> figure:
    """Plot of a panel, with at most ``samples`` points of each curve."""
    plot = time_figure(panel.title, panel.axis, x_range, logarithmic=panel.logarithmic)
    for limit in panel.limits:
        style = {"line_color": INK, "line_alpha": 0.6, "line_dash": "dotted"}
        plot.add_layout(Span(location=limit, dimension="width", **style))
    bands = sum(curve.band is not None for curve in panel.curves)
    alpha = 0.25 / max(bands, 1) ** 0.5
    renderers = {curve: _draw_curve(plot, curve, samples, alpha) for curve in panel.curves}
    _add_hover(plot, renderers)
    low, high = visible_range(panel)
    plot.y_range = Range1d(low, high)
    style_plot(plot)
    return plot


def strip_plot(strip: Strip, x_range: Range1d, samples: int) -> figure:
    """Plot of bars over time, the first row on top, with at most ``samples`` bars of each style."""
    names = list(strip.rows)[::-1]
    plot = time_figure(strip.title, "", x_range, height=_STRIP_HEAD + _STRIP_ROW * len(names))
    by_style: dict[Style, list[tuple[int, StateInterval]]] = {}
    for row, name in enumerate(names):
        for bar in strip.rows[name]:
            by_style.setdefault(bar.style, []).append((row, bar.interval))
    for style, placed in sorted(by_style.items(), key=lambda item: item[1][0][1].state):
        shown = placed[:samples]
        columns = {
            "row": [row for row, _ in shown],
            "start": [interval.start for _, interval in shown],
            "stop": [interval.stop for _, interval in shown],
            "text": [interval.text for _, interval in shown],
        }
        drawn = plot.hbar(
            "row", height=0.6, left="start", right="stop", source=ColumnDataSource(columns), name=style.label,
            color=style.colour, line_width=1.5, legend_label=style.label,
        )  # fmt: skip
        tips = "<div><b>$name</b> @text</div>"
        plot.add_tools(HoverTool(renderers=[drawn], tooltips=tips, visible=False))
    plot.yaxis.ticker = FixedTicker(ticks=list(range(len(names))))
    plot.yaxis.major_label_text_font_size = "10px"
    plot.yaxis.major_label_overrides = {row: plot_text(name, _ROW_NAME) for row, name in enumerate(names)}
    style_plot(plot)
    room = _LEGEND_ROW / _STRIP_ROW * max(legend_rows([style.label for style in by_style]) - 1, 0)
    plot.y_range = Range1d(-0.7, len(names) + 0.7 + room)
    plot.ygrid.visible = False
    return plot


def time_figure(
    title: str, axis: str, x_range: Range1d, *, height: int = _HEIGHT, logarithmic: bool = False
) -> figure:
    """An empty plot over the common time axis."""
    plot = figure(
        title=plot_text(title, _TITLE),
        x_range=x_range,
        y_axis_type="log" if logarithmic else "linear",
        height=height,
        sizing_mode="stretch_width",
        **plot_tools(BoxZoomTool(dimensions="width"), dimensions="width"),
        y_axis_label=axis,
        min_border_left=_BORDER,
        min_border_right=12,
    )
    plot.js_on_event("doubletap", CustomJS(args={"range": x_range}, code="range.reset()"))
    return plot


def plot_tools(box: BoxZoomTool, **of_wheel: str) -> dict[str, Any]:
    """Tools of a plot, as arguments of ``figure``."""
    wheel = WheelZoomTool(modifiers={"ctrl": True}, **of_wheel)
    # None is active: page.js activates them for a mouse; a finger scrolls the page.
    tools = [box, wheel, PanTool(), ResetTool(), SaveTool()]
    return {"tools": tools, "active_drag": None, "active_scroll": None}


def style_plot(plot: figure) -> None:
    """Apply the style of all plots of a report."""
    plot.toolbar.logo = None
    plot.toolbar.autohide = True
    plot.background_fill_color = plot.border_fill_color = PAPER
    plot.outline_line_color = plot.border_line_color = None
    plot.title.text_color, plot.title.text_font_size = INK, "13px"
    for axis in (*plot.xaxis, *plot.yaxis):
        axis.axis_label_text_color = axis.major_label_text_color = INK
        axis.axis_line_color = axis.major_tick_line_color = axis.minor_tick_line_color = GRID
        axis.axis_label_text_font_style = "normal"
    plot.grid.grid_line_color = GRID
    if plot.legend:
        _style_legend(plot)


def _style_legend(plot: figure) -> None:
    """Place the legend above the curves, in the room that ``visible_range`` reserves."""
    legend = plot.legend[0]
    for item in legend.items:
        item.label = value(plot_text(item.label.value))
    labels = [item.label.value for item in legend.items]
    legend.visible = len(labels) > 1
    legend.location, legend.orientation, legend.click_policy = "top_left", "horizontal", "hide"
    legend.label_text_color, legend.label_text_font_size = INK, "11px"
    legend.background_fill_color, legend.background_fill_alpha = PAPER, 0.7
    legend.border_line_color = None
    legend.padding, legend.margin, legend.spacing = 1, 2, 6
    legend.label_height = legend.glyph_height = _LEGEND_ROW - 6
    legend.ncols = _legend_columns(labels)
    plot.height += _LEGEND_ROW * (legend_rows(labels) - 1)


def _legend_columns(labels: Sequence[str]) -> int:
    longest = max(map(len, labels), default=0)
    return max(1, min(len(labels), _LEGEND_WIDTH // (longest + 5)))


def legend_rows(labels: Sequence[str]) -> int:
    """Number of legend rows for these labels; 0 for a single label."""
    return -(-len(labels) // _legend_columns(labels)) if len(labels) > 1 else 0


def plot_text(text: str, longest: int = _LABEL) -> str:
    """External text for a plot: shortened in the middle, and escaped against display as mathematics."""
    shown = printable(text)
    if len(shown) > longest:
        half = (longest - 1) // 2
        shown = f"{shown[:half]}…{shown[-half:]}"
    for opening in ("$$", "\\[", "\\("):
        shown = shown.replace(opening, "\u200b".join(opening))
    return shown


def _draw_curve(plot: figure, curve: Curve, samples: int, band_alpha: float) -> GlyphRenderer:
    """Draw a curve above its band."""
    indices = extreme_indices([curve.values, *(curve.band or ())], samples)
    columns = {"t": curve.times[indices], "value": curve.values[indices]}
    if curve.band is not None:
        columns["low"], columns["high"] = (edge[indices] for edge in curve.band)
    source = ColumnDataSource({name: column.astype(np.float32) for name, column in columns.items()})
    style = {"legend_label": curve.label, "source": source, "name": curve.label}
    if curve.band is not None:
        plot.varea("t", "low", "high", fill_color=curve.colour, fill_alpha=band_alpha, **style)
    style["color"] = curve.colour
    if curve.form in _DASHES:
        style |= {"line_width": 2.2 if curve.colour == INK else 1.5, "line_dash": _DASHES[curve.form]}
        renderer = plot.line("t", "value", **style)
    else:
        marker, size = ("circle", 3.5) if curve.form is Form.POINTS else ("x", 8)
        renderer = plot.scatter("t", "value", marker=marker, size=size, **style)
    return renderer


def _add_hover(plot: figure, renderers: dict[Curve, GlyphRenderer]) -> None:
    """Show values under the mouse: of all lines at its time, or of the point below it."""
    tips = "<div><b>$name</b> @value{0.0000} at @t{0.00} s</div>"
    for mode, is_line in (("vline", True), ("mouse", False)):
        shown = [renderer for curve, renderer in renderers.items() if (curve.form in _DASHES) == is_line]
        plot.add_tools(HoverTool(renderers=shown, tooltips=tips, mode=mode, visible=False))


def visible_range(panel: Panel) -> tuple[float, float]:
    """Bounds of the y axis, robust to single spikes and to the wide bands of the start."""
    lows, highs = list(panel.limits), list(panel.limits)
    for curve in panel.curves:
        values = curve.values[np.isfinite(curve.values)]
        if len(values):
            low, high = np.percentile(values, _VALUE_PERCENTILES)
            lows, highs = [*lows, low], [*highs, high]
        for edge in curve.band or ():
            if np.isfinite(edge).any():
                middle = np.percentile(edge[np.isfinite(edge)], _BAND_PERCENTILES)
                lows, highs = [*lows, *middle], [*highs, *middle]
    if panel.logarithmic:
        low, high = max(min(lows), 1e-3), max(max(highs), 10.0)
        low, high = low / 1.5, 1.5 * high
        return low, high * float((high / low) ** _legend_room(panel))
    low, high = min(lows), max(highs)
    room = _MARGIN * max(high - low, 1e-6)
    low, high = (0.0 if panel.from_zero else low - room), high + room
    return low, high + _legend_room(panel) * (high - low)


def _legend_room(panel: Panel) -> float:
    """Height of the legend over the height of the curves' area."""
    rows = legend_rows(list(dict.fromkeys(plot_text(curve.label) for curve in panel.curves)))
    return _LEGEND_ROW * rows / (_FRAME_HEIGHT - _LEGEND_ROW)


def extreme_indices(columns: Sequence[FloatArray], limit: int) -> NDArray[np.intp]:
    """Indices of the samples to draw, at most ``limit``, of curves over the same increasing abscissa.

    The curves are cut into equal pieces. Each piece keeps the minimum and maximum of every curve, and one nan
    sample, so that breaks remain visible. The first and last samples are always kept.

    Args:
        columns: the curves, each (n,).
        limit: at least 2 + 1 + 2 len(columns).
    """
    size = len(columns[0])
    if size <= limit:
        return np.arange(size)
    pieces = (limit - 2) // (2 * len(columns) + 1)
    width = -(-size // pieces)
    starts = np.arange(0, size, width)
    padded = [np.append(column, np.full(-size % width, np.nan)).reshape(-1, width) for column in columns]
    chosen = [np.array((0, size - 1))]
    for rows in padded:
        chosen.append(starts + np.argmin(np.where(np.isnan(rows), np.inf, rows), axis=1))
        chosen.append(starts + np.argmax(np.where(np.isnan(rows), -np.inf, rows), axis=1))
    broken = np.isnan(np.stack(padded)).any(axis=0)
    chosen.append((starts + np.argmax(broken, axis=1))[broken.any(axis=1)])
    indices = np.unique(np.concatenate(chosen))
    return indices[indices < size]
