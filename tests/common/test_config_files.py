# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The files of ``config/``: found, read, rejected when they are no parameter files; all of them are valid."""

import os
from pathlib import Path
from typing import Any

import pytest

from trackslip_bags.recording import RecordParameters
from trackslip_common.config_files import (
    config_directory,
    config_file,
    load_parameters,
    node_defaults,
    node_parameters,
    read_yaml,
)
from trackslip_common.errors import InputError
from trackslip_common.nodes.parameters import names_in_shared_sections, unapplied_sections
from trackslip_common.parameters import Parameters, flatten, to_flat
from trackslip_drivers import can_parameters
from trackslip_drivers.sick_parameters import SickParameters
from trackslip_drivers.watson_parameters import WatsonParameters
from trackslip_estimation.box import parameters as box_parameters
from trackslip_estimation.slip import parameters as slip_parameters
from trackslip_sim import parameters as emulator_parameters
from trackslip_tools.live import parameters as live_parameters

ROOT = Path(__file__).parents[2]
NODES: dict[str, tuple[type[Parameters], tuple[str, ...]]] = {
    "slip_estimator": (slip_parameters.SlipEstimatorParameters, slip_parameters.DEFAULT_FILES),
    "box_localizer": (box_parameters.BoxNodeParameters, box_parameters.DEFAULT_FILES),
    "record": (RecordParameters, ("record.yaml",)),
    "can_driver": (can_parameters.CanDriverParameters, can_parameters.DEFAULT_FILES),
    "watson_imu": (WatsonParameters, ("watson_imu.yaml",)),
    "sick_pls": (SickParameters, ("sick_pls.yaml",)),
    "live": (live_parameters.LiveParameters, live_parameters.DEFAULT_FILES),
    "emulator": (emulator_parameters.EmulatorParameters, emulator_parameters.DEFAULT_FILES),
}


@pytest.mark.parametrize("node", NODES)
def test_each_node_has_a_default_for_each_parameter(node: str) -> None:
    kind, files = NODES[node]
    values = kind.overlay({}, node_defaults(node, *files))
    flat = to_flat(load_parameters(kind, node, files))
    assert values == {name: flat[name] for name in values}
    assert all(node_parameters(read_yaml(config_file(name)), node, name) for name in files)


def test_config_is_found_beside_the_code_whatever_is_sourced(monkeypatch: pytest.MonkeyPatch) -> None:
    for prefixes in ("", "/nowhere"):
        monkeypatch.setenv("AMENT_PREFIX_PATH", prefixes)
        assert config_directory().resolve() == ROOT / "config"


def test_a_file_of_the_user_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "soils.yaml"
    file.write_text("{}", encoding="utf-8")
    assert config_file(str(file)) == file
    monkeypatch.chdir(tmp_path)
    assert config_file("soils.yaml").resolve() == file
    assert config_file("record.yaml") == config_directory() / "record.yaml"


@pytest.mark.parametrize("name", ["no_such.yaml", "", "mappings"])
def test_missing_file_is_named_with_the_searched_directories(name: str) -> None:
    with pytest.raises(InputError, match=f"^file '{name}' not found, here or in {config_directory()}$"):
        config_file(name)


