# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Plots paths, ellipses, the laser's points and box, and a marker of the machine at the cursor's time."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from bokeh.models import BoxZoomTool, ColumnDataSource, DataRange1d, GlyphRenderer
from bokeh.plotting import figure
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray
from trackslip_tools.replay.series import Path
from trackslip_tools.report import plan_shapes
from trackslip_tools.report.panel import BLUE, GREEN, GREY, INK, ORANGE, PURPLE
from trackslip_tools.report.plan_shapes import machine_size
from trackslip_tools.report.plots import extreme_indices, plot_tools, style_plot
from trackslip_tools.report.run import Run, States, first_runs_of_bags
from trackslip_tools.report.run_styles import curve_colour, curve_label, curve_style

_HEIGHT = 620
BOX_SOURCE = "box_pose"
_ELLIPSES, _BOXES = 90, 30  # number over the whole run


class Track(NamedTuple):
    """Data sources of one run for the linked cursor."""

    path: ColumnDataSource  # t, x, y, heading
    marker: ColumnDataSource  # x, y, heading: the machine at the cursor


class PathPlot(NamedTuple):
    """The path plot and its tracks."""

    plot: figure
    tracks: list[Track]


def path_plot(runs: Sequence[Run], samples: int) -> PathPlot:
    """Plot all runs together, with at most ``samples`` points of each path."""
    plot = figure(
        name="path",
        title="Path, ellipses at 2σ",
        match_aspect=True,
        height=_HEIGHT,
        sizing_mode="stretch_width",
        **plot_tools(BoxZoomTool(match_aspect=True)),
        x_axis_label="x, m",
        y_axis_label="y, m",
        min_border_left=60,
    )
    for run in first_runs_of_bags(runs):
        _draw_laser(plot, run, samples)
    lines = [line for run in first_runs_of_bags(runs) for line in _draw_references(plot, runs, run, samples)]
    tracks = []
    for run in runs:
        if run.states is not None:
            line, track = _draw_estimate(plot, runs, run, samples)
            lines.append(line)
            tracks.append(track)
    if lines:
        room = {"range_padding": 1.0, "range_padding_units": "absolute"}
        plot.x_range, plot.y_range = (DataRange1d(renderers=lines, **room) for _ in "xy")
    style_plot(plot)
    return PathPlot(plot, tracks)


