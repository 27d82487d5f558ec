# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Refusals of the ``trackslip`` command: exit code 2, and one line that names the mistake."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fixtures.commands import TRACKSLIP

from trackslip_bags.messages import make
from trackslip_common.topics import TOPICS

Refuse = Callable[..., str]
BagOf = Callable[..., Path]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("--set slip_estimator.histery_window=3", "unknown parameter 'histery_window'"),
        ("--set slip_estimator.vehicle.kinematics.tred=3", "did you mean 'vehicle.kinematics.tread'?"),
        ("--vehicle excavator_20", "did you mean 'excavator_20t'?"),
        ("--set slip_estimator.vehicle=3", "vehicle: 3 is not text; accepted: excavator_20t, pc05"),
        (
            "--set slip_estimator.vehicle.kinematics.tread=0",
            "kinematics.tread: 0.0 is out of range; accepted: >= 0.02 and <= 20 m",
        ),
        ("--set slip_estimator.odom_frame=[", "not YAML"),
        ("--set history_window=3", "--set history_window=3: accepted: slip_estimator.<parameter>=<value>"),
        ("--set slip_estimator.history_window", "accepted: slip_estimator.<parameter>=<value>"),
        ("--thin box_pose", "--thin box_pose: accepted: TOPIC:HZ"),
        ("--thin box_pose:1e12", "--thin box_pose:1e12: accepted"),
        ("--thin bocks:1", "--thin bocks: there is no such topic; accepted: box_pose"),
        ("--withhold box_pose:4:1", "T0 < T1"),
        ("--withhold bocks", "--withhold bocks: there is no such topic; accepted: box_pose"),
        ("--remap box_pose", "--remap box_pose: accepted: from:=to"),
        ("--remap bocks:=box_pose", "no messages on /bocks; it holds: /box_pose"),
        ("--remap imu/data_raw:=box_pose", "/imu/data_raw is a sensor_msgs/msg/Imu; accepted: geometry_msgs"),
        (
            "--set slip_estimator.slip_sources=[sprockets]",
            "/sprockets is a sensor_msgs/msg/JointState; accepted",
        ),
        ("--reference truth", "no messages on /truth; it holds: /box_pose"),
        ("--reference imu/data_raw", "imu/data_raw: it is a sensor_msgs/msg/Imu; accepted: geometry_msgs"),
        ("--start 5 --stop 5", "accepted: start before stop"),
        ("--stop 1e300", "at most 1e+09 s"),
        ("--start 1000", "accepted: at most that"),
        ("--start soon", "invalid float value: 'soon'"),
        ("--seed -1", "accepted: a whole number >= 0"),
        ("--params no_such.yaml", "file 'no_such.yaml' not found"),
        ("--frequency 3", "unrecognized arguments: --frequency 3"),
        ("--json -", "--json: '-' cannot be written"),
        ("--publish --json out.json", "--json: accepted not together with --publish"),
        ("--publish --rate 0", "--rate: '0' is refused; accepted: 0.01 to 100"),
        ("--publish --also odometry", "no messages on /odometry"),
        ("--publish --withhold bocks", "--withhold bocks: there is no such topic"),
        ("--publish --start 1000", "nothing to publish between --start and --stop"),
        ("--rate 2", "--rate: accepted only together with --publish"),
        ("--paused --loop", "--paused, --loop: accepted only together with --publish"),
    ],
)
def test_a_bad_option_is_refused_in_one_line(bag: Path, refuse: Refuse, options: str, expected: str) -> None:
    assert expected in refuse("replay", bag, *options.split(" "))


@pytest.mark.parametrize("command", ["replay", "info", "check", "calibrate"])
def test_a_missing_bag_is_refused(tmp_path: Path, refuse: Refuse, command: str) -> None:
    assert "nowhere' not found" in refuse(command, tmp_path / "nowhere")


def test_a_bag_without_sprockets_is_refused(lines: list[Any], bag_of: BagOf, refuse: Refuse) -> None:
    path = bag_of([line for line in lines if line.topic != "sprockets"])
    error = refuse("replay", path)
    assert "no messages on /sprockets; it holds: /box_pose, /imu/data_raw, /reference_pose" in error


@pytest.mark.parametrize(
    "topic", ["sprockets", "imu/data_raw", "box_pose", "measurement_reports", "odometry"]
)
def test_a_topic_of_another_type_is_refused(
    lines: list[Any], bag_of: BagOf, refuse: Refuse, topic: str
) -> None:
    text = "std_msgs/msg/String"
    others = [line for line in lines if line.topic != topic]
    path = bag_of([*others, lines[0].instead(topic, make(text, data="hello"))])
    assert f"/{topic} is a {text}; accepted: {TOPICS[topic].type_name}\n" in refuse("replay", path)


def test_a_log_that_is_not_there_is_named(refuse: Refuse) -> None:
    for logs, lost in ((["log.csv"], "log.csv"), ([__file__, "no_such_bag"], "no_such_bag")):
        error = refuse("import", *logs)
        assert f"log '{lost}' not found" in error
        assert "--output" in error


@pytest.mark.parametrize("arguments", [[], ["drive"], ["replay"], ["import"]])
def test_a_bad_command_line_is_refused(arguments: list[str], refuse: Refuse) -> None:
    error = refuse(*arguments)
    assert error.startswith("trackslip")
    assert "--help" in error


def test_the_program_itself_leaves_with_2_and_one_line() -> None:
    done = subprocess.run([*TRACKSLIP, "replay", "nowhere"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1


def test_a_parameter_file_without_anything_for_the_estimator_is_refused(
    bag: Path, tmp_path: Path, refuse: Refuse
) -> None:
    other = tmp_path / "other.yaml"
    other.write_text("can_driver: {ros__parameters: {can_channel: can0}}\n", encoding="utf-8")
    error = refuse("replay", bag, "--params", other)
    assert f"--params {other}: nothing for slip_estimator in it; accepted: " in error


@pytest.mark.parametrize(("node", "words"), [("player", "replay BAG --publish"), ("record", "record")])
def test_without_ros_the_command_names_it(
    bag: Path, refuse: Refuse, monkeypatch: pytest.MonkeyPatch, node: str, words: str
) -> None:
    monkeypatch.setitem(sys.modules, f"trackslip_bags.nodes.{node}", None)
    assert "ROS is not available" in refuse(*words.replace("BAG", str(bag)).split())
