# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The recorder writes each message or reports its loss; killed at any moment, it leaves a readable bag."""

import json
import random
import re
import signal
import time
from collections import Counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.observer import last_of, last_values
from geometry_msgs.msg import QuaternionStamped
from mcap.reader import make_reader
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import String

from trackslip_bags.nodes import subscriptions
from trackslip_bags.reader import open_bag
from trackslip_bags.writer import BagWriter
from trackslip_common.errors import ExitCode
from trackslip_common.nodes.messages import message_class
from trackslip_common.nodes.qos import best_effort_qos, publisher_qos

pytestmark = pytest.mark.xdist_group("graph")

LONGEST_LOSS = 1.0  # s
LONGEST_STEP = 0.01  # s between two readings of the clock; longer steps are stalls of the host
PERIOD = 0.002  # s
MORE_THAN_A_BUFFER = 900  # messages: more than the kernel's 208 kB, fewer than a publisher keeps
QUICK = 1  # kills in make test, of twenty
MOMENTS = np.random.default_rng(7).uniform(0.1, 4.0, 20).round(2).tolist()  # s after the first message

# Publishes the project's topics at factor × their nominal rates for some seconds; prints topics and counts.
# It starts when a file exists: messages before the recorder's discovery would not be counted.
LOAD = """
import json, sys, time
from pathlib import Path
import numpy as np, rclpy
from rclpy.duration import Duration
from trackslip_common.nodes.messages import topic_class
from trackslip_common.nodes.qos import publisher_qos
from trackslip_common.topics import TOPICS
from trackslip_bags.messages import make, serialize

factor, seconds = float(sys.argv[1]), float(sys.argv[2])
fast = ("sprockets", "hydraulics", "odometry", "track_slip", "track_forces")
fast += ("truth/odometry", "truth/track_slip")
rates = {**dict.fromkeys(fast, 100.0), "measurement_reports": 120.0, "imu/data_raw": 11.85, "scan": 4.2}
rclpy.init()
node = rclpy.create_node("load")
publishers = {t: node.create_publisher(topic_class(t), t, publisher_qos(t)) for t in rates}
fields = {topic: {} for topic in rates} | {"scan": {"ranges": np.arange(361, dtype=np.float32)}}
raw = {topic: serialize(make(TOPICS[topic].type_name, **fields[topic])) for topic in rates}
print(json.dumps(list(rates)), flush=True)
while not Path("go").exists() or not all(p.get_subscription_count() for p in publishers.values()):
    time.sleep(0.01)
sent = dict.fromkeys(rates, 0)
began = time.monotonic()
while (now := time.monotonic() - began) < seconds:
    for topic, publisher in publishers.items():
        while sent[topic] < int(now * rates[topic] * factor):
            publisher.publish(raw[topic])
            sent[topic] += 1
    time.sleep(0.001)
for topic, publisher in publishers.items():  # the last one implies all before it
    assert publisher.wait_for_all_acked(Duration(seconds=60))
print(json.dumps(sent), flush=True)
time.sleep(600)  # the middleware forgets what it holds for a publisher that is gone
"""

# The recorder with a disk that blocks once.
STALLING = """
import time
from trackslip_bags.writer import BagWriter
from trackslip_bags.nodes import record

write, calls = BagWriter.write, 0

def hanging(*arguments):
    global calls
    calls += 1
    if calls == 2000:
        time.sleep(2.5)
    write(*arguments)

BagWriter.write = hanging
record.main()
"""


class Recorder:
    """The node and its reports."""

    def __init__(self, programs, observer, program=None, **parameters):
        self.path = programs.folder / "bag"
        self._observer = observer
        self._healths = observer.healths()
        self.program = program or programs.node("record", output="bag", **parameters)

    def health(self):
        """Its last report."""
        return last_of(self._healths, "record") or DiagnosticStatus()

    def values(self):
        return last_values(self._healths, "record")

    def wait(self, condition, what):
        self._observer.wait(condition, what)

    def wait_for(self, *topics):
        """Wait until the recorder has found a publisher of each topic."""
        self._observer.wait_for_recorder(self._healths, *topics)

    def count(self, topic):
        return int(self.values().get(f"/{topic}", 0))

    def lost(self, topic):
        return int(self.values().get(f"/{topic} lost", 0))


def numbered(number):
    message = JointState()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(number, 1000)
    message.name = ["left_sprocket", "right_sprocket"]
    message.position = [float(number)] * 2
    return message


def read_strictly(path):
    """Numbers in the bag, in order, by the strict reader of rosbags; asserts that mcap reads as many."""
    numbers = []
    with AnyReader([path]) as reader:
        connections = [connection for connection in reader.connections if connection.topic == "/sprockets"]
        for connection, _, raw in reader.messages(connections):
            message: Any = reader.deserialize(raw, connection.msgtype)
            numbers.append(int(message.position[0]))
    count = 0
    for file in sorted(path.glob("*.mcap")):
        with file.open("rb") as stream:
            messages = make_reader(stream, validate_crcs=True).iter_messages(["/sprockets"])
            count += sum(1 for _ in messages)
    assert count == len(numbers)
    return numbers


