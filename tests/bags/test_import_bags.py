# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of other robots, in ROS 1 and ROS 2: each topic gets a role and keeps its lateness."""

import copy
import math
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from fixtures.imports import refusal
from fixtures.made_bags import write_foreign
from fixtures.robot_logs import (
    EPOCH_NS,
    IMU_LATE_NS,
    ODOM_COVARIANCE,
    POSE_LATE_NS,
    RADIUS,
    TREAD,
    Drive,
    drive,
    write_ros1,
    write_ros2,
)

from trackslip_bags.importing.importer import Imported, import_log
from trackslip_bags.importing.mapping import read_mapping
from trackslip_bags.messages import header, make, serialize
from trackslip_bags.reader import open_bag
from trackslip_common.errors import InputError
from trackslip_common.make import stamp_ns_of
from trackslip_estimation.slip.measurements import UNOBSERVED

GEOMETRY = {"rolling_radius": RADIUS, "tread": TREAD}
MAPPING: dict[str, Any] = {
    "topics": {
        "sprockets": {
            "from": "/joint_states",
            "left": ["front_left_wheel", "rear_left_wheel"],
            "right": {"joints": ["front_right_wheel", "rear_right_wheel"], "sign": -1},
        },
        "imu/data_raw": {"from": "/imu/data"},
        "mocap_pose": {"role": "pose", "from": "mocap", "stddev": {"x": 0.03, "y": 0.03, "yaw": 0.05}},
        "reference_pose": {"from": "/truth", "stddev": {"x": 0.001, "y": 0.001, "yaw": 0.001}},
    },
    "parameters": {"pose_sources": ["mocap_pose"]},
}
QUATERNION = "geometry_msgs/msg/Quaternion"
TRUTH = drive(2.0)
WRITERS = {"ros1": write_ros1, "ros2": write_ros2}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_ros2(tmp_path_factory.mktemp("log") / "robot", TRUTH)


def changed(**topics: Any) -> dict[str, Any]:
    """The mapping with topics replaced; `imu` stands for imu/data_raw, None removes."""
    mapping = copy.deepcopy(MAPPING)
    for name, topic in topics.items():
        mapping["topics"][{"imu": "imu/data_raw"}.get(name, name)] = topic
    mapping["topics"] = {name: topic for name, topic in mapping["topics"].items() if topic is not None}
    return mapping


def imported(log: Path, folder: Path, mapping: dict[str, Any] = MAPPING) -> tuple[Imported, dict[str, Any]]:
    """The importer's result, and all messages by topic, each with its log time."""
    (folder / "map.yaml").write_text(yaml.safe_dump(mapping), encoding="utf-8")
    result = import_log([log], read_mapping(folder / "map.yaml"), folder / "bag")
    messages: dict[str, list[tuple[int, Any]]] = {}
    with open_bag(folder / "bag") as bag:
        for m in bag.messages():
            messages.setdefault(m.topic, []).append((m.log_time_ns, bag.deserialize(m.raw, m.type_name)))
    return result, messages


@pytest.mark.parametrize("version", WRITERS)
def test_each_topic_gets_a_role_and_keeps_its_lateness(version: str, tmp_path: Path) -> None:
    """Each side is the mean of two wheels; the right ones turn the other way."""
    result, messages = imported(WRITERS[version](tmp_path / "robot.bag", TRUTH), tmp_path)
    sprockets = [m for _, m in messages["/sprockets"]]
    assert sprockets[0].name == ["left_sprocket", "right_sprocket"]
    np.testing.assert_allclose([m.velocity for m in sprockets], TRUTH.wheels, atol=1e-12)
    np.testing.assert_allclose(sprockets[-1].position, TRUTH.wheels.sum(axis=0) / 50.0)
    assert stamp_ns_of(sprockets[0]) == EPOCH_NS
    for topic, late_ns in (("/imu/data_raw", IMU_LATE_NS), ("/mocap_pose", POSE_LATE_NS)):
        lateness = [log_time_ns - stamp_ns_of(m) for log_time_ns, m in messages[topic]]
        assert set(lateness) == {late_ns}
        assert result.lateness[topic].median == pytest.approx(late_ns * 1e-9)
    assert "/reference_pose" not in result.lateness
    imu = messages["/imu/data_raw"][0][1]
    assert (imu.angular_velocity_covariance[8], imu.linear_acceleration.z) == (9e-6, 9.81)
    assert (imu.orientation_covariance[0], imu.header.frame_id) == (-1.0, "imu")
    truth = messages["/reference_pose"][0][1]
    position, turn = truth.pose.pose.position, truth.pose.pose.orientation
    np.testing.assert_allclose((position.x, position.y), TRUTH.pose[5, :2])
    assert 2.0 * math.atan2(turn.z, turn.w) == pytest.approx(TRUTH.pose[5, 2])
    np.testing.assert_allclose(np.diag(truth.pose.covariance.reshape(6, 6))[[0, 1, 5]], 1e-6)


