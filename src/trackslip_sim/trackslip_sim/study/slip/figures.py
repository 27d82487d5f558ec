# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of the study: single runs beside the thesis' Figs 6.3 to 6.14, and Monte Carlo results."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_sim.study.engine import spaced_name
from trackslip_sim.study.plots import BAND, COLOURS, STYLE, save_figure
from trackslip_sim.study.slip.drive import make_drive
from trackslip_sim.study.slip.evaluate import Trace, make_setting, trace
from trackslip_sim.study.slip.parameters import SHEAR, Cell, StudyParameters
from trackslip_sim.study.slip.results import Row

# name → filter, σ_xy m, σ_ω rad/s, figures of the thesis under these conditions
CONDITIONS: Mapping[str, tuple[str, float, float, str]] = MappingProxyType(
    {
        "fig_6_3": ("ekf", 0.001, 0.01, "6.3, 6.4"),
        "fig_6_5": ("daf", 0.001, 0.01, "6.5, 6.6"),
        "fig_6_7": ("ekf", 0.001, 0.1, "6.7, 6.8"),
        "fig_6_9": ("ekf", 0.01, 0.1, "6.9, 6.10"),
        "fig_6_11": ("daf", 0.01, 0.1, "6.11, 6.12"),
        "fig_6_13": ("ekf", 0.1, 0.1, "6.13, 6.14"),
    }
)
_TRUTH, _LEFT, _RIGHT, _ANGLE = "#222222", COLOURS[2], COLOURS[3], COLOURS[4]
_PANEL = (3.3, 2.5)  # inches
_EVERY = 10  # samples per plotted point of an estimate
_RMSE = {"position": (1e3, "position (mm)"), "slip": (100.0, "slip (%)")}  # name → scale, label
_NEES = {"nees_pose": (1.0, "NEES of the pose"), "nees_slip": (1.0, "NEES of the slips")}
_RATIOS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
_TERRAIN_RATIOS = {  # name → bound (empty: 3), label
    "position_rmse": ("position_bound", "position ÷ bound"),
    "turning_slip_rmse": ("turning_slip_bound", "slip in turns ÷ bound"),
    "nees_pose": ("", "NEES of the pose ÷ 3"),
}


def run_figures(p: StudyParameters, estimator: SlipEstimatorParameters) -> Iterator[tuple[str, Figure]]:
    """One run under each of the thesis' conditions on each soil, on the shear truth."""
    drives = {soil: make_drive(p, estimator, soil) for soil in p.soils}
    for name, (filter_, sigma_xy, sigma_omega, numbers) in CONDITIONS.items():
        figure, axes = _panel_grid(3, len(drives))
        for column, (soil, drive) in enumerate(drives.items()):
            cell = Cell(SHEAR, soil, filter_, sigma_xy, sigma_omega)
            run = trace(make_setting(cell, drive, p, estimator), seed=0)
            _draw_path(axes[0][column], run, spaced_name(soil))
            _draw_slips(axes[1][column], run, p.settling)
            _draw_angle(axes[2][column], run, p.settling)
        for row in range(3):
            axes[row][0].legend(fontsize=7)
        conditions = f"σ_xy = {1e3 * sigma_xy:g} mm, σ_ω = {sigma_omega:g} rad/s, {filter_.upper()}"
        figure.suptitle(f"Figs {numbers}: {conditions}", x=0.01, ha="left")
        yield name, figure


def write_figures(rows: Sequence[Row], folder: Path) -> None:
    """Write ``terrain_figure`` of the rows on terrain, else all of ``monte_carlo_figures``, as PNG files."""
    sloping = [row for row in rows if row.terrain]
    with style.context(dict(STYLE)):
        drawn = [("study_slopes", terrain_figure(sloping))] if sloping else monte_carlo_figures(rows)
        for name, figure in drawn:
            save_figure(figure, folder / f"{name}.png")


