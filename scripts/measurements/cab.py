# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The PC05 with a swinging cab: twenty minutes of digging, and soil estimates with the cab to the side."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from measurements.studies import pair
from measurements.workbench import trackslip, write_yaml
from trackslip_common.config_files import config_file, read_yaml
from trackslip_common.soils import load_soils
from trackslip_common.vehicle import VehicleParameters
from trackslip_common.vehicle_files import load_vehicle, vehicle_text
from trackslip_estimation.terramechanics.strength import thrust_limit
from trackslip_sim.study.engine import spaced_name, table_lines

_DRIVES = (("sand", 0), ("dry_clay", 5))
_ANGLES = {"ahead": 0.0, "left": math.pi / 2.0, "back": math.pi, "right": -math.pi / 2.0}
_SWING_TIME = 8.0  # s, for half a turn
_WITHOUT_ENCODER = "--set 'slip_estimator.swing_sources=[\"\"]'"
_DIG = {
    "soil, seed": lambda row: row["drive"],
    "encoder": lambda row: row["encoder"],
    "position mm": lambda row: f"{1e3 * row['rmse']['filter']:.1f}",
    "heading rad": lambda row: f"{row['rmse']['heading']:.4f}",
    "swing rad": lambda row: f"{row['rmse']['swing']:.4f}",
    "NEES": lambda row: f"{row['nees']:.1f}",
}
_STUDY = {
    "soil": lambda row: spaced_name(row["soil"]),
    "encoder": lambda row: row["encoder"],
    "σ_xy m": lambda row: f"{row['sigma_xy']:g}",
    "position ×": lambda row: f"{row['position_rmse'] / row['position_bound']:.2f}",
    "heading mrad (bound)": lambda row: pair(row, "heading", 1e3, 1),
    "swing mrad (bound)": lambda row: pair(row, "swing", 1e3, 1),
    "NEES": lambda row: f"{row['nees_pose']:.1f}",
}
_TURNED = {
    "soil": lambda row: spaced_name(row["soil"]),
    "cab": lambda row: row["direction"],
    "F_max known N": lambda row: _limit(row["known"], row["true"]),
    "F_max unknown N": lambda row: _limit(row["unknown"], row["true"]),
    "true": lambda row: f"{row['true']:.0f}",
    "K known cm": lambda row: _modulus(row["known"]),
}


def dig_cycles(folder: Path) -> list[str]:
    """``dig_cycles`` for 20 min, with the encoder of the swing and without."""
    return table_lines(_DIG, list(_dig_rows(folder)), text_columns=2)


def dig_study(folder: Path) -> list[str]:
    """The same drive for 260 s in the study (fixes with white noise), beside the bound."""
    return table_lines(_STUDY, list(_study_rows(folder)), text_columns=2)


def turned_cab(folder: Path) -> list[str]:
    """``field_trial`` with the cab at constant angles, known or unknown to the estimator."""
    return table_lines(_TURNED, list(_turned_rows(folder)), text_columns=2)


def _dig_rows(folder: Path) -> Iterator[dict[str, Any]]:
    for soil, seed in _DRIVES:
        bag = f"{{}}/{soil}"
        options = f"--soil {soil} --seed {seed} --duration 1200 --output {bag}"
        trackslip(f"simulate --scenario dig_cycles {options}", folder)
        for encoder, option in (("yes", ""), ("no", _WITHOUT_ENCODER)):
            result = trackslip(f"replay {bag} {option}", folder)
            yield {"drive": f"{spaced_name(soil)}, {seed}", "encoder": encoder, **result}


def _study_rows(folder: Path) -> Iterator[dict[str, Any]]:
    options = "--scenario dig_cycles --vehicle pc05_cab --duration 260 --settling 60 --seeds 3"
    grid = f"--filter ekf --sigma-xy 0.01 0.05 --soil {' '.join(soil for soil, _ in _DRIVES)}"
    rows = [
        {"encoder": encoder, **row}
        for encoder, option in (("yes", ""), ("no", _WITHOUT_ENCODER))
        for row in trackslip(f"study --workers 1 {options} {grid} {option}", folder)
    ]
    yield from sorted(rows, key=lambda row: [soil for soil, _ in _DRIVES].index(row["soil"]))


def _turned_rows(folder: Path) -> Iterator[dict[str, Any]]:
    bare = folder / "bare.yaml"
    bare.write_text(vehicle_text(_bare()), encoding="utf-8")
    vehicles = {"known": "pc05_cab", "unknown": str(bare)}
    for soil in ("sand", "dry_clay"):
        for direction, angle in _ANGLES.items():
            tree = dict(read_yaml(config_file("scenarios/field_trial.yaml")))
            swing = {"duration": _SWING_TIME, "left": 0.0, "right": 0.0, "swing_to": angle}
            scenario = write_yaml(
                folder / f"{soil}_{direction}.yaml", {**tree, "segments": [swing, *tree["segments"]]}
            )
            row: dict[str, Any] = {"soil": soil, "direction": direction, "true": _true_limit(soil)}
            for name, vehicle in vehicles.items():
                bag = f"{{}}/{soil}_{direction}_{name}"
                machine = f"--soil {soil} --vehicle {vehicle} --output {bag}"
                trackslip(f"simulate --scenario {scenario} {machine}", folder)
                # The check reports the antenna of an unknown cab as misplaced, correctly.
                row[name] = trackslip(f"replay {bag} --vehicle {vehicle} --force", folder)["soil"]
            yield row


def _bare() -> VehicleParameters:
    """The same machine stated without sensors on its cab."""
    cab = load_vehicle("pc05_cab")
    assert cab.sensors is not None
    return replace(cab, name="bare", sensors=replace(cab.sensors, mounts=None, swing_encoder=None))


def _true_limit(soil: str) -> float:
    """F_max of one track on level ground, N, by (3.1)."""
    properties, vehicle = load_soils()[soil], load_vehicle("pc05_cab").whole()
    area = 2.0 * vehicle.contact_length * vehicle.track_width
    return float(thrust_limit(properties.cohesion, properties.friction_angle, area, vehicle.weight))


def _limit(soil: dict[str, Any], true: float) -> str:
    low, high = soil["F_max_interval"]
    text = f"{soil['F_max']:.0f} ({low:.0f} to {high:.0f})"
    return text if low <= true <= high else f"**{text}**"


def _modulus(soil: dict[str, Any]) -> str:
    low, high = (100.0 * value for value in soil["K_interval"])
    return f"{100.0 * soil['K']:.2f} ({low:.2f} to {high:.2f})"
