# SPDX-License-Identifier: Apache-2.0
"""Who on the network sees the graph: nobody but peers that are named. The hosts are network namespaces."""

import subprocess
import sys
from typing import Any

import pytest

pytestmark = pytest.mark.xdist_group("graph")

# A cable between this namespace and another one, in which a stranger looks for the node.
HOSTS = """
set -e
ip link set lo up
unshare -n sleep 600 > /dev/null 2>&1 & other=$!
node=
trap 'kill -KILL $node $other' EXIT
while [ "$(readlink /proc/$other/ns/net)" = "$(readlink /proc/$$/ns/net)" ]; do sleep 0.05; done
ip link add near type veth peer name far netns $other
ip addr add 10.9.0.1/24 dev near; ip link set near up; ip route add default dev near
nsenter -t $other -n sh -c 'ip link set lo up; ip addr add 10.9.0.2/24 dev far; ip link set far up'
nsenter -t $other -n ip route add default dev far
env $NODE "$1" > /dev/null 2>&1 & node=$!
env $STRANGER nsenter -t $other -n "$2" -c "$3"
"""
STRANGER = """
import time
import rclpy
rclpy.init()
node = rclpy.create_node("stranger")
give_up = time.monotonic() + {seconds}
while not node.count_publishers("sprockets") and time.monotonic() < give_up:
    time.sleep(0.05)
print("seen" if node.count_publishers("sprockets") else sorted(node.get_node_names()))
"""
RANGE, PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"


@pytest.mark.parametrize(
    ("node", "stranger", "expected"),
    [
        (f"{RANGE}=SUBNET", f"{RANGE}=SUBNET", "seen"),  # as ROS has it: so this test can tell
        (f"{RANGE}=LOCALHOST", f"{RANGE}=SUBNET", "['stranger']"),
        (f"{RANGE}=LOCALHOST {PEERS}=10.9.0.2", f"{RANGE}=LOCALHOST {PEERS}=10.9.0.1", "seen"),
    ],
    ids=["open", "closed", "peers"],
)
def test_a_stranger_on_the_network(programs: Any, node: str, stranger: str, expected: str) -> None:
    if subprocess.run(["unshare", "-rn", "true"], capture_output=True, check=False).returncode:
        pytest.skip("no network namespaces here")
    code = STRANGER.format(seconds=60.0 if expected == "seen" else 8.0)
    command = [
        "unshare",
        "-rn",
        "sh",
        "-c",
        HOSTS,
        "sh",
        programs.path("wheel_adapter"),
        sys.executable,
        code,
    ]
    environment = {**programs.environment, "NODE": node, "STRANGER": stranger}
    for name in (RANGE, PEERS):
        environment.pop(name, None)
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False, timeout=120)
    assert done.stdout.strip() == expected, done.stderr