def terrain_figure(rows: Sequence[Row]) -> Figure:
    """Errors over their bounds, and NEES over 3, on each terrain; hollow: the filter without attitude.

    One column of panels per soil. A consistent filter at its bound has 1 everywhere.
    """
    soils = list(dict.fromkeys(row.soil for row in rows))
    terrains = list(dict.fromkeys(row.terrain for row in rows))
    figure, axes = _panel_grid(len(_TERRAIN_RATIOS), len(soils), sharey="row")
    for column, soil in enumerate(soils):
        for panels, (name, (bound, text)) in zip(axes, _TERRAIN_RATIOS.items(), strict=True):
            _draw_terrains(panels[column], [row for row in rows if row.soil == soil], terrains, (name, bound))
            panels[column].set(yscale="log", ylabel=text)
            panels[column].set_yticks(_RATIOS, [f"{ratio:g}" for ratio in _RATIOS])
            panels[column].yaxis.set_minor_locator(NullLocator())
            panels[column].label_outer()
        axes[0][column].set_title(spaced_name(soil))
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="upper right", ncols=2, fontsize=8)
    figure.suptitle("On terrain, beside the bound; hollow: taking the ground for flat", x=0.01, ha="left")
    return figure


def monte_carlo_figures(rows: Sequence[Row]) -> Iterator[tuple[str, Figure]]:
    """Errors and NEES over σ_xy beside their bounds, one pair of figures per truth."""
    for truth in dict.fromkeys(row.truth for row in rows):
        chosen = [row for row in rows if row.truth == truth]
        title = f"RMSE on the {truth} truth; dotted: the posterior Cramér–Rao bound"
        yield f"study_rmse_{truth}", _figure_over_sigma(chosen, title, _RMSE, _draw_rmse)
        title = f"NEES on the {truth} truth; tinted: 95 % of the means of {chosen[0].seeds} consistent runs"
        yield f"study_nees_{truth}", _figure_over_sigma(chosen, title, _NEES, _draw_nees)


def _panel_grid(
    rows: int, columns: int, sharey: Literal["none", "row"] = "none"
) -> tuple[Figure, list[list[Axes]]]:
    figure = Figure(figsize=(_PANEL[0] * columns, _PANEL[1] * rows))
    return figure, [list(row) for row in figure.subplots(rows, columns, squeeze=False, sharey=sharey)]


