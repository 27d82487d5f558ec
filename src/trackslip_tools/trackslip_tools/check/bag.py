# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check of a bag: of its own pass over it, or of the measurements that a replay reads anyway."""

from collections.abc import Callable

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import Bag
from trackslip_estimation.setup_check.check import check
from trackslip_estimation.setup_check.collect import Collector
from trackslip_estimation.setup_check.finding import Result, Undetermined
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_tools.replay.inputs import InputStream

NO_SPROCKETS = Undetermined("everything: there are no sprockets", "record the topic sprockets")


def check_bag(
    bag: Bag,
    p: SlipEstimatorParameters,
    filters: InputFilters | None = None,
    advance: Callable[[float], None] = lambda _: None,
) -> Result:
    """Causes and what the bag cannot decide; ``advance`` is told the seconds that were read.

    Raises:
        InputError: the bag lacks the sprockets, or is damaged inside.
    """
    stream, collector = InputStream(bag, p, filters or InputFilters()), Collector(p)
    reached = 0.0
    for batch in stream:
        collector.add(batch.rows, stream.sources)
        advance(max(stream.duration_s - reached, 0.0))
        reached = max(reached, stream.duration_s)
    return result_of(collector)


def result_of(collector: Collector) -> Result:
    """Of all that was collected."""
    log = collector.log()
    return Result(undetermined=(NO_SPROCKETS,)) if log is None else check(log)
