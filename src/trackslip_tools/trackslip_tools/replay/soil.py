# SPDX-License-Identifier: Apache-2.0
"""The soil estimator over a replay: its inputs are the replayed slips and the hydraulics of the bag."""

from collections import Counter, defaultdict, deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.input_filters import InputFilters, relative
from trackslip_bags.messages import make
from trackslip_bags.reader import Bag
from trackslip_bags.tables import TopicTable, read_tables
from trackslip_common.message_fields import RECORDS, ForceFields, SoilFields, read
from trackslip_common.tally import Tally
from trackslip_common.topics import TOPICS
from trackslip_estimation.slip.estimator import Estimate
from trackslip_estimation.soil import conversions
from trackslip_estimation.soil.conversions import FORCES, SOIL
from trackslip_estimation.soil.records import HYDRAULICS, Hydraulics, TrackForces, inputs_of
from trackslip_estimation.soil.soil_estimator import SoilEstimator, SoilOutput, SoilState
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters
from trackslip_tools.replay.arrivals import Kind
from trackslip_tools.replay.inputs import Inputs, absolute_time
from trackslip_tools.replay.series import Series, SeriesCollector

FloatArray = NDArray[np.float64]

TRUE_FORCES, TRUE_SOIL = "truth/track_forces", "truth/soil"
_READ = (HYDRAULICS, FORCES, SOIL, TRUE_FORCES, TRUE_SOIL)
_TOLERANCE = 1e-9  # relative, between a live and a replayed number


class SoilComparison(NamedTuple):
    """The live forces and soils in the bag against the replayed ones, where both are."""

    compared: int
    unmatched: int
    largest_difference: float  # relative

    @property
    def matches(self) -> bool:
        """Same stamps, same numbers."""
        return self.compared > 0 and self.unmatched == 0 and self.largest_difference <= _TOLERANCE

    def __str__(self) -> str:
        verdict = "yes" if self.matches else "NO"
        numbers = f"{self.compared} messages, {self.unmatched} unmatched"
        return f"soil: replay = live: {verdict} ({numbers}, largest difference {self.largest_difference:.1e})"


@dataclass
class SoilReplay:
    """What the soil estimator made of a replay."""

    parameters: SoilEstimatorParameters
    outputs: list[SoilOutput] = field(default_factory=list)
    rejected: Tally = field(default_factory=Tally)
    messages: Counter[str] = field(default_factory=Counter)
    series: dict[str, Series] = field(default_factory=dict)  # by topic, what the bag holds of live and truth
    live_classes: dict[int, FloatArray] = field(default_factory=dict)  # stamp → probabilities, live
    live: SoilComparison | None = None

    @property
    def forces(self) -> list[TrackForces]:
        """Those for ``track_forces``."""
        return [output for output in self.outputs if isinstance(output, TrackForces)]

    @property
    def states(self) -> list[SoilState]:
        """Those for ``soil``."""
        return [output for output in self.outputs if isinstance(output, SoilState)]


def replay_soil(
    bag: Bag, inputs: Inputs, estimates: list[Estimate], filters: InputFilters, p: SoilEstimatorParameters
) -> SoilReplay | None:
    """Run the soil estimator over what a replay published; None where the bag has no hydraulics.

    Raises:
        InputError: the bag is damaged inside.
    """
    result = SoilReplay(p)
    readings = _read(bag, inputs, filters, result)
    if not result.messages[HYDRAULICS]:
        return None
    estimator = SoilEstimator(p)
    result.rejected = estimator.tally
    log_times = _log_times(inputs)
    for estimate in estimates:
        published_ns = log_times[estimate.stamp_ns].pop(0)
        while readings and readings[0][0] <= published_ns:
            result.outputs += estimator.advance(readings.popleft()[1])
        for half in inputs_of(estimate):
            result.outputs += estimator.advance(half)
    for _, reading in readings:
        result.outputs += estimator.advance(reading)
    if result.series.keys() & {FORCES, SOIL} and not filters.changes_inputs:
        result.live = _compare(result)
    return result


