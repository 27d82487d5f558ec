# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The localizer live: with a repeated bag, and with scans that no scanner sends."""

import itertools
import math
import os
from array import array
from pathlib import Path

import numpy as np
import pytest
import rclpy
from fixtures.box_site import BOX, PARAMETERS, SITE, standing
from fixtures.observer import last_of, last_values, values_of
from fixtures.recorded import record_legs

from trackslip_common.make import stamp_ns_of
from trackslip_common.nodes.health import ERROR
from trackslip_common.nodes.messages import topic_class
from trackslip_common.nodes.qos import publisher_qos
from trackslip_estimation.box.heading_ambiguity import CERTAIN_WEIGHTS, Headings, SideEvidence
from trackslip_estimation.box.track import LocalizerState, Track
from trackslip_estimation.box.track_file import TrackFile
from trackslip_sim.machine.scan_model import ANGLE_INCREMENT, ANGLE_MIN, SiteScanner

TEN_MEGABYTES = 10_000_000
LEGS = ((1.0, 0.0, 0.0), (4.0, 2.2, 2.2))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bag of a 5 s drive."""
    return record_legs(tmp_path_factory.mktemp("loop") / "bag", LEGS)


@pytest.mark.slow
def test_bag_loop_gives_fixes_in_every_round(programs, observer, path):
    poses = observer.subscribe("box_pose")
    programs.node("box_localizer")
    observer.wait_until_active("box_localizer")
    options = ("--publish", "--loop", "--withhold", "box_pose", "--rate", "4")
    player = programs.tool("trackslip", "replay", str(path), *options)

    def in_third_round():
        stamps_ns = [stamp_ns_of(pose) for pose in poses]
        rounds = 1 + sum(after < before for before, after in itertools.pairwise(stamps_ns))
        return rounds == 3 and stamps_ns[-1] > stamps_ns[0] + 3_000_000_000

    observer.wait(in_third_round, "the third round")
    assert player.end()[0] == 130
    fixes = len(poses) / 3
    assert fixes > 12  # of about 20 scans per repetition


@pytest.fixture(scope="module")
def localizer(shared_graph):
    """A node that gets the scans of the test; the node, the observer, and the publisher."""
    programs, observer = shared_graph
    scans, program = observer.publisher("scan"), programs.node("box_localizer")
    observer.wait_for_ends("scan", "observer", "box_localizer")
    observer.wait_until_active("box_localizer")
    yield program, observer, scans
    assert program.end()[0] == 0
    assert "failed" not in program.stderr


def test_node_continues_after_a_scan_of_impossible_geometry(localizer):
    _, observer, scans = localizer
    healths = observer.healths()
    bad = [(math.nan, 0.0), (0.0, math.nan), (0.0, math.inf), (0.0, 1e20)]
    for number, (angle_min, time_increment) in enumerate(bad, start=1):
        message = topic_class("scan")(angle_min=angle_min, time_increment=time_increment)
        message.angle_increment, message.ranges = 0.01, [5.0] * 100
        message.header.stamp.sec = number
        scans.publish(message)

    def malformed():
        return last_values(healths, "box_localizer").get("scan: malformed")

    observer.wait(lambda: malformed() == str(len(bad)), "all to be counted")


@pytest.mark.slow
def test_ambiguous_object_gives_no_pose_before_odometry_arrives(programs, observer, tmp_path):
    """The node starts with a half-minute-old track and no background, as if the laser had been moved."""
    healths, poses = observer.healths(), observer.subscribe("box_pose")
    scans, odometry = observer.publisher("scan"), observer.publisher("odometry")
    headings = Headings(CERTAIN_WEIGHTS, SideEvidence())
    track = Track.from_pose(10**9, np.zeros(3), np.full(3, 1e-4), headings, PARAMETERS)
    file = tmp_path / "track.json"
    TrackFile(str(file)).write(LocalizerState(track, 30 * 10**9))
    program = programs.node("box_localizer", track_file=str(file))
    for topic in ("scan", "odometry"):
        observer.wait_for_ends(topic, "observer", "box_localizer")
    observer.wait_until_active("box_localizer")
    scanner, stamps = SiteScanner(SITE, BOX, seed=1), itertools.count(155)

    def send_scan():
        stamp = next(stamps) / 5
        message = topic_class("scan")(angle_min=ANGLE_MIN, angle_increment=ANGLE_INCREMENT)
        message.ranges = scanner.scan(stamp, standing(3.0, 1.0, 0.3)).tolist()
        for sent in (message, topic_class("odometry")()):
            sent.header.stamp.sec, sent.header.stamp.nanosec = int(stamp), int(stamp % 1.0 * 1e9)
            if sent is message:
                scans.publish(sent)
            elif has_odometry:
                sent.pose.pose.position.x, sent.pose.pose.position.y = 3.1, 0.9
                sent.pose.covariance = (0.01 * np.eye(6)).ravel()
                odometry.publish(sent)

    def is_uncertain():
        send_scan()
        return any(health.message.startswith("box not certain") for health in healths)

    def has_pose():
        send_scan()
        return bool(poses)

    has_odometry = False
    observer.wait(is_uncertain, "a report that nothing is certain")
    assert not poses
    has_odometry = True
    observer.wait(has_pose, "a pose")
    position = poses[0].pose.pose.position
    assert (position.x, position.y) == pytest.approx((3.0, 1.0), abs=0.2)
    assert program.end()[0] == 0


def test_scans_of_ten_megabytes_are_refused_and_their_publisher_is_named(localizer):
    """The report names the content of the scans and their sender; the node's memory stays bounded.

    Fast DDS splits a scan into pieces. For a busy node the kernel keeps only the pieces that fit its receive
    buffer. With a small buffer few scans of ten megabytes arrive whole, so smaller ones are sent, too.
    """
    program, observer, _ = localizer
    healths, seconds = observer.healths(), itertools.count(100)
    observer.wait(lambda: last_of(healths, "box_localizer"), "the node's report")
    before = int(last_values(healths, "box_localizer").get("scan: malformed", 0))
    rogue = rclpy.create_node("rogue", context=observer.node.context)
    scans = rogue.create_publisher(topic_class("scan"), "scan", publisher_qos("scan"))
    buffer = int(Path("/proc/sys/net/core/rmem_default").read_text(encoding="utf-8"))
    sizes = (TEN_MEGABYTES, min(TEN_MEGABYTES, buffer // 2))

    def refused():
        return int(last_values(healths, "box_localizer").get("scan: malformed", 0))

    def publish_until(count):
        def is_refused():
            for size in sizes:
                huge = topic_class("scan")(angle_min=-1.0, angle_increment=1e-6, range_max=80.0)
                huge.ranges = array("f", bytes(size))
                huge.header.stamp.sec = next(seconds)
                scans.publish(huge)
            return refused() >= before + count

        observer.wait(is_refused, f"{count} to be refused")
        return resident_bytes(program.process.pid)

    few, many = publish_until(3), publish_until(12)
    assert many - few < 4 * TEN_MEGABYTES  # scans that wait or miss pieces
    observer.wait(lambda: last_of(healths, "box_localizer: inputs"), "its inputs")
    inputs = last_of(healths, "box_localizer: inputs")
    assert inputs.level == ERROR
    assert inputs.message.startswith("several publishers of scan (")
    assert "/rogue" in values_of(inputs)["publishers of scan"]
    rogue.destroy_node()


def resident_bytes(pid):
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
