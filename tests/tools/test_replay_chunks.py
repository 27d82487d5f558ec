# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs of a bag in batches: bounded, complete, in live order, and as live conversion makes them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.arrival_rows import measurements_of
from fixtures.commands import json_of
from fixtures.made_bags import write_changed, write_messages
from fixtures.recorded import EVERYTHING
from fixtures.records import assert_same_bits
from fixtures.whole_inputs import Inputs, read_inputs

from trackslip_bags import chunks, tables
from trackslip_bags.input_filters import InputFilters, Thin, Withhold
from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import open_bag
from trackslip_bags.sources import BagMessage
from trackslip_common.message_fields import OdometryFields
from trackslip_common.message_reading import dtype_of
from trackslip_common.vehicle_files import vehicle_layer
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.measurements import (
    RESET,
    Measurement,
    Outcome,
    PoseFix,
    Report,
    Sprockets,
    YawRate,
)
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_tools.replay.arrivals import ARRIVAL, IS_COMMAND
from trackslip_tools.replay.inputs import InputStream
from trackslip_tools.replay.run import replay
from trackslip_tools.report.details import Details

P = load_slip_parameters()
ANGLES = {"mounting_roll": math.pi, "mounting_pitch": 0.2, "mounting_yaw": -0.7}
SERIES = ("truth/odometry", "truth/track_slip")
REPORT = "trackslip_msgs/msg/MeasurementReport"
FILTERS = InputFilters(
    start_s=3.0,
    stop_s=31.0,
    withhold=(Withhold("imu/data_raw", 10.0, 12.0),),
    thin=(Thin("box_pose", 1.0, 0.05),),
)


def test_a_bag_comes_in_batches_of_some_seconds(emulated_bag: Path) -> None:
    with open_bag(emulated_bag) as bag:
        batches = list(InputStream(bag, P, InputFilters(), ("truth/odometry",)))
        duration_s = bag.duration_s
    spans = [np.ptp(batch.rows["log_time_ns"]) * 1e-9 for batch in batches if len(batch.rows)]
    assert len(spans) >= duration_s / 11.0
    assert max(spans) <= 11.0
    for batch in batches:
        assert batch.rows.dtype == ARRIVAL
        if "truth/odometry" in batch.tables:
            assert batch.tables["truth/odometry"].rows.dtype == dtype_of(OdometryFields)


