# SPDX-License-Identifier: Apache-2.0
"""Rows of finished cells in a file, so that a study that was interrupted goes on.

A row is found again only while everything that it rests on is the same: cell, seeds, drive, sensors, all
parameters of the estimator, and the sources of estimator, filters, truth and study.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from trackslip_common.errors import InputError
from trackslip_common.parameters import to_flat
from trackslip_estimation import motion
from trackslip_estimation.filters import equations
from trackslip_estimation.slip_parameters import SlipEstimatorParameters
from trackslip_estimation.soils import load_soils
from trackslip_sim.scenarios import load_scenario
from trackslip_sim.study import kernels
from trackslip_sim.study.parameters import Cell, StudyParameters
from trackslip_sim.study.results import Row
from trackslip_sim.truth import shear
from trackslip_sim.truth.settings import load_settings

_GRID = ("truths", "soils", "filters", "sigma_xy", "sigma_omega")  # a cell has one of each
_FOLDERS_OF = (motion, equations, shear, kernels)  # estimator, filters, truth, study


class Cache:
    """One JSON line per cell, appended as soon as it is finished."""

    def __init__(self, path: Path, fresh: bool = False) -> None:
        """Read what is there, unless everything is to be computed afresh; a line cut short is left out.

        Raises:
            InputError: the file cannot be read or made.
        """
        self._path = path
        self._rows: dict[str, Row] = {}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError as error:
            raise InputError(f"--cache: '{path}' cannot be used ({error.strerror})") from error
        for line in () if fresh else lines:
            self._remember(line)

    def get(self, key: str) -> Row | None:
        """The row of a cell; None where it has to be computed."""
        return self._rows.get(key)

    def add(self, key: str, row: Row) -> None:
        """Keep a row, on disk too."""
        self._rows[key] = row
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": key, "row": asdict(row)}) + "\n")

    def _remember(self, line: str) -> None:
        try:
            entry = json.loads(line)
            values: dict[str, Any] = {
                name: tuple(v) if isinstance(v, list) else v for name, v in entry["row"].items()
            }
            self._rows[entry["key"]] = Row(**values)
        except (ValueError, KeyError, TypeError, AttributeError):  # cut short, or of another version
            return


def key_of(cell: Cell, p: StudyParameters, estimator: SlipEstimatorParameters) -> str:
    """Names all that a cell's row rests on."""
    held = {name: value for name, value in to_flat(p).items() if name not in _GRID}
    soil = load_soils().get(cell.soil)
    scenario = load_scenario(p.scenario)
    parts: Mapping[str, Any] = {
        "cell": asdict(cell),
        "study": held,
        "estimator": to_flat(estimator),
        "truth": to_flat(load_settings()),
        "soil": repr(soil),
        "scenario": repr(scenario),
        "sources": _sources(),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


@cache
def _sources() -> str:
    digest = hashlib.sha256()
    for module in _FOLDERS_OF:
        for path in sorted(Path(str(module.__file__)).parent.glob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()
