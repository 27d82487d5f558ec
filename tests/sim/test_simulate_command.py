# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip simulate``: its options, its JSON and its bag."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_common.errors import InputError
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_sim.cli import run
from trackslip_tools.cli.main import parse_arguments
from trackslip_tools.replay.run import replay


def simulate(*options: str) -> int:
    return run(parse_arguments(["simulate", *options]))


def test_json_has_the_promised_keys(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "out.json"
    assert simulate("--scenario", "straight", "--soil", "dry_clay", "--json", str(file)) == 0
    report = json.loads(file.read_text())
    assert set(report) == {"vehicle", "final", "duration_s", "elapsed_s"}
    assert set(report["final"]) == {
        *("x", "y", "z", "yaw", "pitch", "roll", "v_x", "yaw_rate"),
        *("left_slip", "right_slip", "left_thrust", "right_thrust"),
    }
    assert report["duration_s"] == pytest.approx(20.0)
    assert report["final"]["v_x"] == pytest.approx(0.399, abs=1e-3)
    output = capsys.readouterr().out
    assert f"x {report['final']['x']:.3f} m" in output
    assert "{" not in output


def test_bag_has_the_messages_of_all_sensors(tmp_path: Path) -> None:
    scenario = tmp_path / "short.yaml"
    scenario.write_text("name: short\nsoil: sand\nsegments: [{duration: 3.0, left: 2.0, right: 1.6}]\n")
    bag = tmp_path / "bag"
    options = ("--scenario", str(scenario), "--mode", "thesis", "--seed", "7", "--output", str(bag))
    assert simulate(*options) == 0
    with open_bag(bag) as opened:
        counts = {topic: info.count for topic, info in opened.topics.items()}
        p = load_slip_parameters()
        result = replay(opened, p, InputFilters(), None)
    lead_in = 7.0
    assert counts["/sprockets"] == pytest.approx(100 * (3.0 + lead_in - 1.0), abs=3)
    assert counts["/hydraulics"] == pytest.approx(counts["/sprockets"], abs=1)
    assert counts["/imu/data_raw"] == pytest.approx(11.85 * (3.0 + lead_in - 5.0), abs=2)
    assert counts["/scan"] == counts["/box_pose"] > 20
    score = result.scores["filter"]
    assert score is not None
    assert score.position < 0.05


def test_unwritable_output_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"exists already"):
        simulate("--scenario", "straight", "--output", str(tmp_path))
    missing = tmp_path / "no" / "out.json"
    with pytest.raises(InputError, match=r"--json: '.*out\.json' cannot be written"):
        simulate("--scenario", "straight", "--json", str(missing))


@pytest.mark.usefixtures("full_disk")
def test_a_full_disk_leaves_nothing_of_simulate(tmp_path: Path, refuse: Callable[..., str]) -> None:
    options = ("--scenario", "straight", "--duration", "2", "--output", tmp_path / "bag")
    assert "cannot be written (No space left on device)" in refuse("simulate", *options)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_scenario_is_repeated_or_cut(tmp_path: Path) -> None:
    ends = []
    for options in (("--duration", "61"), ("--duration", "61", "--output", str(tmp_path / "bag"))):
        file = tmp_path / "out.json"
        options = (*options, "--json", str(file))
        assert simulate("--scenario", "straight", "--mode", "thesis", *options) == 0
        report = json.loads(file.read_text())
        assert report["duration_s"] == pytest.approx(61.0)
        ends.append(report["final"])
    assert ends[0] == ends[1]
    for refused in ("0", "-1", "nan", "1e9"):
        with pytest.raises(InputError, match=r"--duration: .* s is refused; accepted: > 0 and <= 604800 s"):
            simulate("--scenario", "straight", "--duration", refused)
