# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Collects the results of a replay part by part; keeps of the estimates what the scores need."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from trackslip_common.arrays import Rows
from trackslip_common.orientations import tilts_of
from trackslip_common.tally import Tally
from trackslip_common.topics import (
    LOCAL_ODOMETRY,
    ODOMETRY,
    TRACK_SLIP,
    TRUE_ODOMETRY,
    TRUE_SLIP,
    TRUE_SWING,
)
from trackslip_common.vehicle import Kinematics
from trackslip_estimation.attitude.records import AttitudeRejection
from trackslip_estimation.setup_check.finding import Result as Setup
from trackslip_estimation.slip.explanations import AcceptedEvent
from trackslip_estimation.slip.learned_text import LearnedQuantity
from trackslip_estimation.slip.local_odometry import LocalOdometry
from trackslip_estimation.slip.measurements import Fault, Outcome
from trackslip_estimation.slip.records import ESTIMATE
from trackslip_tools.replay.comparison import (
    LiveComparer,
    LiveComparison,
    odometry_rows,
    slip_rows,
)
from trackslip_tools.replay.dead_reckoning import DeadReckoner
from trackslip_tools.replay.growing import MOST_DRAWN, GrowingRows
from trackslip_tools.replay.inputs import InputStream
from trackslip_tools.replay.no_estimate import ProcessingCounts
from trackslip_tools.replay.parts import LearnedValues, Part
from trackslip_tools.replay.scoring import (
    PairedErrors,
    PathErrors,
    Score,
    SlipErrors,
    path_of,
    path_of_series,
)
from trackslip_tools.replay.series import Path, Series, SeriesCollector, reduce_columns, sort_by_stamp
from trackslip_tools.replay.soil import SoilReplay
from trackslip_tools.replay.stuck_tracks import FixGaps
from trackslip_tools.replay.travel import Travel
from trackslip_tools.replay.withheld import WithheldErrors, WithholdResult

# Field of a result → reasons of a rejection.
_REJECTIONS: dict[str, Sequence[Outcome | Fault | AttitudeRejection]] = {
    "outcome": [outcome for outcome in Outcome if outcome.is_rejected and outcome is not Outcome.INVALID],
    "fault": [*Fault],  # of those that are INVALID
    "attitude": [*AttitudeRejection],
}
KEPT_ESTIMATE = np.dtype([(n, ESTIMATE[n]) for n in ("stamp_ns", "pose", "slips")], align=True)


@dataclass
class Replay:
    """Results of a replay; estimates, series and paths of long bags are thinned, the scores are not."""

    duration_s: float
    elapsed_s: float
    messages: Counter[str]  # topic → number of messages read
    estimates: Rows  # (n,) KEPT_ESTIMATE of the published estimates
    rejected: Tally
    last: Rows = field(default_factory=lambda: np.empty(0, KEPT_ESTIMATE))  # (1,); (0,) without an estimate
    reference: str | None = None
    series: dict[str, Series] = field(default_factory=dict)  # of truth and reference
    scores: dict[str, Score | None] = field(default_factory=dict)
    nees: float | None = None  # of the pose, if the reference has headings
    nees_position: float | None = None
    slip_rmse: float | None = None
    attitude_rmse: float | None = None  # of roll and pitch, rad
    height_rmse: float | None = None  # m
    swing_rmse: float | None = None  # rad
    live: LiveComparison | None = None
    paths: dict[str, Path] = field(default_factory=dict)
    soil: SoilReplay | None = None  # if the bag has hydraulics
    no_estimate: str = ""  # why there is no estimate, or none with a heading
    vehicle: str = ""  # its name
    learned: list[LearnedValues] = field(default_factory=list)  # course of the learned quantities
    accepted_events: list[AcceptedEvent] = field(default_factory=list)  # events that explain contradictions
    withheld: list[WithholdResult] = field(default_factory=list)
    start_ns: int = 0  # log time of the bag's first message
    stamp_origin_ns: int = 0  # time of the stamps then
    travel: Travel = field(default_factory=Travel)
    start: str = ""  # line on what was learned before the bag; empty: nothing
    longest_gap: tuple[float, float] | None = None  # without an accepted fix, s from the bag's first message
    setup: Setup = field(default_factory=Setup)  # result of the setup check

    @property
    def findings(self) -> list[LearnedQuantity]:
        """Learned quantities at the end; empty without an estimate."""
        return self.learned[-1].findings if self.learned else []

    @property
    def rejected_by_source(self) -> dict[str, dict[str, int]]:
        """Source → reason → number of rejected measurements, of both estimators."""
        return self.rejected.by_source() | (self.soil.rejected.by_source() if self.soil is not None else {})

    def has_failed(self, *, force: bool) -> bool:
        """Whether there is no estimate, or one from a wrong setup that ``force`` does not accept."""
        return bool(self.no_estimate) or not (force or self.setup.is_plausible)


