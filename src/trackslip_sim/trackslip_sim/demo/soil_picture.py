# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Forces, resistance and strength of the soil over a drive, with the truth, as Figs 6.15 to 6.17."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from trackslip_sim.demo.soil_results import (
    LIMIT,
    MODULUS,
    SoilResult,
)
from trackslip_tools.replay.series import Series

FloatArray = NDArray[np.float64]

_TRUTH, _LEFT, _RIGHT = "#222222", "#0072b2", "#009e73"


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
