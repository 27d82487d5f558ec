# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""SROS2: the policy allows exactly what the nodes use; under Enforce no node starts without keys."""

import copy
import os
import subprocess
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import rclpy
from fixtures import unseen_bus
from fixtures.patience import wait_for
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from trackslip_bags.nodes.record import RecordNode
from trackslip_common.topics import COMMANDS, TOPICS
from trackslip_drivers.nodes.can_driver import CanDriverNode
from trackslip_drivers.nodes.nmea_gnss import NmeaNode
from trackslip_drivers.nodes.sick_pls import SickNode
from trackslip_drivers.nodes.watson_imu import WatsonNode
from trackslip_drivers.nodes.wheel_adapter import WheelAdapterNode
from trackslip_estimation.nodes.box_localizer import BoxLocalizerNode
from trackslip_estimation.nodes.gnss_localizer import GnssLocalizerNode
from trackslip_estimation.nodes.slip_estimator import SlipEstimatorNode
from trackslip_estimation.nodes.soil_estimator import SoilEstimatorNode
from trackslip_sim.nodes.emulator import EmulatorNode
from trackslip_tools.nodes.live import LiveNode

SECURITY = Path(__file__).parents[2] / "deploy" / "security"
INCLUDE = "{http://www.w3.org/2001/XInclude}include"
CONFIGURED = (
    *(CanDriverNode, WheelAdapterNode, WatsonNode, SickNode, NmeaNode),
    *(BoxLocalizerNode, GnssLocalizerNode, SlipEstimatorNode, SoilEstimatorNode, EmulatorNode),
    LiveNode,
)
PEOPLE = {"observer", "operator"}
OPTIONAL = {"/tf_static"} | (set() if find_spec("tf2_msgs") else {"/tf"})  # used if an IMU requests it


class Rights(NamedTuple):
    """Absolute topic and service names that a node may use."""

    publish: set[str]
    subscribe: set[str]
    reply: set[str]
    request: set[str]


def read_policy() -> dict[str, Rights]:
    """{node: rights} as sros2 reads the policy: includes resolved, names made absolute."""
    common = list(ElementTree.parse(SECURITY / "node.xml").getroot())
    policy = {}
    for enclave in ElementTree.parse(SECURITY / "policy.xml").getroot().iter("enclave"):
        (profile,) = enclave.iter("profile")
        name = profile.attrib["node"]
        assert (enclave.attrib["path"], profile.attrib["ns"]) == (f"/{name}", "/")
        rights = Rights(set(), set(), set(), set())
        for group in profile:
            if group.tag == INCLUDE:
                assert group.attrib == {"href": "node.xml", "xpointer": "xpointer(/profile/*)"}
            for part in copy.copy(common) if group.tag == INCLUDE else [group]:
                ((kind, allowed),) = part.attrib.items()
                assert allowed == "ALLOW"
                getattr(rights, kind).update(absolute(entry.text or "", name) for entry in part)
        policy[name] = rights
    return policy


def absolute(text: str, node: str) -> str:
    return text if text.startswith("/") else f"/{text.replace('~', node)}"


@pytest.fixture
def graph(domain: int, tmp_path: Path, udp_port: int) -> Iterator[Node]:
    """All nodes with all optional sources and outputs; yields a node for graph queries."""
    dbc, roles = unseen_bus.write(tmp_path)
    parameters = {
        "can_driver:dbc_file": dbc,
        "can_driver:roles_file": roles,
        "slip_estimator:pose_sources": "[box_pose, gnss_pose]",
        "slip_estimator:heading_sources": "[heading]",
        "slip_estimator:velocity_sources": "[fix_velocity]",
        "slip_estimator:slip_sources": "[slip_seed]",
        "slip_estimator:vehicle": "pc05_cab",
        "soil_estimator:vehicle": "pc05_cab",
        "emulator:device_directory": tmp_path / "devices",
        "emulator:vehicle": "pc05_cab",
        "emulator:can_port": udp_port,
        "emulator:duration": 1.0,
        "record:output": tmp_path / "bag",
    }
    arguments = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    rclpy.init(
        args=["--ros-args", *arguments], domain_id=domain, signal_handler_options=SignalHandlerOptions.NO
    )
    nodes: list[Any] = [kind() for kind in CONFIGURED]
    for node in nodes:
        node.trigger_configure()
    nodes.append(RecordNode())
    nodes[-1].start()  # it subscribes when activated
    yield nodes[-1]
    for node in nodes:
        node.end()
        node.destroy_node()
    rclpy.try_shutdown()