class Collector:
    """Collects the results of the parts."""

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
        self._scored = scored_topics(reference)
        self._estimates = GrowingRows(KEPT_ESTIMATE, MOST_DRAWN)
        self._series = SeriesCollector(most=MOST_DRAWN)
        self._last, self._rejected = np.empty(0, KEPT_ESTIMATE), stream.rejected
        self._errors, self._slips = PathErrors(), SlipErrors(vehicle.tread)
        self._tilt = PairedErrors("tilt", "tilt", lambda true: np.array((*tilts_of(true).T, true["z"])))
        self._swing = PairedErrors(
            "swing", "angle", lambda true: np.unwrap(true["angle"])[np.newaxis], is_angle=True
        )
        self._reckonings = {
            name: DeadReckoner(vehicle, with_gyro=name == "encoder_gyro")
            for name in (("dead_reckoning", "encoder_gyro") if reference is not None else ())
        }
        self._comparer, self._compares, self._local = LiveComparer(), compares, LocalOdometry()
        self.processed = ProcessingCounts(Counter(), self._rejected)
        self._learned: list[LearnedValues] = []
        self._gaps, self._travel, self._newest_ns = FixGaps(), Travel(), 0
        self._earlier_events: list[AcceptedEvent] = []  # of ended runs
        self._accepted_events: list[AcceptedEvent] = []

    def add(self, part: Part) -> None:
        """Add a part."""
        estimates = part.estimates
        self._keep_estimates(estimates)
        self._learned += part.learned
        self._gaps.add(part.arrivals, part.results)
        self._travel.add(estimates)
        if len(estimates):
            self._newest_ns = max(self._newest_ns, int(estimates["stamp_ns"].max()))
        if part.restart is not None:
            self._earlier_events, self._accepted_events = self._earlier_events + self._accepted_events, []
        self._accepted_events = list(part.accepted_events)
        for source, count in enumerate(np.bincount(part.arrivals["source"]).tolist()):
            self.processed.input_counts[part.sources[source]] += count
        _add_rejections(self._rejected, part)
        tables = {topic: part.tables[topic].rows for topic in self._scored & part.tables.keys()}
        for topic, rows in tables.items():
            self._series.add(topic, rows)
        self._slips.add(estimates, *(tables.get(topic) for topic in (TRUE_SLIP, TRUE_ODOMETRY)))
        self._tilt.add(estimates, tables.get(TRUE_ODOMETRY))
        self._swing.add(estimates, tables.get(TRUE_SWING))
        if self._reference is not None:
            reference_rows = tables.get(self._reference)
            reference = None if reference_rows is None else reduce_columns(reference_rows, detailed=True)
            self._errors.add_estimates(estimates, reference)
            self.withheld.add(estimates, part.tables.get(self._reference))
            for reckoning in self._reckonings.values():
                reckoning.add(part.arrivals, reference)
        if self._compares:
            self._compare_with_live(part)

    def result(self) -> Replay:
        """All results but those of soil, setup and withheld topics; called after the last part."""
        stream = self._stream
        result = Replay(
            stream.duration_s, 0.0, stream.messages, self._estimates.rows(), self._rejected, self._last
        )
        result.start_ns, result.stamp_origin_ns = stream.start_ns, stream.stamp_origin_ns
        result.longest_gap = self._gaps.longest_gap(self._newest_ns, stream.stamp_origin_ns)
        result.travel = self._travel
        result.reference, result.series = self._reference, self._series.series()
        result.slip_rmse = self._slips.rmse
        result.swing_rmse = self._swing.rmse()
        result.attitude_rmse, result.height_rmse = map(self._tilt.rmse, (slice(2), slice(2, None)))
        if len(result.estimates):
            result.paths["filter"] = path_of(sort_by_stamp(result.estimates))
        if self._reference is not None and self._reference in result.series:
            self._add_scores(result, self._reference)
        result.learned, result.accepted_events = self._learned, self._earlier_events + self._accepted_events
        if self._compares and stream.messages[ODOMETRY]:
            result.live = self._comparer.result(stream.counts)
        return result

    def _keep_estimates(self, estimates: Rows) -> None:
        if len(estimates):
            self._estimates.add(estimates)
            self._last = np.empty(1, KEPT_ESTIMATE)
            for name in KEPT_ESTIMATE.names or ():
                self._last[name] = estimates[name][-1]
            self.processed.heading_variance = float(estimates["pose_covariance"][-1, 2, 2])

    def _add_scores(self, result: Replay, reference: str) -> None:
        """Add the paths of reference and dead reckoning, and the errors of all against the reference."""
        first_ns = next((r.first_ns for r in self._reckonings.values()), None)
        result.paths["reference"] = path_of_series(result.series[reference].rows_since(first_ns or 0))
        result.scores["filter"] = self._errors.score
        result.nees, result.nees_position = self._errors.nees, self._errors.nees_position
        for name, reckoning in self._reckonings.items():
            path, result.scores[name] = reckoning.result()
            if path is not None:
                result.paths[name] = path

    def _compare_with_live(self, part: Part) -> None:
        """Compare every live number with the replayed one of the same stamp."""
        nothing, topics = np.empty(0, ESTIMATE), {ODOMETRY, LOCAL_ODOMETRY, TRACK_SLIP} & self._stream.topics
        tables, estimates = part.tables, part.estimates
        live = {topic: tables[topic].rows if topic in tables else nothing for topic in topics}
        numbers = part.arrivals["part"][part.results["published"]]
        parts = self._stream.counts.parts
        if part.restart is not None:
            self._local = LocalOdometry()
        if ODOMETRY in live:
            self._comparer.add(ODOMETRY, live[ODOMETRY], odometry_rows(estimates, estimates), numbers, parts)
        if LOCAL_ODOMETRY in live:
            local = odometry_rows(estimates, self._local.advance(estimates))
            self._comparer.add(LOCAL_ODOMETRY, live[LOCAL_ODOMETRY], local, numbers, parts)
        if TRACK_SLIP in live:
            self._comparer.add(TRACK_SLIP, live[TRACK_SLIP], slip_rows(estimates), numbers, parts)


def _add_rejections(tally: Tally, part: Part) -> None:
    """Count the measurements of a part that were rejected, whole or their orientation or altitude."""
    for field_, reasons in _REJECTIONS.items():
        for reason in reasons:
            sources = part.arrivals["source"][part.results[field_] == reason]
            for name, count in zip(part.sources, np.bincount(sources).tolist(), strict=False):
                tally.add(name, reason, count)


def scored_topics(reference: str | None) -> frozenset[str]:
    """Topics against which estimates are scored, if the bag holds them."""
    return frozenset(filter(None, (TRUE_SLIP, TRUE_ODOMETRY, TRUE_SWING, reference)))
