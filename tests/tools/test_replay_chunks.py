# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Replays in batches of any length, and topics read as columns, equal message-wise ones bit for bit."""

from pathlib import Path
from typing import Any

import pytest
from fixtures.whole_inputs import Inputs, read_inputs

from trackslip_bags import chunks, tables
from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import open_bag
from trackslip_common.vehicle_files import vehicle_layer
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_tools.replay.run import replay
from trackslip_tools.report.details import Details

SERIES = ("truth/odometry", "truth/track_slip")


def test_the_length_of_the_batches_changes_nothing(
    emulated_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Holds for both estimators."""
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


def test_reading_by_column_equals_reading_by_message(
    emulated_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Holds also for a part of the bag."""

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
