# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Study of the slip estimator; one piece is one cell."""

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any, ClassVar

from trackslip_common.errors import InputError
from trackslip_common.parameters import to_flat
from trackslip_common.soils import load_soils
from trackslip_estimation import attitude, kalman, slip, terramechanics
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_sim import machine
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.scenarios.terrains import load_terrain
from trackslip_sim.study.engine import NO_VALUE, Columns, Study, Workers, map_pieces, spaced_name, table_lines
from trackslip_sim.study.slip import kernels
from trackslip_sim.study.slip.drive import Drive, make_drive
from trackslip_sim.study.slip.evaluate import drawn_machine_parameters, evaluate
from trackslip_sim.study.slip.parameters import (
    NODE,
    SHEAR,
    Cell,
    StudyParameters,
    cells,
    load_study_parameters,
)
from trackslip_sim.study.slip.results import Row
from trackslip_sim.truth import shear
from trackslip_sim.truth.settings import load_settings
from trackslip_tools.cli.replay_options import parse_set

_GRID = ("truths", "soils", "terrains", "filters", "sigma_xy", "sigma_omega")  # factors of the grid
_TERRAIN_FILE = "slope_table.md"
_MAX_DRIVES = 4  # drives in memory, some 60 MB each
_LEGEND = (
    "RMSE and, in brackets, the posterior Cramér–Rao bound. NEES and NIS: means over runs and scored time, "
    "with ↑ above and ↓ below the bounds {bounds} numbers (95 % of χ² for the mean of {seeds} runs)."
)


def _error_column(name: str, scale: float, digits: int = 2) -> Callable[[Row], str]:
    def show(row: Row) -> str:
        rmse, bound = (scale * getattr(row, f"{name}_{what}") for what in ("rmse", "bound"))
        return NO_VALUE if math.isnan(rmse) else f"{rmse:.{digits}f} ({bound:.{digits}f})"

    return show


def _consistency_column(name: str) -> Callable[[Row], str]:
    def show(row: Row) -> str:
        value, (low, high) = getattr(row, name), getattr(row, f"{name}_bounds")
        if math.isnan(value):
            return NO_VALUE
        return f"{value:.2f}" + (" ↑" if value > high else " ↓" if value < low else "")

    return show


def _ratio_column(name: str, prefix: str = "") -> Callable[[Row], str]:
    """Column with the ratio of an error to its bound."""

    def show(row: Row) -> str:
        bound = getattr(row, name.removesuffix("rmse") + "bound")
        return NO_VALUE if math.isnan(bound) else f"{getattr(row, prefix + name) / bound:.2f}"

    return show


_COLUMNS: Columns = {
    "truth": lambda row: str(row.truth),
    "soil": lambda row: spaced_name(row.soil),
    "filter": lambda row: str(row.filter),
    "σ_xy m": lambda row: f"{row.sigma_xy:g}",
    "σ_ω rad/s": lambda row: f"{row.sigma_omega:g}",
    "position mm": _error_column("position", 1e3),
    "heading mrad": _error_column("heading", 1e3),
    "slip %": _error_column("slip", 1e2),
    "in turns %": _error_column("turning_slip", 1e2),
    "α mrad": _error_column("alpha", 1e3, digits=1),
    "NEES pose": _consistency_column("nees_pose"),
    "NEES slips": _consistency_column("nees_slip"),
    "NIS pose": _consistency_column("nis_pose"),
    "NIS yaw rate": _consistency_column("nis_yaw_rate"),
}


def _columns(rows: Sequence[Row]) -> Columns:
    """The columns; with the swing after the heading if sensors are on the upper structure."""
    if all(row.swing_rmse is None for row in rows):
        return _COLUMNS
    columns = list(_COLUMNS.items())
    after = list(_COLUMNS).index("heading mrad") + 1
    return dict([*columns[:after], ("swing mrad", _error_column("swing", 1e3)), *columns[after:]])


_TERRAIN_COLUMNS: Columns = {
    "terrain": lambda row: spaced_name(row.terrain),
    "truth": lambda row: str(row.truth),
    "soil": lambda row: spaced_name(row.soil),
    "filter": lambda row: str(row.filter),
    "σ_xy m": lambda row: f"{row.sigma_xy:g}",
    "position mm": _error_column("position", 1e3),
    "×": _ratio_column("position_rmse"),
    "slip in turns %": _error_column("turning_slip", 1e2),
    "× ": _ratio_column("turning_slip_rmse"),
    "NEES pose": _consistency_column("nees_pose"),
    "flat: position ×": _ratio_column("position_rmse", "ignoring_"),
    "in turns ×": _ratio_column("turning_slip_rmse", "ignoring_"),
    "NEES": lambda row: f"{row.ignoring_nees_pose:.1f}",
}
_TERRAIN_LEGEND = (
    "×: the RMSE over its bound on that ground. flat: of the same filter without attitude, which "
    "assumes level ground."
)