def test_a_time_offset_moves_stamps_not_arrivals(log: Path, tmp_path: Path) -> None:
    offset = {"from": "/imu/data", "time_offset": -0.01}
    by_log = {"role": "imu", "from": "/imu/data", "stamp": "log"}
    _, messages = imported(log, tmp_path, changed(imu=offset, by_log=by_log))
    log_time_ns, first = messages["/imu/data_raw"][0]
    assert (stamp_ns_of(first), log_time_ns) == (EPOCH_NS - 10_000_000, EPOCH_NS + IMU_LATE_NS)
    assert all(stamp_ns_of(m) == log_time_ns for log_time_ns, m in messages["/by_log"])


def write_transforms(path: Path, children: tuple[str, ...]) -> Path:
    """A bag with one TFMessage, of a transform to each child."""
    place = make("geometry_msgs/msg/Vector3", x=1.0, y=2.0)
    motion = make("geometry_msgs/msg/Transform", translation=place, rotation=make(QUATERNION, w=1.0))
    one = partial(
        make, "geometry_msgs/msg/TransformStamped", header=header(EPOCH_NS, "map"), transform=motion
    )
    message = make("tf2_msgs/msg/TFMessage", transforms=[one(child_frame_id=child) for child in children])
    return write_foreign(path, [("/tf", message.__msgtype__, EPOCH_NS, serialize(message))])


def test_transforms_of_several_frames_need_that_of_the_machine(tmp_path: Path) -> None:
    bag = write_transforms(tmp_path / "tf", ("/base_link", "camera"))
    topic = {"from": "/tf", "stddev": {"x": 0.1, "y": 0.1, "yaw": 0.1}}
    for child, words in (({}, "several frames"), ({"child_frame": "base"}, "of child frame 'base' serves")):
        with pytest.raises(InputError, match=rf"{words}.*; accepted: child_frame, one of base_link, camera$"):
            imported(bag, tmp_path, {"topics": {"reference_pose": {**topic, **child}}})
    one = write_transforms(tmp_path / "one", ("/base_link",))
    for k, (path, child) in enumerate(((bag, {"child_frame": "base_link"}), (one, {}))):
        (folder := tmp_path / str(k)).mkdir()
        _, messages = imported(path, folder, {"topics": {"reference_pose": {**topic, **child}}})
        assert len(messages["/reference_pose"]) == 1


@pytest.mark.parametrize("use", ["positions", "velocities"])
def test_positions_or_velocities_are_sufficient(log: Path, tmp_path: Path, use: str) -> None:
    sprockets = {**MAPPING["topics"]["sprockets"], "use": use}
    _, messages = imported(log, tmp_path, changed(sprockets=sprockets))
    imported_sprockets = [m for _, m in messages["/sprockets"]]
    assert len(imported_sprockets[0].position) == (2 if use == "positions" else 0)
    np.testing.assert_allclose([m.velocity for m in imported_sprockets[1:]], TRUTH.wheels[1:], atol=1e-5)


def test_topics_may_have_other_roles(log: Path, tmp_path: Path) -> None:
    """v and ω of a base controller become wheel speeds without slip, by the controller's geometry."""
    topics = changed(
        sprockets={"from": "/odom", "geometry": GEOMETRY},
        camera={"role": "odometry", "from": "/odom"},
        reference_pose={"from": "/truth", "stddev": {"x": 0.001, "y": 0.001}, "position_only": True},
    )
    _, messages = imported(log, tmp_path, topics)
    np.testing.assert_allclose([m.velocity for _, m in messages["/sprockets"]], TRUTH.wheels, atol=1e-12)
    odometry = [m for _, m in messages["/camera"]]
    places = [(m.pose.pose.position.x, m.pose.pose.position.y) for m in odometry]
    np.testing.assert_array_equal(places, TRUTH.pose[:, :2])
    turns = [2.0 * math.atan2(m.pose.pose.orientation.z, m.pose.pose.orientation.w) for m in odometry]
    np.testing.assert_allclose(turns, TRUTH.pose[:, 2], atol=1e-12)
    np.testing.assert_array_equal(odometry[0].twist.covariance, ODOM_COVARIANCE)
    assert not odometry[0].pose.covariance.any()
    assert {m.header.frame_id for m in odometry} == {"odom"}
    assert messages["/reference_pose"][0][1].pose.covariance[35] == UNOBSERVED


