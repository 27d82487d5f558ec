# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``trackslip replay --publish`` drives a live estimator from a bag."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from fixtures.recorded import record_legs
from fixtures.terminal import on_terminal
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_estimation.slip.conversions import pose_fix
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_tools.replay.run import replay

pytestmark = pytest.mark.xdist_group("graph")

LEGS = ((1.0, 0.0, 0.0), (3.0, 2.2, 2.2), (3.0, 1.2, 2.2), (1.0, 0.0, 0.0))
# Transport reorders topics by a few ms. The first estimate, and so the final state, may use one sprocket
# sample more or less. A lost message or a stamp other than the bag's exceeds the tolerance.
TOLERANCE = 1e-4  # m, rad


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bag of an 8 s drive with a turn; it starts and ends at rest."""
    return record_legs(tmp_path_factory.mktemp("publish") / "bag", LEGS)


def seconds(stamp):
    return stamp.sec + stamp.nanosec * 1e-9


def test_live_estimator_ends_in_the_state_of_the_replay(programs, observer, path):
    with open_bag(path) as bag:
        expected = replay(bag, load_slip_parameters(), InputFilters(), None).estimates[-1]
    odometry, clock = observer.subscribe("odometry"), []
    observer.node.create_subscription(Clock, "/clock", clock.append, qos_profile_sensor_data)
    programs.node("slip_estimator")
    observer.wait_until_active("slip_estimator")
    player = programs.tool("trackslip", "replay", str(path), "--publish", "--paused", "--rate", "4")
    for topic in ("sprockets", "imu/data_raw", "box_pose"):
        observer.wait_for_ends(topic, "replay", "slip_estimator")
    observer.wait(lambda: len(clock) > 100, "the clock")
    with open_bag(path) as bag:
        begin, end = bag.start_ns * 1e-9, bag.end_ns * 1e-9
        sent = {topic: info.count for topic, info in bag.topics.items() if topic != "/vehicle"}
    assert not odometry  # paused
    assert {seconds(message.clock) for message in clock} == {begin}

    answer = observer.ask(SetBool, "replay/pause", SetBool.Request(data=False))
    assert answer.message == "playing"
    observer.wait(lambda: player.process.poll() is not None, "the end of the bag")
    assert player.wait() == 0, player.stderr
    published = dict(line.split() for line in player.stdout.splitlines()[1:])
    assert {topic: int(count) for topic, count in published.items()} == sent
    last = expected["stamp_ns"] * 1e-9
    observer.wait(lambda: odometry and seconds(odometry[-1].header.stamp) >= last, "the last estimate")
    live = pose_fix(odometry[-1], "odometry").pose
    offset = live - expected["pose"]
    print(f"\nlive - offline: {offset}")
    assert np.abs(offset).max() < TOLERANCE
    times = [seconds(message.clock) for message in clock]
    assert times == sorted(times)
    assert times[-1] <= end + 0.1


def test_ctrl_c_and_options(programs, observer, path):
    """The player ends at once, reports its progress, and publishes only the requested part."""
    received, hidden = observer.subscribe("sprockets"), observer.subscribe("hydraulics")
    options = "--publish --loop --start 2 --stop 2.5 --withhold hydraulics --rate 2"
    player = programs.tool("trackslip", "replay", str(path), *options.split())
    observer.wait(lambda: len(received) > 120, "the loop to begin again")
    assert player.end()[0] == 130
    assert "Traceback" not in player.stderr
    assert "messages published" in player.stdout
    assert "hydraulics" not in player.stdout
    assert not hidden
    with open_bag(path) as bag:
        begin = bag.start_ns * 1e-9
    stamps = np.array([seconds(message.header.stamp) - begin for message in received])
    assert stamps.min() > 1.9
    assert stamps.max() < 2.6
    assert np.count_nonzero(np.diff(stamps) < 0.0) >= 2


@pytest.mark.slow
def test_a_graph_with_drivers_that_still_run_is_warned_of(programs, observer, path):
    observer.publisher("sprockets")
    observer.subscribe("sprockets")
    player = programs.tool("trackslip", "replay", str(path), "--publish", "--stop", "0.5")
    assert player.wait() == 0
    assert "/sprockets is published by observer too" in player.stderr


@pytest.mark.slow
def test_warnings_of_the_player_are_lines_of_their_own(path, domain):
    """On a terminal, without a subscriber."""
    trackslip = [sys.executable, "-m", "trackslip_tools.cli.main"]
    command = [*trackslip, "replay", str(path), "--publish", "--rate", "2"]
    terminal = on_terminal(command, {**os.environ, "ROS_DOMAIN_ID": str(domain)})
    assert terminal.code == 0, terminal.text
    warnings = [line for line in terminal.lines if "no node subscribes" in line]
    assert warnings == ["[WARN] no node subscribes to the played topics"]
