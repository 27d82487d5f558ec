# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Logs of real machines with nominal geometry only: errors within their limits, for any assumed heading.

The limits hold for the mean of three noise draws of the fixes; 5 % allows for other processors and versions.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from fixtures.commands import json_of

from trackslip_bags.parameters import bag_vehicle
from trackslip_bags.reader import open_bag
from trackslip_bags.tables import read_tables
from trackslip_common.arrays import Rows
from trackslip_common.errors import ExitCode
from trackslip_common.message_fields import ImuFields, OdometryFields, PoseFields
from trackslip_common.vehicle_files import load_vehicle
from trackslip_tools.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
WINDOWS = {"marmotte": (), "warthog": ("--start", "128.8", "--stop", "362.9")}
FILES = {"marmotte": "marmotte_boreal.csv", "warthog": "warthog_grass_a.csv"}
THIN = ("--thin", "reference_pose:1:0.05", "--reference", "reference_pose")
SLACK = 1.05
Import = Callable[[str, bool], Path]


@pytest.fixture(scope="module")
def log(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Import:
    """A function that imports a robot's log; ``headings``: whether its reference has headings."""
    folder, made = tmp_path_factory.mktemp("real"), {}

    def import_(robot: str, headings: bool) -> Path:
        if not (shared_data / FILES[robot]).is_file():
            pytest.skip(f"no {FILES[robot]}")
        if (robot, headings) not in made:
            mapping = yaml.safe_load((ROOT / f"config/mappings/{robot}.yaml").read_text(encoding="utf-8"))
            if not headings:
                del mapping["topics"]["reference_pose"]["yaw"]
                del mapping["topics"]["reference_pose"]["stddev"]["yaw"]
            file, bag = folder / f"{robot}_{headings}.yaml", folder / f"{robot}_{headings}"
            file.write_text(yaml.safe_dump(mapping), encoding="utf-8")
            source = str(shared_data / FILES[robot])
            assert main(["import", source, "--mapping", str(file), "--output", str(bag)]) == ExitCode.DONE
            made[robot, headings] = bag
        return made[robot, headings]

    return import_


def replay(bag: Path, robot: str, folder: Path, *options: str) -> dict[str, Any]:
    result: dict[str, Any] = json_of(folder, "replay", bag, *WINDOWS[robot], *THIN, *options)
    return result


@pytest.mark.parametrize(
    ("robot", "hidden", "gyro_too", "bar"),
    [
        ("marmotte", "", False, 0.090),
        pytest.param("marmotte", "75.5:105.5", False, 0.13, marks=pytest.mark.slow),
        pytest.param("marmotte", "75.5:105.5", True, 0.75, marks=pytest.mark.slow),
        pytest.param("warthog", "", False, 0.043, marks=pytest.mark.slow),
        pytest.param("warthog", "303.8:333.8", False, 0.22, marks=pytest.mark.slow),
        pytest.param("warthog", "303.8:333.8", True, 0.29, marks=pytest.mark.slow),
        pytest.param("warthog", "313.8:343.8", False, 0.13, marks=pytest.mark.slow),
        pytest.param("warthog", "313.8:343.8", True, 0.20, marks=pytest.mark.slow),
    ],
)
def test_geometry_alone_is_enough(
    log: Import, tmp_path: Path, robot: str, hidden: str, gyro_too: bool, bar: float
) -> None:
    topics = ["reference_pose", *(["imu/data_raw"] if gyro_too else [])] if hidden else []
    options = [word for topic in topics for word in ("--withhold", f"{topic}:{hidden}")]
    results = [replay(log(robot, True), robot, tmp_path, *options, "--seed", str(seed)) for seed in range(3)]
    assert np.mean([one["rmse"]["filter"] for one in results]) <= SLACK * bar
    # below 2: the fixes are drawn from the reference, and its own covariance is added
    assert 0.3 < np.mean([one["nees_position"] for one in results]) < 3.0
    if not hidden:
        assert np.mean([one["nees"] for one in results]) < 4.5


@pytest.mark.slow
def test_bag_of_the_warthog_log_is_complete(log: Import) -> None:
    path = log("warthog", True)
    with open_bag(path) as bag:
        counts = {name: info.count for name, info in bag.topics.items()}
        assert bag.damage == ""
        assert counts["/sprockets"] + 4 == counts["/imu/data_raw"] == 7259  # four moved to before 0 s
        assert bag.duration_s == pytest.approx(362.9, abs=0.01)
        assert 4.0 < counts["/reference_pose"] / bag.duration_s < 5.5
        assert bag_vehicle(bag) == load_vehicle("warthog")
    assert np.mean(rows_of(path, "/imu/data_raw", ImuFields)["acceleration_z"]) == pytest.approx(
        9.81, abs=0.1
    )
    assert np.diff(rows_of(path, "/reference_pose", PoseFields)["stamp_ns"]).min() > 0


@pytest.mark.slow
def test_warthog_log_gives_the_documented_errors(log: Import, tmp_path: Path) -> None:
    result = replay(log("warthog", True), "warthog", tmp_path)
    assert result["rmse"]["dead_reckoning"] == pytest.approx(7.4, rel=0.05)
    assert result["rmse"]["encoder_gyro"] == pytest.approx(0.45, rel=0.05)
    assert result["messages"] == {"sprockets": 4679, "imu/data_raw": 4682, "reference_pose": 935}


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["marmotte", "warthog"])
def test_error_after_ten_metres_does_not_depend_on_the_assumed_heading(
    log: Import, tmp_path: Path, robot: str
) -> None:
    headed, bare = log(robot, True), log(robot, False)
    right = after_ten_metres(headed, bare, robot, tmp_path / "right")
    start = first_heading(headed, robot)
    for k, turned in enumerate((np.pi / 2.0, np.pi)):
        assumed = [f"slip_estimator.initial_yaw={start + turned}", "slip_estimator.initial_yaw_stddev=0.02"]
        options = [word for value in assumed for word in ("--set", value)]
        assert after_ten_metres(bare, bare, robot, tmp_path / str(k), *options) < SLACK * right
    assert after_ten_metres(bare, bare, robot, tmp_path / "unknown") < SLACK * right