def _read(
    bag: Bag, inputs: Inputs, filters: InputFilters, result: SoilReplay
) -> deque[tuple[int, Hydraulics]]:
    """Log time and reading of the hydraulics; the live and true outputs go into the result."""
    names = {topic: filters.remap.get(relative(topic), relative(topic)) for topic in bag.topics}
    wanted = [topic for topic, name in names.items() if name in _READ]
    readings: deque[tuple[int, Hydraulics]] = deque()
    collector = SeriesCollector()
    limits = [absolute_time(bag, t) for t in (filters.start_s, filters.stop_s)]
    for stretch in read_tables(bag, wanted, *limits):
        for topic, table in stretch.items():
            name = names[topic]
            result.messages[name] += len(table)
            rows = table.rows(RECORDS[TOPICS[name].type_name])
            if name == HYDRAULICS:
                for logged_ns, row in zip(table.log_times_ns.tolist(), rows.tolist(), strict=True):
                    if not filters.hides(name, (logged_ns - inputs.origin_ns) * 1e-9):
                        readings.append((logged_ns, Hydraulics(*row)))
            else:
                collector.add(name, rows)
            if name == SOIL:
                result.live_classes |= _classes(table)
    result.series = collector.series()
    return readings


def _classes(table: TopicTable) -> dict[int, FloatArray]:
    messages = map(table.message, range(len(table)))
    stamps_ns = table.rows(SoilFields)["stamp_ns"].tolist()
    return {t: np.asarray(m.class_probabilities) for t, m in zip(stamps_ns, messages, strict=True)}


def _log_times(inputs: Inputs) -> dict[int, list[int]]:
    """Log times of the sprocket samples at each stamp: an estimate is published as its sample comes."""
    times: dict[int, list[int]] = defaultdict(list)
    rows = inputs.rows[inputs.rows["kind"] == Kind.SPROCKETS]
    for stamp_ns, logged_ns in zip(rows["stamp_ns"].tolist(), rows["log_time_ns"].tolist(), strict=True):
        times[stamp_ns].append(logged_ns)
    return times


def _compare(result: SoilReplay) -> SoilComparison:
    """Every live number against the replayed one, between the first and last stamp of both on a topic."""
    compared = unmatched = 0
    largest = 0.0
    for topic, outputs in ((FORCES, result.forces), (SOIL, result.states)):
        recorded = result.series.get(topic)
        if recorded is None or not outputs:
            continue
        first = max(int(recorded.stamps_ns[0]), outputs[0].stamp_ns)
        last = min(int(recorded.stamps_ns[-1]), outputs[-1].stamp_ns)
        live = {int(row["stamp_ns"]): row for row in recorded.rows}
        theirs = {stamp for stamp in live if first <= stamp <= last}
        mine = {output.stamp_ns: output for output in outputs if first <= output.stamp_ns <= last}
        unmatched += len(theirs ^ mine.keys())
        compared += len(theirs)
        for stamp in theirs & mine.keys():
            message = conversions.message_of(make, mine[stamp], result.parameters.base_frame)
            own = np.array(read(ForceFields if topic == FORCES else SoilFields, message), dtype=np.float64)
            largest = max(largest, _difference(np.array(live[stamp].tolist(), dtype=np.float64), own))
            if topic == SOIL:
                classes = np.asarray(message.class_probabilities)
                largest = max(largest, _difference(result.live_classes[stamp], classes))
    return SoilComparison(compared, unmatched, largest)


def _difference(a: FloatArray, b: FloatArray) -> float:
    """Largest relative difference; nothing equals nothing."""
    if a.shape != b.shape or (np.isnan(a) != np.isnan(b)).any():
        return float("inf")
    scale = np.maximum(np.abs(np.nan_to_num(a)), 1.0)
    return float(np.max(np.abs(np.nan_to_num(a - b)) / scale, initial=0.0))
