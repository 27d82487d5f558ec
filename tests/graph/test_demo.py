# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The demo as a user runs it: its output, its refusals, and how it ends."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from contextlib import suppress
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from trackslip_bags.reader import open_bag
from trackslip_common.errors import ExitCode
from trackslip_common.topics import SENSOR_TOPICS
from trackslip_sim.demo.run import main as run_demo
from trackslip_tools.cli.outputs import PAGE_PREFIX

pytestmark = pytest.mark.xdist_group("graph")


def demo(programs, *arguments):
    return programs.python("-m", "trackslip_sim.demo.main", "--output", "demo", *arguments)


def wait_for_drive(observer):
    """Wait for messages of the machine's sensors."""
    sprockets = observer.subscribe("sprockets")
    observer.wait(lambda: len(sprockets) > 100, "the drive")


def assert_ends_quietly(programs, program):
    """Assert that the demo ends on Ctrl-C quietly, and that all its processes end by themselves."""
    code, _ = program.end(signal.SIGINT)
    assert code == 130
    assert "Traceback" not in program.stderr
    assert set(program.stderr.splitlines()) <= {"interrupted"}
    assert programs.alive() == {}


def test_demo_leaves_numbers_report_and_bag(real_time, programs):
    program = demo(programs, "--duration", "2")
    code = program.wait()
    missed = [line for line in program.stderr.splitlines() if line.startswith("missed: ")]
    assert all("% received" in line for line in missed)  # beside other tests it may lose messages
    assert code == (1 if missed else 0), program.stdout + program.stderr
    folder = programs.folder / "demo"
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["replay_matches"] is True
    assert summary["soil"]["replay_matches"] is True
    assert summary["vehicle"] == "pc05"
    assert "vehicle: pc05\n" in program.stdout
    assert 0.0 < summary["rmse"]["filter"] <= 0.15
    absent = {"fix", "heading", "fix_velocity", "swing"}  # the PC05 has no receiver and no swing encoder
    assert summary["topics"].keys() == set(SENSOR_TOPICS) - absent
    with AnyReader([folder / "bag"]) as reader:
        in_bag = {connection.topic: connection.msgcount for connection in reader.connections}
    for topic, counts in summary["topics"].items():
        assert counts["recorded"] == in_bag[f"/{topic}"]
        assert counts["emitted"] >= counts["received"] >= 0.9 * counts["emitted"] > 0
    assert (folder / "report.html").read_text(encoding="utf-8").startswith(PAGE_PREFIX)
    assert "report: demo/report.html" in program.stdout
    assert programs.alive() == {}
    assert not (folder / "dev").exists()


@pytest.mark.slow
def test_machine_with_an_antenna_drives_by_gnss(real_time, programs):
    program = demo(programs, "--duration", "5", "--vehicle", "excavator_20t", "--no-live")
    assert program.wait() == 0, program.stdout + program.stderr
    summary = json.loads((programs.folder / "demo" / "summary.json").read_text(encoding="utf-8"))
    assert summary["topics"].keys() == set(SENSOR_TOPICS) - {"scan", "swing"}
    assert summary["vehicle"] == "excavator_20t"
    assert "vehicle: excavator_20t\n" in program.stdout
    assert summary["replay_matches"] is True
    assert summary["rmse"]["filter"] <= 0.05


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--soil", "cheese"], ["'cheese'", "sandy_loam"]),
        (["--duration", "soon"], ["'soon'", "1 to 3600"]),
        (["--duration", "-5"], ["'-5'", "1 to 3600"]),
        (["--duration", "nan"], ["'nan'", "1 to 3600"]),
        (["--scenario", "moon"], ["'moon'", "slalom"]),
    ],
    ids=" ".join,
)
def test_demo_refuses(arguments, words, tmp_path, capsys):
    assert run_demo(["--output", str(tmp_path / "demo"), *arguments]) == ExitCode.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert [word for word in words if word not in line] == []
    assert not (tmp_path / "demo").exists()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_demo_with_unwritable_output_ends_with_one_line(programs, tmp_path):
    command = [sys.executable, "-m", "trackslip_sim.demo.main", "--output", str(tmp_path / "demo")]
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == ExitCode.BAD_INPUT
    assert done.stderr == "make demo: cannot read or write (No space left on device)\n"
    assert programs.alive() == {}


def answers(address):
    try:
        with urllib.request.urlopen(address, timeout=5.0) as page:
            return b"live.js" in page.read()
    except OSError:
        return False


@pytest.mark.slow
def test_demo_survives_a_taken_port_a_killed_page_and_a_second_ctrl_c(programs, observer):
    with socket.socket() as taken:
        with suppress(OSError):  # another program has the port: equally suitable
            taken.bind(("127.0.0.1", 5006))
            taken.listen()
        program = demo(programs, "--duration", "60")
        program.until(lambda: "http://" in program.stdout, "the address")
        address = re.search(r"http://\S+", program.stdout)[0]
        assert ":5006" not in address
        program.until(lambda: answers(address), "the page")
        (page,) = (pid for pid, command in programs.alive().items() if "trackslip_tools/live" in command)
        os.kill(page, signal.SIGKILL)
        wait_for_drive(observer)
        program.process.send_signal(signal.SIGINT)
        assert_ends_quietly(programs, program)
    with open_bag(programs.folder / "demo" / "bag") as bag:
        assert not bag.damage


def test_ctrl_c_while_the_demo_loads(programs):
    program = demo(programs)
    program.until(lambda: program.has_loaded("multiarray"), "the demo to load numpy")
    assert_ends_quietly(programs, program)


def test_ctrl_c_before_the_nodes_are_up(programs):
    program = demo(programs)
    program.until((programs.folder / "demo" / "record.log").exists, "record.log to be there")
    assert_ends_quietly(programs, program)


@pytest.mark.parametrize(
    "number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)], ids=lambda n: n.name
)
def test_demo_that_is_killed_leaves_no_orphan(programs, observer, number):
    program = demo(programs, "--duration", "60", "--no-live")
    wait_for_drive(observer)
    program.end(number)
    observer.wait(lambda: not programs.alive(), "the nodes to notice")
    with open_bag(programs.folder / "demo" / "bag") as bag:
        assert not bag.damage
        assert bag.topics["/sprockets"].count > 0


@pytest.mark.slow
def test_node_that_dies_ends_the_demo(programs, observer):
    program = demo(programs, "--duration", "60", "--no-live")
    wait_for_drive(observer)
    (victim,) = [pid for pid, command in programs.alive().items() if "watson_imu" in command]
    os.kill(victim, signal.SIGKILL)
    assert program.wait() == 1
    (line,) = program.stderr.splitlines()
    assert "watson_imu" in line
    assert programs.alive() == {}
