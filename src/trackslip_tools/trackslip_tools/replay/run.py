# SPDX-FileCopyrightText: 2026 Trackslip authors
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
from trackslip_common.vehicle import Kinematics
from trackslip_estimation.attitude.records import OrientationRefusal
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.learned_text import Finding, findings
from trackslip_estimation.slip.local_odometry import LocalOdometry
from trackslip_estimation.slip.measurements import Command, Outcome
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import ESTIMATE, RESULT
from trackslip_estimation.soil.records import HYDRAULICS
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters
from trackslip_tools.replay.arrivals import IS_COMMAND, IS_RELOAD, Rows, to_measurements
from trackslip_tools.replay.comparison import (
    LiveComparer,
    LiveComparison,
    odometry_rows,
    slip_rows,
    tilt_rows,
)
from trackslip_tools.replay.dead_reckoning import Path
from trackslip_tools.replay.errors import PathErrors, SlipErrors
from trackslip_tools.replay.growing import MOST_DRAWN, GrowingRows
from trackslip_tools.replay.inputs import (
    LOCAL_ODOMETRY,
    ODOMETRY,
    TRACK_SLIP,
    TRUE_SWING,
    InputStream,
    Logged,
)
from trackslip_tools.replay.no_estimate import Taken, why_no_estimate
from trackslip_tools.replay.reckoning import Reckoning
from trackslip_tools.replay.scoring import Score, in_order, path_of, reference_path
from trackslip_tools.replay.series import Series, SeriesCollector, reduced
from trackslip_tools.replay.soil import SOIL_TOPICS, SoilReplay, SoilRun
from trackslip_tools.replay.start import learned_before
from trackslip_tools.replay.swing import SwingErrors
from trackslip_tools.replay.tilt import TiltErrors
from trackslip_tools.replay.withheld import Withheld, WithheldErrors

TRUE_ODOMETRY, TRUE_SLIP = "truth/odometry", "truth/track_slip"
REFERENCES = ("reference_pose", TRUE_ODOMETRY)  # used where none is named, if the bag has one

KEPT = np.dtype([(n, ESTIMATE[n]) for n in ("stamp_ns", "pose", "slips")], align=True)


_PIECE = 512  # arrivals between looks at what was learned: seconds


class Known(NamedTuple):
    """What the estimator knew of the machine and its ground."""

    stamp_ns: int
    findings: list[Finding]


class Part(NamedTuple):
    """What some seconds of a bag gave."""

    sources: tuple[str, ...]
    arrivals: Rows  # (n,) ARRIVAL in live order
    results: Rows  # (n,) RESULT, what became of them
    tables: dict[str, Logged]  # what was logged by then of other topics
    learned: list[Known]  # in the course of it

    @property
    def estimates(self) -> Rows:
        """(m,) ESTIMATE that were published."""
        estimates: Rows = self.results["estimate"][self.results["published"]]
        return estimates


Watch = Callable[[Part], None]