def test_the_length_of_the_batches_changes_nothing_with_filters(
    emulated_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_bag(emulated_bag) as bag:
        expected = read_inputs(bag, P, FILTERS, SERIES)
        monkeypatch.setattr(chunks, "STRETCH_NS", 700_000_000)
        assert_same_inputs(read_inputs(bag, P, FILTERS, SERIES), expected)


def assert_same_inputs(inputs: Inputs, expected: Inputs) -> None:
    assert len(inputs.rows) > 1000
    assert_same_bits(inputs.rows, expected.rows)
    for name in SERIES:
        np.testing.assert_array_equal(inputs.series[name].rows, expected.series[name].rows)
    assert (inputs.messages, inputs.duration_s) == (expected.messages, expected.duration_s)


def test_the_length_of_the_batches_changes_nothing(
    emulated_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Holds for both estimators."""
    of_soil = load_soil_parameters(vehicle_layer(P.vehicle))

    def found() -> list[Any]:
        details = Details()
        with open_bag(emulated_bag) as bag:
            result = replay(bag, P, EVERYTHING, None, of_soil, details.add)
        assert result.soil is not None
        states = [repr(vars(state)) for state in result.soil.states]
        forces = result.soil.forces.tobytes()
        numbers = [result.nees, result.slip_rmse]
        numbers += [value for scored in result.scores.values() for value in vars(scored).values()]
        rounded = [round(number, 9) for number in numbers if number is not None]  # sums over batches
        return [
            details.reports.tobytes(),
            details.fixes.tobytes(),
            details.estimates.tobytes(),
            forces,
            states,
            rounded,
        ]

    expected = found()
    monkeypatch.setattr(chunks, "STRETCH_NS", 700_000_000)
    assert found() == expected
    assert len(expected[4]) > 40
    assert len(expected[5]) == 11


@pytest.mark.parametrize("filters", [EVERYTHING, InputFilters(start_s=10.0, stop_s=20.0)])
def test_reading_by_column_equals_reading_by_message(
    emulated_bag: Path, monkeypatch: pytest.MonkeyPatch, filters: InputFilters
) -> None:
    with open_bag(emulated_bag) as bag:
        by_column = read_inputs(bag, P, filters, SERIES)
        monkeypatch.setattr(tables, "_LAYOUTS", 0)
        assert_same_inputs(read_inputs(bag, P, filters, SERIES), by_column)


def test_rows_are_the_measurements_that_live_conversion_makes(emulated_bag: Path) -> None:
    """In log order, because the bag has no journal."""
    expected: list[Measurement] = []
    with open_bag(emulated_bag) as bag:
        for message in bag.messages(["sprockets", "imu/data_raw", "box_pose"]):
            content, source = bag.deserialize(message.raw, message.type_name), message.topic[1:]
            if source == "sprockets":
                expected.append(conversions.sprockets(content, source))
            elif source == "box_pose":
                expected.append(conversions.pose_fix(content, source))
            else:
                expected.append(conversions.yaw_rate(content, source, P.gyros()[source]))
        measurements = measurements_of(read_inputs(bag, P, InputFilters(), ()))
    assert list(map(repr, measurements)) == list(map(repr, expected))
    assert {type(m) for m in measurements} == {Sprockets, YawRate, PoseFix}


def without_readings(bag_path: Path, path: Path, every: int) -> Path:
    """The bag with an IMU that lacks the gyro in each ``every``-th message, and accelerations in the next."""
    absent = np.array((-1.0, *(0.0,) * 8))

    def changed(number: int, imu: Any) -> Any:
        if number % every == 0:
            imu.angular_velocity_covariance = absent
        elif number % every == 1:
            imu.linear_acceleration_covariance = absent
        elif number % every == 2:
            imu.orientation_covariance = np.diag((1e-4, 2e-4, 3e-4)).ravel()
            imu.orientation.x, imu.orientation.w = 0.1 * math.sin(number), 0.995
        return imu

    return write_changed(path, bag_path, "/imu/data_raw", changed)


@pytest.fixture(scope="module")
def lacking(emulated_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return without_readings(emulated_bag, tmp_path_factory.mktemp("lacking") / "bag", 5)


def test_columns_are_what_the_node_makes_of_each_message(lacking: Path) -> None:
    settings = {**ANGLES, "use_orientation": True}
    p = load_slip_parameters({f"sources.imu_data_raw.{name}": value for name, value in settings.items()})
    imu = p.gyros()["imu/data_raw"]
    with open_bag(lacking) as bag:
        messages = [bag.deserialize(m.raw, m.type_name) for m in bag.messages(["imu/data_raw"])]
        found = [m for m in measurements_of(read_inputs(bag, p, InputFilters(), ())) if type(m) is YawRate]
    live = [conversions.yaw_rate(message, "imu/data_raw", imu) for message in messages]
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


def with_messages(path: Path, emulated_bag: Path, more: list[BagMessage]) -> Path:
    """The bag with further messages."""
    with open_bag(emulated_bag) as bag:
        in_order = sorted([*bag.messages(), *more], key=lambda m: m.log_time_ns)
        return write_messages(path, in_order)


def journal(lines: list[tuple[int, Report]]) -> list[BagMessage]:
    """Messages of a journal, given as (log time, report) of each line."""
    messages = (conversions.measurement_report(make, report, k) for k, (_, report) in enumerate(lines))
    topic = "/measurement_reports"
    return [BagMessage(topic, REPORT, t, serialize(m)) for (t, _), m in zip(lines, messages, strict=True)]


def test_the_journal_orders_a_bag_while_it_is_read(emulated_bag: Path, tmp_path: Path) -> None:
    """Measurements are processed up to 0.3 s after their log times, with a reset between; one never is."""
    with open_bag(emulated_bag) as bag:
        inputs = read_inputs(bag, P, InputFilters(), ())
    rng = np.random.default_rng(5)
    late_ns = (rng.random(len(inputs.rows)) * 3e8).astype(np.int64)
    order = np.argsort(inputs.rows["log_time_ns"] + late_ns, kind="stable")
    times_ns = (inputs.rows["log_time_ns"] + late_ns)[order]
    live = inputs.rows[order]
    lines = [
        (int(t), Report(inputs.sources[row["source"]], int(row["stamp_ns"]), Outcome.ACCEPTED))
        for t, row in zip(times_ns, live, strict=True)
    ]
    lines[2000] = (lines[2000][0], Report(RESET, 0, Outcome.ACCEPTED))
    with open_bag(with_messages(tmp_path / "bag", emulated_bag, journal(lines))) as bag:
        reordered = read_inputs(bag, P, InputFilters(), ())
    assert_same_bits(np.delete(reordered.rows, 2000), np.delete(live, 2000))
    assert reordered.counts.lines == len(lines)
    assert (reordered.counts.lost_lines, reordered.counts.lost_inputs) == (0, 0)
    command = reordered.rows[2000]
    assert (command["kind"], reordered.sources[command["source"]]) == (IS_COMMAND, RESET)


def test_pose_set_with_stamp_0_does_not_extend_the_duration(emulated_bag: Path, tmp_path: Path) -> None:
    """Stamp 0 means now."""
    with open_bag(emulated_bag) as bag:
        expected = read_inputs(bag, P, InputFilters(), ()).duration_s
        pose = next(bag.messages(["box_pose"]))
        content = bag.deserialize(pose.raw, pose.type_name)
        content.header.stamp.sec = content.header.stamp.nanosec = 0
    message = pose._replace(topic="/slip_estimator/set_pose", raw=serialize(content))
    with open_bag(with_messages(tmp_path / "bag", emulated_bag, [message])) as bag:
        assert read_inputs(bag, P, InputFilters(), ()).duration_s == expected
