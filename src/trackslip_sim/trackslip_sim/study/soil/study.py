# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Study of the soil estimator; one piece is one run in one process."""

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from types import MappingProxyType, ModuleType
from typing import Any, ClassVar

from trackslip_common.parameters import to_flat
from trackslip_common.soils import load_soils
from trackslip_estimation import attitude, kalman, terramechanics
from trackslip_estimation import slip as slip_estimator
from trackslip_estimation import soil as soil_estimator
from trackslip_estimation.slip.parameters import NODE as SLIP_NODE
from trackslip_estimation.soil.soil_parameters import NODE as SOIL_NODE
from trackslip_sim.machine import sensors
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.scenarios.terrains import load_terrain
from trackslip_sim.study.engine import NO_VALUE, Columns, Study, Workers, map_pieces, spaced_name, table_lines
from trackslip_sim.study.soil import score
from trackslip_sim.study.soil.parameters import SoilCell, load_soil_study_parameters, soil_cells
from trackslip_sim.study.soil.results import AnyRow, ChangeRow, SoilRow, summary
from trackslip_sim.study.soil.score import RECOGNISED, Result, run_trial
from trackslip_sim.study.soil.trial import Setting, Trial, load_setting
from trackslip_sim.truth import shear
from trackslip_sim.truth.settings import load_settings
from trackslip_tools.cli.replay_options import parse_settings

_GRID = (  # fields of a trial
    *("scenarios", "duration", "standstill", "soils", "drawn", "sigma_xy"),
    *("terrains", "seeds"),
)
_SOIL_LEGEND = (
    "Errors over the truth, the median of the runs and, in brackets, the worst: F_max, K and μ_r at the end "
    "of `{scenario}`, M_r in steady turns and F, the thrust, as RMS over that of the truth. in: runs whose "
    "interval from 5 to 95 % contains the truth, nine of ten if it is consistent. known: runs in which K and "
    "F_max are identifiable. offset: the error of a transducer's offset after the standstill."
)
_CHANGE_LEGEND = (
    "`{scenario}`: seconds from the border between two soils to a probability of more than {certain:.0%} for "
    "the right one, and the probability of all others as the border was crossed; medians and, in brackets, "
    "the worst."
)


def _spread_text(median: float, worst: float, scale: float = 100.0) -> str:
    """Text of median and worst; – for nan."""
    if math.isnan(median):
        return NO_VALUE
    return f"{scale * median:.1f} ({scale * worst:.1f})".replace("inf", "never")


def _error_column(name: str) -> Callable[[SoilRow], str]:
    return lambda row: _spread_text(getattr(row, f"{name}_error"), getattr(row, f"{name}_worst"))


def _count_column(name: str) -> Callable[[AnyRow], str]:
    return lambda row: f"{getattr(row, name)}/{row.seeds}"


_MACHINE_COLUMNS: Columns = {
    "machine": lambda row: "drawn" if row.drawn else "nominal",
    "σ_xy m": lambda row: f"{row.sigma_xy:g}",
}
_TERRAIN_COLUMNS: Columns = {"terrain": lambda row: spaced_name(row.terrain) or NO_VALUE}
_SOIL_COLUMNS: Columns = {
    "soil": lambda row: spaced_name(row.soil),
    **_MACHINE_COLUMNS,
    "F_max %": _error_column("F_max"),
    "in": _count_column("F_max_inside"),
    "K %": _error_column("K"),
    "in ": _count_column("K_inside"),
    "K high/low": lambda row: f"{row.K_ratio:.2f}",
    "known": _count_column("identifiable"),
    "P(class)": lambda row: f"{row.class_probability:.2f}",
    "μ_r %": _error_column("mu_r"),
    "in  ": _count_column("mu_r_inside"),
    "M_r %": _error_column("M_r"),
    "in   ": lambda row: NO_VALUE if math.isnan(row.M_r_error) else f"{row.M_r_inside}/{row.seeds}",
    "F driving %": _error_column("driving_thrust"),
    "F braking %": _error_column("braking_thrust"),
    "offset kPa": lambda row: _spread_text(row.offset_residue, row.offset_residue_worst, 1e-3),
}
_CHANGE_COLUMNS: Columns = {
    "from": lambda row: spaced_name(row.soil),
    "to": lambda row: spaced_name(row.into),
    **_MACHINE_COLUMNS,
    "recognised": _count_column("recognised"),
    "after s": lambda row: _spread_text(row.recognised_after, row.recognised_after_worst, 1.0),
    "P(wrong) before": lambda row: f"{row.wrong_before:.2f} ({row.wrong_before_worst:.2f})",
}


