# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""IMUs of a bag: rotated by their mounting, and rejected where they state that data are absent."""

import math
from pathlib import Path

import numpy as np
import pytest
from fixtures.arrival_rows import measurements_of
from fixtures.commands import json_of
from fixtures.whole_inputs import read_inputs

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import serialize
from trackslip_bags.reader import open_bag
from trackslip_bags.writer import BagWriter
from trackslip_estimation.slip.conversions import yaw_rate
from trackslip_estimation.slip.measurements import YawRate
from trackslip_estimation.slip.parameters import load_slip_parameters

ANGLES = {"mounting_roll": math.pi, "mounting_pitch": 0.2, "mounting_yaw": -0.7}


def changed(bag_path: Path, path: Path, every: int) -> Path:
    """The bag with an IMU that lacks the gyro in each ``every``-th message, and accelerations in the next."""
    with open_bag(bag_path) as bag, BagWriter(path) as writer:
        count = 0
        for m in bag.messages():
            raw = bytes(m.raw)
            if m.topic == "/imu/data_raw":
                content = bag.deserialize(m.raw, m.type_name)
                absent = np.array((-1.0, *(0.0,) * 8))
                if count % every == 0:
                    content.angular_velocity_covariance = absent
                elif count % every == 1:
                    content.linear_acceleration_covariance = absent
                elif count % every == 2:
                    content.orientation_covariance = np.diag((1e-4, 2e-4, 3e-4)).ravel()
                    content.orientation.x, content.orientation.w = 0.1 * math.sin(count), 0.995
                raw, count = serialize(content), count + 1
            writer.write(m.topic, m.type_name, raw, m.log_time_ns)
    return path


@pytest.fixture(scope="module")
def lacking(emulated_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return changed(emulated_bag, tmp_path_factory.mktemp("lacking") / "bag", 5)


def test_columns_are_what_the_node_makes_of_each_message(lacking: Path) -> None:
    settings = {**ANGLES, "use_orientation": True}
    p = load_slip_parameters({f"sources.imu_data_raw.{name}": value for name, value in settings.items()})
    imu = p.gyros()["imu/data_raw"]
    with open_bag(lacking) as bag:
        messages = [bag.deserialize(m.raw, m.type_name) for m in bag.messages(["imu/data_raw"])]
        found = [m for m in measurements_of(read_inputs(bag, p, InputFilters(), ())) if type(m) is YawRate]
    live = [yaw_rate(message, "imu/data_raw", imu) for message in messages]
    expected = [m for m in live if isinstance(m, YawRate)]
    assert list(map(repr, found)) == list(map(repr, expected))
    assert len(live) > len(expected) > 100
    assert {np.isnan(m.acceleration_variance) for m in found} == {True, False}
    assert {m.up_variances[0] for m in found} > {-1.0}


def test_messages_without_rates_are_counted_by_name(
    lacking: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = json_of(tmp_path, "replay", lacking)
    with open_bag(lacking) as bag:
        count = bag.topics["/imu/data_raw"].count
    assert found["rejected"]["imu/data_raw"]["without angular velocity"] == math.ceil(count / 5)
    assert "without angular velocity" in capsys.readouterr().out