@pytest.mark.parametrize(
    ("number", "moment"),
    [
        pytest.param(number, moment, marks=() if number < QUICK else pytest.mark.slow)
        for number, moment in enumerate(MOMENTS)
    ],
)
def test_killed_at_any_moment(programs, observer, number, moment):
    """Odd runs split files at 1 s, so that some are killed at the start of a new file."""
    recorder = Recorder(programs, observer, split_duration=1.0 if number % 2 else 0.0)
    publisher = observer.publisher("sprockets")
    recorder.wait_for("sprockets")
    sent = []  # times on a clock that excludes stalls of the host
    elapsed, before = 0.0, time.monotonic()
    while elapsed < moment:
        now = time.monotonic()
        elapsed, before = elapsed + min(now - before, LONGEST_STEP), now
        if elapsed >= len(sent) * PERIOD:
            publisher.publish(numbered(len(sent)))
            sent.append(elapsed)
    recorder.program.end(signal.SIGKILL)
    program = programs.tool("trackslip", "recover", "bag")
    code = program.wait()
    assert "lost: " in program.stdout, program.stderr
    numbers = read_strictly(programs.folder / "bag_recovered")
    assert numbers == list(range(len(numbers)))
    assert code == (ExitCode.DONE if numbers else ExitCode.FAILED)  # nothing was written before the kill
    lost = elapsed - sent[len(numbers)] if len(numbers) < len(sent) else 0.0
    print(f"\nkilled after {moment:.2f} s: {len(numbers)} of {len(sent)}, {lost:.3f} s lost")
    assert lost <= LONGEST_LOSS


def test_recorder_writes_messages_that_wait_for_a_retransmission_at_its_end(programs, observer):
    """Messages after a lost one wait until it is sent again."""
    recorder = Recorder(programs, observer)
    publisher = observer.publisher("sprockets")
    observer.wait_for_ends("sprockets", "record")
    recorder.wait_for("sprockets")
    recorder.program.process.send_signal(signal.SIGSTOP)
    for number in range(MORE_THAN_A_BUFFER):
        publisher.publish(numbered(number))
    recorder.program.process.send_signal(signal.SIGCONT)
    assert recorder.program.end(signal.SIGINT)[0] == 0
    assert read_strictly(recorder.path) == list(range(MORE_THAN_A_BUFFER))


def reported_and_written(programs, observer, recorder, seconds):
    """Ten times the nominal load; (sent, reported lost, recorded), by topic."""
    recorder.wait(recorder.values, "the recorder")
    load = programs.python("-c", LOAD, "10", str(seconds))
    observer.wait(lambda: "]" in load.stdout, "the load")
    recorder.wait_for(*json.loads(load.stdout))
    (programs.folder / "go").touch()
    observer.wait(lambda: "}" in load.stdout, "the load to end")
    sent = json.loads(load.stdout.splitlines()[1])
    observer.wait(
        lambda: all(recorder.count(t) + recorder.lost(t) >= n for t, n in sent.items()), "all to be reported"
    )
    lost = {topic: recorder.lost(topic) for topic in sent}
    assert recorder.health().level == (DiagnosticStatus.ERROR if any(lost.values()) else DiagnosticStatus.OK)
    assert recorder.program.end(signal.SIGINT)[0] == 0
    assert ("messages were lost" in recorder.program.stderr) == any(lost.values())
    assert load.end(signal.SIGKILL)[0] == -signal.SIGKILL
    with open_bag(recorder.path) as bag:
        assert bag.damage == ""
        return Counter(sent), Counter(lost), Counter({t: bag.topics[f"/{t}"].count for t in sent})


@pytest.mark.slow
def test_losses_of_a_stalled_recorder_are_counted_and_reported(programs, observer):
    program = programs.python("-c", STALLING, "--ros-args", "-p", "output:=bag")
    recorder = Recorder(programs, observer, program)
    sent, lost, written = reported_and_written(programs, observer, recorder, 5.0)
    assert lost.total() > 0
    assert written + lost == sent