def test_missing_file_and_named_pipe_are_refused_without_blocking(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    for name, reason in (("no.yaml", r"no\.yaml: cannot be read"), ("pipe.yaml", "no regular file")):
        with pytest.raises(InputError, match=reason):
            read_yaml(tmp_path / name)


def test_section_of_a_node_overrides_the_common_section() -> None:
    tree = {
        "node": {"ros__parameters": {"a": {"b": 1}}},
        "/**": {"ros__parameters": {"a": {"b": 2, "c": 3}}},
        "other": {"ros__parameters": {"d": 4}},
    }
    assert node_parameters(tree, "node", "file") == {"a.b": 1, "a.c": 3}
    assert node_parameters(tree, "third", "file") == {"a.b": 2, "a.c": 3}


@pytest.mark.parametrize("section", [None, 3, {"a": 1}, {"ros__parameters": [1]}])
def test_a_section_of_another_form_is_refused(section: Any) -> None:
    with pytest.raises(InputError, match=r"^file: section 'node' has no 'ros__parameters' mapping$"):
        node_parameters({"node": section}, "node", "file")


@pytest.mark.parametrize("section", ["/node", "/*/node", "/**/node", "/*"])
def test_section_that_ros_applies_to_a_node_is_read(section: str) -> None:
    tree = {"/**": {"ros__parameters": {"a": 1}}, section: {"ros__parameters": {"a": 2}}}
    assert node_parameters(tree, "node", "file") == {"a": 2}


@pytest.mark.parametrize(
    "tree",
    [{"/digger/node": {"ros__parameters": {"a": 2}}}, {"digger": {"node": {"ros__parameters": {"a": 2}}}}],
)
def test_section_of_a_node_in_a_namespace_is_refused_beside_a_common_one(tree: dict[str, Any]) -> None:
    shared = {"/**": {"ros__parameters": {"a": 1}}}
    with pytest.raises(InputError, match=r"^file: section '/?digger.*; accepted: node, or /\*\*$"):
        node_parameters(shared | tree, "node", "file")


def test_other_sections_and_parameters_of_ros_itself_are_passed_over() -> None:
    own = {"use_sim_time": True, "start_type_description_service": True, "qos_overrides": {"/b": {"c": 1}}}
    tree = {"node": {"ros__parameters": {"a": 1, **own}}, 5: {"b": 1}, None: {"b": 1}, "5": {"b": 1}}
    assert node_parameters(tree, "node", "file") == {"a": 1}


def test_names_of_sections_for_many_nodes_are_found_beside_sections_of_any_name(tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("5: {ros__parameters: {a: 1}}\n/**: {ros__parameters: {b: {c: 1}}}\n", encoding="utf-8")
    assert names_in_shared_sections(["--params-file", str(file)]) == {"b.c"}


def test_the_parameters_of_a_mapping_are_those_of_the_estimator() -> None:
    tree = read_yaml(config_file("mappings/warthog.yaml"))["parameters"]
    p = slip_parameters.load_slip_parameters(flatten(tree))
    assert to_flat(p).items() >= flatten(tree).items()


def test_later_layers_override_earlier_ones_and_defaults() -> None:
    p = slip_parameters.load_slip_parameters(
        {"jump_confirmations": 7, "start": "initial_pose"}, {"jump_confirmations": 8}
    )
    assert (p.jump_confirmations, p.start) == (8, "initial_pose")
    assert p.vehicle.kinematics.tread == 0.73


@pytest.mark.parametrize(
    ("text", "node", "section"),
    [
        ("can_drivr: {ros__parameters: {a: 1}}", "/can_driver", "/can_drivr"),
        ("can_driver: {ros__parameters: {a: 1}}", "/one/can_driver", "/can_driver"),
        (
            "{/**: {ros__parameters: {a: 1}}, can_drivr: {ros__parameters: {}}}",
            "/can_driver",
            "/can_drivr",
        ),
        ("two: {can_driver: {ros__parameters: {a: 1}}}", "/one/can_driver", "/two/can_driver"),
        ("can_driver: {ros__parameters: {a: 1}}", "/can_driver", ""),
        ("/**/can_driver: {ros__parameters: {a: 1}}", "/can_driver", ""),
        ("/**/can_driver: {ros__parameters: {a: 1}}", "/one/can_driver", ""),
        ("one: {can_driver: {ros__parameters: {a: 1}}}", "/one/can_driver", ""),
        ("/**: {ros__parameters: {a: 1}}", "/can_driver", ""),
        ("slip_estimator: {ros__parameters: {a: 1}}", "/soil_estimator", ""),
        ("robot_driver: {ros__parameters: {a: 1}}", "/can_driver", ""),
    ],
)
def test_section_that_ros_does_not_apply_to_the_node_it_is_meant_for_is_named(
    tmp_path: Path, text: str, node: str, section: str
) -> None:
    """The node would start with its defaults, without a word."""
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    notes = unapplied_sections(["--ros-args", "--params-file", str(file)], node)
    expected = f"{file}: section {section} is ignored: this node is {node}; name it so, if it is meant"
    assert notes == ([expected] if section else [])