def after_ten_metres(bag: Path, reference: Path, robot: str, output: Path, *options: str) -> float:
    """RMSE of the position after the reference has moved 10 m, m."""
    replay(bag, robot, output.parent, *options, "--output", str(output))
    t, path = columns(reference, "/reference_pose", PoseFields)
    estimate_t, estimate = columns(output, "/odometry", OdometryFields)
    inside = (t >= estimate_t[0]) & (t <= estimate_t[-1])
    t, path = t[inside], path[inside]
    far = np.append(0.0, np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))) > 10.0
    at = np.column_stack([np.interp(t[far], estimate_t, estimate[:, k]) for k in range(2)])
    return float(np.sqrt(np.mean(np.sum(np.square(at - path[far, :2]), axis=1))))


def first_heading(bag: Path, robot: str) -> float:
    """Heading of the reference at the start of the window, rad."""
    t, poses = columns(bag, "/reference_pose", PoseFields)
    begins = float(WINDOWS[robot][1]) if WINDOWS[robot] else 0.0
    with open_bag(bag) as opened:
        start = opened.start_ns * 1e-9 + begins
    return float(poses[np.searchsorted(t, start), 2])


def rows_of(path: Path, topic: str, kind: Any) -> Rows:
    """Records of all messages of a topic."""
    with open_bag(path) as bag:
        return np.concatenate([s[topic].rows(kind) for s in read_tables(bag, [topic]) if topic in s])


def columns(path: Path, topic: str, kind: Any) -> tuple[np.ndarray, np.ndarray]:
    """Stamps in s, and x, y, yaw (n, 3)."""
    rows = rows_of(path, topic, kind)
    yaw = 2.0 * np.arctan2(rows["qz"], rows["qw"])
    return rows["stamp_ns"] * 1e-9, np.column_stack((rows["x"], rows["y"], yaw))
