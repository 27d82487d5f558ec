# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Refusals of the commands that need ROS."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("--publish --json out.json", "--json: accepted not together with --publish"),
        ("--publish --thin box_pose:1", "--thin: accepted not together with --publish"),
        ("--publish --set slip_estimator.history_window=3", "--set: accepted not together with --publish"),
        ("--publish --rate 0", "--rate: '0' is refused; accepted: 0.01 to 100"),
        ("--publish --rate nan", "--rate: 'nan' is refused; accepted: 0.01 to 100"),
        ("--publish --also odometry", "no messages on /odometry"),
        ("--publish --remap bocks:=box_pose", "no messages on /bocks; it holds: /box_pose"),
        ("--publish --withhold bocks", "--withhold bocks: there is no such topic"),
        ("--publish --start 1000", "nothing to publish between --start and --stop"),
        ("--rate 2", "--rate: accepted only together with --publish"),
        ("--rate fast", "--rate: 'fast' is refused; accepted: 0.01 to 100"),
        ("--paused --loop", "--paused, --loop: accepted only together with --publish"),
    ],
)
def test_a_bad_option_is_refused_in_one_line(
    bag: Path, refuse: Callable[..., str], options: str, expected: str
) -> None:
    assert expected in refuse("replay", bag, *options.split())


@pytest.mark.parametrize(("node", "words"), [("player", "replay BAG --publish"), ("record", "record")])
def test_without_ros_the_command_names_it(
    bag: Path, refuse: Callable[..., str], monkeypatch: pytest.MonkeyPatch, node: str, words: str
) -> None:
    monkeypatch.setitem(sys.modules, f"trackslip_bags.nodes.{node}", None)
    assert "ROS is not available" in refuse(*words.replace("BAG", str(bag)).split())
