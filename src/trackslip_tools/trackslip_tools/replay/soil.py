# SPDX-License-Identifier: Apache-2.0
"""The soil estimator over a replay: its inputs are the replayed slips and the hydraulics of the bag."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.column_cache import read_columns
from trackslip_bags.columns import Columns, IrregularError
from trackslip_bags.input_filters import InputFilters, relative
from trackslip_bags.messages import make
from trackslip_bags.reader import Bag
from trackslip_common.make import stamp_ns_of
from trackslip_common.tally import Tally
from trackslip_estimation.slip.estimator import Estimate
from trackslip_estimation.slip.measurements import Sprockets
from trackslip_estimation.soil import conversions, records
from trackslip_estimation.soil.conversions import FORCES, SOIL
from trackslip_estimation.soil.records import (
    HYDRAULICS,
    IS_HYDRAULICS,
    IS_ODOMETRY,
    IS_SLIPS,
    SOIL_INPUT,
    SlipSeed,
)
from trackslip_estimation.soil.soil_estimator import SoilEstimator, SoilOutput, SoilOutputs, SoilState
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters
from trackslip_tools.replay import columns as by_column
from trackslip_tools.replay.inputs import Inputs, absolute_time
from trackslip_tools.replay.scoring import Series

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

TRUE_FORCES, TRUE_SOIL = "truth/track_forces", "truth/soil"
_READ = (HYDRAULICS, FORCES, SOIL, TRUE_FORCES, TRUE_SOIL)
_TOLERANCE = 1e-9  # relative, between a live and a replayed number
_CHUNK = 10_000  # estimates that are made inputs of at a time


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


class _Topic(NamedTuple):
    """The numbers of all messages of a topic, in log order."""

    log_times_ns: IntArray  # (n,)
    stamps_ns: IntArray  # (n,)
    columns: Columns  # in the order of the message's fields

    def series(self) -> Series:
        """All numbers by stamp; of several with the same stamp the last."""
        stamps, from_the_end = np.unique(self.stamps_ns[::-1], return_index=True)
        rows = np.column_stack([column.astype(np.float64) for column in self.columns.values()])
        return Series(stamps, rows[::-1][from_the_end])


@dataclass
class SoilReplay:
    """What the soil estimator made of a replay."""

    parameters: SoilEstimatorParameters
    forces: NDArray[Any] = field(default_factory=lambda: np.zeros(0, records.FORCES))
    states: list[SoilState] = field(default_factory=list)
    seeds: list[SlipSeed] = field(default_factory=list)
    rejected: Tally = field(default_factory=Tally)
    messages: Counter[str] = field(default_factory=Counter)
    series: dict[str, Series] = field(default_factory=dict)  # by topic, what the bag holds of live and truth
    live: SoilComparison | None = None

    @property
    def outputs(self) -> list[SoilOutput]:
        """All that is published, by stamp."""
        return SoilOutputs(self.forces, self.states, self.seeds).in_order()


def replay_soil(
    bag: Bag, inputs: Inputs, estimates: list[Estimate], filters: InputFilters, p: SoilEstimatorParameters
) -> SoilReplay | None:
    """Run the soil estimator over what a replay published; None where the bag has no hydraulics.

    Raises:
        InputError: the bag is damaged inside.
    """
    topics = _read(bag, filters)
    if HYDRAULICS not in topics:
        return None
    messages = Counter({name: len(topic.stamps_ns) for name, topic in topics.items()})
    readings = _visible(topics.pop(HYDRAULICS), inputs.origin_ns, filters)
    estimator = SoilEstimator(p)
    parts = [
        part
        for chunk in _in_order(readings, estimates, _published_ns(inputs, estimates))
        for part in estimator.advance_all(chunk)
    ]
    result = SoilReplay(
        p,
        np.concatenate([np.zeros(0, records.FORCES), *(part.forces for part in parts)]),
        [state for part in parts for state in part.states],
        [seed for part in parts for seed in part.seeds],
        estimator.tally,
        messages,
        {name: topic.series() for name, topic in topics.items()},
    )
    if topics.keys() & {FORCES, SOIL} and not filters.changes_inputs:
        result.live = _compare(result)
    return result


def _read(bag: Bag, filters: InputFilters) -> dict[str, _Topic]:
    """By name the topics that there are, within the limits of time."""
    names = {topic: filters.remap.get(relative(topic), relative(topic)) for topic in bag.topics}
    names = {topic: name for topic, name in names.items() if name in _READ}
    span = [absolute_time(bag, t) for t in (filters.start_s, filters.stop_s)]
    try:
        whole = read_columns(bag, names)
    except IrregularError:
        found = _from_messages(bag, names, span)
    else:
        found = {}
        for topic, columns in whole.items():
            _, log_times_ns, fields = columns.between(*span)
            numbers = {n: c for n, c in fields.items() if not n.startswith("header.") and c.dtype.kind != "U"}
            found[names[topic]] = _Topic(log_times_ns, by_column.stamps_ns(fields), numbers)
    return {name: topic for name, topic in found.items() if len(topic.stamps_ns)}


def _from_messages(bag: Bag, names: dict[str, str], span: list[int | None]) -> dict[str, _Topic]:
    """The same, one message after the other."""
    rows: dict[str, list[tuple[int, Any]]] = {}
    for message in bag.messages(names, *span):
        content = bag.deserialize(message.raw, message.type_name)
        rows.setdefault(names[message.topic], []).append((message.log_time_ns, content))
    return {name: _topic_of(of_topic) for name, of_topic in rows.items()}


def _topic_of(rows: Sequence[tuple[int, Any]]) -> _Topic:
    """Of log times and messages."""
    times, contents = zip(*rows, strict=True)
    stamps = np.array([stamp_ns_of(content) for content in contents], dtype=np.int64)
    fields = {n: np.array([getattr(c, n) for c in contents]) for n in number_fields(contents[0])}
    return _Topic(np.array(times, dtype=np.int64), stamps, fields)


def number_fields(message: Any) -> list[str]:
    """The names of a message's fields that hold numbers."""
    return [
        name
        for name in message.__dataclass_fields__
        if isinstance(getattr(message, name), (bool, int, float, np.ndarray))
    ]


