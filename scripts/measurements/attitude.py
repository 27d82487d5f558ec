# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Roll, pitch and height on the scenarios with slopes, beside a filter to which the ground is flat."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from measurements.workbench import SOILS, trackslip
from trackslip_sim.study.table import table, words

_SCENARIOS = ("hill", "ramp_up", "side_slope")
_COLUMNS = {
    "scenario": lambda row: f"`{row['scenario']}`",
    "soil": lambda row: words(row["soil"]),
    "position mm": lambda row: f"{1e3 * row['rmse']['filter']:.1f}",
    "NEES": lambda row: f"{row['nees']:.1f}",
    "flat: position mm": lambda row: f"{1e3 * row['flat']['rmse']['filter']:.0f}",
    "flat: NEES": lambda row: f"{row['flat']['nees']:.1f}",
    "attitude °": lambda row: f"{math.degrees(row['rmse']['attitude']):.2f}",
    "height m": lambda row: f"{row['rmse']['height']:.3f}",
}


def on_slopes(folder: Path) -> list[str]:
    """Errors with fixes of the laser, each scenario on each soil."""
    return table(_COLUMNS, list(_rows(folder)), text_columns=2)


def _rows(folder: Path) -> Iterator[dict[str, Any]]:
    for scenario in _SCENARIOS:
        for soil in SOILS:
            bag = f"{{}}/{scenario}_{soil}"
            trackslip(f"simulate --scenario {scenario} --soil {soil} --output {bag}", folder)
            found = trackslip(f"replay {bag}", folder)
            flat = trackslip(f"replay {bag} --set slip_estimator.use_attitude=false", folder)
            yield {**found, "scenario": scenario, "soil": soil, "flat": flat}
