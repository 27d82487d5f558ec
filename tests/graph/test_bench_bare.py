# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The bench's bare nodes subscribe to and publish the topics of the real nodes at the same rates."""

import json
import signal
from pathlib import Path

import pytest

import bench_bare
from trackslip_bags.messages import make, serialize
from trackslip_bags.writer import BagWriter
from trackslip_common.topics import TOPICS

SCRIPT = str(Path(bench_bare.__file__))
RATE = 20.0  # Hz, of topics that no input triggers
ENDPOINTS = {
    "slip_estimator": {"subscribes": {"sprockets": False}, "publishes": {"odometry": True}},
    "can_driver": {"subscribes": {}, "publishes": {"sprockets": True}},
}


@pytest.mark.slow
def test_bare_node_publishes_sources_at_their_rate_and_answers_inputs(programs, observer):
    with BagWriter(programs.folder / "bag") as bag:
        for k in range(int(RATE) + 1):
            for topic, fields in (("sprockets", {"name": ["a"]}), ("odometry", {})):
                kind = TOPICS[topic].type_name
                bag.write(f"/{topic}", kind, serialize(make(kind, **fields)), round(k * 1e9 / RATE))
    topics = programs.folder / "topics.json"
    bench_bare.write_topics(topics, ENDPOINTS, programs.folder / "bag")
    assert json.loads(topics.read_text())["topics"]["sprockets"]["rate"] == (RATE + 1) / 1.0

    sprockets, odometry = observer.subscribe("sprockets"), observer.subscribe("odometry")
    estimator = programs.python(SCRIPT, str(topics), "slip_estimator")
    observer.wait_for_ends("odometry", "slip_estimator")
    assert odometry == []
    driver = programs.python(SCRIPT, str(topics), "can_driver")
    observer.wait(lambda: len(sprockets) > 5 and len(odometry) > 5, "both")
    assert sprockets[0].name == ["a"]
    observer.wait(
        lambda: bench_bare.endpoints_of(observer.node).items() >= ENDPOINTS.items(), "their endpoints"
    )
    for program in (driver, estimator):
        assert program.end(signal.SIGINT)[0] == 130
