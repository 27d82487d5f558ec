# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A whole bag's measurements in the order of their stamps, for smoother and tuner."""

from typing import NamedTuple

import numpy as np

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import Bag
from trackslip_common.arrays import IntArray, Rows
from trackslip_common.errors import InputError
from trackslip_common.topics import TRUE_ODOMETRY, TRUE_SLIP
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.log import stamp_order
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import MEASUREMENT, SPROCKETS
from trackslip_tools.replay.arrivals import IS_COMMAND, to_measurements
from trackslip_tools.replay.growing import GrowingRows
from trackslip_tools.replay.inputs import InputStream
from trackslip_tools.replay.series import Series, SeriesCollector


class SortedInputs(NamedTuple):
    """Measurements and series of a bag; commands at run time (restart, hold still) are left out."""

    measurements: Rows  # (n,) MEASUREMENT by stamp
    series: dict[str, Series]  # by topic


def read_sorted_inputs(
    bag: Bag, p: SlipEstimatorParameters, filters: InputFilters, series: tuple[str, ...]
) -> SortedInputs:
    """All measurements after the filters, and the series of the topics, with covariances but for the truth.

    Raises:
        InputError: as ``InputStream``; or the clock of the sprockets goes back by more than the window.
    """
    stream, numbers = InputStream(bag, p, filters, series), SlipEstimator(p).sources
    detailed = frozenset(series) - {TRUE_SLIP, TRUE_ODOMETRY}
    collector, growing = SeriesCollector(detailed), GrowingRows(MEASUREMENT)
    clock = _ClockCheck(bag, p.history_window)
    for batch in stream:
        clock.check(batch.rows)
        measured = batch.rows[batch.rows["kind"] < IS_COMMAND]
        growing.add(to_measurements(measured, stream.sources, numbers))
        for topic, logged in batch.tables.items():
            collector.add(topic, logged.rows)
    measurements = growing.rows()
    _reorder(measurements, stamp_order(measurements))
    return SortedInputs(measurements, collector.series())


class _ClockCheck:
    """Rejects a bag whose clock was set back: stamps then occur twice and cannot be told apart."""

    def __init__(self, bag: Bag, window_s: float) -> None:
        self._bag, self._window_s = bag, window_s
        self._last_ns: int | None = None

    def check(self, rows: Rows) -> None:
        """Check rows of ``ARRIVAL`` in live order."""
        rows = rows[rows["kind"] == SPROCKETS]
        if not len(rows):
            return
        before_ns = int(rows["stamp_ns"][0]) if self._last_ns is None else self._last_ns
        back_s = -np.diff(rows["stamp_ns"], prepend=before_ns) * 1e-9
        self._last_ns = int(rows["stamp_ns"][-1])
        for k in np.flatnonzero(back_s > self._window_s)[:1].tolist():
            at_s = (int(rows["log_time_ns"][k]) - self._bag.start_ns) * 1e-9
            back = f"the clock goes back by {back_s[k]:.1f} s at {at_s:.2f} s"
            accepted = "accepted: a part with one time (--start, --stop)"
            raise InputError(f"bag '{self._bag.path}': {back}; {accepted}")


def _reorder(rows: Rows, order: IntArray) -> None:
    """Reorder in place, column by column: a copy of a long bag's measurements would not fit into memory."""
    if (np.diff(order) == 1).all():
        return
    columns = rows.view(np.int64).reshape(len(rows), -1)
    for column in columns.T:
        column[:] = column[order]
