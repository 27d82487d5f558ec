# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip calibrate`` on recorded runs: parameters of the emulator, a file for replay, refusals."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fixtures.commands import json_of

BAGS = Path(__file__).parents[2] / "bags"
DRIVES = [str(BAGS / name) for name in ("slalom_sand", "spot_turn_sand", "soft_patch")]
NUMBERS = {  # true value, largest width of the interval
    "gyro_bias": (0.002, 0.002),
    "gyro_sign": (1.0, 0.0),
    "gyro_scale": (1.0, 0.1),
    "pose_delay": (0.0, 0.15),
    "imu_roll": (0.0, 0.02),
    "imu_pitch": (0.0, 0.02),
    "left_pressure_offset": (0.0, 1e4),  # 0.1 bar, although a stall traps 10 bar in the lines
    "right_pressure_offset": (0.0, 1e4),
}


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("calibrated")
    output = folder / "calibration.yaml"
    return {"file": output, **json_of(folder, "calibrate", *DRIVES, "--all", "--output", output)}


@pytest.mark.parametrize("name", NUMBERS)
def test_finds_the_emulators_own_numbers(found: dict[str, Any], name: str) -> None:
    """With a single noise draw, twice the interval about its centre misses the true value once in 10 000."""
    value, (low, high) = found["findings"][name]["value"], found["findings"][name]["interval"]
    true, widest = NUMBERS[name]
    assert abs(value - true) <= high - low + 1e-12
    assert high - low <= widest


def test_slip_interval_overlaps_the_slips_on_sand(found: dict[str, Any]) -> None:
    """The slip is 0.72 % on sand (docs: the shear truth) and 1.6 % on the patch."""
    low, high = found["findings"]["common_slip"]["interval"]
    assert low <= 0.016
    assert high >= 0.0072
    assert found["findings"]["rolling_radius"]["value"] is None


def test_replay_accepts_the_calibration_file(found: dict[str, Any], tmp_path: Path) -> None:
    assert json_of(tmp_path, "replay", DRIVES[0], "--params", found["file"])["rmse"]["filter"] < 0.02
    assert found["parameters"]["slip_estimator"]["sources.imu_data_raw.sign"] == 1
    assert found["bags"] == DRIVES


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ([DRIVES[0], "--poses", "nothing"], "/nothing"),
        ([DRIVES[0], "--gyro", "scan"], "accepted: sensor_msgs/msg/Imu"),
        ([DRIVES[0], "--output", "/nowhere/calibration.yaml"], "cannot be written"),
        ([], "BAG"),
    ],
)
def test_bad_input_is_one_line(options: list[str], word: str, refuse: Callable[..., str]) -> None:
    assert word in refuse("calibrate", *options)


def test_bags_of_two_machines_are_not_calibrated_together(refuse: Callable[..., str]) -> None:
    """Their biases and delays would be averaged, and the second would be taken for one with wrong units."""
    line = refuse("calibrate", BAGS / "outage_sandy_loam", BAGS / "example")
    assert "excavator_20t" in line
    assert "pc05" in line
    assert "--vehicle" in line
