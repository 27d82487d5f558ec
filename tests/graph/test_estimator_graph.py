# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Recorder, localizer and estimator live, with valid and invalid inputs; replay reproduces the run."""

import math
import signal
import time
from collections import Counter
from typing import Any

import numpy as np
import pytest
from fixtures.observer import last_values
from fixtures.sensor_messages import pose, sprockets, stamped
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import Imu, LaserScan
from trackslip_msgs.msg import MeasurementReport

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.parameters import bag_parameters
from trackslip_bags.reader import open_bag
from trackslip_common.make import stamp_ns_of
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_sim.machine.scan_model import ANGLE_INCREMENT, ANGLE_MIN, TIME_INCREMENT, SiteScanner
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_tools.replay.run import replay

pytestmark = pytest.mark.xdist_group("graph")

SPEED, RADIUS = 1.5, 0.159  # rad/s, m
DURATION_MS = 6000
BURST = 40  # messages; the kernel queues about 100 for a process that is not scheduled
AGAIN = 10.0  # s until a first message is repeated; a late report of the earlier one counts as well
INPUTS = ("sprockets", "imu/data_raw", "scan", "gnss")
R = MeasurementReport


def imu(at_ms, rate=0.0):
    message = stamped(Imu, at_ms, "imu_link")
    message.orientation_covariance[0] = -1.0
    message.angular_velocity.z = rate
    message.angular_velocity_covariance = np.diag([1e-5] * 3).flatten()
    return message


def driven_pose(at_ms, y=0.0):
    return pose(at_ms, 0.9 * SPEED * RADIUS * at_ms * 1e-3, y)


def scan(at_ms):
    p = load_emulator_parameters({})

    def at_start(times):
        return np.zeros_like(times), np.zeros_like(times), np.zeros_like(times)

    message = stamped(LaserScan, at_ms, "laser")
    message.angle_min, message.angle_increment = ANGLE_MIN, ANGLE_INCREMENT
    message.angle_max = -ANGLE_MIN
    message.time_increment, message.scan_time = TIME_INCREMENT, 0.04
    message.range_min, message.range_max = 0.05, 50.0
    message.ranges = SiteScanner(p.site, p.vehicle.box, at_ms).scan(at_ms * 1e-3, at_start).tolist()
    return message


def ordinary():
    """(arrival time ms, topic, message): each sensor with its delay, poses late by less than the window."""
    random = np.random.default_rng(3)
    script = [(0.0, "scan", scan(0))]
    for at_ms in range(100, DURATION_MS, 10):
        script.append((at_ms + random.uniform(0.0, 30.0), "sprockets", sprockets(at_ms, SPEED)))
        if at_ms % 80 == 0:
            script.append((at_ms + random.uniform(50.0, 150.0), "imu/data_raw", imu(at_ms + 3)))
        if at_ms % 250 == 0:
            script.append((at_ms + random.uniform(100.0, 900.0), "gnss", driven_pose(at_ms + 7)))
    return sorted(script, key=lambda entry: entry[0])


def wrong():
    """(topic, message, expected outcome) of invalid or unusual measurements, sent after the drive."""
    twice = sprockets(DURATION_MS + 20, SPEED)
    lost = sprockets(DURATION_MS + 30, SPEED)
    lost.velocity = [math.nan, SPEED]
    nowhere = driven_pose(DURATION_MS + 40)
    nowhere.pose.pose.position.x = math.nan
    unsure = driven_pose(DURATION_MS + 50)
    unsure.pose.covariance = np.zeros(36)
    return [
        ("sprockets", twice, R.ACCEPTED),
        ("sprockets", twice, R.DUPLICATE),
        ("sprockets", lost, R.INVALID),
        ("imu/data_raw", imu(DURATION_MS + 30, math.inf), R.INVALID),
        ("gnss", nowhere, R.INVALID),
        ("gnss", unsure, R.INVALID),
        ("gnss", driven_pose(1000), R.TOO_LATE),
        ("sprockets", sprockets(1000 + 5, SPEED), R.TOO_LATE),
        ("gnss", driven_pose(DURATION_MS - 1000 + 1), R.ACCEPTED),  # late, but within the window
        ("gnss", driven_pose(DURATION_MS + 60, y=50.0), R.GATED),
        ("sprockets", sprockets(DURATION_MS + 70, SPEED), R.ACCEPTED),
    ]


