# SPDX-License-Identifier: Apache-2.0
"""One replay: inputs in live order through the estimator, then the comparison and the scores."""

import gc
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trackslip_bags import input_filters
from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import make
from trackslip_bags.reader import Bag
from trackslip_common.tally import Tally
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.measurements import KINDS, Input, Outcome, Report, Sprockets, YawRate
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_tools.replay.dead_reckoning import Path, dead_reckon
from trackslip_tools.replay.inputs import (
    ODOMETRY,
    SPROCKETS,
    TRACK_SLIP,
    Inputs,
    in_live_order,
    journal_gaps,
    missing_inputs,
    numbers_of,
    read_inputs,
)
from trackslip_tools.replay.quick import quick_steps
from trackslip_tools.replay.scoring import (
    Score,
    Series,
    in_order,
    mean_nees,
    moving_slips,
    path_of,
    score,
    slip_rmse,
)
from trackslip_tools.replay.soil import SoilReplay

TRUE_ODOMETRY, TRUE_SLIP = "truth/odometry", "truth/track_slip"
REFERENCES = ("reference_pose", TRUE_ODOMETRY)  # used where none is named, if the bag has one
TOLERANCE = 1e-9  # between a live and a replayed number


@dataclass(frozen=True)
class LiveComparison:
    """The live estimates in the bag against the replayed ones."""

    compared: int  # live estimates
    unmatched: int  # messages of one side at a stamp that the other does not have
    largest_difference: float
    lost_reports: int  # lines of the live journal that the bag lacks
    lost_inputs: int  # measurements that the journal names and the bag lacks

    @property
    def matches(self) -> bool:
        """Same stamps, same numbers."""
        return self.compared > 0 and self.unmatched == 0 and self.largest_difference <= TOLERANCE

    def __str__(self) -> str:
        verdict = "yes" if self.matches else "NO"
        numbers = f"{self.compared} estimates, {self.unmatched} unmatched"
        return f"replay = live: {verdict} ({numbers}, largest difference {self.largest_difference:.1e})"


@dataclass
class Replay:
    """All that a replay found out."""

    duration_s: float
    elapsed_s: float
    inputs: Inputs
    steps: list[tuple[Report, Estimate | None]]
    rejected: Tally
    reference: str | None = None
    scores: dict[str, Score | None] = field(default_factory=dict)
    nees: float | None = None
    slip_rmse: float | None = None
    live: LiveComparison | None = None
    paths: dict[str, Path] = field(default_factory=dict)
    soil: SoilReplay | None = None  # where the bag has hydraulics

    @property
    def estimates(self) -> list[Estimate]:
        """What the estimator published."""
        return [estimate for _, estimate in self.steps if estimate is not None]


