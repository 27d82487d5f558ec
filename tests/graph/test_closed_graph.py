# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Two graphs are visible on the network only to named peers. The hosts are network namespaces."""

import subprocess
import sys
from typing import Any

import pytest
from fixtures.patience import PATIENCE

# Link this network namespace to another one, where a stranger looks for the nodes of two domains.
HOSTS = """
set -e
ip link set lo up
unshare -n sleep 600 > /dev/null 2>&1 & other=$!
first= second=
trap 'kill -KILL $first $second $other' EXIT
while [ "$(readlink /proc/$other/ns/net)" = "$(readlink /proc/$$/ns/net)" ]; do sleep 0.05; done
ip link add near type veth peer name far netns $other
ip addr add 10.9.0.1/24 dev near; ip link set near up; ip route add default dev near
nsenter -t $other -n sh -c 'ip link set lo up; ip addr add 10.9.0.2/24 dev far; ip link set far up'
nsenter -t $other -n ip route add default dev far
env $NODE "$1" > /dev/null 2>&1 & first=$!
env $NODE ROS_DOMAIN_ID="$SECOND_DOMAIN" "$1" > /dev/null 2>&1 & second=$!
env $STRANGER nsenter -t $other -n "$2" -c "$3"
"""
STRANGER = """
import os
import time
import rclpy
from rclpy.context import Context

def look_into(domain):
    context = Context()
    rclpy.init(context=context, domain_id=int(domain))
    return rclpy.create_node("stranger", context=context, enable_rosout=False)

def visible(node):
    topics = (name for name, _ in node.get_topic_names_and_types())
    return "seen" if node.count_publishers("sprockets") else sorted({{*node.get_node_names(), *topics}})

nodes = [look_into(os.environ[name]) for name in ("ROS_DOMAIN_ID", "SECOND_DOMAIN")]
give_up = time.monotonic() + {seconds}
while not all(node.count_publishers("sprockets") for node in nodes) and time.monotonic() < give_up:
    time.sleep(0.05)
print(*map(visible, nodes))
"""
NOTHING = "['/parameter_events', 'stranger']"  # nothing but itself
RANGE, PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"


@pytest.mark.parametrize(
    ("node", "stranger", "expected"),
    [
        pytest.param(  # ROS's default: nodes are visible
            f"{RANGE}=SUBNET", f"{RANGE}=SUBNET", "seen seen", marks=pytest.mark.slow
        ),
        (f"{RANGE}=LOCALHOST", f"{RANGE}=SUBNET", f"{NOTHING} {NOTHING}"),
        (f"{RANGE}=LOCALHOST {PEERS}=10.9.0.2", f"{RANGE}=LOCALHOST {PEERS}=10.9.0.1", "seen seen"),
    ],
    ids=["open", "closed", "peers"],
)
def test_graph_is_visible_only_to_named_peers(programs: Any, node: str, stranger: str, expected: str) -> None:
    if subprocess.run(["unshare", "-rn", "true"], capture_output=True, check=False).returncode:
        pytest.skip("no network namespaces here")
    code = STRANGER.format(seconds=PATIENCE if expected.startswith("seen") else 5.0)
    shell = ["unshare", "-rn", "sh", "-c", HOSTS, "sh"]
    command = [*shell, programs.path("wheel_adapter"), sys.executable, code]
    second = str(int(programs.environment["ROS_DOMAIN_ID"]) + 101)  # outside the range of other tests
    environment = {**programs.environment, "NODE": node, "STRANGER": stranger, "SECOND_DOMAIN": second}
    for name in (RANGE, PEERS):
        environment.pop(name, None)
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment, check=False, timeout=2 * PATIENCE
    )
    assert done.stdout.strip() == expected, done.stderr
