# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Two machines in two namespaces of one domain have separate estimates, bags and frames."""

import pytest
from fixtures.sensor_messages import pose, sprockets

from trackslip_bags.reader import open_bag

MACHINES = {"one": 1.0, "two": -2.0}  # rad/s of both sprockets
STEP_MS = 20
NODES = ("slip_estimator", "record")


def subscribe_tf(observer):
    try:
        return observer.subscribe("/tf", "tf")
    except ModuleNotFoundError:  # tf2_msgs is optional
        return []


def links(name):
    return {("map", f"{name}/odom"), (f"{name}/odom", f"{name}/base_link")}


@pytest.mark.parametrize("steps", [20, pytest.param(3000, marks=pytest.mark.slow)])  # 0.4 s, 60 s
def test_two_machines_side_by_side(programs, observer, steps):
    healths, transforms = observer.healths(), subscribe_tf(observer)
    odometry, local, reports = (
        {name: observer.subscribe(f"/{name}/{topic}", topic) for name in MACHINES}
        for topic in ("odometry", "odometry/local", "measurement_reports")
    )
    publishers = {
        name: [observer.publisher(f"/{name}/{topic}", topic) for topic in ("sprockets", "box_pose")]
        for name in MACHINES
    }
    running = {}
    for name in MACHINES:
        space = ("-r", f"__ns:=/{name}")
        programs.node("slip_estimator", *space, frame_prefix=f"{name}/", vehicle="excavator_20t")
        running[name] = programs.node("record", *space, output=name)
        for topic in ("sprockets", "box_pose"):
            observer.wait_for_ends(f"/{name}/{topic}", *NODES)
    for name in MACHINES:
        published = [
            f"{name}/{topic}" for topic in ("odometry", "track_slip", "measurement_reports", "vehicle")
        ]
        observer.wait_for_recorder(healths, *published, recorder=f"{name}/record")
    for step in range(steps):
        for name, speed in MACHINES.items():
            publishers[name][0].publish(sprockets(step * STEP_MS, speed))
            if step == 0:
                observer.wait(lambda name=name: reports[name], f"a report of {name}")
                publishers[name][1].publish(pose(0, speed))
        observer.wait(lambda step=step: all(len(r) == step + 2 for r in reports.values()), "all reports")
    for name, speed in MACHINES.items():
        last, driven = odometry[name][-1], 0.35 * speed * (steps - 1) * STEP_MS * 1e-3
        assert abs(last.pose.pose.position.x - speed - driven) < 0.05
        assert (last.header.frame_id, last.child_frame_id) == ("map", f"{name}/base_link")
        assert (local[name][-1].header.frame_id, local[name][-1].child_frame_id) == (
            f"{name}/odom",
            f"{name}/base_link",
        )
    chains = {(t.header.frame_id, t.child_frame_id) for message in transforms for t in message.transforms}
    assert chains in (set(), links("one") | links("two"))
    expected = {f"{name}/{node}" for name in MACHINES for node in NODES}
    observer.wait(lambda: expected <= {status.name for status in healths}, "diagnostics of all four")
    assert "slip_estimator" not in {status.name for status in healths}
    for name, recorder in running.items():
        assert recorder.end()[0] == 0
        with open_bag(programs.folder / name) as bag:
            filled = {topic for topic, info in bag.topics.items() if info.count}
            assert {t.split("/")[1] for t in filled} <= {name, "tf", "diagnostics"}
            assert f"/{name}/vehicle" in filled
    summary = programs.replay("two", "--namespace", "two")
    assert summary["replay_matches"] is True
    assert summary["vehicle"] == "excavator_20t"
