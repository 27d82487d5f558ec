# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A user's mistake is reported in one line; a signal ends a node quietly."""

import re
import signal
import socket
import subprocess
import sys
from typing import Any

import pytest
import yaml
from fixtures.own_node import own_node
from fixtures.programs import ros_arguments

from trackslip_bags.nodes.record import RecordNode
from trackslip_common.config_files import node_defaults
from trackslip_common.errors import ExitCode, InputError
from trackslip_common.nodes.run import run
from trackslip_common.vehicle_files import load_vehicle, parse_vehicle
from trackslip_drivers.nodes.can_driver import CanDriverNode
from trackslip_drivers.nodes.sick_pls import SickNode
from trackslip_drivers.nodes.watson_imu import WatsonNode
from trackslip_estimation.nodes.box_localizer import BoxLocalizerNode
from trackslip_estimation.nodes.slip_estimator import SlipEstimatorNode
from trackslip_estimation.nodes.soil_estimator import SoilEstimatorNode
from trackslip_sim.nodes.emulator import EmulatorNode

FEW = 4  # kernels compiled before Ctrl-C, of some dozens
NODES = {
    "can_driver": CanDriverNode,
    "watson_imu": WatsonNode,
    "sick_pls": SickNode,
    "box_localizer": BoxLocalizerNode,
    "slip_estimator": SlipEstimatorNode,
    "soil_estimator": SoilEstimatorNode,
    "record": RecordNode,
    "emulator": EmulatorNode,
}
REFUSED: dict[str, dict[str, Any]] = {
    "can_driver": {
        "can_port": 80,
        "can_bitrate": "fast",
        "can_options": "fd",
        "dbc_file": "missing.dbc",
        "roles_file": "missing.yaml",
        "autostart": 5,
    },
    "watson_imu": {"serial_baud": 0, "parity": 7},
    "sick_pls": {"range_max": -1.0, "parity": "X", "glare_is_nan": "yes, please", "serial_baud": 1200},
    "box_localizer": {"range_stddev": -0.1, "laser_x": "here", "vehicle__sensors__box__length": 0.0},
    "slip_estimator": {"history_window": 100.0, "publish_tf": 1, "vehicle__kinematics__tread": -1.0},
    "soil_estimator": {"forces_period": 0.0, "dynamics__mu_r": -1.0, "vehicle__mass__mass": "heavy"},
    "record": {"more_topics": "((", "output": 1, "split_size": -1, "split_duration": -1.0},
    "emulator": {"lead_in": -1.0, "seed": "one", "soil": "cheese", "scenario": "moon", "mode": "magic"},
}
QUICK = {"emulator": {"scenario": "straight", "lead_in": 0.5}}  # further parameters for a quick start


def assert_one_line(stdout, stderr, *words):
    """Assert that stderr is one line with all these words, and stdout is empty."""
    lines = stderr.splitlines()
    assert len(lines) == 1, stderr
    assert [word for word in words if word not in lines[0]] == [], lines[0]
    assert stdout == ""


