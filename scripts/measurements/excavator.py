# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The 20 t machine with a GNSS receiver: output of its replay, and effects of single wrong parameters."""

import math
from pathlib import Path
from typing import Any

from measurements.workbench import run, trackslip, write_yaml
from trackslip_common.config_files import config_file, node_parameters, read_yaml
from trackslip_sim.study.engine import table_lines

_SIMULATE = "simulate --scenario thesis --soil sand --vehicle excavator_20t --duration 60"
_REPLAY = "replay {}/drive --params gnss.yaml"
_WRONG: dict[str, dict[str, Any]] = {  # wrong parameters of the machine
    "rolling radius 1 % too large": {"kinematics": {"rolling_radius": 1.01 * 0.35}},
    "tread 5 cm too large": {"kinematics": {"tread": 2.38 + 0.05}},
    "contact length 5 cm too large": {"kinematics": {"contact_length": 3.46 + 0.05}},
    "antenna 5 cm too far ahead": {"sensors": {"antenna": {"x": -1.2 + 0.05}}},
    "mass 5 % too large": {"mass": {"mass": 1.05 * 21000.0}},
    "motor displacement 5 % too large": {"hydraulics": {"motor_displacement": 1.05 * 160.0e-6}},
}
_COLUMNS = {
    "wrong": lambda row: row["wrong"],
    "position m": lambda row: f"{row['rmse']['filter']:.3f}",
    "heading rad": lambda row: f"{row['rmse']['heading']:.4f}",
    "slip": lambda row: f"{row['rmse']['slip']:.3f}",
    "NEES": lambda row: f"{row['nees']:.1f}",
    "μ_r": lambda row: f"{row['soil']['mu_r']:.3f}",
    "K cm": lambda row: f"{100.0 * row['soil']['K']:.1f}",
    "F_max kN": lambda row: f"{1e-3 * row['soil']['F_max']:.1f}",
}
_SHOWN = ("RMSE", "  encoders", "  filter", "  slip", "  mean NEES", "soil", "  K ", "  not identifiable")


def wrong_numbers(folder: Path) -> list[str]:
    """The same drive, replayed with one wrong parameter of the vehicle or a wrong antenna direction."""
    trackslip(f"{_SIMULATE} --output {{}}/drive", folder)
    rows = [{"wrong": "nothing", **trackslip(_REPLAY, folder)}]
    for wrong, content in _WRONG.items():
        vehicle = write_yaml(folder / "wrong.yaml", {"base": "excavator_20t", "name": "wrong", **content})
        rows.append({"wrong": wrong, **trackslip(f"{_REPLAY} --vehicle {vehicle}", folder)})
    file = config_file("gnss.yaml")
    parameters = node_parameters(read_yaml(file), "slip_estimator", str(file))
    offset = float(parameters.get("sources.heading.offset", -math.pi / 2.0)) + 0.02
    result = trackslip(f"{_REPLAY} --set slip_estimator.sources.heading.offset={offset}", folder)
    rows.append({"wrong": "direction of the antennas 0.02 rad off", **result})
    return table_lines(_COLUMNS, rows, text_columns=1)


def printed(folder: Path) -> list[str]:
    """Selected lines of the output of ``trackslip replay``, as a block of code."""
    trackslip(f"{_SIMULATE} --output {{}}/drive", folder)
    lines = run(_REPLAY, folder).splitlines()
    return ["", *(f"    {line}" for line in lines if line.startswith(_SHOWN)), ""]