def _draw_path(axes: Axes, run: Trace, soil: str) -> None:
    axes.plot(*run.poses[:, :2].T, color=_TRUTH, linewidth=2.5, label="truth")
    axes.plot(*run.estimated_poses[:, :2].T, color=_LEFT, linewidth=1.0, label="estimate")
    axes.set(title=soil, xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.set_adjustable("datalim")


def _draw_slips(axes: Axes, run: Trace, settling: float) -> None:
    for side, (colour, name) in enumerate(((_LEFT, "left"), (_RIGHT, "right"))):
        _draw_band(axes, run, side, (100.0, colour, name))
    _draw_settling(axes, settling, "slip (%)")
    low, high = 100.0 * np.percentile(run.slips[:, :2], (0.5, 99.5))
    axes.set_ylim(low - 8.0, high + 8.0)


def _draw_angle(axes: Axes, run: Trace, settling: float) -> None:
    _draw_band(axes, run, 2, (1e3, _ANGLE, "slip angle"))
    _draw_settling(axes, settling, "slip angle (mrad)")
    axes.set_ylim(-40.0, 40.0)


def _draw_band(axes: Axes, run: Trace, column: int, look: tuple[float, str, str]) -> None:
    """Draw truth, estimate, and a band of two standard deviations."""
    scale, colour, name = look
    t, every = run.t[::_EVERY], slice(None, None, _EVERY)
    mean, sigma = scale * run.estimated_slips[every, column], scale * run.slip_deviations[every, column]
    axes.fill_between(t, mean - 2.0 * sigma, mean + 2.0 * sigma, color=colour, alpha=0.25, linewidth=0.0)
    axes.plot(t, mean, color=colour, linewidth=0.8, label=f"{name}, ±2σ")
    axes.plot(run.t, scale * run.slips[:, column], color=_TRUTH, linewidth=1.0)


def _draw_settling(axes: Axes, settling: float, unit: str) -> None:
    axes.axvspan(0.0, settling, color=BAND, zorder=0)
    axes.set(xlabel="time (s)", ylabel=unit)


def _figure_over_sigma(
    rows: Sequence[Row],
    title: str,
    quantities: Mapping[str, tuple[float, str]],
    draw: Callable[[Axes, Sequence[Row], str, float, dict[str, Any]], None],
) -> Figure:
    """A figure with one column of panels per soil and one row per quantity."""
    soils = list(dict.fromkeys(row.soil for row in rows))
    figure, axes = _panel_grid(len(quantities), len(soils))
    for column, soil in enumerate(soils):
        for panels, (name, (scale, unit)) in zip(axes, quantities.items(), strict=True):
            panels[column].set(xscale="log", xlabel="σ_xy (mm)", ylabel=unit)
            _label_ticks(panels[column], sorted({row.sigma_xy for row in rows}))
            for curve, look in _curves([row for row in rows if row.soil == soil]):
                draw(panels[column], curve, name, scale, look)
            panels[column].set_ylim(bottom=0.0)
        axes[0][column].set_title(spaced_name(soil))
    axes[0][0].legend(fontsize=7)
    figure.suptitle(title, x=0.01, ha="left")
    return figure


def _draw_terrains(
    axes: Axes, rows: Sequence[Row], terrains: Sequence[str], quantity: tuple[str, str]
) -> None:
    name, bound = quantity
    axes.axhline(1.0, color=_TRUTH, linewidth=0.8)
    for colour, sigma in zip((_LEFT, _RIGHT), sorted({row.sigma_xy for row in rows}), strict=False):
        chosen = [row for row in rows if row.sigma_xy == sigma]
        positions = [terrains.index(row.terrain) for row in chosen]
        for prefix, fill in (("", colour), ("ignoring_", "none")):
            values = _column_values(chosen, prefix + name) / (_column_values(chosen, bound) if bound else 3.0)
            look = {
                "markerfacecolor": fill,
                "color": colour,
                "marker": "o",
                "markersize": 4,
                "linewidth": 0.0,
            }
            axes.plot(positions, values, label=None if prefix else f"σ_xy = {1e3 * sigma:g} mm", **look)
    axes.set_xticks(range(len(terrains)), [spaced_name(name) for name in terrains], rotation=45, ha="right")
    axes.xaxis.set_minor_locator(NullLocator())


def _column_values(rows: Sequence[Row], name: str) -> FloatArray:
    """(n,) a column of the rows; NaN where nothing moved."""
    return np.array([getattr(row, name) for row in rows], np.float64)


def _label_ticks(axes: Axes, sigma: Sequence[float]) -> None:
    axes.set_xticks(sigma, [f"{1e3 * value:g}" for value in sigma])
    axes.xaxis.set_minor_locator(NullLocator())


def _curves(rows: Sequence[Row]) -> Iterator[tuple[list[Row], dict[str, Any]]]:
    """Groups of rows that differ in σ_xy only, and their line styles: the DAF is dashed, over the EKF."""
    omegas = list(dict.fromkeys(row.sigma_omega for row in rows))
    for filter_, omega in dict.fromkeys((row.filter, row.sigma_omega) for row in rows):
        curve = sorted(
            (row for row in rows if (row.filter, row.sigma_omega) == (filter_, omega)),
            key=lambda row: row.sigma_xy,
        )
        colour = COLOURS[(2 + omegas.index(omega)) % len(COLOURS)]
        dash = "-" if filter_ == "ekf" else (0, (3, 3))
        name = f"{filter_.upper()}, σ_ω = {omega:g} rad/s"
        yield curve, {"color": colour, "linestyle": dash, "marker": "o", "markersize": 3, "label": name}


def _draw_rmse(axes: Axes, curve: Sequence[Row], name: str, scale: float, look: dict[str, Any]) -> None:
    sigma = [row.sigma_xy for row in curve]
    axes.plot(sigma, [scale * getattr(row, f"{name}_rmse") for row in curve], **look)
    bound = [scale * getattr(row, f"{name}_bound") for row in curve]
    axes.plot(sigma, bound, color=look["color"], linestyle=":", linewidth=1.0)


def _draw_nees(axes: Axes, curve: Sequence[Row], name: str, scale: float, look: dict[str, Any]) -> None:
    axes.axhspan(*getattr(curve[0], f"{name}_bounds"), color=BAND, zorder=0, linewidth=0.0)
    axes.plot([row.sigma_xy for row in curve], [scale * getattr(row, name) for row in curve], **look)
