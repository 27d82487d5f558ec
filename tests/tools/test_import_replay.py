# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Logs of another robot, of both ROS versions, through import, replay and report with a mapping alone."""

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from fixtures.commands import json_of
from fixtures.made_bags import write_messages
from fixtures.robot_logs import EPOCH_NS, Gnss, drive, write_gnss_csv, write_ros1, write_ros2

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import open_bag
from trackslip_common.config_files import config_file
from trackslip_common.errors import ExitCode
from trackslip_common.make import stamp_ns_of
from trackslip_common.tally import Tally
from trackslip_common.topics import TOPICS
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_tools.cli.main import main
from trackslip_tools.replay.no_estimate import ProcessingCounts, explain_missing_estimate

TRUTH = drive(40.0)
PAGE = Path(__file__).parents[2] / "docs" / "import.md"


def mapping(**changed: Any) -> dict[str, Any]:
    """Mapping of the four-wheel robot, with changed topics."""
    content: dict[str, Any] = yaml.safe_load(
        config_file("mappings/four_wheels.yaml").read_text(encoding="utf-8")
    )
    content["topics"] |= changed
    return content


def imported(folder: Path, log: Path, content: dict[str, Any]) -> Path:
    """The bag that ``trackslip import`` writes."""
    (folder / "map.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    arguments = ["--mapping", str(folder / "map.yaml"), "--output", str(folder / "bag")]
    assert main(["import", str(log), *arguments]) == ExitCode.DONE
    return folder / "bag"


def replayed(bag: Path, *options: str, code: int = ExitCode.DONE) -> dict[str, Any]:
    result: dict[str, Any] = json_of(bag.parent, "replay", bag, *options, code=code)
    return result


@pytest.fixture
def ros1_log(tmp_path: Path) -> Path:
    return write_ros1(tmp_path / "robot.bag", TRUTH)


@pytest.fixture(scope="module")
def ros2_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_ros2(tmp_path_factory.mktemp("ros2") / "robot", TRUTH)


@pytest.fixture(scope="module")
def bag(ros2_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return imported(tmp_path_factory.mktemp("bag"), ros2_log, mapping())


@pytest.fixture(scope="module")
def summary(bag: Path) -> dict[str, Any]:
    return replayed(bag)


def test_four_wheel_robot_is_imported_and_replayed(summary: dict[str, Any]) -> None:
    """Fixes of 3 cm at 5 Hz, 0.12 s late; encoders alone are metres off, as it turns at 0.8 of their rate."""
    assert summary["rmse"]["dead_reckoning"] > 1.0
    assert summary["rmse"]["filter"] < 0.03
    assert summary["rmse"]["heading"] < 0.01
    assert summary["nees_position"] < 8.0


def test_figures_on_the_page_on_imports_are_those_of_a_replay(summary: dict[str, Any]) -> None:
    """The tolerance is half a millimetre: the last digit depends on the processor."""
    page = PAGE.read_text(encoding="utf-8")
    figures = {
        name: re.search(rf"^      {re.escape(name)} +(\d\.\d+)", page, re.MULTILINE)
        for name in ("encoders alone", "encoders + gyro", "filter")
    }
    for name, key in zip(figures, ("dead_reckoning", "encoder_gyro", "filter"), strict=True):
        assert float(figures[name][1]) == pytest.approx(summary["rmse"][key], abs=5e-4), name


@pytest.mark.slow
def test_a_log_of_ros_1_gives_the_same(ros1_log: Path, summary: dict[str, Any], tmp_path: Path) -> None:
    of_ros_1 = replayed(imported(tmp_path, ros1_log, mapping()))
    for key in ("messages", "rejected", "final", "rmse", "nees", "nees_position"):
        assert of_ros_1[key] == summary[key], key


def test_machine_with_gnss_is_imported_and_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three files, RTK of 2 cm at 5 Hz on the boom's side, and a heading with a gap of two seconds."""
    truth = drive(40.0, tread=2.38)
    logs = write_gnss_csv(tmp_path / "logs", truth, (-1.2, 0.6))
    bag, out = tmp_path / "bag", tmp_path / "estimates"
    arguments = ["--mapping", "mappings/gnss_machine.yaml", "--output", str(bag)]
    capsys.readouterr()
    assert main(["import", str(logs), *arguments]) == ExitCode.DONE
    datum = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("datum: "))
    assert f"    {datum}\n" in PAGE.read_text(encoding="utf-8")
    replayed(bag, "--output", str(out))
    c, s = np.cos(truth.pose[0, 2]), np.sin(truth.pose[0, 2])
    antenna = truth.pose[0, :2] + np.array((-1.2, 0.6)) @ np.array(((c, s), (-s, c)))  # near the first fix
    errors = []
    with open_bag(out) as estimates:
        for m in estimates.messages(["odometry"]):
            odometry = estimates.deserialize(m.raw, m.type_name)
            k = round((stamp_ns_of(odometry) - EPOCH_NS) / 20e6)
            place = odometry.pose.pose.position
            errors.append(np.hypot(*(truth.pose[k, :2] - antenna - (place.x, place.y))))
    assert len(errors) > 1900
    assert np.sqrt(np.mean(np.square(errors))) < 0.06  # includes the noise of the fix that sets the datum


@pytest.mark.parametrize("topic", [pytest.param("/gps/heading", marks=pytest.mark.slow), "/gps/quaternion"])
@pytest.mark.parametrize("write", [pytest.param(write_ros1, marks=pytest.mark.slow), write_ros2])
def test_heading_of_two_antennas_is_imported_from_a_bag(write: Any, topic: str, tmp_path: Path) -> None:
    """RTK on another robot, with the mapping of the documentation page."""
    antenna = Gnss((-0.2, 0.1), np.pi / 2.0)
    log = write(tmp_path / "robot.bag", TRUTH, antenna)
    of_page = yaml.safe_load(PAGE.read_text(encoding="utf-8").split("```yaml")[1].split("```")[0])
    content = mapping(**(of_page["topics"] | {"heading": {"from": topic}}))
    del content["topics"]["mocap_pose"]
    content["datum"] = of_page["datum"]
    content["parameters"] |= of_page["parameters"]
    summary = replayed(imported(tmp_path, log, content))
    assert "heading" not in summary["rejected"]
    assert summary["rmse"]["heading"] < 0.006
    assert summary["rmse"]["filter"] < 0.02


def test_the_order_of_arrival_is_that_of_the_robot(
    ros2_log: Path, summary: dict[str, Any], tmp_path: Path
) -> None:
    """The same poses without their delay give a better estimate at the time of publication."""
    early = {"role": "pose", "from": "/truth", "stddev": {"x": 0.001, "y": 0.001, "yaw": 0.001}}
    prompt = replayed(imported(tmp_path, ros2_log, mapping(mocap_pose=early)))
    assert prompt["rmse"]["filter"] < summary["rmse"]["filter"]


@pytest.mark.slow
def test_a_reference_of_positions_gives_no_nonsense(
    ros2_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    positions = {"from": "/truth", "stddev": {"x": 0.001, "y": 0.001}, "position_only": True}
    imported_bag = imported(tmp_path, ros2_log, mapping(reference_pose=positions))
    summary = replayed(imported_bag)
    rmse = summary["rmse"]
    assert rmse["filter"] < 0.03
    assert (rmse["heading"], summary["nees"], rmse["dead_reckoning"]) == (None, None, None)
    assert summary["nees_position"] < 8.0
    shown = capsys.readouterr().out
    assert "mean NEES of position" in shown
    assert "nan" not in shown
    page = tmp_path / "report.html"
    assert main(["report", str(imported_bag), "--output", str(page)]) == ExitCode.DONE
    assert "NEES of the position" in page.read_text(encoding="utf-8")


NO_ESTIMATE = {
    "no fix came: nothing on box_pose; the bag has mocap_pose, reference_pose "
    "(--set slip_estimator.pose_sources=[mocap_pose])": ["--set", "slip_estimator.pose_sources=[box_pose]"],
    "no fix came: pose_sources names none": ["--set", "slip_estimator.pose_sources=['']"],
    "no fix came: mocap_pose is withheld": ["--withhold", "mocap_pose"],
}


@pytest.mark.parametrize("reason", NO_ESTIMATE)
def test_no_estimate_states_why(bag: Path, reason: str, printed: Callable[[], str]) -> None:
    assert replayed(bag, *NO_ESTIMATE[reason], code=ExitCode.FAILED)["final"] is None
    assert f"no estimate: {reason}" in printed()


REFUSED = {
    "every sample of the sprockets was rejected (sprockets: 9 invalid)": ({"sprockets": 9}, {"sprockets": 9}),
    "every fix was rejected (mocap_pose: 5 invalid)": ({"sprockets": 9, "mocap_pose": 5}, {"mocap_pose": 5}),
    "no sprockets after the first fix": ({"sprockets": 9, "mocap_pose": 5}, {"mocap_pose": 4}),
    "no sprockets between --start and --stop": ({"mocap_pose": 5}, {}),
}


@pytest.mark.parametrize("reason", REFUSED)
def test_refused_measurements_are_counted_in_the_reason(bag: Path, reason: str) -> None:
    input_counts, invalid = REFUSED[reason]
    rejected = Tally()
    for source, count in invalid.items():
        rejected.add(source, Outcome.INVALID, count)
    rejected.add("imu/data_raw", Outcome.WAITING, 9)
    p = load_slip_parameters({"pose_sources": ["mocap_pose"]})
    processed = ProcessingCounts(Counter(input_counts), rejected)
    with open_bag(bag) as opened:
        assert explain_missing_estimate(opened, p, InputFilters(), processed) == reason


def test_fixes_of_other_types_are_named_where_no_fix_came(tmp_path: Path) -> None:
    written = ("vo", "odometry", "truth/odometry", "fix")
    types = {name: TOPICS.get(name, TOPICS["odometry"]).type_name for name in written}
    messages = ((f"/{name}", kind, 1, serialize(make(kind))) for name, kind in types.items())
    processed = ProcessingCounts(Counter({"sprockets": 9}), Tally())
    with open_bag(write_messages(tmp_path / "bag", messages)) as bag:
        reason = explain_missing_estimate(bag, load_slip_parameters({}), InputFilters(), processed)
    assert "trackslip import makes fixes of fix, vo" in reason


def test_heading_never_found_fails(
    ros2_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The robot is at standstill for the first second, and one antenna has no heading."""
    antenna = {"role": "pose", "from": "/mocap", "stddev": {"x": 0.03, "y": 0.03}, "position_only": True}
    imported_bag = imported(tmp_path, ros2_log, mapping(mocap_pose=antenna))
    replayed(imported_bag, "--stop", "1.0", code=ExitCode.FAILED)
    assert "no estimate of the heading: heading unknown: it is found" in capsys.readouterr().out
    assert replayed(imported_bag)["rmse"]["heading"] < 0.3
