# SPDX-License-Identifier: Apache-2.0
"""Filter and smoother over a bag, each scored against the reference."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from trackslip_bags.input_filters import InputFilters
from trackslip_bags.messages import make, serialize
from trackslip_bags.parameters import PARAMETERS_TOPIC, PARAMETERS_TYPE
from trackslip_bags.reader import Bag, absolute
from trackslip_bags.writer import BagWriter
from trackslip_common.config_files import parameters_text
from trackslip_common.errors import InputError
from trackslip_common.parameters import to_flat
from trackslip_common.topics import TOPICS
from trackslip_estimation.slip.estimator import Estimate
from trackslip_estimation.slip.parameters import NODE as SLIP_NODE
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_tools.replay.arrivals import Kind
from trackslip_tools.replay.inputs import ODOMETRY, TRACK_SLIP, Inputs, read_inputs
from trackslip_tools.replay.run import (
    TRUE_ODOMETRY,
    TRUE_SLIP,
    message_of,
    own_reference,
    reference_path,
    slip_error,
)
from trackslip_tools.replay.scoring import mean_nees, path_of, score
from trackslip_tools.smoothing.smoothing import Shown, Smoothed, smooth

SMOOTHED = "smoothed/"  # before the names of the topics


class Errors(NamedTuple):
    """Of one set of estimates; None where there is nothing to compare with."""

    position: float | None  # m, RMS
    heading: float | None  # rad, RMS
    slip: float | None  # RMS
    nees: float | None  # of the pose, mean; 3 if honest


@dataclass(frozen=True)
class SmoothedBag:
    """What a bag gives."""

    estimates: Smoothed
    reference: str | None
    filter: Errors
    smoother: Errors
    elapsed_s: float

    @property
    def duration_s(self) -> float:
        """From the first estimate to the last."""
        stamps = [e.stamp_ns for e in self.estimates.smoothed]
        return (stamps[-1] - stamps[0]) * 1e-9 if stamps else 0.0

    def summary(self) -> dict[str, Any]:
        """The contents of ``--json``."""
        return {
            "duration_s": self.duration_s,
            "estimates": len(self.estimates.smoothed),
            "reference": self.reference,
            "filter": self.filter._asdict(),
            "smoother": self.smoother._asdict(),
        }

    def __str__(self) -> str:
        """For a terminal."""
        lines = [f"{self.duration_s:.1f} s smoothed in {self.elapsed_s:.1f} s"]
        if not self.estimates.smoothed:
            return "no estimate: nothing to start from (no fix of a pose source, no initial pose)"
        if self.reference is None:
            return f"{lines[0]}\nno reference in the bag: --reference TOPIC names one"
        lines.append(f"RMSE against {self.reference:<22}position m   heading rad          slip   NEES (3)")
        for name in ("filter", "smoother"):
            cells = ("–" if value is None else f"{value:.4f}" for value in getattr(self, name))
            lines.append(f"  {name:<29}" + "".join(f"{cell:>14}" for cell in cells))
        return "\n".join(lines)


def smooth_bag(
    bag: Bag, p: SlipEstimatorParameters, filters: InputFilters, reference: str | None, shown: Shown = iter
) -> SmoothedBag:
    """Run filter and smoother over a bag; ``shown`` wraps the measurements, for a progress bar.

    Raises:
        InputError: the bag lacks what is needed.
    """
    began = time.monotonic()
    reference = reference or own_reference(bag)
    inputs = read_inputs(bag, p, filters, (TRUE_SLIP, TRUE_ODOMETRY, *((reference,) if reference else ())))
    _require_one_time(bag, inputs, p.history_window)
    found = smooth(inputs.inputs, p, shown)
    of_filter, of_smoother = (_errors(estimates, inputs, reference, p.vehicle.tread) for estimates in found)
    return SmoothedBag(found, reference, of_filter, of_smoother, time.monotonic() - began)


def write_smoothed(path: Path, result: SmoothedBag, p: SlipEstimatorParameters) -> None:
    """The smoothed estimates and the parameters, each logged at its stamp.

    Raises:
        InputError: the path exists already.
    """
    estimates = result.estimates.smoothed
    with BagWriter(path) as bag:
        if estimates:
            text = serialize(make(PARAMETERS_TYPE, data=parameters_text(to_flat(p), SLIP_NODE)))
            bag.write(absolute(PARAMETERS_TOPIC), PARAMETERS_TYPE, text, estimates[0].stamp_ns)
        for estimate in estimates:
            for topic in (ODOMETRY, TRACK_SLIP):
                data = serialize(message_of(topic, estimate, p))
                bag.write(absolute(SMOOTHED + topic), TOPICS[topic].type_name, data, estimate.stamp_ns)


def _require_one_time(bag: Bag, inputs: Inputs, window_s: float) -> None:
    """A clock that was set back makes two times of one: their stamps cannot be told apart."""
    rows = inputs.rows[inputs.rows["kind"] == Kind.SPROCKETS]
    back_s = -np.diff(rows["stamp_ns"]) * 1e-9
    for k in np.flatnonzero(back_s > window_s)[:1].tolist():
        at_s = (int(rows["log_time_ns"][k + 1]) - bag.start_ns) * 1e-9
        accepted = "accepted: a part with one time (--start, --stop)"
        raise InputError(
            f"bag '{bag.path}': the clock goes back by {back_s[k]:.1f} s at {at_s:.2f} s; {accepted}"
        )


def _errors(estimates: list[Estimate], inputs: Inputs, reference: str | None, tread: float) -> Errors:
    series = inputs.series.get(reference or "")
    slip = slip_error(inputs, estimates, tread)
    if series is None or not estimates:
        return Errors(None, None, slip, None)
    path = reference_path(series, estimates[0].stamp_ns)
    found = score(path_of(estimates), path)
    if found is None:
        return Errors(None, None, slip, None)
    return Errors(found.position, found.heading, slip, mean_nees(estimates, path))