class Graph:
    """Recorder, localizer and estimator; the test replaces the sensors."""

    def __init__(self, programs, observer):
        self._observer = observer
        self.folder = programs.folder
        self._publishers = {
            "gnss": observer.publisher("gnss", as_topic="box_pose"),
            **{topic: observer.publisher(topic) for topic in INPUTS if topic != "gnss"},
        }
        self.reports = observer.subscribe("measurement_reports")
        self.odometry = observer.subscribe("odometry")
        self._sent = Counter()
        self.sent_again = 0  # repeated first messages, which only the recorder may have received
        self._healths = observer.healths()
        sources = ["box_pose", "gnss"]
        self._recorder = programs.node("record", output="bag", more_topics="/gnss")
        self._estimators = [
            programs.node("slip_estimator", pose_sources=sources),
            programs.node("box_localizer"),
        ]
        for topic in INPUTS:
            observer.wait_for_ends(topic, "record", "box_localizer" if topic == "scan" else "slip_estimator")
        observer.wait_for_ends("measurement_reports", "slip_estimator", "record")
        observer.wait_for_ends("box_pose", "box_localizer", "slip_estimator", "record")
        observer.wait_until_active("record", "slip_estimator", "box_localizer")
        outputs = ("box_pose", "odometry", "track_slip", "measurement_reports")
        inputs = [topic for topic in INPUTS if topic != "scan"]
        observer.wait_for_recorder(self._healths, *outputs, *inputs)

    def feed(self, script):
        """Publish in bursts; wait for the reports of each burst before the next one."""
        script = list(script)
        for k in range(0, len(script), BURST):
            expected = len(self.reports)
            for topic, message in script[k : k + BURST]:
                self._publishers[topic].publish(message)
                self._sent[topic] += 1
                expected += 1  # the report on a scan is that of its pose
            self._observer.wait(lambda n=expected: len(self.reports) >= n, f"{expected} reports")

    def first(self, topic, message):
        """Publish a source's first message, repeatedly until all nodes on its path are connected."""
        before = len(self.reports)
        sent = -math.inf
        self.sent_again -= 1

        def reported():
            nonlocal sent
            if len(self.reports) == before and time.monotonic() - sent >= AGAIN:
                self.sent_again += 1
                self._publishers[topic].publish(message)
                self._sent[topic] += 1
                message.header.stamp.nanosec += 1_000_000  # repetitions have later stamps
                sent = time.monotonic()
            return len(self.reports) > before

        self._observer.wait(reported, f"a report on {topic}")

    def bag(self):
        """End all nodes, the recorder first; the bag's path."""
        count = len(self.reports)
        self._observer.wait(lambda: [r.sequence for r in self.reports] == list(range(count)), "all reports")
        self._observer.wait(self._is_recorded, "the recorder to have it all")
        assert self._recorder.end(signal.SIGINT)[0] == 0
        assert [program.end()[0] for program in self._estimators] == [0, 0]
        path = self.folder / "bag"
        with open_bag(path) as bag:
            recorded = bag.topics["/odometry"].count
        self._observer.wait(lambda: len(self.odometry) >= recorded, "all recorded estimates")
        return path

    def _is_recorded(self):
        """Whether the recorder's counts are complete; messages in its queues at its end are not recorded."""
        counts = last_values(self._healths, "record")
        expected = {**self._sent, "measurement_reports": len(self.reports), "odometry": len(self.odometry)}
        return all(counts.get(f"/{topic}") == str(n) for topic, n in expected.items())


def drive(graph):
    graph.first("sprockets", sprockets(50, SPEED))  # before the first fix
    assert graph.reports[-1].outcome == R.WAITING
    script = ordinary()
    graph.first("scan", script[0][2])
    assert (graph.reports[-1].source, graph.reports[-1].outcome) == ("box_pose", R.ACCEPTED)
    graph.feed([entry[1:] for entry in script[1:]])


def replayed_outcomes(path):
    """Outcomes of all measurements in order; asserts that replay equals the live run exactly."""
    parts = []
    with open_bag(path) as bag:
        assert not bag.damage
        p = load_slip_parameters(bag_parameters(bag))
        result = replay(bag, p, InputFilters(), None, watch=parts.append)
    assert result.live is not None
    assert result.live.matches
    assert result.live.largest_difference == 0.0
    assert result.live.lost_reports == 0
    return [int(outcome) for part in parts for outcome in part.results["outcome"]]


@pytest.mark.slow
def test_every_measurement_is_reported_and_replayed(programs, observer):
    graph = Graph(programs, observer)
    drive(graph)
    ordinary_count = len(graph.reports)
    outcomes = [report.outcome for report in graph.reports[1:]]
    assert outcomes.count(R.ACCEPTED) > 0.98 * len(outcomes)
    for topic, message, outcome in wrong():
        graph.feed([(topic, message)])
        report = graph.reports[-1]
        assert (report.source, report.outcome) == (topic, outcome)
        assert report.header.stamp == message.header.stamp
        if topic != "gnss":  # its outcome is that of the most probable hypothesis
            assert (report.nis > report.gate) == (outcome == R.GATED)
    assert len(graph.reports) == ordinary_count + len(wrong())
    stamps = [stamp_ns_of(m) for m in graph.odometry]
    assert stamps == sorted(set(stamps))
    assert np.isfinite([m.pose.pose.position.x for m in graph.odometry]).all()
    path = graph.bag()
    assert replayed_outcomes(path) == [r.outcome for r in graph.reports]
    with AnyReader([path]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert counts["/measurement_reports"] == len(graph.reports)
        assert counts["/odometry"] == len(graph.odometry)
        assert counts["/gnss"] == sum(r.source == "gnss" for r in graph.reports)
        connection = next(c for c in reader.connections if c.topic == "/odometry")
        first = next(raw for _, _, raw in reader.messages([connection]))
        read: Any = reader.deserialize(first, connection.msgtype)
        assert read.pose.pose.position.x == graph.odometry[0].pose.pose.position.x
    summary = programs.replay(str(path))
    processed = sum(summary["messages"][topic] for topic in ("sprockets", "imu/data_raw", "gnss", "box_pose"))
    assert processed - graph.sent_again <= len(graph.reports) <= processed
    assert summary["final"]["x"] == graph.odometry[-1].pose.pose.position.x


def test_replay_is_exact_under_load_and_out_of_order(programs, observer):
    """On a busy machine, with measurements in random order within a second."""
    graph = Graph(programs, observer)
    burners = [programs.python("-c", "while True: pass") for _ in range(3)]
    graph.first("scan", scan(0))
    script = [entry[1:] for entry in ordinary()[1:]]
    random = np.random.default_rng(4)
    for k in range(0, len(script), 100):
        chunk = script[k : k + 100]
        graph.feed([chunk[i] for i in random.permutation(len(chunk))])
    for burner in burners:
        assert burner.end(signal.SIGKILL)[0] == -signal.SIGKILL
    outcomes = replayed_outcomes(graph.bag())
    assert len(outcomes) == len(graph.reports)
    assert 0 <= len(outcomes) - len(script) - 1 <= graph.sent_again