def _draw_laser(plot: figure, run: Run, samples: int) -> None:
    """Draw the points of the laser, and the fixes with the box at their poses."""
    recording = run.recording
    if recording.laser is not None:
        points = recording.points[:: -(-len(recording.points) // samples) or 1]
        x, y = points.T.astype(np.float32)
        plot.scatter(x, y, marker="dot", size=6, color=GREY, alpha=0.7, legend_label="laser points")
        style = {"marker": "triangle", "size": 11, "color": GREY, "legend_label": "laser"}
        plot.scatter(*recording.laser[:, np.newaxis], **style)
    outlines = boxes(run)
    if len(outlines):
        x, y = (list(outlines[:, :, axis]) for axis in (0, 1))
        plot.multi_line(x, y, color=GREEN, alpha=0.45, line_width=1, legend_label="box by the laser")
    for (source, poses), colour in zip(fixes_of(run).items(), (PURPLE, GREEN, ORANGE), strict=False):
        x, y = poses[:: -(-len(poses) // samples), :2].T
        style = {"marker": "cross", "size": 6, "color": colour, "alpha": 0.8}
        plot.scatter(x, y, **style, legend_label=f"fixes of {source}")


def _draw_references(plot: figure, runs: Sequence[Run], run: Run, samples: int) -> list[GlyphRenderer]:
    """Draw the reference; in a report of one run also the smoothed path and the encoders alone."""
    lines = []
    encoders, reference = (run.replay.paths.get(name) for name in ("dead_reckoning", "reference"))
    if run.smoothed_states is not None and len(runs) == 1:
        source = _path_source(run, run.smoothed_states.path, samples)
        style = {"color": PURPLE, "line_dash": "dashed", "line_width": 1.5}
        lines.append(plot.line("x", "y", source=source, legend_label="smoothed", **style))
    if encoders is not None and len(runs) == 1:
        source = _path_source(run, encoders, samples)
        style = {"color": ORANGE, "line_dash": "dashed", "line_width": 1.5}
        lines.append(plot.line("x", "y", source=source, legend_label="encoders alone", **style))
    if reference is not None and len(reference.stamps_ns):
        source = _path_source(run, reference, samples)
        bags = first_runs_of_bags(runs)
        style = {"color": INK, "line_width": 3, "legend_label": curve_label(bags, run, "reference")}
        if len(bags) > 1:
            style |= {"color": curve_colour(runs, run, INK), "line_dash": "dotted"}
        lines.append(plot.line("x", "y", source=source, **style))
    return lines


def _draw_estimate(plot: figure, runs: Sequence[Run], run: Run, samples: int) -> tuple[GlyphRenderer, Track]:
    assert run.states is not None
    label, colour = curve_style(runs, run, "estimate", BLUE)
    outlines = ellipses(run.states)
    x, y = (list(outlines[:, :, axis]) for axis in (0, 1))
    plot.patches(x, y, color=colour, fill_alpha=0.2, line_alpha=0.6, legend_label=label)
    source = _path_source(run, run.states.path, samples)
    line = plot.line("x", "y", source=source, color=colour, line_width=1.8, legend_label=label)
    first = {name: [float(source.data[name][0])] for name in ("x", "y", "heading")}
    marker = ColumnDataSource(first)
    length, width = machine_size(run.parameters.vehicle)
    style = {"fill_color": colour, "fill_alpha": 0.25, "line_color": colour, "line_width": 1.5}
    plot.rect("x", "y", angle="heading", source=marker, width=length, height=width, **style)
    plot.ray("x", "y", angle="heading", length=0.9 * length, source=marker, color=colour)
    return line, Track(source, marker)


def _path_source(run: Run, path: Path, samples: int) -> ColumnDataSource:
    indices = extreme_indices([path.poses[:, 0], path.poses[:, 1]], samples)
    x, y, heading = path.poses[indices].T
    t = run.recording.seconds(path.stamps_ns[indices])
    return ColumnDataSource(
        {"t": t.astype(np.float32), "x": x, "y": y, "heading": heading.astype(np.float32)}
    )


def ellipses(states: States) -> FloatArray:
    """(k, 33, 2) closed 2σ outlines of the position, evenly spread over the samples."""
    indices = _spread_indices(len(states.path.stamps_ns), _ELLIPSES)
    covariances = states.rows["pose_covariance"][indices, :2, :2]
    return plan_shapes.ellipses(states.path.poses[indices, :2], covariances)


def boxes(run: Run) -> FloatArray:
    """(k, 5, 2) closed outlines of the box at accepted fixes, evenly spread over the fixes."""
    fixes = fixes_of(run).get(BOX_SOURCE)
    sensors = run.parameters.vehicle.sensors
    if fixes is None or sensors is None or sensors.box is None:
        return np.empty((0, 5, 2))
    return np.array(
        [plan_shapes.box_outline(sensors.box, pose) for pose in fixes[_spread_indices(len(fixes), _BOXES)]]
    )


def fixes_of(run: Run) -> dict[str, FloatArray]:
    """Source → (n, 3) poses of accepted fixes."""
    fixes = run.details.accepted_fixes
    by_source = {
        run.details.sources[number]: fixes["source"] == number for number in np.unique(fixes["source"])
    }
    return {source: fixes["value"][is_source] for source, is_source in sorted(by_source.items())}


def _spread_indices(size: int, requested: int) -> NDArray[np.intp]:
    """Up to ``requested`` indices, evenly spread from the first to the last."""
    return np.unique(np.linspace(0, size - 1, min(size, requested)).round().astype(np.intp))
