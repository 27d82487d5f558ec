# SPDX-License-Identifier: Apache-2.0
"""The grid of a study, cell by cell; the runs of a cell share the cores: kernels hold no lock."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

from trackslip_common.errors import InputError
from trackslip_common.parameters import to_flat
from trackslip_common.soils import load_soils
from trackslip_estimation.slip import motion
from trackslip_estimation.slip.models import dispatch as equations
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.study.slip import kernels
from trackslip_sim.study.slip.cache import Cache, key_of, resumed
from trackslip_sim.study.slip.drive import make_drive
from trackslip_sim.study.slip.evaluate import evaluate
from trackslip_sim.study.slip.parameters import Cell, StudyParameters, cells, load_study_parameters
from trackslip_sim.study.slip.results import Row
from trackslip_sim.study.slip.table import markdown
from trackslip_sim.truth import shear
from trackslip_sim.truth.settings import load_settings
from trackslip_tools.cli.replay_options import parse_set

_GRID = ("truths", "soils", "filters", "sigma_xy", "sigma_omega")  # a cell has one of each
_SOURCES = (motion, equations, shear, kernels)  # estimator, filters, truth, study


class SlipStudy:
    """What ``trackslip study`` does unless told otherwise; a piece of it is a cell, which is a row.

    Raises:
        InputError: an option is refused.
    """

    UNIT: ClassVar[str] = "cells"
    PARAMETERS: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"truth": "truths", "soil": "soils", "filter": "filters"}
        | {name: name for name in ("sigma_xy", "sigma_omega", "sigma_heading")}
        | {name: name for name in ("seeds", "scenario", "duration", "settling")}
    )  # option → parameter

    def __init__(self, given: Mapping[str, Any], settings: Sequence[str]) -> None:
        first, *others = given.get("scenario", [None])
        if others:
            raise InputError(f"--scenario: '{others[0]}' is one too many; accepted: one")
        scenario = {} if first is None else {"scenario": first}
        self._p = load_study_parameters({**given, **scenario})
        self._estimator = load_slip_parameters(dict(map(parse_set, settings)))

    def __len__(self) -> int:
        """How many cells it has."""
        return len({*cells(self._p)})

    def run(self, cache: Path, jobs: int, *, fresh: bool) -> Iterator[Row]:
        """The rows in the order of the grid."""
        return run_study(self._p, self._estimator, Cache(cache, Row, fresh), jobs)

    def rows(self, finished: Sequence[Row]) -> list[Row]:
        """The pieces are the rows."""
        return list(finished)

    def markdown(self, rows: Sequence[Row]) -> str:
        """The table."""
        return markdown(rows)

    def write(self, rows: Sequence[Row], folder: Path) -> None:
        """``study_table.md``, and in ``figures`` what the Monte Carlo says."""
        from trackslip_sim.study.slip.figures import (
            write_monte_carlo,  # matplotlib: not for every command's start
        )

        (folder / "study_table.md").write_text(markdown(rows), encoding="utf-8")
        (folder / "figures").mkdir(exist_ok=True)
        write_monte_carlo(rows, folder / "figures")


def run_study(
    p: StudyParameters, estimator: SlipEstimatorParameters, cache: Cache[Row], jobs: int | None = None
) -> Iterator[Row]:
    """The rows in the order of the grid; those in the cache are not computed again.

    Raises:
        InputError: scenario or a soil is unknown or refused; before a row is computed.
    """

    def compute(missing: Sequence[Cell]) -> Iterator[Row]:
        drives = {
            soil: make_drive(p, estimator, soil) for soil in dict.fromkeys(cell.soil for cell in missing)
        }
        pool = ThreadPoolExecutor(jobs)
        try:
            for cell in missing:
                yield evaluate(cell, drives[cell.soil], p, estimator, pool.map)
        finally:
            pool.shutdown(cancel_futures=True)

    return resumed({cell: _key(cell, p, estimator) for cell in cells(p)}, cache, compute)


def _key(cell: Cell, p: StudyParameters, estimator: SlipEstimatorParameters) -> str:
    """Names all that a cell's row rests on."""
    parts = {
        "cell": asdict(cell),
        "study": {name: value for name, value in to_flat(p).items() if name not in _GRID},
        "estimator": to_flat(estimator),
        "truth": to_flat(load_settings()),
        "soil": repr(load_soils().get(cell.soil)),
        "scenario": repr(load_scenario(p.scenario)),
    }
    return key_of(parts, *_SOURCES)