def rights_in_use(graph: Node, name: str) -> Rights:
    """Topics and services that a node of the graph uses."""
    lists = (
        graph.get_publisher_names_and_types_by_node,
        graph.get_subscriber_names_and_types_by_node,
        graph.get_service_names_and_types_by_node,
        graph.get_client_names_and_types_by_node,
    )
    return Rights(*({topic for topic, _ in names(name, "/")} for names in lists))


def test_policy_grants_exactly_the_rights_that_nodes_use(graph: Node) -> None:
    policy = read_policy()
    names = set(policy) - PEOPLE
    wait_for(lambda: names <= set(graph.get_node_names()))
    assert set(graph.get_node_names()) == names
    for name in sorted(names):
        for allowed, used, what in zip(policy[name], rights_in_use(graph, name), Rights._fields, strict=True):
            assert allowed - OPTIONAL == used - OPTIONAL, f"{name}: {what}"


def test_each_output_topic_has_one_permitted_publisher() -> None:
    policy = read_policy()
    for topic in set(TOPICS) - {"diagnostics", *COMMANDS}:
        full = absolute("/tf" if topic == "tf" else topic, "")
        publishers = {name for name, rights in policy.items() if full in rights.publish}
        expected = {
            "vehicle": {"slip_estimator", "emulator"},
            "sprockets": {"can_driver", "wheel_adapter"},
            "swing": {"can_driver", "emulator"},
        }
        assert publishers == expected.get(topic, publishers), topic
        assert len(publishers) == len(expected.get(topic, {topic})), topic
    for topic in COMMANDS:
        assert {n for n, rights in policy.items() if f"/{topic}" in rights.publish} == {"operator"}
    assert {n for n, rights in policy.items() if "/odometry" in rights.publish} == {"slip_estimator"}
    assert not policy["observer"].request


@pytest.mark.parametrize("keystore", [None, "empty"])
def test_enforce_without_keys_starts_no_node(programs: Any, keystore: str | None) -> None:
    security = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
    if keystore is not None:
        (programs.folder / keystore / "enclaves").mkdir(parents=True)
        security["ROS_SECURITY_KEYSTORE"] = str(programs.folder / keystore)
    programs.environment = {**programs.environment, **security}
    program = programs.node("wheel_adapter")
    assert program.wait() == 2
    (line,) = program.stderr.splitlines()
    assert "ROS_SECURITY_ENABLE" in line
    assert "docs/security.md" in line


def test_keystore_script_refuses_invalid_arguments(tmp_path: Path) -> None:
    script = SECURITY / "make_keystore.sh"
    for arguments, word in (((), "usage"), (("keys", "a b"), "NAMESPACE"), (("keys", "/a"), "NAMESPACE")):
        done = subprocess.run([script, *arguments], capture_output=True, text=True, cwd=tmp_path, check=False)
        assert done.returncode == 2
        assert word in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("namespace", ["", "digger1"])
def test_keystore_script_passes_the_policy_in_its_namespace_to_sros2(tmp_path: Path, namespace: str) -> None:
    """sros2 is only in apt: the test checks the command line."""
    (tmp_path / "ros2").write_text(
        '#!/bin/sh\necho "$@"\nfor last; do :; done\n[ -f "$last" ] && cat "$last"\n:\n'
    )
    (tmp_path / "ros2").chmod(0o755)
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    command = [SECURITY / "make_keystore.sh", tmp_path / "keys", *filter(None, [namespace])]
    output = subprocess.run(command, capture_output=True, text=True, env=environment, check=True).stdout
    assert output.startswith(f"security create_keystore {tmp_path}/keys\nsecurity generate_artifacts -k ")
    prefix = f"/{namespace}" if namespace else ""
    assert f'<enclave path="{prefix}/slip_estimator">' in output
    assert f'<profile ns="/{namespace}" node="slip_estimator">' in output
    assert output.count("<profile ns") == len(read_policy())
