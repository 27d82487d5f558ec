# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Headings of antenna pairs, velocities, and angles of an upper structure from bags and CSV logs."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.imports import import_csv, import_messages, import_topics
from fixtures.made_bags import heading, joints, quaternion, write_bag

from trackslip_bags.messages import header, make
from trackslip_common.errors import InputError
from trackslip_estimation.slip.conversions import heading_fix, swing_angle, velocity_fix
from trackslip_estimation.slip.measurements import UNOBSERVED, HeadingFix, VelocityFix
from trackslip_estimation.slip.parameters import load_slip_parameters

COMPASS = load_slip_parameters({"heading_sources": ["heading"]}).compasses()["heading"]
UNKNOWN = COMPASS.stddev**2  # if the message has no variance
EAST, NORTH = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))


def headings(messages: list[Any]) -> list[tuple[float, float]]:
    """Yaw and variance of each message, as the estimator reads them."""
    fixes = [heading_fix(message, "heading", COMPASS) for message in messages]
    assert all(isinstance(one, HeadingFix) for one in fixes)
    return [(one.heading, one.variance) for one in fixes if isinstance(one, HeadingFix)]


def test_the_orientation_of_an_imu_without_rates_is_a_heading(tmp_path: Path) -> None:
    """nmea_gnss publishes such messages; those that state no orientation are left out and counted."""
    turns = [heading(0.0, EAST, 0.0, 1e-5), heading(0.2, EAST, -1.0, 0.0), heading(0.4, NORTH, 0.0, 0.0)]
    turns.append(heading(0.6, (0.0, 0.0, 0.0, 0.0), 0.0, 0.0))
    sent = (("/gps/heading", one) for one in turns)
    result, messages = import_messages(tmp_path, sent, {"heading": {"from": "/gps/heading"}})
    assert headings(messages) == [(0.0, 1e-5), (pytest.approx(math.pi / 2.0), UNKNOWN)]
    assert result.left_out["/heading"] == {"states that it has no orientation": 1, "holds no orientation": 1}
    assert {m.header.frame_id for m in messages} == {"gps"}
    assert messages[0].angular_velocity_covariance[0] == -1.0


def test_a_bare_quaternion_has_the_variance_of_its_source_or_of_the_mapping(tmp_path: Path) -> None:
    log = write_bag(tmp_path / "log", [("/gps/q", quaternion(0.0, NORTH))])
    _, messages = import_topics(tmp_path, log, {"compass": {"role": "heading", "from": "/gps/q"}})
    assert headings(messages) == [(pytest.approx(math.pi / 2.0), UNKNOWN)]
    (certain := tmp_path / "sure").mkdir()
    stated = {"role": "heading", "from": "/gps/q", "stddev": {"yaw": 0.1}}
    _, messages = import_topics(certain, log, {"compass": stated})
    assert headings(messages) == [(pytest.approx(math.pi / 2.0), pytest.approx(0.01))]


CSV: dict[str, dict[str, Any]] = {
    "t,h,s\n0,0,2\n1,,2\n2,90,\n": {
        "heading": {"column": "h", "unit": "deg"},
        "stddev": {"yaw": {"column": "s", "unit": "deg"}},
    },
    "t,qx,qy,qz,qw\n0,0,0,0.70710678,0.70710678\n1,0,0,0,0\n2,0,0,0,1\n": {
        q: {"column": q} for q in ("qx", "qy", "qz", "qw")
    },
    "t,y\n0,90\n1,\n2,0\n": {"yaw": {"column": "y", "unit": "deg"}},
}


@pytest.mark.parametrize("log", CSV)
def test_columns_of_a_compass_are_headings(log: str, tmp_path: Path) -> None:
    result, messages = import_csv(tmp_path, log, {"heading": CSV[log]})
    first = UNKNOWN if "stddev" not in CSV[log] else math.radians(2.0) ** 2
    expected = [(math.pi / 2.0, first), (0.0, UNKNOWN)]
    assert [pytest.approx(one, abs=1e-8) for one in expected] == headings(messages)
    assert result.left_out == ({"/heading": {"holds no orientation": 1}} if "qx" in log else {})


