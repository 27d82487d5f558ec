# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Logs of real machines, which are not part of the project: ``data/`` of ``$TRACKSLIP_SHARED``.

Only the geometry is given. Fixes are lidar poses at 1 Hz with 5 cm of noise, in three draws.
"""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from measurements.blocks import ROOT
from measurements.workbench import NotMeasured, run, trackslip, write_yaml
from trackslip_sim.study.engine import table_lines


class _Log(NamedTuple):
    file: str
    mapping: str
    options: str
    cases: dict[str, str]  # name → withheld interval and topics


_LOGS = (
    _Log(
        "marmotte_boreal.csv",
        "mappings/marmotte.yaml",
        "",
        {
            "tracked robot, fixes": "",
            "… none for 30 s": "75.5:105.5",
            "… neither fixes nor gyro": "75.5:105.5 gyro",
        },
    ),
    _Log("marmotte_boreal.csv", "{}/marmotte_positions.yaml", "", {"tracked robot, heading unknown": ""}),
    _Log(
        "warthog_grass_a.csv",
        "mappings/warthog.yaml",
        "--start 128.8 --stop 362.9",
        {
            "Warthog, fixes": "",
            "… none for 30 s": "303.8:333.8",
            "… neither fixes nor gyro": "303.8:333.8 gyro",
            "… none for 30 s, later": "313.8:343.8",
            "… neither fixes nor gyro, later": "313.8:343.8 gyro",
        },
    ),
    _Log(
        "warthog_grass_a.csv",
        "{}/warthog_positions.yaml",
        "--start 128.8 --stop 362.9",
        {"Warthog, heading unknown": ""},
    ),
)
_THINNED = "--thin reference_pose:1:0.05 --reference reference_pose"
_MODELS = ("turning", "icr")


def _shown(model: str, place: int, digits: int) -> Callable[[dict[str, Any]], str]:
    return lambda row: f"{row[model][place]:.{digits}f}"


_COLUMNS: dict[str, Callable[[dict[str, Any]], str]] = {
    "case": lambda row: str(row["case"]),
    **{f"{model} m": _shown(model, 0, 3) for model in _MODELS},
    **{f"{model} NEES": _shown(model, 1, 1) for model in _MODELS},
}


def with_geometry_alone(folder: Path) -> list[str]:
    """RMSE of each model over the whole log, and NEES; mean of three draws.

    Raises:
        NotMeasured: a log is missing.
    """
    return table_lines(_COLUMNS, list(_rows(folder)), text_columns=1)


def _rows(folder: Path) -> Iterator[dict[str, Any]]:
    data = Path(os.environ.get("TRACKSLIP_SHARED", ROOT.parent / "shared")) / "data"
    for name in ("marmotte", "warthog"):
        mapping = yaml.safe_load((ROOT / "config" / "mappings" / f"{name}.yaml").read_text(encoding="utf-8"))
        write_yaml(folder / f"{name}_positions.yaml", _of_positions(mapping))
    for log in _LOGS:
        if not (data / log.file).is_file():
            raise NotMeasured(f"no {data / log.file}")
        bag = folder / Path(log.mapping).stem
        run(f"import {data / log.file} --mapping {log.mapping} --output {bag}", folder)
        for case, hidden in log.cases.items():
            window, _, gyro = hidden.partition(" ")
            topics = ("reference_pose", "imu/data_raw") if gyro else ("reference_pose",)
            options = " ".join(f"--withhold {topic}:{window}" for topic in topics) if window else ""
            replay = f"replay {bag} {log.options} {_THINNED} {options}"
            yield {"case": case, **{model: _mean(replay, model, folder) for model in _MODELS}}


def _of_positions(mapping: dict[str, Any]) -> dict[str, Any]:
    """The mapping without the heading of the reference."""
    topics = {topic: {**roles} for topic, roles in mapping["topics"].items()}
    topics["reference_pose"].pop("yaw")
    stddev = topics["reference_pose"]["stddev"]
    topics["reference_pose"]["stddev"] = {axis: stddev[axis] for axis in "xy"}
    return {**mapping, "topics": topics}


def _mean(replay: str, model: str, folder: Path) -> tuple[float, float]:
    """Mean RMSE, m, and NEES of the position over three draws."""
    results = [
        trackslip(f"{replay} --set slip_estimator.model={model} --seed {seed}", folder) for seed in range(3)
    ]
    rmse = [result["rmse"]["filter"] for result in results]
    return float(np.mean(rmse)), float(np.mean([result["nees_position"] for result in results]))
