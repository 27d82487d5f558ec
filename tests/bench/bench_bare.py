# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The floor of loads: bare rclpy nodes with the subscriptions and publications of the real ones.

``bench_bare.py TOPICS NAME`` runs one of them. ``TOPICS`` is a JSON file. It has the topics that each node of
the real graph subscribed to and published, and the rate and one message of each topic. A node publishes some
topics in response to an input; a thread paces the others.
"""

import json
import signal
import sys
import threading
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.qos import ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from bench_ros import repeat
from trackslip_bags.reader import open_bag
from trackslip_common.nodes.messages import topic_class
from trackslip_common.nodes.qos import best_effort_qos, publisher_qos, reliable_qos
from trackslip_common.nodes.run import Executor
from trackslip_common.topics import TOPICS

Endpoints = dict[str, dict[str, bool]]  # "subscribes" and "publishes": topic → whether reliably
_ESTIMATE = ("odometry", "odometry/local", "attitude", "swing/estimate", "track_slip", "machine_state")
_TRIGGERS = {  # topic → topics whose messages trigger it
    **dict.fromkeys(_ESTIMATE, ("sprockets",)),
    "box_pose": ("scan",),
    "measurement_reports": ("sprockets", "imu/data_raw", "box_pose"),
}
_SPIN = 0.1  # s, as in the real nodes


def endpoints_of(node: Any) -> dict[str, Endpoints]:
    """Project topics that each node subscribes to and publishes, by node name, as ``node`` sees them."""
    endpoints: dict[str, Endpoints] = defaultdict(lambda: {"subscribes": {}, "publishes": {}})
    for topic in TOPICS:
        for endpoint in node.get_publishers_info_by_topic(f"/{topic}"):
            endpoints[endpoint.node_name]["publishes"][topic] = True
        for endpoint in node.get_subscriptions_info_by_topic(f"/{topic}"):
            reliable = endpoint.qos_profile.reliability == ReliabilityPolicy.RELIABLE
            endpoints[endpoint.node_name]["subscribes"][topic] = reliable
    return dict(endpoints)


def recorded_topics(path: Path) -> dict[str, tuple[bytes, float]]:
    """Topic → last message, and rate, Hz, of a bag."""
    messages: dict[str, bytes] = {}
    counts: Counter[str] = Counter()
    with open_bag(path) as bag:
        for m in bag.messages():
            counts[m.topic] += 1
            messages[m.topic] = bytes(m.raw)
    return {name.removeprefix("/"): (raw, counts[name] / bag.duration_s) for name, raw in messages.items()}


def write_topics(path: Path, nodes: dict[str, Endpoints], topics: dict[str, tuple[bytes, float]]) -> None:
    """Write the JSON file; ``topics``: message and rate, Hz, of each topic."""
    entries = {topic: {"message": raw.hex(), "rate": rate} for topic, (raw, rate) in topics.items()}
    path.write_text(json.dumps({"nodes": nodes, "topics": entries}), encoding="utf-8")


def run(path: Path, name: str) -> None:
    """Run until interrupted; SIGINT sets a flag, because rclpy could drop an exception."""
    ended: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: ended.append(number))
    content = json.loads(path.read_text(encoding="utf-8"))
    own, topics = content["nodes"][name], content["topics"]
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(name)
    outputs = {topic: _output(node, topic, topics[topic]) for topic in own["publishes"] if topic in topics}
    for topic, is_reliable in own["subscribes"].items():
        if topic in topics:
            triggered = [publish for output, publish in outputs.items() if topic in _TRIGGERS.get(output, ())]
            kind, qos = topic_class(topic), reliable_qos() if is_reliable else best_effort_qos()
            node.create_subscription(kind, topic, _call_all(triggered), qos, raw=True)
    for topic, publish in outputs.items():
        if topic not in _TRIGGERS:
            period = 1.0 / topics[topic]["rate"]
            threading.Thread(target=repeat, args=(publish, period), daemon=True).start()
    executor = Executor()
    executor.add_node(node)
    while not ended:
        executor.spin_until_future_complete(Future(), _SPIN)


def _output(node: Any, topic: str, entry: dict[str, Any]) -> Callable[[], None]:
    publisher = node.create_publisher(topic_class(topic), topic, publisher_qos(topic))
    message = bytes.fromhex(entry["message"])
    return lambda: publisher.publish(message)


def _call_all(functions: list[Callable[[], None]]) -> Callable[[bytes], None]:
    def call(_: bytes) -> None:
        for function in functions:
            function()

    return call


if __name__ == "__main__":
    run(Path(sys.argv[1]), sys.argv[2])
    sys.exit(130)