def _visible(readings: _Topic, origin_ns: int, filters: InputFilters) -> _Topic:
    """Without those that are withheld."""
    if not filters.withhold:
        return readings
    seconds = ((readings.log_times_ns - origin_ns) * 1e-9).tolist()
    kept = ~np.array([filters.hides(HYDRAULICS, t) for t in seconds], dtype=bool)
    columns = {name: column[kept] for name, column in readings.columns.items()}
    return _Topic(readings.log_times_ns[kept], readings.stamps_ns[kept], columns)


def _published_ns(inputs: Inputs, estimates: Sequence[Estimate]) -> IntArray:
    """(n,) log times of the sprocket samples of the estimates: each is published as its sample comes."""
    samples = [arrival for arrival in inputs.arrivals if isinstance(arrival.measurement, Sprockets)]
    stamps = np.array([sample.measurement.stamp_ns for sample in samples], dtype=np.int64)
    order = np.argsort(stamps, kind="stable")
    wanted = np.array([estimate.stamp_ns for estimate in estimates], dtype=np.int64)
    by_stamp = np.argsort(wanted, kind="stable")
    ordered = wanted[by_stamp]
    again = np.arange(len(wanted)) - np.searchsorted(ordered, ordered)  # a stamp may occur again
    log_times = np.array([sample.log_time_ns for sample in samples], dtype=np.int64)[order]
    published = np.empty_like(wanted)
    published[by_stamp] = log_times[np.searchsorted(stamps[order], ordered) + again]
    return published


def _in_order(readings: _Topic, estimates: list[Estimate], published_ns: IntArray) -> Iterator[NDArray[Any]]:
    """SOIL_INPUT in the order in which a live estimator has them, some at a time."""
    # A reading comes before the first estimate that is published no earlier.
    latest = np.maximum.accumulate
    before = np.searchsorted(latest(published_ns), latest(readings.log_times_ns))
    for first in range(0, len(estimates) + 1, _CHUNK):
        last = min(first + _CHUNK, len(estimates))
        end = last if last < len(estimates) else last + 1
        begin, stop = np.searchsorted(before, (first, end)).tolist()
        chunk = np.zeros(stop - begin + 2 * (last - first), SOIL_INPUT)
        of_readings = 2 * (before[begin:stop] - first) + np.arange(stop - begin)
        others = np.ones(len(chunk), dtype=bool)
        others[of_readings] = False
        chunk[of_readings] = _reading_inputs(readings, slice(begin, stop))
        chunk[others] = estimate_inputs(estimates[first:last])
        yield chunk