@dataclass
class Replay:
    """All that a replay found out; of long bags estimates, series and paths are thinned, not the scores."""

    duration_s: float
    elapsed_s: float
    messages: Counter[str]  # by topic, all that was read
    estimates: Rows  # (n,) KEPT, what the estimator published
    rejected: Tally
    last: Rows = field(default_factory=lambda: np.empty(0, KEPT))  # (1,), or (0,) where there is none
    reference: str | None = None
    series: dict[str, Series] = field(default_factory=dict)  # of truth and reference
    scores: dict[str, Score | None] = field(default_factory=dict)
    nees: float | None = None  # of the pose, where the reference has headings
    nees_position: float | None = None
    slip_rmse: float | None = None
    attitude_rmse: float | None = None  # of roll and of pitch, rad
    height_rmse: float | None = None  # m
    swing_rmse: float | None = None  # rad
    live: LiveComparison | None = None
    paths: dict[str, Path] = field(default_factory=dict)
    soil: SoilReplay | None = None  # where the bag has hydraulics
    no_estimate: str = ""  # why there is none, or none with a heading
    vehicle: str = ""  # its name
    learned: list[Known] = field(default_factory=list)  # in the course of it
    withheld: list[Withheld] = field(default_factory=list)
    start: str = ""  # what it started from, where that is not the parameters alone


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
    of_both = (ODOMETRY, LOCAL_ODOMETRY, TRACK_SLIP, *(SOIL_TOPICS if of_soil is not None else ()))
    stream = InputStream(bag, p, filters, _scored(reference).union(of_both))
    withheld = WithheldErrors(filters, bag.start_ns)
    collector = _Collector(
        stream, reference, p.vehicle.kinematics, withheld, compares=not filters.changes_inputs
    )
    soil = (
        SoilRun(bag.start_ns, filters, of_soil)
        if of_soil is not None and HYDRAULICS in stream.topics
        else None
    )
    learned, start = learned_before(bag, p)
    for part in run_estimator(stream, SlipEstimator(p, learned=learned)):
        collector.add(part)
        if soil is not None:
            published = part.results["published"]
            soil.add(part.estimates, part.arrivals["log_time_ns"][published], part.tables)
        watch(part)
    result = collector.result()
    result.no_estimate = why_no_estimate(bag, p, filters, collector.taken)
    result.start = start
    of_soil_alone = soil.hidden if soil is not None else [0] * len(stream.hidden)
    result.withheld = withheld.result([sum(n) for n in zip(stream.hidden, of_soil_alone, strict=True)])
    result.soil = soil.result() if soil is not None and stream.messages[HYDRAULICS] else None
    result.vehicle = p.vehicle.name
    result.elapsed_s = time.monotonic() - began
    return result


def run_estimator(stream: InputStream, estimator: SlipEstimator) -> Iterator[Part]:
    """Part by part of a bag; commands and changes of parameters act where they came."""
    for batch in stream:
        rows = batch.rows
        results = np.zeros(len(rows), RESULT)
        commands = np.flatnonzero(rows["kind"] >= IS_COMMAND)
        learned: list[Known] = []
        begin = 0
        for end in np.union1d(commands, (*range(_PIECE, len(rows), _PIECE), len(rows))).tolist():
            given = to_measurements(rows[begin:end], stream.sources, estimator.sources)
            results[begin:end] = estimator.process_records(given)
            begin = end
            if estimator.started and end > 0:
                stamp_ns = estimator.newest_ns or 0
                learned.append(Known(stamp_ns, findings(estimator.learned, estimator.meaning)))
            if end in commands:
                is_reload = rows["kind"][end] == IS_RELOAD
                command = Command(stream.sources[rows["source"][end]], int(rows["stamp_ns"][end]))
                estimator.apply_command(stream.reloads[rows["reload"][end]] if is_reload else command)
                results["stamp_ns"][end] = rows["stamp_ns"][end]
                results["nis"][end] = results["gate"][end] = np.nan
                begin = end + 1
        yield Part(stream.sources, rows, results, batch.tables, learned)


