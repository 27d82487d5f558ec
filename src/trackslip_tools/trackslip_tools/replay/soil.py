# SPDX-License-Identifier: Apache-2.0
"""The soil estimator over a replay: its inputs are the replayed slips and the hydraulics of the bag."""

from collections import Counter, defaultdict, deque
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.input_filters import InputFilters, relative
from trackslip_bags.messages import make
from trackslip_bags.reader import Bag
from trackslip_common.make import stamp_ns_of
from trackslip_common.tally import Tally
from trackslip_estimation.slip.estimator import Estimate
from trackslip_estimation.slip.measurements import Sprockets
from trackslip_estimation.soil import conversions
from trackslip_estimation.soil.conversions import FORCES, SOIL
from trackslip_estimation.soil.records import HYDRAULICS, Hydraulics, TrackForces, inputs_of
from trackslip_estimation.soil.soil_estimator import SoilEstimator, SoilOutput, SoilState
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters
from trackslip_tools.replay.inputs import Inputs, absolute_time
from trackslip_tools.replay.scoring import Series

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
    wanted = {topic for topic, name in names.items() if name in _READ}
    readings: deque[tuple[int, Hydraulics]] = deque()
    rows: dict[str, dict[int, FloatArray]] = defaultdict(dict)
    limits = [absolute_time(bag, t) for t in (filters.start_s, filters.stop_s)]
    for message in bag.messages(wanted, *limits):
        name, content = names[message.topic], bag.deserialize(message.raw, message.type_name)
        result.messages[name] += 1
        if name != HYDRAULICS:
            rows[name][stamp_ns_of(content)] = numbers_of(content)
        elif not filters.hides(name, (message.log_time_ns - inputs.origin_ns) * 1e-9):
            readings.append((message.log_time_ns, conversions.hydraulics(content)))
    for name, by_stamp in rows.items():
        stamps = sorted(by_stamp)
        values = np.array([by_stamp[stamp] for stamp in stamps])
        result.series[name] = Series(np.array(stamps, dtype=np.int64), values)
    return readings


def _log_times(inputs: Inputs) -> dict[int, list[int]]:
    """Log times of the sprocket samples at each stamp: an estimate is published as its sample comes."""
    times: dict[int, list[int]] = defaultdict(list)
    for arrival in inputs.arrivals:
        if isinstance(arrival.measurement, Sprockets):
            times[arrival.measurement.stamp_ns].append(arrival.log_time_ns)
    return times


def numbers_of(message: Any) -> FloatArray:
    """All numbers of a TrackForces or SoilEstimate but its stamp."""
    fields = {name: getattr(message, name) for name in message.__dataclass_fields__}
    numbers = [v for v in fields.values() if isinstance(v, (bool, int, float, np.ndarray))]
    return np.concatenate([np.atleast_1d(np.asarray(v, dtype=np.float64)) for v in numbers])


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
        live = dict(zip(recorded.stamps_ns.tolist(), recorded.values, strict=True))
        theirs = {stamp for stamp in live if first <= stamp <= last}
        mine = {output.stamp_ns: output for output in outputs if first <= output.stamp_ns <= last}
        unmatched += len(theirs ^ mine.keys())
        compared += len(theirs)
        for stamp in theirs & mine.keys():
            message = conversions.message_of(make, mine[stamp], result.parameters.base_frame)
            largest = max(largest, _difference(live[stamp], numbers_of(message)))
    return SoilComparison(compared, unmatched, largest)


def _difference(a: FloatArray, b: FloatArray) -> float:
    """Largest relative difference; nothing equals nothing."""
    if a.shape != b.shape or (np.isnan(a) != np.isnan(b)).any():
        return float("inf")
    scale = np.maximum(np.abs(np.nan_to_num(a)), 1.0)
    return float(np.max(np.abs(np.nan_to_num(a - b)) / scale, initial=0.0))
