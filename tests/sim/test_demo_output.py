# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The demo: files in its directory that it may remove, its nodes, and results that are a shortfall."""

import math
import os
from pathlib import Path

import pytest
from fixtures.patience import wait_for

from trackslip_common.errors import InputError
from trackslip_sim.demo.graph import LIVE_NODE, DemoOptions, NodeSpec, demo_nodes
from trackslip_sim.demo.output import DEMO, LOGS, Results, claim
from trackslip_sim.demo.processes import Processes
from trackslip_sim.demo.results import Counts, shortfalls
from trackslip_sim.demo.run import claimed_domain
from trackslip_sim.demo.show import status


def test_directory_with_files_of_the_user_is_refused(tmp_path):
    mine = tmp_path / "results"
    mine.mkdir()
    (mine / "thesis.tex").write_text("years of work")
    for results in (DEMO, Results("soak", ("thesis.tex",))):
        with pytest.raises(InputError, match=f"holds files that are not a {results.kind}'s; accepted"):
            claim(mine, results)
    assert [path.read_text() for path in mine.iterdir()] == ["years of work"]


@pytest.mark.parametrize("before", ["absent", "empty", "nested"])
def test_new_and_empty_directories_are_accepted(tmp_path, before):
    output = tmp_path / ("a/b/demo" if before == "nested" else "demo")
    if before == "empty":
        output.mkdir()
    with claim(output):
        assert (output / DEMO.marker).is_file()


def test_results_of_an_earlier_demo_are_replaced_and_other_files_kept(tmp_path):
    output = tmp_path / "demo"
    with claim(output):
        (output / "bag").mkdir()
        (output / "bag" / "bag_0.mcap").write_bytes(b"old")
        (output / "summary.json").write_text("{}")
        (output / "slip_estimator.log").write_text("old")
    (output / "notes.txt").write_text("the user's")
    (output / "field.log").write_text("the user's, and not of a node")
    with claim(output):
        assert {path.name for path in output.iterdir()} == {DEMO.marker, "notes.txt", "field.log"}


@pytest.mark.parametrize("gnss", [False, True])
def test_every_log_of_a_demo_is_among_its_results(gnss):
    here = Path()
    options = DemoOptions(here, here, 1, 1.0, "sand", "thesis", "pc05", autostart=True, gnss=gnss)
    assert {f"{node.executable}.log" for node in (*demo_nodes(options), LIVE_NODE)} <= set(LOGS)


def test_two_demos_use_different_domains(monkeypatch):
    """Domains differ even if the process ids map to the same one."""
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    with claimed_domain() as first:
        monkeypatch.setattr(os, "getpid", lambda: first - 1)
        with claimed_domain() as second:
            assert first != second
        monkeypatch.setenv("ROS_DOMAIN_ID", str(first))
        with (
            pytest.raises(InputError, match=f"another demo runs in domain {first}; accepted"),
            claimed_domain(),
        ):
            pass
    with claimed_domain() as again:
        assert again == first


@pytest.mark.parametrize("text", ["102", "500", "-1", "one", "9999"])
def test_domain_outside_0_to_101_is_refused(monkeypatch, text):
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with (
        pytest.raises(InputError, match=f"ROS_DOMAIN_ID: '{text}' is no domain; accepted: 0 to 101"),
        claimed_domain(),
    ):
        pass


def test_links_are_not_followed_when_results_are_replaced(tmp_path):
    output, mine = tmp_path / "demo", tmp_path / "archive"
    mine.mkdir()
    (mine / "bag_0.mcap").write_bytes(b"kept")
    with claim(output):
        (output / "bag").symlink_to(mine)
    with claim(output):
        assert not os.path.lexists(output / "bag")
    assert (mine / "bag_0.mcap").read_bytes() == b"kept"


def test_a_second_demo_in_one_directory_is_refused(tmp_path):
    output = tmp_path / "demo"
    with claim(output):
        (output / "summary.json").write_text("{}")
        with pytest.raises(InputError, match=r"another demo .*accepted"):
            claim(output)
        assert (output / "summary.json").exists()
    with claim(output):
        pass


@pytest.mark.parametrize("made", ["a file", "below a file"])
def test_path_that_cannot_be_a_directory_is_refused_in_one_line(tmp_path, made):
    (tmp_path / "demo").write_text("a file")
    with pytest.raises(InputError, match="demo"):
        claim(tmp_path / "demo" / "below" if made == "below a file" else tmp_path / "demo")
    assert (tmp_path / "demo").read_text() == "a file"


@pytest.mark.parametrize("has_pose", [False, True])
def test_status_lines_fit_80_columns(has_pose):
    pose = (-123.4, -99.99, -math.pi) if has_pose else (math.nan,) * 3
    rates = {"sprockets": 100.4, "imu/data_raw": 11.9, "scan": 4.2, "odometry": 100.4}
    text = status(3599.9, pose, (-1.0, 1.0, -math.pi / 2.0), rates)
    assert max(map(len, text.splitlines())) <= 80
    assert all(topic in text for topic in rates)


@pytest.fixture
def started(tmp_path, monkeypatch):
    """Starter of a node that is a shell script; returns once it has printed that it is up."""

    def start(name, script):
        program = tmp_path / "lib" / "some" / name
        program.parent.mkdir(parents=True)
        program.write_text(f"#!/bin/sh\n{script}")
        program.chmod(0o755)
        monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
        processes = Processes(tmp_path, os.environ)
        processes.start(NodeSpec("some", name))
        wait_for(lambda: processes.log(name) == "up")
        return processes

    return start


def test_killed_node_is_reported(started, monkeypatch, capsys):
    monkeypatch.setattr("trackslip_sim.demo.processes._KILL_DELAY", 0.1)
    started("deaf", "trap '' INT\necho up\nsleep 600 & wait\n").stop()
    assert capsys.readouterr().err == "deaf did not end within 0.1 s of being asked, and was killed\n"


def test_second_ctrl_c_ends_a_node_that_lost_the_first(started, monkeypatch, capsys):
    """The first Ctrl-C can be lost: Python ignores exceptions in start-up hooks of the installation."""
    monkeypatch.setattr("trackslip_sim.demo.processes._SIGINT_PERIOD", 0.1)
    lose = """trap 'trap "exit 0" INT; echo lost' INT"""
    processes = started("late", f"{lose}\necho up\nwhile :; do sleep 0.05; done\n")
    processes.stop()
    assert processes.log("late") == "up\nlost"
    assert capsys.readouterr().err == ""


GOOD = {"replay_matches": True, "soil": {}, "nees_position": 2.0, "rmse": {"filter": 0.1}}


@pytest.mark.parametrize(
    ("change", "missed"),
    [
        ({"nees_position": 50.0}, None),
        ({"nees_position": 50.0, "rmse": {"filter": 0.2}}, "position RMSE: 0.200 m"),
        ({"rmse": {"filter": 0.3}}, None),  # within its covariance, as after 250 s without a fix
        ({"nees_position": None, "rmse": {"filter": None}}, "position RMSE: inf m"),
        ({"replay_matches": None}, "the replay's estimates are not the live ones"),
        ({"soil": {"replay_matches": False}}, "the replay's forces and soil are not the live ones"),
    ],
)
def test_shortfalls_of_a_replay(change, missed):
    lines = shortfalls(GOOD | change, {"sprockets": Counts(1000, 995, 1000)})
    assert [line.partition(",")[0] for line in lines] == ([] if missed is None else [missed])


def test_lost_messages_are_a_shortfall():
    (line,) = shortfalls(GOOD, {"scan": Counts(100, 98, 98)})
    assert line.startswith("scan: 98.00 % received")
