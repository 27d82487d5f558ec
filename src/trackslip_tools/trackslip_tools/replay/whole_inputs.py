# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The inputs of a whole bag of moderate length at once."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import Bag
from trackslip_estimation.slip.measurements import Reload
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_tools.replay.arrivals import ARRIVAL, IS_COMMAND, Rows, to_measurements
from trackslip_tools.replay.inputs import InputStream
from trackslip_tools.replay.live_order import JournalCounts
from trackslip_tools.replay.series import Series, SeriesCollector


@dataclass
class Inputs:
    """A whole bag's inputs."""

    sources: tuple[str, ...] = ()
    rows: Rows = field(default_factory=lambda: np.empty(0, ARRIVAL))  # in live order
    reloads: list[Reload] = field(default_factory=list)
    series: dict[str, Series] = field(default_factory=dict)  # by topic
    messages: Counter[str] = field(default_factory=Counter)  # by topic, all that was read
    counts: JournalCounts = field(default_factory=JournalCounts)
    duration_s: float = 0.0  # of the stamps

    def measurements(self, numbers: Mapping[str, int]) -> Rows:
        """(n,) MEASUREMENT without the commands; ``numbers``: the estimator's of each source."""
        measured = self.rows[self.rows["kind"] < IS_COMMAND]
        return to_measurements(measured, self.sources, numbers)


def read_inputs(
    bag: Bag, p: SlipEstimatorParameters, filters: InputFilters, series: tuple[str, ...]
) -> Inputs:
    """All inputs in live order, the filters applied, and the series of the topics named.

    Raises:
        InputError: as ``InputStream``.
    """
    stream = InputStream(bag, p, filters, series)
    collector = SeriesCollector()
    parts = [np.empty(0, ARRIVAL)]
    for batch in stream:
        parts.append(batch.rows)
        for topic, logged in batch.tables.items():
            collector.add(topic, logged.rows)
    rows = np.concatenate(parts)
    found = (collector.series(), stream.messages, stream.counts, stream.duration_s)
    return Inputs(stream.sources, rows, stream.reloads, *found)