PRESSURE = {"column": "p", "unit": "bar"}
T = {"column": "t", "unit": "s"}
PRESSURES = {"left_pressure": PRESSURE, "right_pressure": PRESSURE, "time": T}
ANGLE = {"angle": {"column": "a", "unit": "rad"}}
BAD = {  # regular expression of the error → mapping
    r"from: no topic '/joint_state' in .*did you mean '/joint_states'\?; it holds: /imu/data, ": changed(
        sprockets={"from": "joint_state"}
    ),
    r"from: /imu/data is a sensor_msgs/msg/Imu; accepted: sensor_msgs/msg/JointState, nav": changed(
        sprockets={"from": "/imu/data"}
    ),
    r"has no joints front_left.*did you mean 'front_left_wheel'\?; accepted: arm, ": changed(
        sprockets={"from": "/joint_states", "left": "front_left", "right": "front_right"}
    ),
    r"has no joints left_sprocket, right_sprocket \(no left and right.*accepted: arm, ": changed(
        sprockets={"from": "/joint_states"}
    ),
    r"sprockets: only one of left and right; accepted: the joints of both": changed(
        sprockets={"from": "/joint_states", "left": "front_left_wheel"}
    ),
    r"sprockets: left and right are both of 'front_left_wheel'; accepted: the joints of each": changed(
        sprockets={"from": "/j", "left": "front_left_wheel", "right": ["front_left_wheel"]}
    ),
    r"sprockets.right.sign: 2 is not accepted; accepted: 1 or -1": changed(
        sprockets={"from": "/j", "left": "a", "right": {"joints": "b", "sign": 2}}
    ),
    r"sprockets: a speed over ground needs a vehicle.*geometry": changed(sprockets={"from": "/odom"}),
    r"mocap_pose: mocap states no variance of x that is above 0; accepted: stddev: {x: …}": changed(
        mocap_pose={"role": "pose", "from": "mocap"}
    ),
    r"mocap_pose: mocap states no variance of yaw.*or position_only: true": changed(
        mocap_pose={"role": "pose", "from": "mocap", "stddev": {"x": 0.1, "y": 0.1}}
    ),
    r"reference_pose: no message of /truth of child frame 'rover' serves \(there is none\)": changed(
        reference_pose={"from": "/truth", "child_frame": "rover", "stddev": {"x": 1, "y": 1}}
    ),
    r"imu/data_raw: a column of angular_velocity_z, and the log is a bag; accepted: a number, SI": changed(
        imu={"from": "/imu/data", "stddev": {"angular_velocity_z": {"column": "s", "unit": "rad/s"}}}
    ),
    r"topics both with and without 'from'; accepted: one log": changed(hydraulics=PRESSURES),
    r"'time' is of CSV logs; accepted for a bag: from alone": {**MAPPING, "time": T},
    r"a bag, and .* names columns; accepted: topics with 'from'": {"time": T, "topics": {"swing": ANGLE}},
}


@pytest.mark.parametrize("message", BAD)
def test_what_does_not_fit_is_named_in_one_line(log: Path, tmp_path: Path, message: str) -> None:
    assert re.search(message, refusal(tmp_path, log, **BAD[message]))


def test_a_mapping_of_topics_is_not_for_a_table(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t\n0\n", encoding="utf-8")
    assert re.search(r"no bag, and .* has topics of one", refusal(tmp_path, tmp_path / "log.csv", **MAPPING))


def test_split_bags_of_ros1_are_one_log(tmp_path: Path) -> None:
    half = len(TRUTH.t) // 2
    parts = [Drive(*(column[rows] for column in TRUTH)) for rows in (slice(0, half), slice(half, None))]
    logs = [write_ros1(tmp_path / f"{k}.bag", part) for k, part in enumerate(parts)]
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAPPING), encoding="utf-8")
    result = import_log(logs, read_mapping(tmp_path / "map.yaml"), tmp_path / "bag")
    assert result.counts["/sprockets"] == len(TRUTH.t)


def test_a_cut_bag_of_ros1_names_what_mends_it(tmp_path: Path) -> None:
    whole = write_ros1(tmp_path / "robot.bag", TRUTH).read_bytes()
    for size in (len(whole) // 3, len(whole) - 100):
        (tmp_path / "robot.bag").write_bytes(whole[:size])
        with pytest.raises(InputError, match="rosbag reindex"):
            imported(tmp_path / "robot.bag", tmp_path)


def test_a_type_of_another_form_is_named(tmp_path: Path) -> None:
    """The bag's definition of JointState is damaged."""
    log = write_ros1(tmp_path / "robot.bag", TRUTH)
    log.write_bytes(log.read_bytes().replace(b"float64[] velocity", b"float64[] velocitx"))
    with pytest.raises(
        InputError, match=r"robot\.bag': bad sensor_msgs/msg/JointState on /joint_states \(.*velocity"
    ):
        imported(log, tmp_path)
