# SPDX-License-Identifier: Apache-2.0
"""The slip estimator's study; a piece of it is a cell, whose runs share the cores: kernels hold no lock."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any, ClassVar

from trackslip_common.errors import InputError
from trackslip_common.parameters import to_flat
from trackslip_common.soils import load_soils
from trackslip_estimation import kalman, slip
from trackslip_estimation.slip import models
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.study.engine import Study
from trackslip_sim.study.slip import kernels
from trackslip_sim.study.slip.drive import make_drive
from trackslip_sim.study.slip.evaluate import evaluate
from trackslip_sim.study.slip.parameters import Cell, cells, load_study_parameters
from trackslip_sim.study.slip.results import Row
from trackslip_sim.study.table import Columns, table, words
from trackslip_sim.truth import shear
from trackslip_sim.truth.settings import load_settings
from trackslip_tools.cli.replay_options import parse_set

_GRID = ("truths", "soils", "filters", "sigma_xy", "sigma_omega")  # a cell has one of each
_LEGEND = (
    "RMSE and, in brackets, the posterior Cramér–Rao bound. NEES and NIS: means over runs and scored time, "
    "with ↑ above and ↓ below the bounds {bounds} numbers (95 % of χ² for the mean of {seeds} runs)."
)


def _error(name: str, scale: float, digits: int = 2) -> Callable[[Row], str]:
    def show(row: Row) -> str:
        rmse, bound = (scale * getattr(row, f"{name}_{what}") for what in ("rmse", "bound"))
        return f"{rmse:.{digits}f} ({bound:.{digits}f})"

    return show


def _within(name: str) -> Callable[[Row], str]:
    def show(row: Row) -> str:
        value, (low, high) = getattr(row, name), getattr(row, f"{name}_bounds")
        return f"{value:.2f}" + (" ↑" if value > high else " ↓" if value < low else "")

    return show


_COLUMNS: Columns = {
    "truth": lambda row: str(row.truth),
    "soil": lambda row: words(row.soil),
    "filter": lambda row: str(row.filter),
    "σ_xy m": lambda row: f"{row.sigma_xy:g}",
    "σ_ω rad/s": lambda row: f"{row.sigma_omega:g}",
    "position mm": _error("position", 1e3),
    "heading mrad": _error("heading", 1e3),
    "slip %": _error("slip", 1e2),
    "in turns %": _error("turning_slip", 1e2),
    "α mrad": _error("alpha", 1e3, digits=1),
    "NEES pose": _within("nees_pose"),
    "NEES slips": _within("nees_slip"),
    "NIS pose": _within("nis_pose"),
    "NIS yaw rate": _within("nis_yaw_rate"),
}


class SlipStudy(Study[Cell, Row]):
    """What ``trackslip study`` does unless asked otherwise.

    Raises:
        InputError: an option is refused.
    """

    UNIT: ClassVar[str] = "cells"
    PARAMETERS: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"truth": "truths", "soil": "soils", "filter": "filters"}
        | {name: name for name in ("sigma_xy", "sigma_omega", "sigma_heading")}
        | {name: name for name in ("seeds", "scenario", "duration", "settling")}
    )
    RESULT: ClassVar[type[Any]] = Row
    SOURCES: ClassVar[Sequence[ModuleType]] = (kalman, slip, models, shear, kernels)
    FILE: ClassVar[str] = "study_table.md"

    def __init__(self, given: Mapping[str, Any], settings: Sequence[str]) -> None:
        first, *others = given.get("scenario", [None])
        if others:
            raise InputError(f"--scenario: '{others[0]}' is one too many; accepted: one")
        scenario = {} if first is None else {"scenario": first}
        self._p = load_study_parameters({**given, **scenario})
        self._estimator = load_slip_parameters(dict(map(parse_set, settings)))
        self.cells = {cell: [cell] for cell in cells(self._p)}
        self._common = {
            "study": {name: value for name, value in to_flat(self._p).items() if name not in _GRID},
            "estimator": to_flat(self._estimator),
            "truth": to_flat(load_settings()),
            "scenario": repr(load_scenario(self._p.scenario)),
        }

    def rests_on(self, piece: Cell) -> Mapping[str, Any]:
        return {**self._common, "soil": repr(load_soils().get(piece.soil))}

    def compute(self, pieces: Sequence[Cell], jobs: int | None) -> Iterator[Row]:
        """As ``Study``; each soil is driven once."""
        p, estimator = self._p, self._estimator
        drives = {soil: make_drive(p, estimator, soil) for soil in dict.fromkeys(c.soil for c in pieces)}
        pool = ThreadPoolExecutor(jobs)
        try:
            for cell in pieces:
                yield evaluate(cell, drives[cell.soil], p, estimator, pool.map)
        finally:
            pool.shutdown(cancel_futures=True)

    def row(self, cell: Cell, results: Sequence[Row]) -> Row:
        (row,) = results
        return row

    def markdown(self, rows: Sequence[Row]) -> str:
        row = rows[0]
        intervals = {3: row.nees_pose_bounds, 2: row.nees_slip_bounds, 1: row.nis_yaw_rate_bounds}
        bounds = ", ".join(f"{low:.2f}–{high:.2f} for {dof}" for dof, (low, high) in intervals.items())
        legend = _LEGEND.format(bounds=bounds, seeds=row.seeds)
        return "\n".join((*table(_COLUMNS, rows, text_columns=3), "", legend)) + "\n"

    def write(self, rows: Sequence[Row], folder: Path) -> None:
        """The table, and in ``figures`` what the Monte Carlo gives."""
        from trackslip_sim.study.slip.figures import (
            write_monte_carlo,  # matplotlib: not for every command's start
        )

        super().write(rows, folder)
        (folder / "figures").mkdir(exist_ok=True)
        write_monte_carlo(rows, folder / "figures")
