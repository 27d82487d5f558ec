# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of attitude and height on slopes, beside filters without attitude or altitudes."""

import math
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from measurements.workbench import SOILS, trackslip
from trackslip_sim.study.engine import spaced_name, table_lines

_ALTITUDE = "--set slip_estimator.sources.gnss_pose.use_altitude"
_SHARED = {
    "scenario": lambda row: f"`{row['scenario']}`",
    "soil": lambda row: spaced_name(row["soil"]),
    "position mm": lambda row: f"{1e3 * row['rmse']['filter']:.1f}",
    "NEES": lambda row: f"{row['nees']:.1f}",
}
_TILT = {
    "attitude °": lambda row: f"{math.degrees(row['rmse']['attitude']):.2f}",
    "height m": lambda row: f"{row['rmse']['height']:.3f}",
}
_WITH_BOX = {
    **_SHARED,
    "flat: position mm": lambda row: f"{1e3 * row['other']['rmse']['filter']:.0f}",
    "flat: NEES": lambda row: f"{row['other']['nees']:.1f}",
    **_TILT,
}
_WITH_RTK = {
    **_SHARED,
    **_TILT,
    "without altitudes: attitude °": lambda row: f"{math.degrees(row['other']['rmse']['attitude']):.2f}",
    "height of it m": lambda row: f"{row['other']['rmse']['height']:.3f}",
}


def on_slopes(folder: Path) -> list[str]:
    """Errors with fixes of the laser box, for each scenario and soil."""
    flat = "--set slip_estimator.use_attitude=false"
    rows = _rows(folder, ("hill", "ramp_up", "side_slope"), other=flat)
    return table_lines(_WITH_BOX, list(rows), text_columns=2)


def with_rtk(folder: Path) -> list[str]:
    """Errors of the 20 t machine with RTK fixes and a heading."""
    scenarios = ("hill", "side_slope")  # a ramp bends too sharply for its tracks
    options = f"--params config/gnss.yaml {_ALTITUDE}"
    rows = _rows(
        folder,
        scenarios,
        machine="--vehicle excavator_20t",
        options=f"{options}=true",
        other=f"{options}=false",
    )
    return table_lines(_WITH_RTK, list(rows), text_columns=2)


def _rows(
    folder: Path, scenarios: Sequence[str], *, machine: str = "", options: str = "", other: str
) -> Iterator[dict[str, Any]]:
    """Results of a replay for each scenario and soil, and those with ``other`` options."""
    for scenario, soil in product(scenarios, SOILS):
        bag = f"{{}}/{scenario}_{soil}"
        trackslip(f"simulate --scenario {scenario} --soil {soil} {machine} --output {bag}", folder)
        result, changed = (trackslip(f"replay {bag} {text}", folder) for text in (options, other))
        yield {**result, "scenario": scenario, "soil": soil, "other": changed}
