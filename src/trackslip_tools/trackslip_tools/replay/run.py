# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One replay: a bag's inputs in live order through both estimators, then the comparison and the scores.

Works in batches and in bounded memory: of the estimates it keeps what the scores need.
"""

import time

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.parameters import bag_learned
from trackslip_bags.reader import Bag
from trackslip_common.topics import LOCAL_ODOMETRY, ODOMETRY, TRACK_SLIP, TRUE_ODOMETRY
from trackslip_estimation.setup_check.collect import Collector as SetupCollector
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.learned import Learned
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.soil.records import HYDRAULICS
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters, load_soil_parameters
from trackslip_tools.check.bag import check_collected, with_gated_sources
from trackslip_tools.replay.inputs import InputStream
from trackslip_tools.replay.no_estimate import explain_missing_estimate
from trackslip_tools.replay.parts import Watch, run_estimator, usable_learned
from trackslip_tools.replay.result import Collector, Replay, scored_topics
from trackslip_tools.replay.soil import SOIL_TOPICS, SoilRun
from trackslip_tools.replay.withheld import WithheldErrors

REFERENCES = ("reference_pose", TRUE_ODOMETRY)  # default references, the first that the bag has


def replay(
    bag: Bag,
    p: SlipEstimatorParameters,
    filters: InputFilters,
    reference: str | None,
    soil_p: SoilEstimatorParameters | None = None,
    watch: Watch = lambda _: None,
) -> Replay:
    """Run the slip estimator and, with ``soil_p``, the soil estimator over a bag; ``watch`` gets each part.

    Raises:
        InputError: the bag lacks a required topic, or is damaged.
    """
    began = time.monotonic()
    reference = reference or default_reference(bag)
    topics = (ODOMETRY, LOCAL_ODOMETRY, TRACK_SLIP, *(SOIL_TOPICS if soil_p is not None else ()))
    stream = InputStream(bag, p, filters, scored_topics(reference).union(topics))
    withheld, compares = WithheldErrors(filters, bag.start_ns), not filters.changes_inputs
    collector = Collector(stream, reference, p.vehicle.kinematics, withheld, compares=compares)
    soil = None
    if soil_p is not None and HYDRAULICS in stream.topics:
        soil = SoilRun(soil_p, stream.withholding, compares=compares)
    learned, start = learned_before_bag(bag, p)
    setup = SetupCollector(p, (soil_p or load_soil_parameters()).watch)
    for part in run_estimator(stream, SlipEstimator(p, learned=learned)):
        collector.add(part)
        setup.add(part.arrivals, part.sources)
        if HYDRAULICS in part.tables:
            setup.add_hydraulics(part.tables[HYDRAULICS].rows)
        if soil is not None:
            published = part.results["published"]
            soil.add(part.estimates, part.arrivals["log_time_ns"][published], part.tables)
        watch(part)
    result = collector.result()
    result.no_estimate = explain_missing_estimate(bag, p, filters, collector.processed)
    result.start = start
    counts = collector.processed
    result.setup = with_gated_sources(check_collected(setup, stream), counts.input_counts, counts.rejected)
    result.withheld = withheld.result(stream.withholding.counts)
    if soil is not None and stream.messages[HYDRAULICS]:
        result.soil = soil.result(stream.counts.comparable)
    result.vehicle = p.vehicle.name
    result.elapsed_s = time.monotonic() - began
    return result


def default_reference(bag: Bag) -> str | None:
    """The default reference topic that the bag has; None without one."""
    return next((r for r in REFERENCES if f"/{r}" in bag.topics or r in bag.topics), None)


def learned_before_bag(bag: Bag, p: SlipEstimatorParameters) -> tuple[Learned | None, str]:
    """What was learned before the bag, None if the bag lacks it for these parameters; a line for the user.

    Raises:
        InputError: the topic of the parameters holds something else.
    """
    return usable_learned(bag_learned(bag), p)
