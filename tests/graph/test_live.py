# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The node of the live page: pose sources that the slip estimator states; 2000 hostile connections."""

import asyncio
import http.client
import json
import re
import signal
import time
from pathlib import Path

import pytest
from fixtures import flood
from fixtures.patience import PATIENCE
from fixtures.programs import ros_arguments
from geometry_msgs.msg import PoseWithCovarianceStamped
from std_msgs.msg import String
from tornado.websocket import websocket_connect

from trackslip_common.config_files import parameters_text
from trackslip_common.nodes.qos import latched_qos

PARAMETERS = "slip_estimator/parameters"


def fixes(port):
    """Fixes in the first message to an opened page."""

    async def whole():
        page = await websocket_connect(f"ws://127.0.0.1:{port}/stream")
        return json.loads(await page.read_message() or "{}")

    return asyncio.run(asyncio.wait_for(whole(), PATIENCE))["fixes"]


def port_of(program):
    """Port of the page's server."""
    printed = r"http://\S+:(\d+)/"
    program.until(lambda: re.search(printed, program.stdout + program.stderr), "the address")
    port, *_ = re.findall(printed, program.stdout + program.stderr)
    return port


def subscribed(observer):
    """Topics to which the node ``live`` subscribes."""
    return {name for name, _ in observer.node.get_subscriber_names_and_types_by_node("live", "/")}


def test_page_follows_the_pose_sources_that_the_estimator_states(programs, observer):
    """Fixes are drawn beside invalid names; subscriptions of removed sources are dropped."""
    port = port_of(programs.node("live", port=0))
    observer.wait(lambda: "/box_pose" in subscribed(observer), "the node's subscriptions")
    first = subscribed(observer)
    publisher = observer.node.create_publisher(String, PARAMETERS, latched_qos())

    def state(*names):
        text = parameters_text({"pose_sources": [*names]}, "slip_estimator")
        publisher.publish(String(data=text))

    state("no topic at all!", "rtk/pose")
    poses = observer.node.create_publisher(PoseWithCovarianceStamped, "rtk/pose", 10)
    pose = PoseWithCovarianceStamped()
    pose.pose.pose.position.x, pose.pose.pose.position.y = 3.0, 4.0

    def drawn():
        poses.publish(pose)
        return [3.0, 4.0] in fixes(port)

    observer.wait(drawn, "a fix on the page")
    for names in (["lidar/pose", "beacon/pose"], []):
        state(*names)
        expected = first | {f"/{name}" for name in names}
        observer.wait(lambda expected=expected: subscribed(observer) == expected, f"{names}")


STRANGERS, DESCRIPTORS = 2000, 256
LIMITED = f'ulimit -n {DESCRIPTORS} && exec "$@"'


def seconds_until_answered(port: int, path: str) -> float:
    began = time.monotonic()
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
    connection.request("GET", path)
    answer = connection.getresponse()
    assert answer.status == 200
    assert len(answer.read()) == int(answer.headers["Content-Length"])
    connection.close()
    return time.monotonic() - began


@pytest.mark.soak  # beside other tests the machine is too busy to judge the answers by
@pytest.mark.parametrize("duration_s", [60.0])
def test_page_answers_good_clients_among_2000_bad_ones(programs, duration_s):
    node = programs.start("sh", "-c", LIMITED, "sh", programs.path("live"), *ros_arguments(port=0))
    port = int(port_of(node))
    lines_before = len((node.stdout + node.stderr).splitlines())
    strangers = programs.python(str(Path(flood.__file__)), str(port), str(STRANGERS))
    began, answered_s = time.monotonic(), []
    while time.monotonic() < began + duration_s or len(answered_s) < 9:
        assert strangers.process.poll() is None, strangers.stderr
        answered_s.append(seconds_until_answered(port, ("/", "/live.js", "/page.json")[len(answered_s) % 3]))
        time.sleep(0.1)
    lines = len((node.stdout + node.stderr).splitlines()) - lines_before
    lasted_s = time.monotonic() - began
    answered_s.sort()
    print(
        f"{STRANGERS} bad connections for {lasted_s:.0f} s: {len(answered_s)} good requests answered within "
        f"{answered_s[-1]:.2f} s (median {answered_s[len(answered_s) // 2]:.3f} s), {lines} lines of log"
    )
    assert lines <= 1 + lasted_s
    strangers.end(signal.SIGKILL)
