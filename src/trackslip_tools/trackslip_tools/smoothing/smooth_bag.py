# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Runs filter and smoother over a bag and scores both against the reference."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.reader import Bag
from trackslip_common.arrays import Rows
from trackslip_common.clock_monitor import NEVER_NS
from trackslip_common.errors import InputError
from trackslip_common.topics import ODOMETRY, TRACK_SLIP, TRUE_ODOMETRY, TRUE_SLIP
from trackslip_estimation.slip.estimator import make_estimate
from trackslip_estimation.slip.log import make_log
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_tools.replay.output import StampedWriter, message_of
from trackslip_tools.replay.run import default_reference
from trackslip_tools.replay.scoring import PathErrors, SlipErrors
from trackslip_tools.replay.series import Series
from trackslip_tools.replay.sorted_inputs import read_sorted_inputs
from trackslip_tools.smoothing.smoothing import Smoothed, smooth
from trackslip_tools.terminal_text import number_text, wrap_line

Watch = Callable[[Smoothed], None]

_COLUMNS = ("position m", "heading rad", "slip", "NEES")
SMOOTHED = "smoothed/"  # prefix of the topics


class Errors(NamedTuple):
    """Errors of one set of estimates; None without anything to compare with."""

    position: float | None  # m, RMS
    heading: float | None  # rad, RMS
    slip: float | None  # RMS
    nees: float | None  # of the pose, mean; 3 if consistent


@dataclass(frozen=True)
class SmoothedBag:
    """Counts and errors of a smoothed bag."""

    estimates: int
    duration_s: float  # from the first estimate to the last
    reference: str | None
    filter: Errors
    smoother: Errors

    def summary(self) -> dict[str, Any]:
        """The contents of ``--json``."""
        return {
            "duration_s": self.duration_s,
            "estimates": self.estimates,
            "reference": self.reference,
            "filter": self.filter._asdict(),
            "smoother": self.smoother._asdict(),
        }

    def text(self, elapsed_s: float) -> str:
        """The results for a terminal; ``elapsed_s``: waiting time of the user."""
        lines = [f"{self.duration_s:.1f} s smoothed in {elapsed_s:.1f} s"]
        if not self.estimates:
            return "no estimate: nothing to start from (no fix of a pose source, no initial pose)"
        if self.reference is None:
            return f"{lines[0]}\nno reference in the bag: --reference TOPIC names one"
        lines.append(wrap_line(f"RMSE against {self.reference}; NEES is 3 if consistent"))
        lines.append(f"  {'':<21}" + "".join(f"{name:>14}" for name in _COLUMNS))
        for name in ("filter", "smoother"):
            cells = (f"{number_text(value, '.4f'):>14}" for value in getattr(self, name))
            lines.append(f"  {name:<21}" + "".join(cells))
        return "\n".join(lines)


def smooth_bag(
    bag: Bag,
    p: SlipEstimatorParameters,
    filters: InputFilters,
    reference: str | None,
    watch: Watch = lambda _: None,
) -> SmoothedBag:
    """Run filter and smoother over a bag; ``watch`` gets each block of estimates.

    Raises:
        InputError: the bag lacks a required topic.
    """
    reference = reference or default_reference(bag)
    requested = (TRUE_SLIP, TRUE_ODOMETRY, *((reference,) if reference else ()))
    measurements, series = read_sorted_inputs(bag, p, filters, requested)
    truth = [series.get(topic or "") for topic in (TRUE_SLIP, TRUE_ODOMETRY, reference)]
    filter_errors, smoother_errors = (_EstimateErrors(p.vehicle.kinematics.tread) for _ in range(2))
    count, first_ns, last_ns = 0, NEVER_NS, NEVER_NS
    for block in smoothed_blocks(measurements, p):
        if not len(block.smoothed):
            continue
        stamps_ns = block.smoothed["stamp_ns"]
        rows = [_rows_between(one, last_ns, int(stamps_ns[-1])) for one in truth]
        first_ns, last_ns = first_ns if count else int(stamps_ns[0]), int(stamps_ns[-1])
        count += len(block.smoothed)
        filter_errors.add(block.filtered, rows)
        smoother_errors.add(block.smoothed, rows)
        watch(block)
    duration_s = (last_ns - first_ns) * 1e-9
    return SmoothedBag(count, duration_s, reference, filter_errors.errors(), smoother_errors.errors())


def smoothed_blocks(measurements: Rows, p: SlipEstimatorParameters) -> Iterator[Smoothed]:
    """Filter and smoother over a bag's measurements; empty if nothing in the log can start the filter."""
    try:
        log = make_log(measurements, p)
    except InputError:
        return
    yield from smooth(log, p)


def _rows_between(series: Series | None, after_ns: int, until_ns: int) -> Rows | None:
    """Rows after one stamp up to another; None without a series."""
    if series is None:
        return None
    begin, end = np.searchsorted(series.stamps_ns, (after_ns, until_ns), side="right")
    return series.rows[begin:end]


class _EstimateErrors:
    """Errors of one set of estimates against the truth."""

    def __init__(self, tread: float) -> None:
        self._path, self._slips = PathErrors(), SlipErrors(tread)

    def add(self, estimates: Rows, truth: list[Rows | None]) -> None:
        """Add estimates and rows of the truth."""
        slips, odometry, reference = truth
        self._path.add_estimates(estimates, reference)
        self._slips.add(estimates, slips, odometry)

    def errors(self) -> Errors:
        """Errors of all added estimates."""
        score = self._path.score
        position, heading = (None, None) if score is None else (score.position, score.heading)
        return Errors(position, heading, self._slips.rmse, self._path.nees)


class SmoothedWriter(StampedWriter):
    """Writes a bag of the smoothed estimates and the parameters.

    Raises:
        InputError: the path exists already.
    """

    def __init__(self, path: Path, p: SlipEstimatorParameters) -> None:
        super().__init__(path)
        self._p, self._begun = p, False

    def add(self, block: Smoothed) -> None:
        """Write a block of estimates."""
        for estimate in (make_estimate(record.item()) for record in block.smoothed):
            if not self._begun:
                self.write_parameters(self._p, estimate.stamp_ns)
                self._begun = True
            for topic in (ODOMETRY, TRACK_SLIP):
                message = message_of(topic, estimate, self._p)
                self.write_message(SMOOTHED + topic, message, estimate.stamp_ns)
