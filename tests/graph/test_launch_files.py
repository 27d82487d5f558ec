# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Launch files start the expected nodes and arguments, and the real nodes accept these."""

import re
from pathlib import Path
from typing import Any

import pytest
from fixtures.launch_stub import LaunchContext, ProcessExited, declarations, launched

from trackslip_common.errors import ExitCode, InputError

ROOT = Path(__file__).resolve().parents[2]
DRIVERS, NAVIGATION, DEMO = (
    ROOT / "src" / package / "launch" / f"{name}.launch.py"
    for package, name in (
        ("trackslip_drivers", "drivers"),
        ("trackslip_estimation", "navigation"),
        ("trackslip_sim", "demo"),
    )
)
FILES = (DRIVERS, NAVIGATION, DEMO)
RANGE, PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"


def names(file: Path, **arguments: str) -> set[str]:
    return {node.executable for node in launched(file, **arguments)[0]}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_arguments_are_described_as_on_the_page(file: Path) -> None:
    arguments = declarations(file)
    assert all(arguments.values())
    common = {"vehicle", "params_file", "namespace", "use_sim_time", "log_level", "respawn", "peers"}
    assert common | {"laser", "imu", "gnss"} <= arguments.keys()


ANOTHER = {  # values other than the default, of arguments that are not booleans
    "namespace": "digger1",
    "log_level": "debug",
    "vehicle": "excavator_20t",
    "peers": "10.0.0.7",
    "state_file": "none",
    "duration": "7",
    "soil": "clayey_soil",
    "scenario": "slalom",
    "devices": "/tmp/elsewhere",
    "can_port": "43114",
}


