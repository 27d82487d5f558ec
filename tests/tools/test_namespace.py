# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A bag of several machines: each is replayed alone, by its namespace."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fixtures.commands import json_of
from fixtures.made_bags import TEXT, text, write_messages

from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import open_bag
from trackslip_common.errors import ExitCode
from trackslip_common.vehicle_files import load_vehicle, vehicle_text
from trackslip_tools.cli.main import main

KIND = "sensor_msgs/msg/JointState"
JOINTS = serialize(make(KIND))


@pytest.fixture(scope="module")
def two_machines(emulated_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same drive in the namespaces one and two; the laser of two has failed."""
    with open_bag(emulated_bag) as bag:
        both = [
            m._replace(topic=namespace + m.topic)
            for m in bag.messages()
            for namespace in ("/site/one", "/two")
            if (namespace, m.topic) != ("/two", "/box_pose")
        ]
    return write_messages(tmp_path_factory.mktemp("two") / "bag", both)


def replayed(folder: Path, *arguments: str | Path) -> dict[str, Any]:
    found: dict[str, Any] = json_of(folder, "replay", *arguments)
    return {name: value for name, value in found.items() if name != "real_time_factor"}


def test_shared_topics_of_a_machine_are_one_with_those_of_its_namespace(tmp_path: Path) -> None:
    topics = ("/two/diagnostics", "/diagnostics", "/diagnostics_crane/joints", "/one/diagnostics")
    bag = write_messages(tmp_path / "bag", ((topic, KIND, k, JOINTS) for k, topic in enumerate(topics)))
    with open_bag(bag, "two") as part:
        assert {topic: info.count for topic, info in part.topics.items()} == {"/diagnostics": 2}
        assert [m.log_time_ns for m in part.messages(["/diagnostics"])] == [0, 1]


@pytest.mark.slow
def test_each_machine_replays_alone(emulated_bag: Path, two_machines: Path, tmp_path: Path) -> None:
    alone = replayed(tmp_path, emulated_bag)
    of_one = replayed(tmp_path, two_machines, "--namespace", "/site/one")
    # Errors are summed in batches, which are cut at different places.
    for name in ("rmse", "nees", "nees_position"):
        assert of_one.pop(name) == pytest.approx(alone.pop(name), rel=1e-12)
    assert of_one == alone
    start = "slip_estimator.start=initial_pose"
    other = replayed(tmp_path, two_machines, "--namespace", "two", "--set", start)
    assert "box_pose" not in other["messages"]
    assert other["vehicle"] == alone["vehicle"]


def test_the_vehicles_of_namespaces_are_not_assumed(
    two_machines: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicle = text(vehicle_text(load_vehicle("excavator_20t")))
    with open_bag(two_machines) as bag:
        messages = [
            ("/two/vehicle", TEXT, bag.start_ns, vehicle),
            ("/tower/sprockets", KIND, bag.start_ns, JOINTS),
            *(m for m in bag.messages() if m.topic not in ("/two/vehicle", "/two/slip_estimator/parameters")),
        ]
    path = write_messages(tmp_path / "bag", messages)
    assert main(["info", str(path)]) == ExitCode.DONE
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("vehicle")]
    assert lines == [
        "vehicle   pc05 (--namespace site/one)",
        "vehicle   not named: pc05 is assumed (--namespace tower)",
        "vehicle   excavator_20t (--namespace two)",
    ]
    assert main(["info", str(path), "--namespace", "two"]) == ExitCode.DONE
    assert "vehicle   excavator_20t\n" in capsys.readouterr().out


def test_a_replay_without_the_namespace_names_those_there_are(
    two_machines: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(two_machines)]) == ExitCode.BAD_INPUT
    assert "(--vehicle does); it has machines in --namespace site/one, two\n" in capsys.readouterr().out


def test_vehicle_topic_of_another_type_names_no_vehicle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_messages(tmp_path / "bag", [("/vehicle", KIND, 0, JOINTS)])
    assert main(["info", str(bag)]) == ExitCode.DONE
    assert "not named: pc05 is assumed" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["replay", "info"])
def test_a_namespace_that_is_not_there_is_refused(
    two_machines: Path, command: str, refuse: Callable[..., str]
) -> None:
    expected = "--namespace three: nothing is in it; accepted: site/one, two\n"
    assert refuse(command, two_machines, "--namespace", "three") == expected