def test_a_joint_of_another_name_is_the_swing(tmp_path: Path) -> None:
    """With gear ratio and inverted sign; messages without the joint or its position are counted."""
    names = ["cab", "boom"]
    states = [joints(0.1 * k, names, [0.5 * k, 9.0], []) for k in range(3)]
    states += [joints(0.3, ["boom"], [9.0], []), joints(0.4, names, [], [1.0, 1.0])]
    swing = {"from": "/joint_states", "joint": {"joints": "cab", "sign": -1, "ratio": 0.1}}
    sent = (("/joint_states", one) for one in states)
    result, messages = import_messages(tmp_path, sent, {"swing": swing})
    angles = [swing_angle(one, "swing", 1.0).angle for one in messages]
    assert angles == pytest.approx([0.0, -0.05, -0.1])
    with pytest.raises(InputError, match=r"no joints swing \(no joint in .*accepted: cab, boom"):
        import_topics(tmp_path, tmp_path / "log", {"swing": {"from": "/joint_states"}})
    assert result.left_out["/swing"] == {"has none of the joints": 1, "has no finite values": 1}


@pytest.mark.parametrize(
    ("keys", "yaw"),
    [
        ({}, 0.5),
        ({"convention": "enu", "sign": -1}, -0.5),
        ({"convention": "compass"}, math.pi / 2.0 - 0.5),
        ({"convention": "compass", "sign": -1}, math.pi / 2.0 + 0.5),
    ],
)
def test_the_convention_of_a_heading_is_stated(tmp_path: Path, keys: dict[str, Any], yaw: float) -> None:
    turn = (0.0, 0.0, math.sin(0.25), math.cos(0.25))
    sent = [("/q", quaternion(0.0, turn)), ("/imu", heading(0.1, turn, 0.0, 1e-5))]
    topics = {name: {"role": "heading", "from": f"/{name}", **keys} for name in ("q", "imu")}
    _, messages = import_messages(tmp_path, sent, topics)
    assert [imported_yaw for imported_yaw, _ in headings(messages)] == pytest.approx([yaw, yaw])


def wheels(apart_s: float) -> list[tuple[str, Any]]:
    """Each wheel in its own message, that of the right one stamped ``apart_s`` later."""
    messages = []
    for k in range(5):
        messages.append(("/wheels", joints(0.1 * k, ["left"], [1.0 + k], [])))
        messages.append(("/wheels", joints(0.1 * k + apart_s, ["right"], [2.0 + k], [])))
    return messages


def test_joints_in_messages_of_their_own_are_joined_by_stamp(tmp_path: Path) -> None:
    topics = {"sprockets": {"from": "/wheels", "left": "left", "right": "right", "use": "positions"}}
    result, messages = import_messages(tmp_path, wheels(0.0)[:-1], topics)
    assert [list(m.position) for m in messages] == [[1.0 + k, 2.0 + k] for k in range(4)]
    assert list(result.left_out["/sprockets"].values()) == [1]


def test_joints_that_no_stamp_joins_are_refused(tmp_path: Path) -> None:
    topics = {"sprockets": {"from": "/wheels", "left": "left", "right": "right"}}
    with pytest.raises(InputError, match="no messages of one stamp, hold left, right together"):
        import_messages(tmp_path, wheels(0.01), topics)


