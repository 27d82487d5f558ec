# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One picture of a run: its paths and slips, and forces and soil with the truth, as Figs 6.15 to 6.17."""

from pathlib import Path as File

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from trackslip_sim.demo.results import (
    LIMIT,
    MODULUS,
    DemoResult,
    SoilResult,
)
from trackslip_tools.replay.series import Series

FloatArray = NDArray[np.float64]

_TRUTH, _FILTER, _ENCODERS = "#222222", "#0072b2", "#d55e00"
_ELLIPSE_EVERY = 2.0  # s
_ELLIPSE_SCALE = 2.0  # σ
_LEFT, _RIGHT = "#0072b2", "#009e73"


def draw(result: DemoResult, title: str, file: File) -> None:
    """Write the picture as PNG."""
    columns = 2 if result.soil is None else 3
    figure = plt.figure(figsize=(6.5 * columns, 7), layout="constrained")
    grid = figure.add_gridspec(15, columns, width_ratios=(1.15, *(1.0,) * (columns - 1)))
    _draw_paths(figure.add_subplot(grid[:, 0]), result)
    upper = figure.add_subplot(grid[:5, 1])
    _draw_error(upper, result)
    if result.soil is not None:
        panels = [figure.add_subplot(grid[row : row + 3, 2], sharex=upper) for row in range(0, 15, 3)]
        draw_soil(panels, result.soil, int(result.truth.stamps_ns[0]))
        panels[-1].set_xlabel("time of the drive, s")
    for row, name in enumerate(("left", "right")):
        axes = figure.add_subplot(grid[5 * row + 5 : 5 * row + 10, 1], sharex=upper)
        _draw_slip(axes, result, row, name)
        if row == 0:
            axes.legend(loc="upper right", fontsize="small", ncols=3)
    axes.set_xlabel("time of the drive, s")
    figure.suptitle(title)
    figure.savefig(file, dpi=110)
    plt.close(figure)


def _draw_paths(axes: Axes, result: DemoResult) -> None:
    truth = result.truth.poses
    encoders, estimate = result.paths["dead_reckoning"].poses, result.paths["filter"].poses
    axes.plot(truth[:, 0], truth[:, 1], color=_TRUTH, lw=2.5, label="truth")
    label = f"encoders alone, RMSE {result.dead_reckoning.position:.2f} m"
    axes.plot(encoders[:, 0], encoders[:, 1], color=_ENCODERS, lw=1.2, ls="--", label=label)
    label = f"estimate, RMSE {result.filter.position:.3f} m, with 2σ"
    axes.plot(estimate[:, 0], estimate[:, 1], color=_FILTER, lw=1.2, label=label)
    for ellipse in _ellipses(result.odometry):
        axes.add_patch(ellipse)
    axes.plot(*truth[0, :2], "o", color=_TRUTH, ms=6)
    axes.annotate("start", truth[0, :2], textcoords="offset points", xytext=(6, 6))
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
    axes.margins(0.08)
    axes.grid(alpha=0.3)
    axes.legend(loc="best", fontsize="small")


def _ellipses(odometry: Series) -> list[Ellipse]:
    """2σ of the position every few seconds."""
    t = (odometry.stamps_ns - odometry.stamps_ns[0]) * 1e-9
    ellipses = []
    for when in np.arange(0.0, t[-1], _ELLIPSE_EVERY):
        row = odometry.rows[int(np.searchsorted(t, when))]
        covariance = row["covariance"][:2, :2]
        variances, axes = np.linalg.eigh(covariance)
        width, height = 2.0 * _ELLIPSE_SCALE * np.sqrt(variances[::-1])
        angle = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
        look = {"angle": angle, "fc": _FILTER, "alpha": 0.25, "ec": _FILTER}
        ellipses.append(Ellipse((row["x"], row["y"]), width, height, **look))
    return ellipses