@pytest.fixture
def assert_refused(domain, tmp_path, monkeypatch, capfd):
    """A function that runs a node with bad arguments and asserts exit code 2 and one line."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.chdir(tmp_path)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def refuse(node, arguments, *words):
        assert run(NODES[node], arguments) == ExitCode.BAD_INPUT
        assert_one_line(*capfd.readouterr(), *words)

    yield refuse
    for number, handler in handlers.items():
        signal.signal(number, handler)


def test_can_port_that_another_program_has_is_named(assert_refused, can):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", can["can_port"]))
        arguments = ros_arguments(**can, **QUICK["emulator"], autostart=True)
        assert_refused("emulator", arguments, f"can_port {can['can_port']}", "in use", "accepted: ")


def test_system_does_not_give_the_can_port_of_the_emulator_to_other_programs():
    first_ephemeral = 32768  # of Linux as it comes; net.ipv4.ip_local_port_range
    assert node_defaults("emulator", "emulator.yaml")["can_port"] < first_ephemeral


@pytest.mark.parametrize("node", NODES)
def test_unknown_parameter(assert_refused, node):
    assert_refused(node, ros_arguments(nonsense=1), node, "'nonsense'", "accepted: ")


def test_process_of_a_node_ends_with_the_exit_code_and_the_line(programs):
    program = programs.node("can_driver", nonsense=1)
    assert program.wait() == ExitCode.BAD_INPUT
    assert_one_line(program.stdout, program.stderr, "can_driver", "'nonsense'", "accepted: ")


@pytest.mark.parametrize(
    ("node", "name"), [(node, name) for node, parameters in REFUSED.items() for name in parameters]
)
def test_refused_value(assert_refused, node, name):
    value = REFUSED[node][name]
    text = value if isinstance(value, str) else f"{value:g}"
    assert_refused(node, ros_arguments(**{name: value}), name.rpartition("__")[2], text)


def test_parameter_file_that_is_missing_or_no_yaml(assert_refused, tmp_path):
    (tmp_path / "bad.yaml").write_text("sick_pls: [", encoding="utf-8")
    for name in ("missing.yaml", "bad.yaml"):
        assert_refused("sick_pls", ros_arguments("--params-file", name), name, "accepted: ")


def test_unknown_parameter_in_a_file(assert_refused, tmp_path):
    (tmp_path / "one.yaml").write_text("watson_imu: {ros__parameters: {nonsense: 1}}", encoding="utf-8")
    assert_refused("watson_imu", ros_arguments("--params-file", "one.yaml"), "'nonsense'", "serial_port")


@pytest.mark.parametrize(
    ("sources", "remapping", "words"),
    [
        ("[a b]", (), ("'a b' is no name of a topic",)),
        ("[sprockets]", (), ("'sprockets'", "JointState in this node", "PoseWithCovarianceStamped")),
        ("[slip_estimator/pose_set]", (), ("/slip_estimator/pose_set, which this node publishes",)),
        ("[rtk]", ("-r", "rtk:=imu/data_raw"), ("'rtk' is /imu/data_raw", "Imu in this node")),
        ("[rtk, box_pose]", ("-r", "rtk:=box_pose"), ("'rtk' and 'box_pose' are both /box_pose",)),
    ],
)
def test_topic_that_cannot_be_a_source_is_refused(
    sources: str, remapping: tuple[str, ...], words: tuple[str, ...], domain: int
) -> None:
    with own_node(SlipEstimatorNode, domain, *remapping, pose_sources=yaml.safe_load(sources)) as node:
        with pytest.raises(InputError) as refused:
            node.start()
        assert all(word in str(refused.value) for word in ("slip_estimator: ", "; accepted: ", *words))


def test_joints_of_tracks_and_swing_may_come_in_one_topic(domain: int) -> None:
    remapping = ("-r", "sprockets:=joint_states", "-r", "swing:=joint_states")
    with own_node(SlipEstimatorNode, domain, *remapping, vehicle="pc05_cab") as node:
        node.start()
        inputs = [subscription.topic_name for subscription in node.subscriptions]
        assert inputs.count("/joint_states") == 2


def test_renamed_node_takes_its_parameters_from_a_common_file(programs, observer):
    """The path is relative to the working directory; parameters of other nodes are ignored."""
    values = "vehicle: excavator_20t, jump_confirmations: 7, serial_port: /dev/x, output: bag"
    config = programs.folder / "mine.yaml"
    config.write_text(f"/**: {{ros__parameters: {{{values}}}}}", encoding="utf-8")
    texts, vehicle = observer.subscribe("slip_estimator/parameters"), observer.subscribe("vehicle")
    programs.node("slip_estimator", "-r", "__node:=second", "--params-file", "mine.yaml")
    observer.wait(lambda: texts and vehicle, "the parameters in use")
    assert texts[0].data.startswith("slip_estimator:")
    assert "jump_confirmations: 7" in texts[0].data
    assert parse_vehicle(vehicle[0].data, "vehicle") == load_vehicle("excavator_20t")


def test_recorder_keeps_existing_files(assert_refused, tmp_path):
    (tmp_path / "bag").mkdir()
    assert_refused("record", ros_arguments(output="bag"), "'bag'", "exists already", "accepted: ")
    assert list((tmp_path / "bag").iterdir()) == []


def test_recorder_that_cannot_write(assert_refused, tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    assert_refused("record", ros_arguments(output="file/bag"), "'file/bag'")


@pytest.mark.parametrize(
    ("node", "number"),
    [
        ("emulator", signal.SIGINT),
        ("slip_estimator", signal.SIGTERM),
        pytest.param(
            "record",
            signal.SIGHUP,
            marks=pytest.mark.skipif(
                signal.getsignal(signal.SIGHUP) == signal.SIG_IGN, reason="under nohup nodes stay"
            ),
        ),
        *(pytest.param(node, signal.SIGINT, marks=pytest.mark.slow) for node in NODES if node != "emulator"),
    ],
)
def test_running_node_ends_quietly(programs, observer, can, node, number):
    parameters = QUICK.get(node, {})
    if node == "emulator":
        parameters = {**parameters, "device_directory": str(programs.folder / "dev"), **can}
    healths = observer.healths()
    program = programs.node(node, **parameters)
    observer.wait(lambda: [status for status in healths if status.name == node], f"diagnostics of {node}")
    code, _ = program.end(number)
    logged = re.compile(rf"\[(INFO|WARN|ERROR)\] \[[\d.]+\] \[{node}\]: ")  # changes of state
    assert [line for line in program.stderr.splitlines() if not logged.match(line)] == []
    assert code == 0
    assert programs.alive() == {}
    assert not (programs.folder / "dev" / "watson").is_symlink()


@pytest.mark.parametrize(
    "node",
    ["slip_estimator", *(pytest.param(n, marks=pytest.mark.slow) for n in NODES if n != "slip_estimator")],
)
@pytest.mark.parametrize("moment", ["_rclpy_pybind11", "typesupport"])
def test_ctrl_c_while_a_node_starts(programs, node, moment):
    program = programs.node(node, autostart=True)
    program.until(lambda: program.has_loaded(moment), f"{node} to load {moment}")
    code, _ = program.end()
    assert (code, program.stderr) == (0, "")


def test_ctrl_c_while_the_emulator_compiles(programs):
    programs.environment["NUMBA_CACHE_DIR"] = str(programs.folder / "empty")
    program = programs.node("emulator", device_directory=str(programs.folder / "dev"))
    program.until(lambda: program.stderr.endswith("\n"), "its first line")
    code, _ = program.end()
    assert code == 0
    (line,) = program.stderr.splitlines()
    assert line.endswith("[emulator]: compiling, about a minute: once after an installation")
    assert len(list((programs.folder / "empty").rglob("*.nbc"))) < FEW


LOST = """
import os, signal, sys
from trackslip_common.nodes.run import run
def make_node():
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:  # as a compiler calls back
        pass
    raise RuntimeError("no compiled object yet for <Library 'slide'>")
sys.exit(run(make_node, []))
"""


def test_ctrl_c_lost_in_the_compiler_ends_the_node_quietly():
    done = subprocess.run([sys.executable, "-c", LOST], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_soil_estimator_without_hydraulics_names_the_missing_groups(programs, observer):
    healths = observer.healths()
    programs.node("soil_estimator", vehicle="warthog")
    message = "vehicle 'warthog' has no mass and no hydraulics: no forces and no soil are estimated"
    observer.wait(lambda: any(status.message == message for status in healths), "what it lacks")
