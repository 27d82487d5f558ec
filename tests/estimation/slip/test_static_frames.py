# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Mounting of an IMU from the links of /tf_static."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fixtures.visual_odometry import product
from hypothesis import given
from hypothesis import strategies as st

from trackslip_bags.messages import make, serialize
from trackslip_bags.parameters import bag_parameters
from trackslip_bags.reader import open_bag
from trackslip_bags.writer import BagWriter
from trackslip_common.config_files import parameters_text
from trackslip_common.parameters import to_flat
from trackslip_estimation.nodes.measurement_sources import StaticMountings
from trackslip_estimation.slip.learned import learned_context
from trackslip_estimation.slip.mounting import quaternion_from_angles, rotation
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.static_frames import StaticFrames

angles = st.tuples(st.floats(-3.1, 3.1), st.floats(-math.pi / 2.0, math.pi / 2.0), st.floats(-3.1, 3.1))
IMU = "imu/data_raw"


@given(angles, angles, angles)
def test_angles_are_composed_over_links_in_both_directions(mast: Any, plate: Any, imu: Any) -> None:
    """base_link ← chassis → …: base_link is the child of a frame that carries the IMU too."""
    frames = StaticFrames()
    frames.add("chassis", "base_link", quaternion_from_angles(*mast))
    frames.add("/chassis", "plate", quaternion_from_angles(*plate))
    frames.add("plate", "/imu_link", quaternion_from_angles(*imu))
    up = np.array(quaternion_from_angles(*mast)) * (-1.0, -1.0, -1.0, 1.0)
    whole = product(
        product(up, np.array(quaternion_from_angles(*plate))), np.array(quaternion_from_angles(*imu))
    )
    found = frames.angles("base_link", "imu_link")
    assert found is not None
    assert abs(np.dot(quaternion_from_angles(*found), whole)) == pytest.approx(1.0, abs=1e-9)


def test_frames_without_a_connection_have_no_angles() -> None:
    frames = StaticFrames()
    frames.add("a", "b", (0.0, 0.0, 0.0, 0.0))
    frames.add("c", "d", (math.nan, 0.0, 0.0, 1.0))
    assert frames.angles("a", "b") is None
    assert frames.angles("c", "d") is None
    assert frames.angles("a", "a") == (0.0, 0.0, 0.0)
    frames.add("loop", "pool", (0.0, 0.0, 0.0, 1.0))
    frames.add("pool", "loop", (0.0, 0.0, 0.0, 1.0))
    assert frames.angles("a", "loop") is None


def tf(parent: str, child: str, roll: float, pitch: float, yaw: float) -> Any:
    turn = SimpleNamespace(**dict(zip("xyzw", quaternion_from_angles(roll, pitch, yaw), strict=True)))
    link = SimpleNamespace(
        header=SimpleNamespace(frame_id=parent),
        child_frame_id=child,
        transform=SimpleNamespace(rotation=turn),
    )
    return SimpleNamespace(transforms=[link])


def test_imu_is_used_once_its_mounting_arrives_and_keeps_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trackslip_estimation.nodes.measurement_sources.topic_class", lambda _: object)
    p = load_slip_parameters({"sources.imu_data_raw.mounting_from_tf": True})
    asked = []
    node = SimpleNamespace(create_subscription=lambda *given: asked.append(given[1]))
    mountings = StaticMountings(node, "base_link", p.gyros())
    assert asked == ["/tf_static"]
    assert mountings.mounted_imu(IMU, "imu_link") == (None, {})
    mountings.add_transforms(tf("base_link", "imu_link", math.pi, 0.0, 0.2))
    imu, found = mountings.mounted_imu(IMU, "imu_link")
    assert imu is not None
    np.testing.assert_allclose(np.array(imu.mounting), np.array(rotation(math.pi, 0.0, 0.2)), atol=1e-12)
    assert found["sources.imu_data_raw.mounting_yaw"] == pytest.approx(0.2)
    mountings.add_transforms(tf("base_link", "imu_link", 0.0, 0.0, 0.0))
    assert mountings.mounted_imu(IMU, "imu_link") == (imu, {})


def test_an_imu_whose_parameters_state_how_it_is_mounted_needs_no_tf() -> None:
    p = load_slip_parameters()
    mountings = StaticMountings(SimpleNamespace(), "base_link", p.gyros())
    assert mountings.mounted_imu(IMU, "anything") == (p.gyros()[IMU], {})


def test_mounting_of_a_bag_is_that_of_its_later_parameters(tmp_path: Path) -> None:
    """The mounting is recorded after the parameters of the start; learned states stay valid."""
    asked = load_slip_parameters({"sources.imu_data_raw.mounting_from_tf": True})
    found = asked.changed({"sources.imu_data_raw.mounting_yaw": 0.2})
    later = found.changed({"gate_probability": 0.99})
    with BagWriter(tmp_path / "bag") as bag:
        for k, p in enumerate((asked, found, later)):
            text = make("std_msgs/msg/String", data=parameters_text(to_flat(p), "slip_estimator"))
            bag.write("/slip_estimator/parameters", "std_msgs/msg/String", serialize(text), 1 + k)
    with open_bag(tmp_path / "bag") as opened:
        values = bag_parameters(opened)
    assert values["sources.imu_data_raw.mounting_yaw"] == 0.2
    assert values["gate_probability"] == asked.gate_probability
    assert learned_context(asked).machine == learned_context(found).machine