def _draw_error(axes: Axes, result: DemoResult) -> None:
    """Distance from the truth, below the 2σ that the estimate claims."""
    odometry = result.odometry
    t = (odometry.stamps_ns - result.truth.stamps_ns[0]) * 1e-9
    error = odometry.columns("x", "y") - result.truth.at(odometry.stamps_ns)[:, :2]
    covariances = odometry["covariance"][:, :2, :2]
    claimed = _ELLIPSE_SCALE * np.sqrt(np.trace(covariances, axis1=1, axis2=2))
    axes.fill_between(t, 0.0, 1e3 * claimed, color=_FILTER, alpha=0.2, lw=0.0, label="2σ claimed")
    axes.plot(t, 1e3 * np.hypot(error[:, 0], error[:, 1]), color=_FILTER, lw=1.0, label="error")
    axes.set(ylabel="position, mm", ylim=(0.0, None))
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right", fontsize="small", ncols=2)


def _draw_slip(axes: Axes, result: DemoResult, side: int, name: str) -> None:
    start_ns = result.truth.stamps_ns[0]
    t = (result.slips.stamps_ns - start_ns) * 1e-9
    column = ("left_slip", "right_slip")[side]
    slip = result.slips[column]
    sigma = np.sqrt(result.slips["covariance"][:, side, side])
    true = result.true_slips
    axes.fill_between(
        t, slip - 2.0 * sigma, slip + 2.0 * sigma, color=_FILTER, alpha=0.2, lw=0.0, label="±2σ"
    )
    axes.plot((true.stamps_ns - start_ns) * 1e-9, true[column], color=_TRUTH, lw=1.5, label="truth")
    axes.plot(t, slip, color=_FILTER, lw=1.2, label="estimate")
    axes.axhline(0.0, color="0.6", lw=0.6)
    low, high = np.percentile(np.concatenate((true[column], slip)), (0.5, 99.5))
    room = 0.25 * max(high - low, 0.05)
    axes.set(ylabel=f"{name} slip", ylim=(low - room, high + room))
    axes.grid(alpha=0.3)


def draw_soil(axes: list[Axes], result: SoilResult, start_ns: int) -> None:
    """Five pictures, one below the other, over the time of the drive."""
    thrust, resistance, mu, modulus, limit = axes
    for panel, field in ((thrust, "thrust"), (resistance, "resistance")):
        for name, colour in (("left", _LEFT), ("right", _RIGHT)):
            column = f"{name}_{field}"
            panel.plot(*_line(result.true_forces, column, start_ns, 1e-3), color=_TRUTH, lw=1.5)
            panel.plot(*_line(result.forces, column, start_ns, 1e-3), color=colour, lw=1.0, label=name)
        panel.set(ylabel=f"{field}, kN")
    thrust.legend(loc="upper left", fontsize="small", ncols=2)
    for name, column, colour in (("μ_r", "mu_r", _LEFT), ("mobilised μ_l", "mu_l", _RIGHT)):
        t, values = _line(result.soil, column, start_ns)
        spread = 2.0 * np.sqrt(result.soil[f"{column}_variance"])
        mu.fill_between(t, values - spread, values + spread, color=colour, alpha=0.2, lw=0.0)
        mu.plot(*_line(result.true_soil, column, start_ns), color=_TRUTH, lw=1.5)
        mu.plot(t, values, color=colour, lw=1.2, label=name)
    mu.set(ylabel="resistance, 1", ylim=(0.0, 0.8))
    mu.legend(loc="upper right", fontsize="small", ncols=2)
    _draw_interval(modulus, result, MODULUS, start_ns, "K, cm", 1e2)
    _draw_interval(limit, result, LIMIT, start_ns, "F_max, kN", 1e-3)
    for panel in axes:
        panel.grid(alpha=0.3)


def _draw_interval(
    axes: Axes, result: SoilResult, column: str, start_ns: int, label: str, scale: float
) -> None:
    """Median and 5 to 95 %, logarithmic."""
    t, values = _line(result.soil, column, start_ns, scale)
    low, high = (scale * result.soil[f"{column}_{end}"] for end in ("lower", "upper"))
    axes.fill_between(t, low, high, color=_LEFT, alpha=0.2, lw=0.0)
    axes.plot(*_line(result.true_soil, column, start_ns, scale), color=_TRUTH, lw=1.5)
    axes.plot(t, values, color=_LEFT, lw=1.2)
    axes.set(ylabel=label, yscale="log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _line(series: Series, column: str, start_ns: int, scale: float = 1.0) -> tuple[FloatArray, FloatArray]:
    return np.asarray((series.stamps_ns - start_ns) * 1e-9), scale * series[column]