@pytest.mark.parametrize(("every", "digits", "count"), [(10, 2, 29), (1, 0, 300)])
def test_a_heading_that_the_log_holds_is_one_message_and_a_coarse_one_is_not(
    every: int, digits: int, count: int, tmp_path: Path
) -> None:
    """Held over ten rows, or rounded to degrees while the machine turns at all rates."""
    at = every * (np.arange(300) // every)
    headings = 90.0 + 40.0 * np.sin(0.02 * at)
    rows = [f"{0.1 * k:.1f},{heading:.{digits}f}" for k, heading in enumerate(headings.tolist())]
    heading = {"heading": {"column": "h", "unit": "deg"}}
    _, messages = import_csv(tmp_path, "\n".join(("t,h", *rows, "")), {"heading": heading})
    assert len(messages) == count


RECEIVER = load_slip_parameters({"velocity_sources": ["fix_velocity"]}).velocities()["fix_velocity"]


VELOCITIES: dict[str, dict[str, Any]] = {
    "t,e,n,s\n0,1,0,0.1\n1,0,-2,0.2\n": {
        "east": {"column": "e", "unit": "m/s"},
        "north": {"column": "n", "unit": "m/s"},
        "stddev": {axis: {"column": "s", "unit": "m/s"} for axis in "xy"},
    },
    "t,v,c\n0,3.6,90\n1,7.2,180\n": {
        "speed": {"column": "v", "unit": "km/h"},
        "course": {"column": "c", "unit": "deg"},
    },
}


@pytest.mark.parametrize("log", VELOCITIES)
def test_columns_of_a_receiver_are_velocities(log: str, tmp_path: Path) -> None:
    _, messages = import_csv(tmp_path, log, {"fix_velocity": VELOCITIES[log]})
    fixes = [velocity_fix(m, "fix_velocity", RECEIVER) for m in messages]
    assert [list(one.velocity) for one in fixes] == [pytest.approx((1.0, 0.0)), pytest.approx((0.0, -2.0))]
    stated = (0.1, 0.2) if "stddev" in VELOCITIES[log] else (RECEIVER.stddev,) * 2
    assert [one.covariance[1, 1] for one in fixes] == [pytest.approx(s**2) for s in stated]


def test_column_of_a_radar_is_a_velocity_along_one_axis(tmp_path: Path) -> None:
    topics = {"radar": {"role": "velocity", "forward": {"column": "v", "unit": "m/s"}}}
    _, (message,) = import_csv(tmp_path, "t,v\n0,0.5\n", topics)
    velocity = velocity_fix(message, "radar", RECEIVER)
    assert isinstance(velocity, VelocityFix)
    assert (velocity.velocity[0], velocity.covariance[1, 1]) == (0.5, UNOBSERVED)


def test_twists_of_a_bag_are_velocities(tmp_path: Path) -> None:
    def twist(t: float, speed: float, variance: float) -> Any:
        covariance = np.zeros(36)
        covariance[[0, 7]] = variance
        linear = make("geometry_msgs/msg/Vector3", x=speed, y=0.0, z=0.0)
        both = make("geometry_msgs/msg/TwistWithCovariance", covariance=covariance)
        both.twist.linear = linear
        kind = "geometry_msgs/msg/TwistWithCovarianceStamped"
        return make(kind, header=header(round(t * 1e9), "gps"), twist=both)

    twists = [twist(0.0, 1.0, 0.04), twist(0.2, 2.0, -1.0), twist(0.4, math.nan, 0.04), twist(0.6, 3.0, 0.0)]
    sent = (("/gps/vel", one) for one in twists)
    result, messages = import_messages(tmp_path, sent, {"fix_velocity": {"from": "/gps/vel"}})
    assert [m.twist.twist.linear.x for m in messages] == [1.0, 3.0]
    assert [m.twist.covariance[0] for m in messages] == [0.04, 0.0]
    refused = {"states that it has no velocity": 1, "has no finite values": 1}
    assert result.left_out["/fix_velocity"] == refused


def test_messages_moved_before_zero_are_left_out_and_the_others_keep_their_frames(tmp_path: Path) -> None:
    turn = make("geometry_msgs/msg/Quaternion", w=1.0)
    sent = [
        ("/q", make("geometry_msgs/msg/QuaternionStamped", header=header(t * 10**9, frame), quaternion=turn))
        for t, frame in ((1, "a"), (3, "b"), (4, "c"))
    ]
    topics = {"heading": {"from": "/q", "time_offset": -2.0}}
    result, messages = import_messages(tmp_path, sent, topics)
    assert [m.header.frame_id for m in messages] == ["b", "c"]
    assert list(result.left_out["/heading"].values()) == [1]
