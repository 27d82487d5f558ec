# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Launch files: which nodes they start with which arguments, and that real nodes take these."""

from pathlib import Path
from typing import Any

import pytest
from fixtures.launch_stub import declarations, launched

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
def test_arguments_are_described_as_the_readme_says(file: Path) -> None:
    found = declarations(file)
    assert all(found.values())
    common = {"vehicle", "params_file", "namespace", "use_sim_time", "log_level", "respawn", "peers"}
    assert common | {"laser", "imu", "hydraulics", "gnss", "live"} <= found.keys()


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_the_graph_is_closed_unless_its_environment_says_otherwise(
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
def test_fast_dds_gets_our_profile_unless_it_has_one(
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


@pytest.mark.parametrize("switches", [{}, {"gnss": "true", "laser": "false", "vehicle": "excavator_20t"}])
@pytest.mark.xdist_group("graph")
def test_real_nodes_take_what_the_launch_files_give_them(
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
    for node in started:
        observer.wait(
            lambda name=node.name: observer.state(f"/digger1/{name}") == "active", f"{node.name} to be active"
        )
    (estimator,) = [node for node in nodes if node.executable == "slip_estimator"]
    state = next(p for p in estimator.parameters if isinstance(p, dict))["state_file"]
    assert state == str(programs.folder / "trackslip" / "digger1" / "slip_estimator.yaml")
