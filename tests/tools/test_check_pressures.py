# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check names pressures that are not what they state, and no others."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fixtures.made_bags import write_changed

from trackslip_bags.reader import open_bag
from trackslip_estimation.setup_check.finding import Result
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil.records import HYDRAULICS
from trackslip_sim.machine.excavator import simulate_drive
from trackslip_sim.machine.offline import record_drive
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_tools.check.bag import check_bag
from trackslip_tools.cli.main import main

BAGS = Path(__file__).parents[2] / "bags"


def scaled(left: float, right: float) -> Callable[[Any], None]:
    def change(m: Any) -> None:
        m.left_pressure, m.right_pressure = left * m.left_pressure, right * m.right_pressure

    return change


def exchange(m: Any) -> None:
    m.left_pressure, m.right_pressure = m.right_pressure, m.left_pressure


def hold(m: Any) -> None:
    m.left_pressure = 31e5


MISTAKES = {
    "pressure_sign": scaled(-1.0, -1.0),
    "pressure_unit": scaled(1e-5, 1e-5),
    "pressure_side": scaled(1.0, 0.1),
    "pressures_swapped": exchange,
    "pressure_frozen": hold,
}


def changed_bag(folder: Path, bag: Path, change: Callable[[Any], None]) -> Path:
    def write(_: int, message: Any) -> Any:
        change(message)
        return message

    with open_bag(bag) as opened:
        (topic,) = (m for m in opened.topics if m.strip("/") == HYDRAULICS)
    return write_changed(folder / "changed", bag, topic, write)


def result_of(bag: Path) -> Result:
    with open_bag(bag) as opened:
        return check_bag(opened, load_slip_parameters())


@pytest.mark.parametrize("cause", MISTAKES)
def test_wrong_pressures_are_a_named_cause(cause: str, emulated_bag: Path, tmp_path: Path) -> None:
    bag = changed_bag(tmp_path, emulated_bag, MISTAKES[cause])
    assert [(found.cause, found.source) for found in result_of(bag).causes] == [(cause, HYDRAULICS)]
    assert main(["check", str(bag)]) == 1
    assert main(["replay", str(bag)]) == 1


@pytest.mark.parametrize("name", sorted(path.parent.name for path in BAGS.glob("*/metadata.yaml")))
def test_pressures_of_healthy_drives_are_no_cause(name: str) -> None:
    assert not [found for found in result_of(BAGS / name).causes if found.source == HYDRAULICS]


@pytest.mark.parametrize("terrain", ["slope_down_15", "side_slope_15"])
def test_motors_that_brake_on_a_slope_are_no_cause(terrain: str, tmp_path: Path) -> None:
    """Dry clay resists with a tenth of the weight: down the slope the motors brake for half of the drive."""
    changes = {"scenario": "field_trial", "terrain": terrain, "soil": "dry_clay", "seed": 1}
    p = load_emulator_parameters(changes)
    record_drive(p, simulate_drive(p), tmp_path / "bag")
    assert not [found for found in result_of(tmp_path / "bag").causes if found.source == HYDRAULICS]
