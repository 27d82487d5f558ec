# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip replay`` and ``info`` on a small bag: complete and repeatable results."""

import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fixtures.recorded import in_order_of_journal, write_lines
from rosbags.rosbag2 import StoragePlugin, Writer

from trackslip_bags.messages import serialize
from trackslip_bags.reader import open_bag
from trackslip_bags.types import typestore
from trackslip_common.errors import ExitCode
from trackslip_common.topics import TOPICS
from trackslip_sim.demo.command import run_commands
from trackslip_tools.cli.main import main

BagOf = Callable[..., Path]
Summary = Callable[..., dict[str, Any]]

ESTIMATES = ("odometry", "odometry/local", "track_slip", "machine_state")
OUTPUTS = (*ESTIMATES, "measurement_reports", "slip_estimator/parameters", "vehicle")
KEYS = {"duration_s", "messages", "rejected", "final", "rmse", "nees", "real_time_factor"}


def without_time(result: dict[str, Any]) -> dict[str, Any]:
    """A summary without its duration; means are rounded, as their last digit depends on the batches."""
    rest = {name: value for name, value in result.items() if name != "real_time_factor"}
    rest["rmse"] = {name: value and round(value, 9) for name, value in rest["rmse"].items()}
    return rest | {name: round(rest[name], 9) for name in ("nees", "nees_position") if rest.get(name)}


def test_the_summary_has_the_keys_of_the_contract(bag: Path, summary: Summary) -> None:
    result = summary(bag)
    assert result.keys() >= KEYS
    assert result["final"].keys() == {"x", "y", "yaw", "left_slip", "right_slip"}
    assert result["rmse"].keys() >= {"dead_reckoning", "encoder_gyro", "filter", "heading"}
    counts = {"sprockets": 501, "imu/data_raw": 100, "box_pose": 51, "reference_pose": 501}
    assert result["messages"] == counts
    assert result["duration_s"] == pytest.approx(10.0, abs=0.35)
    assert result["real_time_factor"] > 0.0
    assert result["reference"] == "reference_pose"
    assert set(result["rejected"]) <= {"sprockets", "imu/data_raw", "box_pose"}
    assert {reason for reasons in result["rejected"].values() for reason in reasons} == {"waiting"}


def test_the_filter_beats_dead_reckoning(
    bag: Path, summary: Summary, capsys: pytest.CaptureFixture[str]
) -> None:
    rmse = summary(bag)["rmse"]
    assert rmse["filter"] < 0.05
    assert rmse["filter"] < rmse["encoder_gyro"] < rmse["dead_reckoning"]
    shown = capsys.readouterr().out
    for number in (rmse["filter"], rmse["encoder_gyro"], rmse["dead_reckoning"]):
        assert f"{number:.4f}" in shown


def test_command_in_a_running_process_counts_its_own_time(bag: Path, summary: Summary) -> None:
    begin_s = time.monotonic()
    factor = summary(bag)["real_time_factor"]
    assert 10.0 / factor <= time.monotonic() - begin_s


