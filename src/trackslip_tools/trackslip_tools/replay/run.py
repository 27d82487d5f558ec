# SPDX-License-Identifier: Apache-2.0
"""One replay: a bag's inputs in live order through both estimators, then the comparison and the scores.

Batch by batch, in bounded memory: what is kept of the estimates is what the scores need.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import Bag
from trackslip_common.tally import Tally
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Command, Outcome
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import ESTIMATE, RESULT
from trackslip_estimation.soil.records import HYDRAULICS
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters
from trackslip_tools.replay.arrivals import IS_COMMAND, IS_RELOAD, Rows, to_measurements
from trackslip_tools.replay.comparison import LiveComparer, LiveComparison, odometry_rows, slip_rows
from trackslip_tools.replay.dead_reckoning import DrivenCollector, Path, Sprocketed, dead_reckon
from trackslip_tools.replay.growing import GrowingRows
from trackslip_tools.replay.inputs import ODOMETRY, TRACK_SLIP, InputStream, Logged
from trackslip_tools.replay.scoring import (
    NeesCollector,
    Score,
    in_order,
    moving_slips,
    path_of,
    score,
    slip_rmse,
)
from trackslip_tools.replay.series import Series, SeriesCollector, reduced, series_of
from trackslip_tools.replay.soil import SOIL_TOPICS, SoilReplay, SoilRun

TRUE_ODOMETRY, TRUE_SLIP = "truth/odometry", "truth/track_slip"
REFERENCES = ("reference_pose", TRUE_ODOMETRY)  # used where none is named, if the bag has one

KEPT = np.dtype([(n, ESTIMATE[n]) for n in ("stamp_ns", "pose", "slips")], align=True)


class Part(NamedTuple):
    """What some seconds of a bag gave."""

    sources: tuple[str, ...]
    arrivals: Rows  # (n,) ARRIVAL in live order
    results: Rows  # (n,) RESULT, what became of them
    tables: dict[str, Logged]  # what was logged by then of other topics

    @property
    def estimates(self) -> Rows:
        """(m,) ESTIMATE that were published."""
        estimates: Rows = self.results["estimate"][self.results["published"]]
        return estimates


Watch = Callable[[Part], None]


@dataclass
class Replay:
    """All that a replay found out."""

    duration_s: float
    elapsed_s: float
    messages: Counter[str]  # by topic, all that was read
    estimates: Rows  # (n,) KEPT, what the estimator published
    rejected: Tally
    reference: str | None = None
    series: dict[str, Series] = field(default_factory=dict)  # of truth and reference
    sprockets: Sprocketed | None = None  # where there is a reference
    scores: dict[str, Score | None] = field(default_factory=dict)
    nees: float | None = None
    slip_rmse: float | None = None
    live: LiveComparison | None = None
    paths: dict[str, Path] = field(default_factory=dict)
    soil: SoilReplay | None = None  # where the bag has hydraulics
    vehicle: str = ""  # its name


def replay(
    bag: Bag,
    p: SlipEstimatorParameters,
    filters: InputFilters,
    reference: str | None,
    of_soil: SoilEstimatorParameters | None = None,
    watch: Watch = lambda _: None,
) -> Replay:
    """Run the estimators over a bag, the soil's where it has parameters; ``watch`` sees each part.

    Raises:
        InputError: the bag lacks what is needed, or is damaged inside.
    """
    began = time.monotonic()
    reference = reference or own_reference(bag)
    of_both = (ODOMETRY, TRACK_SLIP, *(SOIL_TOPICS if of_soil is not None else ()))
    stream = InputStream(bag, p, filters, _scored(reference).union(of_both))
    collector = _Collector(stream, reference, compares=not filters.changes_inputs)
    soil = (
        SoilRun(bag.start_ns, filters, of_soil)
        if of_soil is not None and HYDRAULICS in stream.topics
        else None
    )
    for part in run_estimator(stream, SlipEstimator(p)):
        collector.add(part)
        if soil is not None:
            published = part.results["published"]
            soil.add(part.estimates, part.arrivals["log_time_ns"][published], part.tables)
        watch(part)
    result = collector.result(p)
    result.soil = soil.result() if soil is not None and stream.messages[HYDRAULICS] else None
    result.vehicle = p.vehicle.name
    result.elapsed_s = time.monotonic() - began
    return result


def run_estimator(stream: InputStream, estimator: SlipEstimator) -> Iterator[Part]:
    """Part by part of a bag; commands and changes of parameters act where they came."""
    for batch in stream:
        rows = batch.rows
        results = np.zeros(len(rows), RESULT)
        begin = 0
        for end in (*np.flatnonzero(rows["kind"] >= IS_COMMAND).tolist(), len(rows)):
            given = to_measurements(rows[begin:end], stream.sources, estimator.sources)
            results[begin:end] = estimator.process_records(given)
            if end < len(rows):
                is_reload = rows["kind"][end] == IS_RELOAD
                command = Command(stream.sources[rows["source"][end]], int(rows["stamp_ns"][end]))
                estimator.apply_command(stream.reloads[rows["reload"][end]] if is_reload else command)
                results["stamp_ns"][end] = rows["stamp_ns"][end]
                results["nis"][end] = results["gate"][end] = np.nan
            begin = end + 1
        yield Part(stream.sources, rows, results, batch.tables)


class _Collector:
    """What is kept of the parts."""

    def __init__(self, stream: InputStream, reference: str | None, *, compares: bool) -> None:
        self._stream, self._reference, self._nees = stream, reference, NeesCollector()
        self._scored = _scored(reference)
        self._estimates, self._series = GrowingRows(KEPT), SeriesCollector()
        self._driven, self._rejected = DrivenCollector(), Tally()
        self._comparer, self._compares = LiveComparer(), compares

    def add(self, part: Part) -> None:
        """More of the bag."""
        estimates = part.estimates
        self._estimates.add(estimates)
        refused = part.results["outcome"] != Outcome.ACCEPTED
        pairs = np.column_stack((part.arrivals["source"][refused], part.results["outcome"][refused]))
        for (source, outcome), count in zip(*np.unique(pairs, axis=0, return_counts=True), strict=True):
            self._rejected.add(part.sources[source], Outcome(outcome), int(count))
        if self._scored:
            self._driven.add(part.arrivals)
        for topic in self._scored & part.tables.keys():
            self._series.add(topic, part.tables[topic].rows)
        if self._reference is not None:
            logged = part.tables.get(self._reference)
            self._nees.add(estimates, None if logged is None else reduced(logged.rows))
        if self._compares:
            self._compare(part.tables, estimates)

    def result(self, p: SlipEstimatorParameters) -> Replay:
        """When all was added."""
        stream = self._stream
        estimates, series = self._estimates.rows(), self._series.series()
        found = Replay(
            stream.duration_s, 0.0, stream.messages, estimates, self._rejected, self._reference, series
        )
        _score(found, p, self._driven)
        found.nees = self._nees.mean()
        if self._compares and stream.messages[ODOMETRY]:
            found.live = self._comparer.result(stream.counts)
        return found

    def _compare(self, tables: dict[str, Logged], estimates: Rows) -> None:
        """Every live number against the replayed one of the same stamp."""
        nothing = np.empty(0, ESTIMATE)
        if ODOMETRY in self._stream.topics:
            live = tables[ODOMETRY].rows if ODOMETRY in tables else nothing
            self._comparer.add_odometry(live, odometry_rows(estimates))
        if TRACK_SLIP in self._stream.topics:
            live = tables[TRACK_SLIP].rows if TRACK_SLIP in tables else nothing
            self._comparer.add_slips(live, slip_rows(estimates))


def _scored(reference: str | None) -> frozenset[str]:
    return frozenset(filter(None, (TRUE_SLIP, TRUE_ODOMETRY, reference)))


def own_reference(bag: Bag) -> str | None:
    """The topic to score against where none is named, if the bag has one."""
    return next((r for r in REFERENCES if f"/{r}" in bag.topics or r in bag.topics), None)


def _score(result: Replay, p: SlipEstimatorParameters, driven: DrivenCollector) -> None:
    """Paths of filter and dead reckoning, and their errors against the reference."""
    estimates = in_order(result.estimates)
    if len(estimates):
        result.paths["filter"] = path_of(estimates)
    result.slip_rmse = slip_error(result.series, estimates, p.vehicle.kinematics.tread)
    series = result.series.get(result.reference or "")
    if series is None:
        return
    sprockets, gyro = driven.sprockets(), driven.gyro()
    reference = reference_path(series, 0 if sprockets is None else int(sprockets.stamps_ns[0]))
    if sprockets is not None and len(reference.stamps_ns):
        start = (reference.stamps_ns[0], reference.poses[0])
        result.paths["dead_reckoning"] = dead_reckon(p.vehicle.kinematics, sprockets, *start)
        if gyro is not None:
            result.paths["encoder_gyro"] = dead_reckon(p.vehicle.kinematics, sprockets, *start, gyro)
    result.paths["reference"], result.sprockets = reference, sprockets
    for name in ("dead_reckoning", "encoder_gyro", "filter"):
        result.scores[name] = score(result.paths[name], reference) if name in result.paths else None


def slip_error(series: dict[str, Series], estimates: Rows, tread: float) -> float | None:
    """Of estimates in order, against the true slips, where the bag has them; while the machine moves."""
    slips, odometry = (series.get(topic) for topic in (TRUE_SLIP, TRUE_ODOMETRY))
    if slips is None or odometry is None or not len(estimates):
        return None
    left, right = estimates["slips"][:, 0], estimates["slips"][:, 1]
    own = series_of(stamp_ns=estimates["stamp_ns"], left_slip=left, right_slip=right)
    return slip_rmse(own, moving_slips(odometry, slips, tread))


def reference_path(series: Series, from_ns: int) -> Path:
    """The reference from the first sprocket sample on, its heading continuous."""
    covered = series.since(from_ns)
    poses = covered.columns("x", "y", "heading")
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Path(covered.stamps_ns.copy(), poses)