class SoilStudy(Study[Trial, Result]):
    """The study of ``trackslip study --estimator soil``.

    Raises:
        InputError: an option is refused, or a scenario or soil cannot be driven.
    """

    UNIT: ClassVar[str] = "runs"
    PARAMETERS: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"scenario": "scenarios", "soil": "soils", "terrain": "terrains"}
        | {name: name for name in ("duration", "drawn", "sigma_xy", "sigma_heading", "seeds")}
    )
    RESULT: ClassVar[type[Any]] = Result
    SOURCES: ClassVar[Sequence[ModuleType]] = (
        *(kalman, attitude, slip_estimator, soil_estimator, terramechanics),
        *(sensors, shear, score),
    )
    FILE: ClassVar[str] = "soil_table.md"

    def __init__(self, parameters: Mapping[str, Any], settings: Sequence[str]) -> None:
        p = load_soil_study_parameters(dict(parameters))
        slip, soil = (parse_settings(settings, node) for node in (SLIP_NODE, SOIL_NODE))
        setting = self._setting = load_setting(p, slip, soil)
        self.cells = {
            cell: [
                Trial(
                    *(cell.soil, cell.sigma_xy, seed, cell.drawn, cell.scenario, p.duration, p.standstill),
                    terrain=cell.terrain,
                )
                for seed in range(p.seeds)
            ]
            for cell in soil_cells(p)
        }
        self._scenarios = {name: repr(load_scenario(name)) for name in p.scenarios}
        self._common = {
            "study": {name: value for name, value in to_flat(p).items() if name not in _GRID},
            "slip": to_flat(setting.slip),
            "soil": to_flat(setting.soil),
            "noise": to_flat(setting.noise),
            "truth": to_flat(load_settings()),
            "soils": repr(load_soils()),
        }

    def depends_on(self, piece: Trial) -> Mapping[str, Any]:
        terrain = repr(load_terrain(piece.terrain)) if piece.terrain else ""
        return {**self._common, "scenario": self._scenarios[piece.scenario], "terrain": terrain}

    def compute(self, pieces: Sequence[Trial], workers: Workers) -> Generator[Result, None, None]:
        return map_pieces(_run, self._setting, pieces, workers)

    def row(self, cell: SoilCell, results: Sequence[Result]) -> AnyRow:
        return summary(cell, results)

    def markdown(self, rows: Sequence[AnyRow]) -> str:
        """A table and its legend for each scenario."""
        scenarios = dict.fromkeys(row.scenario for row in rows)
        return "\n".join(_tables([row for row in rows if row.scenario == name]) for name in scenarios)


def _run(setting: Setting, trial: Trial) -> Result:
    return run_trial(trial, setting)


def _tables(rows: Sequence[AnyRow]) -> str:
    """The tables of one scenario."""
    soils = [row for row in rows if isinstance(row, SoilRow)]
    changes = [row for row in rows if isinstance(row, ChangeRow)]
    scenario = rows[0].scenario
    lines: list[str] = []
    if soils:
        on_terrain = any(row.terrain for row in soils)
        columns = {**_TERRAIN_COLUMNS, **_SOIL_COLUMNS} if on_terrain else _SOIL_COLUMNS
        lines += [
            *table_lines(columns, soils, text_columns=2 + on_terrain),
            "",
            _SOIL_LEGEND.format(scenario=scenario),
        ]
    if changes:
        legend = _CHANGE_LEGEND.format(scenario=scenario, certain=RECOGNISED)
        lines += [*table_lines(_CHANGE_COLUMNS, changes, text_columns=3), "", legend]
    return "\n".join(lines) + "\n"
