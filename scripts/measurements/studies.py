# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Tables from ``trackslip study``, whose cache keeps finished pieces."""

from pathlib import Path
from typing import Any

from measurements.workbench import SOILS, trackslip
from trackslip_sim.study.engine import spaced_name, table_lines

_TERRAINS = {"slope_15": "15° up", "slope_down_15": "15° down", "side_slope_15": "15° across", "hill": "hill"}
_SLOPES = {
    "terrain": lambda row: _TERRAINS[row["terrain"]],
    "soil": lambda row: spaced_name(row["soil"]),
    "F_max %": lambda row: _error(row, "F_max"),
    "K %": lambda row: _error(row, "K"),
    "μ_r %": lambda row: _error(row, "mu_r"),
    "identifiable": lambda row: f"{row['identifiable']}/{row['seeds']}",
}
_DRAWN = {
    "soil": lambda row: spaced_name(row["soil"]),
    "σ_xy m": lambda row: f"{row['sigma_xy']:g}",
    "position mm (bound)": lambda row: pair(row, "position", 1e3, 1),
    "slip in turns % (bound)": lambda row: pair(row, "turning_slip", 100.0, 2),
    "NEES of pose": lambda row: f"{row['nees_pose']:.1f}",
}
_MACHINES = {
    "machine": lambda row: f"`{row['vehicle']}`",
    "soil": lambda row: spaced_name(row["soil"]),
    "position mm (bound)": lambda row: pair(row, "position", 1e3, 1),
    "slip % (bound)": lambda row: pair(row, "slip", 100.0, 2),
    "NEES of pose": lambda row: f"{row['nees_pose']:.1f}",
}


def soil_on_slopes(folder: Path) -> list[str]:
    """Errors of the soil estimate on slopes of 15° and a hill, three runs per cell."""
    options = f"--scenario field_trial --terrain {' '.join(_TERRAINS)} --sigma-xy 0.01 --seeds 3"
    return table_lines(
        _SLOPES, trackslip(f"study --estimator soil --workers 1 {options}", folder), text_columns=2
    )


def drawn_machines(folder: Path) -> list[str]:
    """Errors of drawn machines with nominal parameters, with fixes of 1 and 5 cm."""
    options = "--truth drawn --filter ekf --sigma-xy 0.01 0.05 --sigma-omega 0.01 --seeds 48"
    return table_lines(_DRAWN, trackslip(f"study --workers 1 {options}", folder), text_columns=1)


def two_machines(folder: Path) -> list[str]:
    """Errors of the PC05 and the 20 t machine on the shear truth."""
    options = f"--truth shear --filter ekf --sigma-xy 0.05 --seeds 10 --soil {' '.join(SOILS)}"
    rows = [
        {"vehicle": vehicle, **row}
        for vehicle in ("pc05", "excavator_20t")
        for row in trackslip(f"study --workers 1 --vehicle {vehicle} {options}", folder)
    ]
    return table_lines(_MACHINES, rows, text_columns=2)


def _error(row: dict[str, Any], name: str) -> str:
    """Text of median, worst, and share of runs whose interval contains the truth."""
    share = f"{row[f'{name}_inside']}/{row['seeds']}"
    return f"{100.0 * row[f'{name}_error']:.1f} ({100.0 * row[f'{name}_worst']:.1f}), {share}"


def pair(row: dict[str, Any], name: str, scale: float, digits: int) -> str:
    """Text of an error of a row and its bound."""
    return f"{scale * row[f'{name}_rmse']:.{digits}f} ({scale * row[f'{name}_bound']:.{digits}f})"
