# SPDX-License-Identifier: Apache-2.0
"""A user's mistake with a node is reported in one line; what ends a node ends it quietly."""

import re
import signal

import pytest

from trackslip_common.vehicle import load_vehicle, vehicle_of_text

NODES = (
    *("can_driver", "watson_imu", "sick_pls", "box_localizer"),
    *("slip_estimator", "soil_estimator", "record", "emulator"),
)
REFUSED = {
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
QUICK = {"emulator": {"scenario": "straight", "lead_in": 0.5}}  # what else a node needs to come up soon
BAR = 3.0  # s from Ctrl-C to the end
SLACK = 2.0  # on a busy machine


def is_refused(program, *words):
    """Exit code 2 and one line with all these words, nothing else."""
    assert program.wait() == 2
    lines = program.stderr.splitlines()
    assert len(lines) == 1, program.stderr
    assert [word for word in words if word not in lines[0]] == [], lines[0]
    assert program.stdout == ""


@pytest.mark.parametrize("node", NODES)
def test_unknown_parameter(programs, node):
    is_refused(programs.node(node, nonsense=1), node, "'nonsense'", "accepted: ")


@pytest.mark.parametrize(
    ("node", "name"), [(node, name) for node, parameters in REFUSED.items() for name in parameters]
)
def test_refused_value(programs, node, name):
    value = REFUSED[node][name]
    shown = value if isinstance(value, str) else f"{value:g}"
    is_refused(programs.node(node, **{name: value}), name.rpartition("__")[2], shown)


@pytest.mark.parametrize("node", NODES)
def test_parameter_file_that_is_not_there(programs, node):
    is_refused(programs.node(node, "--params-file", "missing.yaml"), "missing.yaml", "accepted: ")


def test_parameter_file_that_is_not_yaml(programs):
    (programs.folder / "bad.yaml").write_text("sick_pls: [", encoding="utf-8")
    is_refused(programs.node("sick_pls", "--params-file", "bad.yaml"), "bad.yaml", "accepted: ")


def test_unknown_parameter_in_a_file(programs):
    (programs.folder / "one.yaml").write_text(
        "watson_imu: {ros__parameters: {nonsense: 1}}", encoding="utf-8"
    )
    is_refused(programs.node("watson_imu", "--params-file", "one.yaml"), "'nonsense'", "serial_port")


def test_parameter_files_of_the_project_are_accepted(programs, observer):
    """A node takes the file that ``config/`` has for it, and the PC05 where it has a vehicle."""
    config = programs.folder / "mine.yaml"
    config.write_text("/**: {ros__parameters: {vehicle: {kinematics: {tread: 0.8}}}}", encoding="utf-8")
    texts = observer.subscribe("slip_estimator/parameters")
    programs.node("slip_estimator", "--params-file", "mine.yaml")
    observer.wait(lambda: texts, "the parameters in use")
    assert "vehicle.kinematics.tread: 0.8" in texts[0].data


def test_recorder_does_not_touch_what_exists(programs):
    (programs.folder / "bag").mkdir()
    is_refused(programs.node("record", output="bag"), "'bag'", "exists already", "accepted: ")
    assert list((programs.folder / "bag").iterdir()) == []


def test_recorder_that_cannot_write(programs):
    (programs.folder / "file").write_text("", encoding="utf-8")
    is_refused(programs.node("record", output="file/bag"), "'file/bag'")


@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_running_node_ends_quietly(programs, observer, node, number):
    given = QUICK.get(node, {})
    if node == "emulator":
        given = {**given, "device_directory": str(programs.folder / "dev")}
    healths = observer.healths()
    program = programs.node(node, **given)
    observer.wait(lambda: [status for status in healths if status.name == node], f"diagnostics of {node}")
    code, seconds = program.end(number)
    logged = re.compile(rf"\[(INFO|WARN|ERROR)\] \[[\d.]+\] \[{node}\]: ")  # its states, as they change
    assert [line for line in program.stderr.splitlines() if not logged.match(line)] == []
    assert code == 0
    assert seconds < BAR * SLACK
    assert programs.alive() == {}
    assert not (programs.folder / "dev" / "watson").is_symlink()


@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("moment", ["_rclpy_pybind11", "typesupport"])
def test_ctrl_c_while_a_node_starts(programs, node, moment):
    program = programs.node(node, autostart=True)
    program.until(lambda: program.has_loaded(moment), f"{node} to load {moment}")
    code, seconds = program.end()
    assert (code, program.stderr) == (0, "")
    assert seconds < BAR * SLACK


def test_ctrl_c_while_the_emulator_compiles(programs, observer):
    programs.environment["NUMBA_CACHE_DIR"] = str(programs.folder / "empty")
    program = programs.node("emulator", device_directory=str(programs.folder / "dev"))
    program.until(lambda: program.stderr.endswith("\n"), "its first line")
    code, seconds = program.end()
    assert code == 0
    (line,) = program.stderr.splitlines()
    assert line.endswith("[emulator]: compiling, about a minute: once after an installation")
    assert seconds < BAR * SLACK


def test_defaults_are_those_of_what_a_node_is_not_of_its_name(programs, observer):
    texts = observer.subscribe("slip_estimator/parameters")
    programs.node("slip_estimator", "-r", "__node:=second")
    observer.wait(lambda: texts, "its parameters")
    assert texts[0].data.startswith("slip_estimator:")


def test_what_a_section_for_many_nodes_holds_for_others_is_no_error(programs, observer, tmp_path):
    config = tmp_path / "all.yaml"
    values = f"vehicle: excavator_20t, serial_port: /dev/x, output: {tmp_path / 'bag'}"
    config.write_text(f"/**: {{ros__parameters: {{{values}}}}}", encoding="utf-8")
    vehicle = observer.subscribe("vehicle")
    for node in ("slip_estimator", "record"):
        programs.node(node, "--params-file", str(config))
    for node in ("slip_estimator", "record"):
        observer.wait(lambda node=node: observer.state(node) == "active", f"{node} to be active")
    observer.wait(lambda: vehicle, "the vehicle")
    assert vehicle_of_text(vehicle[0].data, "vehicle") == load_vehicle("excavator_20t")


def test_a_soil_estimator_without_hydraulics_says_what_it_lacks(programs, observer):
    healths = observer.healths()
    programs.node("soil_estimator", vehicle="warthog")
    lacking = "vehicle 'warthog' has no mass and no hydraulics: no forces and no soil are estimated"
    observer.wait(lambda: any(status.message == lacking for status in healths), "what it lacks")
