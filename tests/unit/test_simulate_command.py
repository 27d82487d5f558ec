# SPDX-License-Identifier: Apache-2.0
"""``trackslip simulate``: its options, its JSON and where a bag writer plugs in."""

import argparse
import json
from pathlib import Path

import pytest

from trackslip_common.errors import InputError
from trackslip_sim.cli import add_arguments, run
from trackslip_sim.truth.record import Truth


def parse(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return parser.parse_args(arguments)


def test_json_has_the_promised_keys(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "out.json"
    assert run(parse("--scenario", "straight", "--soil", "dry_clay", "--json", str(file))) == 0
    report = json.loads(file.read_text())
    assert set(report) == {"final", "duration_s", "elapsed_s"}
    assert set(report["final"]) == {
        *("x", "y", "yaw", "v_x", "yaw_rate"),
        *("left_slip", "right_slip", "left_thrust", "right_thrust"),
    }
    assert report["duration_s"] == pytest.approx(20.0)
    assert report["final"]["v_x"] == pytest.approx(0.399, abs=1e-3)
    assert json.loads(capsys.readouterr().out) == report


def test_mode_and_bag_writer_are_used(tmp_path: Path) -> None:
    seen: list[tuple[float, int, Path]] = []

    def write_bag(truth: Truth, seed: int, path: Path) -> None:
        seen.append((truth.duration, seed, path))

    arguments = parse(
        *("--scenario", "turn_left", "--soil", "sand", "--mode", "thesis"),
        *("--seed", "7", "--output", str(tmp_path / "bag")),
    )
    assert run(arguments, write_bag) == 0
    assert seen == [(pytest.approx(30.0), 7, tmp_path / "bag")]


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--output: .* refused"):
        run(parse("--scenario", "straight", "--output", str(tmp_path / "bag")))
    missing = tmp_path / "no" / "out.json"
    with pytest.raises(InputError, match=r"--json: '.*out\.json' cannot be written"):
        run(parse("--scenario", "straight", "--json", str(missing)))