@contextmanager
def _collector_paused() -> Iterator[None]:
    """What a replay makes stays and holds no cycles; a third of the time would go to searching it."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


@_collector_paused()
def replay(bag: Bag, p: SlipEstimatorParameters, filters: InputFilters, reference: str | None) -> Replay:
    """Run the estimator over a bag.

    Raises:
        InputError: the bag lacks what is needed.
    """
    began = time.monotonic()
    reference = reference or own_reference(bag)
    wanted = (ODOMETRY, TRACK_SLIP, TRUE_SLIP, TRUE_ODOMETRY, *((reference,) if reference else ()))
    inputs = read_inputs(bag, p, filters, wanted)
    arrivals = input_filters.apply(filters, inputs.arrivals, inputs.origin_ns)
    measurements = list(in_live_order(arrivals, inputs.journal))
    steps = quick_steps(measurements, p) or list(map(SlipEstimator(p).advance, measurements))
    rejected = Tally()
    for report, _ in steps:
        if report.outcome is not Outcome.ACCEPTED:
            rejected.add(report.source, report.outcome)
    duration = _duration(inputs)
    result = Replay(duration, time.monotonic() - began, inputs, steps, rejected, reference)
    _score(result, p, measurements)
    if ODOMETRY in inputs.series and not filters.changes_inputs:
        result.live = _compare(result, p)
    return result


def own_reference(bag: Bag) -> str | None:
    """The topic to score against where none is named, if the bag has one."""
    return next((r for r in REFERENCES if f"/{r}" in bag.topics or r in bag.topics), None)


def _score(result: Replay, p: SlipEstimatorParameters, measurements: list[Input]) -> None:
    """Paths of filter and dead reckoning, and their errors against the reference."""
    estimates = in_order(result.estimates)
    if estimates:
        result.paths["filter"] = path_of(estimates)
    result.slip_rmse = slip_error(result.inputs, estimates, p.vehicle.tread)
    series = result.inputs.series.get(result.reference or "")
    if series is None:
        return
    by_stamp = sorted(measurements, key=lambda m: m.stamp_ns)
    sprockets = [m for m in by_stamp if isinstance(m, Sprockets) and m.is_finite()]
    gyro = [m for m in by_stamp if isinstance(m, YawRate) and m.is_finite()]
    reference = reference_path(series, sprockets[0].stamp_ns if sprockets else 0)
    if sprockets and len(reference.stamps_ns):
        start = (reference.stamps_ns[0], reference.poses[0])
        result.paths["dead_reckoning"] = dead_reckon(p.vehicle, sprockets, *start)
        if gyro:
            result.paths["encoder_gyro"] = dead_reckon(p.vehicle, sprockets, *start, gyro)
    result.paths["reference"] = reference
    for name in ("dead_reckoning", "encoder_gyro", "filter"):
        result.scores[name] = score(result.paths[name], reference) if name in result.paths else None
    if estimates:
        result.nees = mean_nees(estimates, reference)


def slip_error(inputs: Inputs, estimates: list[Estimate], tread: float) -> float | None:
    """Of estimates in order, against the true slips, where the bag has them; while the machine moves."""
    slips, odometry = (inputs.series.get(topic) for topic in (TRUE_SLIP, TRUE_ODOMETRY))
    if slips is None or odometry is None or not estimates:
        return None
    stamps = np.array([e.stamp_ns for e in estimates], dtype=np.int64)
    own = Series(stamps, np.array([e.outputs.slips for e in estimates]))
    return slip_rmse(own, moving_slips(odometry, slips, tread))


def reference_path(series: Series, from_ns: int) -> Path:
    """The reference from the first sprocket sample on, its heading continuous."""
    covered = series.since(from_ns)
    poses = covered.values[:, :3].copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Path(covered.stamps_ns, poses)


def _compare(result: Replay, p: SlipEstimatorParameters) -> LiveComparison:
    """Every live number against the replayed one of the same stamp, as messages carry them.

    A recording ends in the middle of things: what it holds beyond its last journal line is left out.
    """
    journal = result.inputs.journal
    end_ns = max((taken.stamp_ns for taken in journal if taken.source == SPROCKETS), default=None)
    estimates = in_order(result.estimates)
    compared = unmatched = 0
    largest = 0.0
    for topic in (ODOMETRY, TRACK_SLIP):
        recorded = result.inputs.series.get(topic)
        if recorded is None:
            continue
        live = dict(zip(recorded.stamps_ns.tolist(), recorded.values, strict=True))
        live = {stamp: row for stamp, row in live.items() if end_ns is None or stamp <= end_ns}
        mine = {e.stamp_ns: e for e in estimates if live and min(live) <= e.stamp_ns <= max(live)}
        unmatched += len(live.keys() ^ mine.keys())
        for stamp in live.keys() & mine.keys():
            difference = np.abs(live[stamp] - numbers_of(message_of(topic, mine[stamp], p)))
            largest = max(largest, float(np.max(difference)))
        compared = max(compared, len(live))
    missing = missing_inputs(result.inputs.arrivals, journal)
    return LiveComparison(compared, unmatched, largest, journal_gaps(journal), missing)


def message_of(topic: str, estimate: Estimate, p: SlipEstimatorParameters) -> Any:
    """The message that the live node publishes for an estimate on ``odometry`` or ``track_slip``."""
    if topic == ODOMETRY:
        return conversions.odometry(make, estimate, p.odom_frame, p.base_frame)
    return conversions.track_slip(make, estimate, p.base_frame)


def _duration(inputs: Inputs) -> float:
    """Seconds from the first to the last measurement, by stamp."""
    stamps = [a.measurement.stamp_ns for a in inputs.arrivals if isinstance(a.measurement, KINDS)]
    return (max(stamps) - min(stamps)) * 1e-9 if stamps else 0.0
