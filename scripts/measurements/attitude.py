# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of attitude and height on slopes, beside filters without attitude or altitudes."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from measurements.workbench import SOILS, trackslip
from trackslip_sim.study.engine import spaced_name, table_lines

_SCENARIOS = ("hill", "ramp_up", "side_slope")
_ALTITUDE = "slip_estimator.sources.gnss_pose.use_altitude"
_COLUMNS = {
    "scenario": lambda row: f"`{row['scenario']}`",
    "soil": lambda row: spaced_name(row["soil"]),
    "position mm": lambda row: f"{1e3 * row['rmse']['filter']:.1f}",
    "NEES": lambda row: f"{row['nees']:.1f}",
    "flat: position mm": lambda row: f"{1e3 * row['flat']['rmse']['filter']:.0f}",
    "flat: NEES": lambda row: f"{row['flat']['nees']:.1f}",
    "attitude °": lambda row: f"{math.degrees(row['rmse']['attitude']):.2f}",
    "height m": lambda row: f"{row['rmse']['height']:.3f}",
}


def on_slopes(folder: Path) -> list[str]:
    """Errors with fixes of the laser box, for each scenario and soil."""
    return table_lines(_COLUMNS, list(_rows(folder)), text_columns=2)


_WITH_RTK = {
    **{
        name: _COLUMNS[name] for name in ("scenario", "soil", "position mm", "NEES", "attitude °", "height m")
    },
    "without altitudes: attitude °": lambda row: f"{math.degrees(row['without']['rmse']['attitude']):.2f}",
    "height of it m": lambda row: f"{row['without']['rmse']['height']:.3f}",
}


def with_rtk(folder: Path) -> list[str]:
    """Errors of the 20 t machine with RTK fixes and a heading."""
    return table_lines(_WITH_RTK, list(_rows_with_rtk(folder)), text_columns=2)


def _rows_with_rtk(folder: Path) -> Iterator[dict[str, Any]]:
    machine = "--vehicle excavator_20t"
    for scenario in ("hill", "side_slope"):  # a ramp bends too sharply for its tracks
        for soil in SOILS:
            bag = f"{{}}/{scenario}_{soil}"
            trackslip(f"simulate --scenario {scenario} --soil {soil} {machine} --output {bag}", folder)
            result, without = (
                trackslip(f"replay {bag} --params config/gnss.yaml --set {_ALTITUDE}={used}", folder)
                for used in ("true", "false")
            )
            yield {**result, "scenario": scenario, "soil": soil, "without": without}


def _rows(folder: Path) -> Iterator[dict[str, Any]]:
    for scenario in _SCENARIOS:
        for soil in SOILS:
            bag = f"{{}}/{scenario}_{soil}"
            trackslip(f"simulate --scenario {scenario} --soil {soil} --output {bag}", folder)
            result = trackslip(f"replay {bag}", folder)
            flat = trackslip(f"replay {bag} --set slip_estimator.use_attitude=false", folder)
            yield {**result, "scenario": scenario, "soil": soil, "flat": flat}
