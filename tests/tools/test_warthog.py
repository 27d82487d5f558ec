# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A real log, skidding on grass: imported, replayed and scored against its lidar poses."""

import json
from pathlib import Path
from typing import Any

import pytest

from trackslip_common.errors import ExitCode
from trackslip_tools.cli.main import main

WINDOW = ("--start", "128.8", "--stop", "362.9")
THIN = ("--thin", "reference_pose:1:0.05")


@pytest.fixture(scope="module")
def log(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    source, bag = shared_data / "warthog_grass_a.csv", tmp_path_factory.mktemp("warthog") / "bag"
    if not source.is_file():
        pytest.skip(f"no {source}")
    assert (
        main(["import", str(source), "--mapping", "mappings/warthog.yaml", "--output", str(bag)])
        == ExitCode.DONE
    )
    return bag


def replay(log: Path, tmp_path: Path, *options: str) -> dict[str, Any]:
    out = tmp_path / "out.json"
    assert main(["replay", str(log), *WINDOW, *options, "--json", str(out)]) == ExitCode.DONE
    found: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return found


@pytest.mark.parametrize("seed", ["0", "1", "2"])
def test_fixes_once_a_second_hold_the_position(log: Path, tmp_path: Path, seed: str) -> None:
    found = replay(log, tmp_path, *THIN, "--seed", seed)
    assert found["rmse"]["dead_reckoning"] == pytest.approx(7.4, rel=0.05)
    assert found["rmse"]["encoder_gyro"] == pytest.approx(0.45, rel=0.05)
    assert found["rmse"]["filter"] <= 0.15
    assert found["messages"] == {"sprockets": 4679, "imu/data_raw": 4682, "reference_pose": 935}


def test_an_outage_of_half_a_minute_is_survived(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    held = replay(log, tmp_path, *THIN)["rmse"]["filter"]
    capsys.readouterr()
    found = replay(log, tmp_path, *THIN, "--withhold", "reference_pose:303.8:333.8")
    lost = found["rmse"]["filter"]
    assert held < lost < 5.0
    assert f"{lost:.4f}" in capsys.readouterr().out
