# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Short tables from files of the repository: the manifest of ``bags/``, and tables of the slip study."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from measurements.blocks import ROOT
from trackslip_sim.study.engine import NO_VALUE, table_lines

_RUNS = {
    "bag": lambda row: f"`{row['name']}`",
    "s": lambda row: f"{row['holds']['duration_s']:.0f}",
    "encoders alone m": lambda row: f"{row['rmse']['dead_reckoning']:.2f}",
    "position mm": lambda row: f"{1e3 * row['rmse']['filter']:.1f}",
    "heading rad": lambda row: f"{row['rmse']['heading']:.4f}",
    "slip": lambda row: f"{row['rmse']['slip']:.3f}",
    "NEES": lambda row: f"{row['replay']['nees']:.1f}",
}
_STUDY = {
    "truth": lambda row: row["truth"],
    "σ_ω rad/s": lambda row: row["σ_ω rad/s"],
    "σ_xy m": lambda row: row["σ_xy m"],
    "position": lambda row: row["position"],
    "slips in turns": lambda row: row["slips"],
    "NEES of pose": lambda row: row["pose"],
    "NEES of slips": lambda row: row["of_slips"],
}
_SLOPES = {
    "filter": lambda row: row["filter"],
    "position": lambda row: row["position"],
    "slips in turns": lambda row: row["slips"],
    "NEES of pose": lambda row: row["pose"],
}
_CANNOT_CLIMB = "clayey soil"

Row = Mapping[str, str]


def runs(_: Path) -> list[str]:
    """Results of ``trackslip replay`` for each bag; ``tests/bags/test_bags.py`` replays them."""
    bags = yaml.safe_load((ROOT / "bags/manifest.yaml").read_text(encoding="utf-8"))["bags"]
    rows = [{"name": name, "rmse": bag["replay"]["rmse"], **bag} for name, bag in bags.items()]
    return table_lines(_RUNS, rows, text_columns=1)


def study_ranges(_: Path) -> list[str]:
    """Smallest and largest values over soils and filters; errors as RMSE over bound."""
    cells = _rows_of(ROOT / "docs/study_table.md")
    keys = dict.fromkeys((row["truth"], row["σ_ω rad/s"], row["σ_xy m"]) for row in cells)
    return table_lines(
        _STUDY,
        [
            _ranges([row for row in cells if (row["truth"], row["σ_ω rad/s"], row["σ_xy m"]) == key])
            for key in keys
        ],
        text_columns=1,
    )


def slope_ranges(_: Path) -> list[str]:
    """The same on slopes, for filters with and without attitude, from the ratios in the slope table."""
    cells = [row for row in _rows_of(ROOT / "docs/slope_table.md") if row["terrain"] != "flat"]
    climbs = [row for row in cells if row["soil"] != _CANNOT_CLIMB]
    names = {"with the slope": ("×", "× 2", "NEES pose"), "to which the ground is flat": _IGNORING}
    rows = [
        {
            "filter": f"{name}{where}",
            "position": _range(row[position] for row in chosen),
            "slips": _range(row[slips] for row in chosen),
            "pose": _range(row[nees] for row in chosen),
        }
        for chosen, where in ((climbs, ""), (_on_clay(cells), f", {_CANNOT_CLIMB}"))
        for name, (position, slips, nees) in names.items()
    ]
    return table_lines(_SLOPES, rows, text_columns=1)


_IGNORING = ("flat: position ×", "in turns ×", "NEES")


def _on_clay(cells: Iterable[Row]) -> list[Row]:
    return [row for row in cells if row["soil"] == _CANNOT_CLIMB]


def _ranges(cells: list[Row]) -> dict[str, Any]:
    return {
        **cells[0],
        "position": _range(_ratio(row["position mm"]) for row in cells),
        "slips": _range(_ratio(row["in turns %"]) for row in cells),
        "pose": _range(row["NEES pose"] for row in cells),
        "of_slips": _range(row["NEES slips"] for row in cells),
    }


def _rows_of(file: Path) -> list[Row]:
    """Rows of the first table; a repeated heading gets a number."""
    lines = [line for line in file.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    heads: list[str] = []
    for head in _cells(lines[0]):
        heads.append(head if head not in heads else f"{head} {1 + heads.count(head)}")
    return [dict(zip(heads, _cells(line), strict=True)) for line in lines[2:]]


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def _ratio(cell: str) -> str:
    """``RMSE (bound)`` as a quotient."""
    rmse, bound = re.findall(r"[\d.]+", cell)
    return f"{float(rmse) / float(bound):.2f}"


def _range(cells: Iterable[str]) -> str:
    texts = [found[0] for cell in cells if (found := re.match(r"[\d.]+", cell))]
    if not texts:
        return NO_VALUE
    low, high = min(texts, key=float), max(texts, key=float)
    return low if low == high else f"{low}–{high}"