def test_command_of_the_demo_counts_its_own_time(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    begin_s = time.monotonic()
    assert run_commands([["replay", str(bag)]]) == ExitCode.DONE
    elapsed_s = float(re.findall(r"replayed in ([\d.]+) s", capsys.readouterr().out)[0])
    assert elapsed_s <= time.monotonic() - begin_s + 0.05  # rounded


def test_the_same_replay_twice_is_the_same(bag: Path, summary: Summary) -> None:
    options = ("--thin", "box_pose:2:0.1", "--seed", "3")
    assert without_time(summary(bag, *options)) == without_time(summary(bag, *options))
    assert summary(bag, *options)["final"] != summary(bag, *options[:2])["final"]


def test_sqlite_replays_as_mcap(bag: Path, tmp_path: Path, lines: list[Any], summary: Summary) -> None:
    writer = Writer(tmp_path / "sqlite", version=8, storage_plugin=StoragePlugin.SQLITE3)
    with writer:
        connections = {
            line.topic: writer.add_connection(f"/{line.topic}", line.type_name, typestore=typestore())
            for line in {line.topic: line for line in lines}.values()
        }
        for line in sorted(lines, key=lambda line: line.log_ns):
            writer.write(connections[line.topic], line.log_ns, serialize(line.message))
    assert next((tmp_path / "sqlite").glob("*.db3")).exists()
    assert without_time(summary(tmp_path / "sqlite")) == without_time(summary(bag))


def test_a_window_cuts_by_log_time(bag: Path, summary: Summary) -> None:
    result = summary(bag, "--start", "2", "--stop", "5")
    assert result["messages"]["sprockets"] == 150
    assert result["duration_s"] == pytest.approx(3.0, abs=0.35)


def test_window_before_the_bag_has_no_estimate(
    bag: Path, summary: Summary, capsys: pytest.CaptureFixture[str]
) -> None:
    result = summary(bag, "--start", "-2", "--stop", "-1", code=ExitCode.FAILED)
    assert (result["final"], result["messages"], result["nees"], result["learned"]) == (None, {}, None, None)
    assert "no estimate" in capsys.readouterr().out


def test_next_command_for_a_bag_without_fixes_gives_an_estimate(
    lines: list[Any], bag_of: BagOf, capsys: pytest.CaptureFixture[str]
) -> None:
    """Check, replay and check named each other, and none the setting without which nothing starts."""
    path = bag_of([line for line in lines if line.topic not in ("box_pose", "reference_pose")])
    assert main(["check", str(path)]) == ExitCode.DONE
    *_, last = capsys.readouterr().out.splitlines()
    setting = ["--set", "slip_estimator.start=initial_pose"]
    assert last == " ".join(["next: trackslip replay", str(path), *setting])
    for command in ("replay", "smooth"):
        assert main([command, str(path)]) == ExitCode.FAILED
        output = " ".join(capsys.readouterr().out.split())
        assert " ".join(setting) in output
        assert "next: trackslip check" not in output
        assert main([command, str(path), *setting]) == ExitCode.DONE


def test_withheld_messages_are_counted_and_scored_and_not_used(
    bag: Path, summary: Summary, printed: Callable[[], str]
) -> None:
    result = summary(bag, "--withhold", "box_pose:4:9", "--withhold", "imu/data_raw:2:6")
    poses, rates = result["withheld"]
    assert (poses["topic"], poses["messages"]) == ("box_pose", 25)
    assert (rates["topic"], rates["messages"]) == ("imu/data_raw", 40)
    assert 0.0 < poses["rmse"] < 1.0
    assert 0.0 < poses["end"] < 1.0
    assert result["rmse"]["withheld"] == {"rmse": rates["rmse"], "end": rates["end"]}
    words = f"withheld: 25 messages of box_pose from 4 to 9 s; position off by {poses['rmse']:.4f} m"
    assert words in printed()
    whole = summary(bag)
    assert whole["withheld"] == []
    assert result["rmse"]["filter"] != whole["rmse"]["filter"]
    assert result["rmse"]["dead_reckoning"] == whole["rmse"]["dead_reckoning"]


def test_an_output_that_exists_is_refused_before_the_work(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refuse: Callable[..., str]
) -> None:
    def never(*_: Any) -> Any:
        raise AssertionError("the bag was opened")

    monkeypatch.setattr("trackslip_tools.cli.replay_command.open_bag", never)
    assert "exists already" in refuse("replay", bag, "--output", tmp_path)
    assert "cannot be written (no such folder" in refuse("replay", bag, "--json", tmp_path / "no" / "x.json")
    assert "cannot be written" in refuse("replay", bag, "--json", tmp_path)


def test_a_remapped_topic_is_the_source(
    bag: Path, lines: list[Any], bag_of: Callable[..., Path], summary: Summary
) -> None:
    names = {"box_pose": "gnss/pose", "sprockets": "wheels"}
    renamed = bag_of(line._replace(topic=names.get(line.topic, line.topic)) for line in lines)
    remaps = ("--remap", "gnss/pose:=box_pose", "--remap", "/wheels:=sprockets")
    assert without_time(summary(renamed, *remaps)) == without_time(summary(bag))
    scored = summary(renamed, *remaps, "--reference", "box_pose")
    assert scored["rmse"] == summary(bag, "--reference", "box_pose")["rmse"]


def test_parameters_come_in_layers(bag: Path, tmp_path: Path, summary: Summary) -> None:
    wide = tmp_path / "wide.yaml"
    wide.write_text(
        "/**: {ros__parameters: {vehicle: {kinematics: {tread: 1.46}}, serial_port: /dev/x}}\n",
        encoding="utf-8",
    )
    tread = "slip_estimator.vehicle.kinematics.tread"
    default, by_file = summary(bag), summary(bag, "--params", wide)
    assert by_file["rmse"]["dead_reckoning"] != default["rmse"]["dead_reckoning"]
    assert summary(bag, "--set", f"{tread}=1.46")["rmse"] == by_file["rmse"]
    back = summary(bag, "--params", wide, "--set", f"{tread}=1", "--set", f"{tread}=0.73")
    assert back["rmse"] == default["rmse"]


def test_a_replay_of_a_recorded_run_matches_it(
    bag: Path, tmp_path: Path, lines: list[Any], summary: Summary
) -> None:
    """The output of a replay, merged with its inputs, is a recording that replays to the same numbers."""
    made = tmp_path / "made"
    summary(bag, "--output", made, "--set", "slip_estimator.sources.box_pose.timeout=9")
    with open_bag(made) as estimates:
        types = {topic.removeprefix("/"): info.type_name for topic, info in estimates.topics.items()}
    assert types == {topic: TOPICS[topic].type_name for topic in OUTPUTS}
    both = write_lines(tmp_path / "both", lines, in_order_of_journal(made))
    assert summary(both)["replay_matches"] is True
    assert "replay_matches" not in summary(both, "--withhold", "box_pose:4:5")
    assert summary(both, "--set", "slip_estimator.vehicle.kinematics.tread=0.74")["replay_matches"] is False


def test_json_has_null_for_nan_and_infinity(
    bag: Path, summary: Summary, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> dict[str, Any]:
        return {"final": {"x": float("nan")}, "K_interval": [0.1, float("inf")], "nees": None, "n": 3}

    monkeypatch.setattr("trackslip_tools.cli.replay_command.summary", broken)
    result = summary(bag)
    assert result == {"final": {"x": None}, "K_interval": [0.1, None], "nees": None, "n": 3}


def test_the_installed_program_helps() -> None:
    done = subprocess.run(
        [Path(sys.executable).with_name("trackslip"), "replay", "--help"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0
    assert "--withhold" in done.stdout
