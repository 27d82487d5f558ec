# SPDX-License-Identifier: Apache-2.0
"""One replay: inputs in live order through the estimator, then the comparison and the scores."""

import gc
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import make
from trackslip_bags.reader import Bag
from trackslip_common.tally import Tally
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.measurements import Outcome, Report
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_tools.replay.comparison import LiveComparer, LiveComparison, odometry_rows, slip_rows
from trackslip_tools.replay.dead_reckoning import DrivenCollector, Path, dead_reckon
from trackslip_tools.replay.inputs import ODOMETRY, TRACK_SLIP, Inputs, read_inputs
from trackslip_tools.replay.quick import quick_steps
from trackslip_tools.replay.scoring import (
    Score,
    in_order,
    mean_nees,
    moving_slips,
    path_of,
    score,
    slip_rmse,
)
from trackslip_tools.replay.series import Series, series_of
from trackslip_tools.replay.soil import SoilReplay

TRUE_ODOMETRY, TRUE_SLIP = "truth/odometry", "truth/track_slip"
REFERENCES = ("reference_pose", TRUE_ODOMETRY)  # used where none is named, if the bag has one


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
    measurements = inputs.inputs
    steps = quick_steps(measurements, p) or list(map(SlipEstimator(p).advance, measurements))
    rejected = Tally()
    for report, _ in steps:
        if report.outcome is not Outcome.ACCEPTED:
            rejected.add(report.source, report.outcome)
    result = Replay(inputs.duration_s, time.monotonic() - began, inputs, steps, rejected, reference)
    _score(result, p)
    if ODOMETRY in inputs.series and not filters.changes_inputs:
        result.live = _compare(result)
    return result


def own_reference(bag: Bag) -> str | None:
    """The topic to score against where none is named, if the bag has one."""
    return next((r for r in REFERENCES if f"/{r}" in bag.topics or r in bag.topics), None)


def _score(result: Replay, p: SlipEstimatorParameters) -> None:
    """Paths of filter and dead reckoning, and their errors against the reference."""
    estimates = in_order(result.estimates)
    if estimates:
        result.paths["filter"] = path_of(estimates)
    result.slip_rmse = slip_error(result.inputs, estimates, p.vehicle.tread)
    series = result.inputs.series.get(result.reference or "")
    if series is None:
        return
    driven = DrivenCollector()
    driven.add(result.inputs.rows)
    sprockets, gyro = driven.sprockets(), driven.gyro()
    reference = reference_path(series, 0 if sprockets is None else int(sprockets.stamps_ns[0]))
    if sprockets is not None and len(reference.stamps_ns):
        start = (reference.stamps_ns[0], reference.poses[0])
        result.paths["dead_reckoning"] = dead_reckon(p.vehicle, sprockets, *start)
        if gyro is not None:
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
    found = np.array([e.outputs.slips for e in estimates])
    stamps = np.array([e.stamp_ns for e in estimates], dtype=np.int64)
    own = series_of(stamp_ns=stamps, left_slip=found[:, 0], right_slip=found[:, 1])
    return slip_rmse(own, moving_slips(odometry, slips, tread))


def reference_path(series: Series, from_ns: int) -> Path:
    """The reference from the first sprocket sample on, its heading continuous."""
    covered = series.since(from_ns)
    poses = covered.columns("x", "y", "heading")
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Path(covered.stamps_ns, poses)


def _compare(result: Replay) -> LiveComparison:
    """Every live number against the replayed one of the same stamp."""
    comparer, estimates = LiveComparer(), in_order(result.estimates)
    series = result.inputs.series
    comparer.add_odometry(series[ODOMETRY].rows, odometry_rows(estimates))
    if TRACK_SLIP in series:
        comparer.add_slips(series[TRACK_SLIP].rows, slip_rows(estimates))
    return comparer.result(result.inputs.counts)


def message_of(topic: str, estimate: Estimate, p: SlipEstimatorParameters) -> Any:
    """The message that the live node publishes for an estimate on ``odometry`` or ``track_slip``."""
    if topic == ODOMETRY:
        return conversions.odometry(make, estimate, p.odom_frame, p.base_frame)
    return conversions.track_slip(make, estimate, p.base_frame)