class _DriveCache:
    """Cache of the drives that cells share; each process keeps the last ``_MAX_DRIVES``."""

    def __init__(self, p: StudyParameters, estimator: SlipEstimatorParameters) -> None:
        self.p, self.estimator = p, estimator
        self._drives: dict[tuple[str, str], Drive] = {}

    def drive_of(self, cell: Cell) -> Drive:
        """The drive of a cell; it is computed if not in the cache."""
        key = cell.soil, cell.terrain
        if key not in self._drives:
            while len(self._drives) >= _MAX_DRIVES:
                del self._drives[next(iter(self._drives))]
            self._drives[key] = make_drive(self.p, self.estimator, *key)
        return self._drives[key]

    def __getstate__(self) -> dict[str, Any]:
        """State without the drives: each process computes those that it needs."""
        return {**vars(self), "_drives": {}}


def _upper_sensor_parameters(
    p: StudyParameters, estimator: SlipEstimatorParameters, truths_requested: bool
) -> StudyParameters:
    """Parameters for sensors on the upper structure: shear truth and level ground only."""
    topics = ", ".join(topic for topic, source in estimator.mountable_sources().items() if source.above)
    mounted = f"is refused with {topics} on the upper structure"
    if truths_requested and (others := [truth for truth in p.truths if truth != SHEAR]):
        raise InputError(f"{NODE}: truths: '{others[0]}' {mounted}; accepted: {SHEAR}")
    if any(p.terrains):
        raise InputError(f"{NODE}: terrains: a terrain {mounted}; accepted: none")
    return replace(p, truths=(SHEAR,))


def _evaluate(drives: _DriveCache, cell: Cell) -> Row:
    return evaluate(cell, drives.drive_of(cell), drives.p, drives.estimator)


class SlipStudy(Study[Cell, Row]):
    """The default study of ``trackslip study``.

    Raises:
        InputError: an option is refused.
    """

    UNIT: ClassVar[str] = "cells"
    PARAMETERS: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"truth": "truths", "soil": "soils", "filter": "filters", "terrain": "terrains"}
        | {name: name for name in ("sigma_xy", "sigma_omega", "sigma_heading")}
        | {name: name for name in ("seeds", "scenario", "duration", "settling")}
    )
    RESULT: ClassVar[type[Any]] = Row
    SOURCES: ClassVar[Sequence[ModuleType]] = (
        *(kalman, attitude, slip, terramechanics),
        *(shear, machine, kernels),
    )
    FILE: ClassVar[str] = "study_table.md"

    def __init__(self, parameters: Mapping[str, Any], settings: Sequence[str]) -> None:
        first, *others = parameters.get("scenario", [None])
        if others:
            raise InputError(f"--scenario: '{others[0]}' is one too many; accepted: one")
        scenario = {} if first is None else {"scenario": first}
        self._p = load_study_parameters({**parameters, **scenario})
        self._estimator = load_slip_parameters(dict(map(parse_set, settings)))
        if self._estimator.swings:
            self._p = _upper_sensor_parameters(self._p, self._estimator, "truths" in parameters)
        self.cells = {cell: [cell] for cell in cells(self._p)}
        self._common = {
            "study": {name: value for name, value in to_flat(self._p).items() if name not in _GRID},
            "estimator": to_flat(self._estimator),
            "drawn": to_flat(drawn_machine_parameters(self._estimator)),
            "noise": to_flat(load_emulator_parameters({}).noise),
            "truth": to_flat(load_settings()),
            "scenario": repr(load_scenario(self._p.scenario)),
        }

    def depends_on(self, piece: Cell) -> Mapping[str, Any]:
        terrain = repr(load_terrain(piece.terrain)) if piece.terrain else ""
        return {**self._common, "soil": repr(load_soils().get(piece.soil)), "ground": terrain}

    def compute(self, pieces: Sequence[Cell], workers: Workers) -> Generator[Row, None, None]:
        return map_pieces(_evaluate, _DriveCache(self._p, self._estimator), pieces, workers)

    def row(self, cell: Cell, results: Sequence[Row]) -> Row:
        (row,) = results
        return row

    def markdown(self, rows: Sequence[Row]) -> str:
        row = rows[0]
        intervals = {3: row.nees_pose_bounds, 2: row.nees_slip_bounds, 1: row.nis_yaw_rate_bounds}
        bounds = ", ".join(f"{low:.2f}–{high:.2f} for {dof}" for dof, (low, high) in intervals.items())
        legend = _LEGEND.format(bounds=bounds, seeds=row.seeds)
        level, sloping = ([r for r in rows if bool(r.terrain) == on_terrain] for on_terrain in (False, True))
        lines = table_lines(_columns(level), level, text_columns=3) if level else []
        if sloping:
            lines += [*[""][: len(lines)], *table_lines(_TERRAIN_COLUMNS, sloping, text_columns=4)]
            legend = f"{legend} {_TERRAIN_LEGEND}"
        return "\n".join((*lines, "", legend)) + "\n"

    def files(self) -> tuple[str, ...]:
        """The table, and the figures in ``figures``."""
        if any(cell.terrain for cell in self.cells):
            return _TERRAIN_FILE, "figures/study_slopes.png"
        names = [f"study_{what}_{truth}" for truth in self._p.truths for what in ("rmse", "nees")]
        return self.FILE, *(f"figures/{name}.png" for name in names)

    def write(self, rows: Sequence[Row], folder: Path) -> None:
        from trackslip_sim.study.slip import figures  # loads matplotlib, which is slow

        super().write(rows, folder)
        figures.write_figures(rows, folder / "figures")