def _reading_inputs(readings: _Topic, which: slice) -> NDArray[Any]:
    """(n,) SOIL_INPUT."""
    found = np.zeros(len(readings.stamps_ns[which]), SOIL_INPUT)
    found["source"], found["stamp_ns"] = IS_HYDRAULICS, readings.stamps_ns[which]
    for k, side in enumerate(("left", "right")):
        found["pressures"][:, k] = readings.columns[f"{side}_pressure"][which]
        found["spools"][:, k] = readings.columns[f"{side}_spool"][which]
    return found


def estimate_inputs(estimates: Sequence[Estimate]) -> NDArray[Any]:
    """(2 n,) SOIL_INPUT, of each estimate the odometry and the slips."""
    found = np.zeros((len(estimates), 2), SOIL_INPUT)
    if estimates:
        found["stamp_ns"] = np.array([[estimate.stamp_ns] for estimate in estimates])
        odometry, slips = found[:, 0], found[:, 1]
        odometry["source"], slips["source"] = IS_ODOMETRY, IS_SLIPS
        odometry["twist"] = [estimate.outputs.twist for estimate in estimates]
        odometry["twist_covariance"] = [estimate.outputs.twist_covariance for estimate in estimates]
        odometry["pose"] = [estimate.pose for estimate in estimates]
        odometry["pose_covariance"] = [estimate.pose_covariance for estimate in estimates]
        slips["slips"] = [estimate.outputs.slips for estimate in estimates]
        slips["motion"] = [int(estimate.motion) for estimate in estimates]
    return found.ravel()


def _compare(result: SoilReplay) -> SoilComparison:
    """Every live number against the replayed one, between the first and last stamp of both on a topic."""
    compared = unmatched = 0
    largest = 0.0
    for topic, own in _series_of(result):
        live = result.series.get(topic)
        if live is None:
            continue
        first, last = max(live.stamps_ns[0], own.stamps_ns[0]), min(live.stamps_ns[-1], own.stamps_ns[-1])
        theirs, mine = (_between(of, first, last) for of in (live, own))
        _, in_theirs, in_mine = np.intersect1d(theirs.stamps_ns, mine.stamps_ns, return_indices=True)
        unmatched += len(theirs.stamps_ns) + len(mine.stamps_ns) - 2 * len(in_mine)
        compared += len(theirs.stamps_ns)
        largest = max(largest, _difference(theirs.values[in_theirs], mine.values[in_mine]))
    return SoilComparison(compared, unmatched, largest)


def _series_of(result: SoilReplay) -> Iterator[tuple[str, Series]]:
    """Topic and numbers of the outputs, as messages carry them."""
    if len(result.forces):
        columns = conversions.force_columns(result.forces)
        names = number_fields(make("trackslip_msgs/msg/TrackForces"))
        stamps = result.forces["stamp_ns"]
        yield FORCES, _Topic(stamps, stamps, {name: columns[name] for name in names}).series()
    if result.states:
        frame = result.parameters.base_frame
        yield (
            SOIL,
            _topic_of([(0, conversions.soil_estimate(make, s, frame)) for s in result.states]).series(),
        )


def _between(series: Series, first_ns: int, last_ns: int) -> Series:
    inside = (first_ns <= series.stamps_ns) & (series.stamps_ns <= last_ns)
    return Series(series.stamps_ns[inside], series.values[inside])


def _difference(a: FloatArray, b: FloatArray) -> float:
    """Largest relative difference; nothing equals nothing."""
    if a.shape != b.shape or (np.isnan(a) != np.isnan(b)).any():
        return float("inf")
    scale = np.maximum(np.abs(np.nan_to_num(a)), 1.0)
    return float(np.max(np.abs(np.nan_to_num(a - b)) / scale, initial=0.0))
