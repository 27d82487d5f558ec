# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The recorded runs of bags/ are unchanged and readable, and replay to the numbers of their manifest."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from trackslip_bags.reader import open_bag
from trackslip_common.errors import ExitCode
from trackslip_tools.cli.main import main

BAGS = Path(__file__).parents[2] / "bags"
MANIFEST: dict[str, Any] = yaml.safe_load((BAGS / "manifest.yaml").read_text(encoding="utf-8"))
MAX_BYTES = 5_500_000  # total of all runs

each = pytest.mark.parametrize("name", MANIFEST["bags"])


def test_the_manifest_names_every_file_and_they_are_small() -> None:
    named = {BAGS / name / file for name, bag in MANIFEST["bags"].items() for file in bag["sha256"]}
    present = {path for path in BAGS.rglob("*") if path.is_file()}
    assert present - named == {BAGS / "manifest.yaml", *(BAGS / "scenarios").iterdir()}
    assert sum(path.stat().st_size for path in present) <= MAX_BYTES
    scenarios = {bag["made"]["scenario"] for bag in MANIFEST["bags"].values()}
    assert {f"scenarios/{path.name}" for path in (BAGS / "scenarios").iterdir()} <= scenarios


@each
def test_files_match_the_digests_of_the_manifest(name: str) -> None:
    for file, digest in MANIFEST["bags"][name]["sha256"].items():
        assert hashlib.sha256((BAGS / name / file).read_bytes()).hexdigest() == digest


@each
def test_bag_matches_the_counts_of_the_manifest(name: str) -> None:
    holds = MANIFEST["bags"][name]["holds"]
    with open_bag(BAGS / name) as bag:
        assert {topic: info.count for topic, info in bag.topics.items()} == holds["messages"]
        assert sum(1 for _ in bag.messages()) == sum(holds["messages"].values())
        assert bag.duration_s == pytest.approx(holds["duration_s"], abs=1e-6)
        assert bool(bag.damage) == holds["damaged"]


@each
def test_replays_to_the_expected_numbers(name: str, tmp_path: Path) -> None:
    assert main(["replay", str(BAGS / name), "--json", str(tmp_path / "result.json")]) == ExitCode.DONE
    result, expected = json.loads((tmp_path / "result.json").read_text()), MANIFEST["bags"][name]["replay"]
    tolerances = MANIFEST["tolerances"]
    kinds = {"x": "position", "y": "position", "yaw": "heading", "heading": "heading"}
    kinds |= dict.fromkeys(("left_slip", "right_slip", "slip"), "slip")
    for group in ("final", "rmse"):
        for key, value in expected[group].items():
            assert result[group][key] == pytest.approx(value, abs=tolerances[kinds.get(key, "position")]), (
                group,
                key,
            )
    assert result["nees"] == pytest.approx(expected["nees"], abs=tolerances["nees"])
    assert result["rejected"] == expected["rejected"]


def test_bags_include_a_truncated_one_and_one_with_failing_sensors() -> None:
    bags = MANIFEST["bags"].values()
    assert sum(bag["holds"]["damaged"] for bag in bags) == 1
    rates = [bag["holds"]["messages"]["/imu/data_raw"] / bag["holds"]["duration_s"] for bag in bags]
    assert min(rates) < 0.8 * max(rates)
