# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A bag of several machines: each replays alone, by its namespace."""

import json
from pathlib import Path
from typing import Any

import pytest

from trackslip_bags.reader import open_bag
from trackslip_bags.writer import BagWriter
from trackslip_common.errors import ExitCode
from trackslip_tools.cli.main import main


@pytest.fixture(scope="module")
def two_machines(emulated_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same drive twice, in the namespaces one and two; of two the laser failed."""
    path = tmp_path_factory.mktemp("two") / "bag"
    with open_bag(emulated_bag) as bag, BagWriter(path) as both:
        for m in bag.messages():
            both.write(f"/site/one{m.topic}", m.type_name, m.raw, m.log_time_ns)
            if m.topic != "/box_pose":
                both.write(f"/two{m.topic}", m.type_name, m.raw, m.log_time_ns)
    return path


def replayed(folder: Path, *arguments: str | Path) -> dict[str, Any]:
    file = folder / "found.json"
    assert main(["replay", *map(str, arguments), "--json", str(file)]) == ExitCode.DONE
    found: dict[str, Any] = json.loads(file.read_text())
    return {name: value for name, value in found.items() if name != "real_time_factor"}


def test_each_machine_replays_alone(emulated_bag: Path, two_machines: Path, tmp_path: Path) -> None:
    alone = replayed(tmp_path, emulated_bag)
    of_one = replayed(tmp_path, two_machines, "--namespace", "/site/one")
    # Errors are summed over parts of the bag, which are not cut at the same places.
    for name in ("rmse", "nees", "nees_position"):
        assert of_one.pop(name) == pytest.approx(alone.pop(name), rel=1e-12)
    assert of_one == alone
    start = "slip_estimator.start=initial_pose"
    other = replayed(tmp_path, two_machines, "--namespace", "two", "--set", start)
    assert "box_pose" not in other["messages"]
    assert other["vehicle"] == alone["vehicle"]


@pytest.mark.parametrize("command", ["replay", "info"])
def test_a_namespace_that_is_not_there_is_refused(
    two_machines: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, str(two_machines), "--namespace", "three"]) == ExitCode.BAD_INPUT
    assert capsys.readouterr().err == "--namespace three: nothing is in it; accepted: site, two\n"
