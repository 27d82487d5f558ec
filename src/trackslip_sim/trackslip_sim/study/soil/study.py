# SPDX-License-Identifier: Apache-2.0
"""The grid of the soil estimator's study, run by run, on all cores: each run is a process's work."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

from joblib import Parallel, delayed

from trackslip_common.parameters import to_flat
from trackslip_common.soils import load_soils
from trackslip_estimation import terramechanics
from trackslip_estimation.slip import motion
from trackslip_estimation.slip.models import dispatch as equations
from trackslip_estimation.slip.parameters import NODE as SLIP_NODE
from trackslip_estimation.soil import soil_estimator
from trackslip_estimation.soil.soil_parameters import NODE as SOIL_NODE
from trackslip_sim.machine import sensors
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.study.slip.cache import Cache, key_of, resumed
from trackslip_sim.study.soil import score
from trackslip_sim.study.soil.parameters import load_soil_study_parameters, soil_cells
from trackslip_sim.study.soil.results import AnyRow, summary
from trackslip_sim.study.soil.score import Result, run
from trackslip_sim.study.soil.table import markdown
from trackslip_sim.study.soil.trial import Setting, Trial, load_setting
from trackslip_sim.truth import shear
from trackslip_sim.truth.settings import load_settings
from trackslip_tools.cli.replay_options import parse_settings

_GRID = ("scenarios", "duration", "stand", "soils", "drawn", "sigma_xy", "seeds")  # a trial has one of each
_SOURCES = (motion, equations, soil_estimator, terramechanics, sensors, shear, score)


class SoilStudy:
    """What ``trackslip study --estimator soil`` does; a piece of it is a run.

    Raises:
        InputError: an option is refused, or a scenario or soil cannot be driven.
    """

    UNIT: ClassVar[str] = "runs"
    PARAMETERS: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"scenario": "scenarios", "soil": "soils"}
        | {name: name for name in ("duration", "drawn", "sigma_xy", "sigma_heading", "seeds")}
    )

    def __init__(self, given: Mapping[str, Any], settings: Sequence[str]) -> None:
        p = load_soil_study_parameters(dict(given))
        slip, soil = (parse_settings(settings, node) for node in (SLIP_NODE, SOIL_NODE))
        self._setting = load_setting(p, slip, soil)
        self._trials = {
            cell: [
                Trial(cell.soil, cell.sigma_xy, seed, cell.drawn, cell.scenario, p.duration, p.stand)
                for seed in range(p.seeds)
            ]
            for cell in soil_cells(p)
        }

    def __len__(self) -> int:
        """How many runs it has."""
        return sum(map(len, self._trials.values()))

    def run(self, cache: Path, jobs: int, *, fresh: bool) -> Iterator[Result]:
        """The runs in their order; those in the cache are not computed again."""
        trials = [trial for of_cell in self._trials.values() for trial in of_cell]
        keys = dict(zip(trials, keys_of(trials, self._setting), strict=True))

        def compute(missing: Sequence[Trial]) -> Iterator[Result]:
            with Parallel(jobs, return_as="generator") as pool:
                yield from pool(delayed(run)(trial, self._setting) for trial in missing)

        return resumed(keys, Cache(cache, Result, fresh), compute)

    def rows(self, results: Sequence[Result]) -> list[AnyRow]:
        """One of each cell."""
        found = iter(results)
        return [summary(cell, [next(found) for _ in of_cell]) for cell, of_cell in self._trials.items()]

    def markdown(self, rows: Sequence[AnyRow]) -> str:
        """The tables."""
        return markdown(rows)

    def write(self, rows: Sequence[AnyRow], folder: Path) -> None:
        """``soil_table.md``."""
        (folder / "soil_table.md").write_text(markdown(rows), encoding="utf-8")


def keys_of(trials: Sequence[Trial], setting: Setting) -> list[str]:
    """Names all that the results of the trials rest on."""
    scenarios = {name: repr(load_scenario(name)) for name in {trial.scenario for trial in trials}}
    common = {
        "study": {name: value for name, value in to_flat(setting.study).items() if name not in _GRID},
        "slip": to_flat(setting.slip),
        "soil": to_flat(setting.soil),
        "noise": to_flat(setting.noise),
        "truth": to_flat(load_settings()),
        "soils": repr(load_soils()),
    }
    return [
        key_of({"trial": asdict(trial), "scenario": scenarios[trial.scenario], **common}, *_SOURCES)
        for trial in trials
    ]