def test_full_disk_is_reported_and_the_bag_stays_recoverable(programs, observer):
    limited = f"ulimit -f 4096; exec {programs.path('record')} --ros-args -p output:=bag"
    healths = observer.healths()
    program = programs.start("bash", "-c", limited)
    publisher = observer.publisher("emulator/fault")
    observer.wait_for_recorder(healths, "emulator/fault")
    noise = random.Random(1)

    def full_disk_reports():
        publisher.publish(String(data=noise.randbytes(200_000).hex()))
        return [h for h in healths if h.name == "record" and "cannot write (File too large)" in h.message]

    observer.wait(full_disk_reports, "the disk to be full")
    report = full_disk_reports()[-1]
    assert report.level == DiagnosticStatus.ERROR
    assert "/emulator/fault lost" in {pair.key for pair in report.values}
    assert program.end()[0] == 1
    assert "further messages are lost" in program.stderr
    assert program.stderr.count(" lost") == 2  # at the failure, and at the end
    assert re.search(
        r"cannot write \(File too large\): bag is incomplete, \d+ messages were lost$", program.stderr.strip()
    )
    assert "Traceback" not in program.stderr
    again = programs.tool("trackslip", "recover", "bag")
    assert again.wait() == 0, again.stderr
    with open_bag(programs.folder / "bag_recovered") as bag:
        assert bag.damage == ""
        assert bag.topics["/emulator/fault"].count > 0


def test_topics_of_others_are_recorded_by_expression(programs, observer):
    """Messages from before the recorder's start are included if their publisher keeps them."""
    node = observer.node
    latching = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    latched = node.create_publisher(String, "/site/plan", latching)
    latched.publish(String(data="a field"))
    plain = node.create_publisher(String, "/site/note", 10)
    node.create_publisher(String, "/other/note", 10)
    program = programs.tool("trackslip", "record", "--output", "bag", "--more-topics", "/site/.*")
    recorder = Recorder(programs, observer, program)
    recorder.wait_for("site/note", "site/plan")
    plain.publish(String(data="rain"))
    recorder.wait(lambda: recorder.count("site/note") and recorder.count("site/plan"), "both")
    assert recorder.program.end()[0] == 0
    log = recorder.program.stderr
    assert "[INFO] writing " in log
    assert max(map(len, log.splitlines())) <= 80, log
    with open_bag(recorder.path) as bag:
        texts = {
            m.topic: bag.deserialize(m.raw, m.type_name).data
            for m in bag.messages(["/site/plan", "/site/note"])
        }
        assert texts == {"/site/plan": "a field", "/site/note": "rain"}
        assert "/other/note" not in bag.topics


@pytest.mark.parametrize("kind", [pytest.param(Imu, marks=pytest.mark.slow), QuaternionStamped])
def test_headings_are_recorded_by_the_type_that_is_published(programs, observer, kind):
    recorder = Recorder(programs, observer)
    observer.wait_for_ends("/heading", "record")
    publisher = observer.node.create_publisher(kind, "heading", publisher_qos("heading"))
    name = f"/{kind.__name__}"
    observer.wait(lambda: publisher.get_subscription_count() > 0, f"the recorder on headings as {name}")
    recorder.wait_for("heading")  # a reader without a matched writer acknowledges but receives nothing
    for k in range(5):
        message = kind()
        message.header.stamp.sec = 1 + k
        publisher.publish(message)
    assert publisher.wait_for_all_acked(Duration(seconds=10))
    assert recorder.program.end()[0] == 0
    with open_bag(recorder.path) as bag:
        assert bag.topics["/heading"].type_name.endswith(name)
        stamps = [bag.deserialize(m.raw, m.type_name).header.stamp.sec for m in bag.messages(["/heading"])]
    assert stamps == [1, 2, 3, 4, 5]


@pytest.fixture
def discovered(observer, tmp_path, monkeypatch):
    """A function that returns the recorder's subscriptions after it has found best-effort publishers."""

    def discover(**types):
        def publishers(topic):
            kind = types.get(topic.removeprefix("/"))
            return [SimpleNamespace(topic_type=kind, qos_profile=best_effort_qos())] if kind else []

        monkeypatch.setattr(observer.node, "get_publishers_info_by_topic", publishers)
        found = subscriptions.RawSubscriptions(observer.node, bag, re.compile(r"(?!)"), lambda *_: None)
        found.discover()
        return found

    with BagWriter(tmp_path / "bag") as bag:
        yield discover


def test_best_effort_topic_of_a_type_that_is_not_installed_is_not_recorded(discovered, monkeypatch):
    def only_sensors(type_name):
        if not type_name.startswith("sensor_msgs/"):
            raise ModuleNotFoundError(f"no {type_name}")
        return message_class(type_name)

    monkeypatch.setattr(subscriptions, "message_class", only_sensors)
    recorded = discovered(heading="geometry_msgs/msg/QuaternionStamped")
    assert "/heading" in recorded.not_recorded
    assert "/heading" not in recorded.publishers()


def test_topic_of_a_best_effort_publisher_is_subscribed_with_best_effort(discovered, observer):
    publisher = observer.node.create_publisher(JointState, "sprockets", best_effort_qos())
    discovered(sprockets="sensor_msgs/msg/JointState")
    observer.wait(publisher.get_subscription_count, "a subscription that matches")
