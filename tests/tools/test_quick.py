# SPDX-License-Identifier: Apache-2.0
"""Replay of ordinary logs in one go, and topics read as columns: the same to the last bit as one by one."""

from collections.abc import Callable
from dataclasses import is_dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trackslip_bags import tables
from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import RESET, Command, Input, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_tools.replay.inputs import Inputs, read_inputs
from trackslip_tools.replay.quick import Steps, quick_steps

SERIES = ("truth/odometry", "truth/track_slip")


def bits(value: Any) -> Any:
    """Something that is equal where every bit is."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, (list, tuple)):
        return [bits(item) for item in value]
    if is_dataclass(value):
        return {name: bits(item) for name, item in vars(value).items()}
    return repr(value)


def one_by_one(inputs: list[Input], **changes: Any) -> Steps:
    return list(map(SlipEstimator(load_slip_parameters(changes)).advance, inputs))


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"model": "icr", "pose_lever_arms_x": [0.4], "yaw_rate_signs": [-1]},
        {"model": "free_slips", "filter": "daf", "use_heading": False},
    ],
)
def test_an_ordinary_log_goes_in_one(log: Any, changes: dict[str, Any]) -> None:
    """With late fixes, spikes, and a gyro that comes before the sprockets of its time."""
    inputs: list[Input] = list(log.measurements)
    fixes = [k for k, m in enumerate(inputs) if isinstance(m, PoseFix)]
    for k in fixes[20:60:7]:
        inputs[k] = replace(inputs[k], pose=inputs[k].pose + 3.0)  # type: ignore[call-arg, union-attr]
    found = quick_steps(inputs, load_slip_parameters(changes))
    assert found is not None
    expected = one_by_one(inputs, **changes)
    assert bits(found) == bits(expected)
    assert sum(report.outcome.refused for report, _ in found) > 5
    stamps = [m.stamp_ns for m in inputs]
    assert sum(after < before for before, after in pairwise(stamps)) > 100


def _with(at: int, given: Input) -> Callable[[list[Input]], list[Input]]:
    return lambda inputs: [*inputs[:at], given, *inputs[at:]]


def _without_sprockets(inputs: list[Input]) -> list[Input]:
    return [m for k, m in enumerate(inputs) if not (1500 < k < 1600 and isinstance(m, Sprockets))]


def _jumping(inputs: list[Input]) -> list[Input]:
    at = next(k for k in range(1500, 2000) if isinstance(inputs[k], Sprockets))
    return [*inputs[:at], replace(inputs[at], positions=(900.0, 0.0)), *inputs[at + 1 :]]  # type: ignore[call-arg]


@pytest.mark.parametrize(
    "change",
    [
        _with(2000, Command(RESET)),
        _with(2000, YawRate("imu/data_raw", 1, 0.0, 1e-4)),
        _with(2000, YawRate("imu/data_raw", 2**62, 0.0, 1e-4)),
        _with(2000, YawRate("imu/data_raw", 2000, float("nan"), 1e-4)),
        lambda inputs: [*inputs[:2000], inputs[1999], *inputs[2000:]],
        _without_sprockets,
        _jumping,
        lambda inputs: [m for m in inputs if not isinstance(m, PoseFix)],
        lambda _: [],
    ],
)
def test_all_other_logs_go_one_by_one(log: Any, change: Callable[[list[Input]], list[Input]]) -> None:
    assert quick_steps(change(list(log.measurements)), load_slip_parameters()) is None


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
        assert bits(by_column.inputs) == bits(by_message.inputs)
        assert by_column.messages == by_message.messages
        assert bits([by_column.series[name].rows for name in SERIES]) == bits(
            [by_message.series[name].rows for name in SERIES]
        )
        assert len(by_column.inputs) > 1000
