# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A replay in batches of any length, and topics read as columns: the same to the last bit as one by one."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trackslip_bags import chunks, tables
from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_common.vehicle_files import vehicle_layer
from trackslip_estimation.slip.estimator import SlipEstimator, make_step
from trackslip_estimation.slip.measurements import (
    Measurement,
    Outcome,
    PoseFix,
    Sprockets,
    YawRate,
)
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import POSE, to_records
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_tools.replay.arrivals import Rows
from trackslip_tools.replay.run import replay
from trackslip_tools.replay.whole_inputs import Inputs, read_inputs
from trackslip_tools.report.details import Details

SERIES = ("truth/odometry", "truth/track_slip")
Change = Callable[[list[Measurement]], list[Measurement]]


def results_of(records: Rows, sizes: list[int], **changes: Any) -> Rows:
    """RESULT of records given so many at a time, in turn."""
    estimator, ends = SlipEstimator(load_slip_parameters(changes)), np.cumsum(sizes)
    ends = np.concatenate(
        (np.arange(0, len(records), ends[-1])[:, np.newaxis] + ends).tolist(), dtype=np.int64
    )
    return np.concatenate([estimator.process_records(part) for part in np.split(records, ends)])


def bits(results: Rows) -> list[tuple[Any, ...]]:
    """Something that is equal where every bit is; an estimate that is not published is none."""
    names = ["stamp_ns", "outcome", "dof", "nis", "gate"]
    estimates = [
        e.tobytes() if there else b""
        for e, there in zip(results["estimate"], results["published"], strict=True)
    ]
    return [(*(row[name].tobytes() for name in names), e) for row, e in zip(results, estimates, strict=True)]


def spiked(measurements: tuple[Measurement, ...], changes: dict[str, Any]) -> Rows:
    """With late fixes, spikes, and a gyro that comes before the sprockets of its time."""
    records = to_records(measurements, SlipEstimator(load_slip_parameters(changes)).sources)
    records["value"][np.flatnonzero(records["kind"] == POSE)[20:60:7]] += 3.0
    return records


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"model": "icr", "sources.box_pose.lever_arm_x": 0.4, "sources.imu_data_raw.sign": -1},
        {"model": "free_slips", "filter": "daf", "sources.box_pose.use_heading": False},
    ],
)
def test_many_at_once_are_one_by_one(log: Any, changes: dict[str, Any]) -> None:
    records = spiked(log.measurements, changes)
    expected = results_of(records, [1], **changes)
    assert bits(results_of(records, [7, 1, 300, 0, 1000], **changes)) == bits(expected)
    assert bits(results_of(records, [len(records)], **changes)) == bits(expected)
    assert np.isin(expected["outcome"], [o for o in Outcome if o.refused]).sum() > 5
    assert sum(after < before for before, after in pairwise(records["stamp_ns"].tolist())) > 100


def _with(given: Measurement) -> Change:
    return lambda inputs: [*inputs[:2000], given, *inputs[2000:]]


@pytest.mark.parametrize(
    "change",
    [
        _with(YawRate("imu/data_raw", 1, 0.0, 1e-4)),
        _with(YawRate("imu/data_raw", 2**62, 0.0, 1e-4)),
        _with(YawRate("imu/data_raw", 2000, float("nan"), 1e-4)),
        lambda inputs: [*inputs[:2000], inputs[1999], *inputs[2000:]],
        lambda inputs: [
            m for k, m in enumerate(inputs) if not (1500 < k < 1900 and isinstance(m, Sprockets))
        ],
        lambda inputs: [m for m in inputs if not isinstance(m, PoseFix)],
        lambda inputs: [*inputs, *inputs],
    ],
)
def test_what_is_out_of_the_ordinary_too(log: Any, change: Change) -> None:
    """Nonsense, duplicates, silence, no start, and a clock that goes back."""
    sources = SlipEstimator(load_slip_parameters()).sources
    records = to_records(change(list(log.measurements)), sources)
    assert bits(results_of(records, [400, 3])) == bits(results_of(records, [1]))


def test_measurements_and_their_records_are_one(log: Any) -> None:
    p, given = load_slip_parameters(), log.measurements[:600]
    estimator = SlipEstimator(p)
    steps = [
        make_step(found.item(), m.source)
        for found, m in zip(results_of(to_records(given, estimator.sources), [50]), given, strict=True)
    ]
    one_by_one = [estimator.process(m) for m in given]
    assert [repr(report) for report, _ in steps] == [repr(report) for report, _ in one_by_one]
    assert [e is None for _, e in steps] == [e is None for _, e in one_by_one]


def test_the_length_of_the_batches_changes_nothing(
    emulated_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of both estimators."""
    p = load_slip_parameters()
    of_soil = load_soil_parameters(vehicle_layer(p.vehicle))

    def found() -> list[Any]:
        details = Details()
        with open_bag(emulated_bag) as bag:
            result = replay(bag, p, InputFilters(), None, of_soil, details.add)
        assert result.soil is not None
        states = [repr(vars(state)) for state in result.soil.states]
        forces = result.soil.forces.tobytes()
        numbers = [result.nees, result.slip_rmse]
        numbers += [value for scored in result.scores.values() for value in vars(scored).values()]
        rounded = [round(number, 9) for number in numbers if number is not None]  # sums over the batches
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


def test_columns_give_what_messages_give(emulated_bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of a part of the bag."""

    def read(filters: InputFilters) -> Inputs:
        with open_bag(emulated_bag) as bag:
            return read_inputs(bag, load_slip_parameters(), filters, SERIES)

    for filters in (InputFilters(), InputFilters(start_s=10.0, stop_s=20.0)):
        by_column = read(filters)
        with monkeypatch.context() as patch:
            patch.setattr(tables, "_LAYOUTS", 0)
            by_message = read(filters)
        assert by_column.rows.tobytes() == by_message.rows.tobytes()
        assert by_column.messages == by_message.messages
        for name in SERIES:
            assert by_column.series[name].rows.tobytes() == by_message.series[name].rows.tobytes()
        assert len(by_column.rows) > 1000