def effect(file: Path, **arguments: str) -> tuple[list[tuple[str, list[Any], list[str], bool]], str]:
    nodes, environment = launched(file, **arguments)
    shown = [(n.executable, [*map(str, n.parameters)], [*n.arguments], n.respawn) for n in nodes]
    return shown, environment[PEERS]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_every_argument_offered_has_an_effect(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(PEERS, raising=False)
    mine = tmp_path / "mine.yaml"
    mine.write_text("/**: {ros__parameters: {}}\n", encoding="utf-8")
    values = {**ANOTHER, "params_file": str(mine)}
    default = effect(file)
    for name in declarations(file):
        choices = [values[name]] if name in values else ["true", "false"]
        assert [
            value for value in choices if without_day(effect(file, **{name: value})) != without_day(default)
        ], name


def without_day(shown: Any) -> str:
    """The text without the time in the name of the demo's bag."""
    return re.sub(r"trackslip_\d{8}_\d{6}", "", str(shown))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_parameter_file_that_does_not_exist_is_refused(file: Path) -> None:
    with pytest.raises(InputError, match=r"params_file: '/nowhere/mine\.yaml' is not a file; accepted: "):
        launched(file, params_file="/nowhere/mine.yaml")


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_word_that_is_neither_on_nor_off_is_refused_by_every_switch(file: Path) -> None:
    switches = [name for name in declarations(file) if name not in (*ANOTHER, "params_file")]
    assert {"use_sim_time", "respawn", "laser", "imu", "gnss"} <= {*switches}
    for name in switches:
        for word in ("ture", "", "2"):
            with pytest.raises(InputError, match=rf"^{name}: '{word}' is refused; accepted: true, "):
                launched(file, **{name: word})


@pytest.mark.parametrize("word", ["true", "yes", "on", "1", "True", "YES"])
def test_every_word_for_on_switches_every_node_on(word: str) -> None:
    assert "record" in names(NAVIGATION, record=word)
    assert "live" in names(NAVIGATION, live=word)
    assert "gnss_localizer" in names(NAVIGATION, gnss=word)
    assert "nmea_gnss" in names(DEMO, gnss=word)
    assert all(node.respawn for node in launched(DRIVERS, respawn=word)[0])


@pytest.mark.parametrize("word", ["false", "no", "off", "0", "False"])
def test_every_word_for_off_switches_every_node_off(word: str) -> None:
    assert "record" not in names(NAVIGATION, record=word)
    assert "sick_pls" not in names(DRIVERS, laser=word)
    assert "sick_pls" not in names(DEMO, laser=word)


@pytest.mark.parametrize(("name", "text"), [("duration", "soon"), ("can_port", "4e3")])
def test_invalid_number_of_the_demo_is_refused(name: str, text: str) -> None:
    with pytest.raises(InputError, match=rf"^{name}: '{text}' is refused; accepted: "):
        launched(DEMO, **{name: text})


def parameters(node: Any) -> dict[str, Any]:
    return {name: value for part in node.parameters if isinstance(part, dict) for name, value in part.items()}


SENSORS = [{}, {"gnss": "true"}, {"gnss": "true", "laser": "false"}, {"hydraulics": "false"}]


@pytest.mark.parametrize("switches", SENSORS)
def test_demo_waits_for_all_estimators_that_it_starts_and_for_no_other_node(switches: dict[str, str]) -> None:
    nodes = {node.executable: node for node in launched(DEMO, **switches)[0]}
    estimators = {name for name, node in nodes.items() if node.package == "trackslip_estimation"}
    assert {*parameters(nodes["emulator"])["start_after"]} == estimators
    assert "slip_estimator" in estimators


@pytest.mark.parametrize("switches", SENSORS)
def test_demo_starts_the_sensor_behind_each_source_of_its_estimates(switches: dict[str, str]) -> None:
    nodes = {node.executable: node for node in launched(DEMO, **switches)[0]}
    behind = {
        "box_pose": ("box_localizer", "sick_pls"),
        "gnss_pose": ("gnss_localizer", "nmea_gnss"),
        "imu/data_raw": ("watson_imu",),
    }
    p = parameters(nodes["slip_estimator"])
    sources = [*p.get("pose_sources", ["box_pose"]), *p.get("yaw_rate_sources", ["imu/data_raw"])]
    assert [source for source in sources if not {*behind[source]} <= nodes.keys()] == []
    has_receiver = parameters(nodes["emulator"])["gnss.device.rate"] > 0.0
    assert has_receiver == ("gnss_pose" in sources)


def test_respawn_waits_and_is_called_off_where_a_node_refused_its_input() -> None:
    for node in launched(NAVIGATION, respawn="true")[0]:
        assert node.respawn_delay is not None
        assert node.respawn_delay >= 1.0
        assert node.on_exit is not None
        for code in (ExitCode.DONE, ExitCode.FAILED, -9):
            assert node.on_exit(ProcessExited(node, code), LaunchContext()) is None
        event = node.on_exit(ProcessExited(node, ExitCode.BAD_INPUT), LaunchContext())
        assert event is not None
        assert [other for other in (node, object()) if event.event.process_matcher(other)] == [node]
    assert {node.on_exit for node in launched(NAVIGATION)[0]} == {None}


def test_namespace_comes_before_the_frames_of_all_nodes_that_state_the_machines_frame() -> None:
    prefixes = {
        node.executable: parameters(node).get("frame_prefix")
        for node in launched(DEMO, namespace="/digger1/")[0]
    }
    own_frame = ("can_driver", "emulator", "slip_estimator", "soil_estimator")
    assert {name for name, prefix in prefixes.items() if prefix == "digger1/"} == {*own_frame}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_the_graph_is_closed_unless_its_environment_opens_it(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (RANGE, PEERS):
        monkeypatch.delenv(name, raising=False)
    _, environment = launched(file)
    assert (environment[RANGE], environment[PEERS]) == ("LOCALHOST", "")
    assert launched(file, peers="10.0.0.7;10.0.0.8")[1][PEERS] == "10.0.0.7;10.0.0.8"
    monkeypatch.setenv(RANGE, "SUBNET")
    assert launched(file)[1][RANGE] == "SUBNET"


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
@pytest.mark.parametrize("fast_dds", ["FASTRTPS", "FASTDDS"])
def test_our_fast_dds_profile_is_used_unless_another_is_set(
    file: Path, fast_dds: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    variable = f"{fast_dds}_DEFAULT_PROFILES_FILE"
    monkeypatch.delenv(variable, raising=False)
    assert "<udpv4/>" in Path(launched(file)[1][variable]).read_text(encoding="utf-8")
    monkeypatch.setenv(variable, "/etc/own.xml")
    assert launched(file)[1][variable] == "/etc/own.xml"


def test_switches_choose_the_nodes() -> None:
    laser = {"box_localizer", "slip_estimator", "soil_estimator", "record"}
    assert names(NAVIGATION) == laser
    assert names(NAVIGATION, gnss="true", laser="false") == laser - {"box_localizer"} | {"gnss_localizer"}
    assert names(NAVIGATION, hydraulics="0", record="false", live="true") == {
        *("box_localizer", "slip_estimator", "live")
    }
    assert names(DRIVERS) == {"can_driver", "watson_imu", "sick_pls"}
    assert names(DRIVERS, laser="false", imu="false", gnss="yes") == {"can_driver", "nmea_gnss"}
    assert "nmea_gnss" in names(DEMO, gnss="true", laser="false", vehicle="excavator_20t")


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_each_node_is_an_executable_of_its_package_in_its_namespace(file: Path) -> None:
    nodes, _ = launched(file, namespace="digger1", respawn="true")
    for node in nodes:
        setup = (ROOT / "src" / node.package / "setup.py").read_text(encoding="utf-8")
        assert f'"{node.executable} = ' in setup
        assert (node.namespace, node.respawn) == ("digger1", True)
        assert node.arguments[-1] == f"/digger1/{node.executable}"


@pytest.mark.parametrize(
    "switches",
    [
        {},
        pytest.param({"gnss": "true", "laser": "false", "vehicle": "excavator_20t"}, marks=pytest.mark.slow),
    ],
)
@pytest.mark.xdist_group("graph")
def test_nodes_start_with_the_parameters_of_the_launch_files(
    programs: Any, observer: Any, monkeypatch: pytest.MonkeyPatch, switches: dict[str, str]
) -> None:
    monkeypatch.setenv("ROS_HOME", str(programs.folder))
    arguments = {"namespace": "digger1", **switches}
    nodes = [*launched(NAVIGATION, live="true", **arguments)[0], *launched(DRIVERS, **arguments)[0]]
    started = [
        node for node in nodes if node.executable not in ("live", "watson_imu", "sick_pls", "nmea_gnss")
    ]
    for node in nodes:
        programs.tool(node.executable, *node.command())
    observer.wait_until_active(*(f"/digger1/{node.name}" for node in started))
    (estimator,) = [node for node in nodes if node.executable == "slip_estimator"]
    state = next(p for p in estimator.parameters if isinstance(p, dict))["state_file"]
    assert state == str(programs.folder / "trackslip" / "digger1" / "slip_estimator.yaml")