class _Collector:
    """What is kept of the parts."""

    def __init__(
        self,
        stream: InputStream,
        reference: str | None,
        vehicle: Kinematics,
        withheld: WithheldErrors,
        *,
        compares: bool,
    ) -> None:
        self._stream, self._reference = stream, reference
        self.withheld = withheld
        self._scored = _scored(reference)
        self._estimates, self._series = GrowingRows(KEPT, MOST_DRAWN), SeriesCollector(most=MOST_DRAWN)
        self._last, self._rejected = np.empty(0, KEPT), stream.refused
        self._errors, self._slips, self._tilt = PathErrors(), SlipErrors(vehicle.tread), TiltErrors()
        self._swing = SwingErrors()
        self._reckonings = {
            name: Reckoning(vehicle, with_gyro=name == "encoder_gyro")
            for name in (("dead_reckoning", "encoder_gyro") if reference is not None else ())
        }
        self._comparer, self._compares, self._local = LiveComparer(), compares, LocalOdometry()
        self.taken = Taken(Counter(), self._rejected)
        self._learned: list[Known] = []

    def add(self, part: Part) -> None:
        """More of the bag."""
        estimates = part.estimates
        self._keep(estimates)
        self._learned += part.learned
        for source, count in enumerate(np.bincount(part.arrivals["source"]).tolist()):
            self.taken.given[part.sources[source]] += count
        for name, outcome, n in _refused(part, "outcome"):
            self._rejected.add(name, Outcome(outcome), n)
        for name, refusal, n in _refused(part, "orientation"):
            self._rejected.add(name, OrientationRefusal(refusal), n)
        tables = {topic: part.tables[topic].rows for topic in self._scored & part.tables.keys()}
        for topic, rows in tables.items():
            self._series.add(topic, rows)
        self._slips.add(estimates, *(tables.get(topic) for topic in (TRUE_SLIP, TRUE_ODOMETRY)))
        self._tilt.add(estimates, tables.get(TRUE_ODOMETRY))
        self._swing.add(estimates, tables.get(TRUE_SWING))
        if self._reference is not None:
            known = tables.get(self._reference)
            reference = None if known is None else reduced(known)
            self._errors.add_estimates(estimates, reference)
            self.withheld.add(estimates, part.tables.get(self._reference))
            for reckoning in self._reckonings.values():
                reckoning.add(part.arrivals, reference)
        if self._compares:
            self._compare(part.tables, estimates)

    def result(self) -> Replay:
        """When all was added."""
        stream = self._stream
        found = Replay(
            stream.duration_s, 0.0, stream.messages, self._estimates.rows(), self._rejected, self._last
        )
        found.reference, found.series = self._reference, self._series.series()
        found.slip_rmse = self._slips.rmse
        found.swing_rmse = self._swing.rmse
        found.attitude_rmse, found.height_rmse = self._tilt.attitude, self._tilt.height
        if len(found.estimates):
            found.paths["filter"] = path_of(in_order(found.estimates))
        if self._reference is not None and self._reference in found.series:
            self._score(found, self._reference)
        found.learned = self._learned
        if self._compares and stream.messages[ODOMETRY]:
            found.live = self._comparer.result(stream.counts)
        return found

    def _keep(self, estimates: Rows) -> None:
        if len(estimates):
            self._estimates.add(estimates)
            self._last = np.empty(1, KEPT)
            for name in KEPT.names or ():
                self._last[name] = estimates[name][-1]
            self.taken.heading_variance = float(estimates["pose_covariance"][-1, 2, 2])

    def _score(self, found: Replay, reference: str) -> None:
        """Paths beside the filter's, and the errors of all against the reference."""
        first_ns = next((r.first_ns for r in self._reckonings.values()), None)
        found.paths["reference"] = reference_path(found.series[reference], first_ns or 0)
        found.scores["filter"] = self._errors.score
        found.nees, found.nees_position = self._errors.nees, self._errors.nees_position
        for name, reckoning in self._reckonings.items():
            path, found.scores[name] = reckoning.result()
            if path is not None:
                found.paths[name] = path

    def _compare(self, tables: dict[str, Logged], estimates: Rows) -> None:
        """Every live number against the replayed one of the same stamp."""
        nothing = np.empty(0, ESTIMATE)
        if ODOMETRY in self._stream.topics:
            live = tables[ODOMETRY].rows if ODOMETRY in tables else nothing
            self._comparer.add_odometry(live, odometry_rows(estimates, estimates))
            self._comparer.add_tilt(live, tilt_rows(estimates))
        if LOCAL_ODOMETRY in self._stream.topics:
            live = tables[LOCAL_ODOMETRY].rows if LOCAL_ODOMETRY in tables else nothing
            self._comparer.add_local(live, odometry_rows(estimates, self._local.advance(estimates)))
        if TRACK_SLIP in self._stream.topics:
            live = tables[TRACK_SLIP].rows if TRACK_SLIP in tables else nothing
            self._comparer.add_slips(live, slip_rows(estimates))


def _refused(part: Part, field_: str) -> Iterator[tuple[str, int, int]]:
    """Source, reason and how many of what a field of the results is not 0 for."""
    refused = part.results[field_] != 0
    pairs = np.column_stack((part.arrivals["source"][refused], part.results[field_][refused]))
    for (source, reason), count in zip(*np.unique(pairs, axis=0, return_counts=True), strict=True):
        yield part.sources[source], int(reason), int(count)


def _scored(reference: str | None) -> frozenset[str]:
    return frozenset(filter(None, (TRUE_SLIP, TRUE_ODOMETRY, TRUE_SWING, reference)))


def own_reference(bag: Bag) -> str | None:
    """The topic to score against where none is named, if the bag has one."""
    return next((r for r in REFERENCES if f"/{r}" in bag.topics or r in bag.topics), None)
