# SPDX-License-Identifier: Apache-2.0
"""Filter and smoother over a bag, each scored against the reference."""

import time
from collections.abc import Callable, Iterator
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
from trackslip_estimation.slip.estimator import SlipEstimator, make_estimate
from trackslip_estimation.slip.log import make_log
from trackslip_estimation.slip.parameters import NODE as SLIP_NODE
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import ESTIMATE, SPROCKETS
from trackslip_tools.replay.arrivals import Rows
from trackslip_tools.replay.growing import GrowingRows
from trackslip_tools.replay.inputs import ODOMETRY, TRACK_SLIP, Inputs, read_inputs
from trackslip_tools.replay.output import message_of
from trackslip_tools.replay.run import (
    TRUE_ODOMETRY,
    TRUE_SLIP,
    own_reference,
    reference_path,
    slip_error,
)
from trackslip_tools.replay.scoring import mean_nees, path_of, score
from trackslip_tools.smoothing.smoothing import Smoothed, smooth

Watch = Callable[[Smoothed], None]

_KEPT = np.dtype([(n, ESTIMATE[n]) for n in ("stamp_ns", "pose", "pose_covariance", "slips")], align=True)
SMOOTHED = "smoothed/"  # before the names of the topics


class Errors(NamedTuple):
    """Of one set of estimates; None where there is nothing to compare with."""

    position: float | None  # m, RMS
    heading: float | None  # rad, RMS
    slip: float | None  # RMS
    nees: float | None  # of the pose, mean; 3 if consistent


@dataclass(frozen=True)
class SmoothedBag:
    """What a bag gives."""

    estimates: int
    duration_s: float  # from the first estimate to the last
    reference: str | None
    filter: Errors
    smoother: Errors
    elapsed_s: float

    def summary(self) -> dict[str, Any]:
        """The contents of ``--json``."""
        return {
            "duration_s": self.duration_s,
            "estimates": self.estimates,
            "reference": self.reference,
            "filter": self.filter._asdict(),
            "smoother": self.smoother._asdict(),
        }

    def __str__(self) -> str:
        """For a terminal."""
        lines = [f"{self.duration_s:.1f} s smoothed in {self.elapsed_s:.1f} s"]
        if not self.estimates:
            return "no estimate: nothing to start from (no fix of a pose source, no initial pose)"
        if self.reference is None:
            return f"{lines[0]}\nno reference in the bag: --reference TOPIC names one"
        lines.append(f"RMSE against {self.reference:<22}position m   heading rad          slip   NEES (3)")
        for name in ("filter", "smoother"):
            cells = ("–" if value is None else f"{value:.4f}" for value in getattr(self, name))
            lines.append(f"  {name:<29}" + "".join(f"{cell:>14}" for cell in cells))
        return "\n".join(lines)


def smooth_bag(
    bag: Bag,
    p: SlipEstimatorParameters,
    filters: InputFilters,
    reference: str | None,
    watch: Watch = lambda _: None,
) -> SmoothedBag:
    """Run filter and smoother over a bag; ``watch`` sees each block of estimates.

    Raises:
        InputError: the bag lacks what is needed.
    """
    began = time.monotonic()
    reference = reference or own_reference(bag)
    inputs = read_inputs(bag, p, filters, (TRUE_SLIP, TRUE_ODOMETRY, *((reference,) if reference else ())))
    _require_one_time(bag, inputs, p.history_window)
    kept = GrowingRows(_KEPT), GrowingRows(_KEPT)
    for block in smoothed_blocks(inputs, p):
        for of, estimates in zip(kept, block, strict=True):
            of.add(estimates)
        watch(block)
    filtered, smoothed = (of.rows() for of in kept)
    of_filter, of_smoother = (
        _errors(estimates, inputs, reference, p.vehicle.kinematics.tread)
        for estimates in (filtered, smoothed)
    )
    stamps_ns = smoothed["stamp_ns"]
    duration_s = (int(stamps_ns[-1]) - int(stamps_ns[0])) * 1e-9 if len(stamps_ns) else 0.0
    elapsed_s = time.monotonic() - began
    return SmoothedBag(len(smoothed), duration_s, reference, of_filter, of_smoother, elapsed_s)


def smoothed_blocks(inputs: Inputs, p: SlipEstimatorParameters) -> Iterator[Smoothed]:
    """Filter and smoother over a bag's inputs; nothing where there is nothing to start from."""
    measurements = inputs.measurements(SlipEstimator(p).sources)
    try:
        log = make_log(measurements, p)
    except InputError:
        return
    yield from smooth(log, p)


class SmoothedWriter:
    """A bag of the smoothed estimates and the parameters, each logged at its stamp.

    Raises:
        InputError: the path exists already.
    """

    def __init__(self, path: Path, p: SlipEstimatorParameters) -> None:
        self._bag, self._p, self._begun = BagWriter(path), p, False

    def __enter__(self) -> "SmoothedWriter":
        self._bag.__enter__()
        return self

    def __exit__(self, *raised: Any) -> None:
        self._bag.__exit__(*raised)

    def add(self, block: Smoothed) -> None:
        """More of the bag."""
        for estimate in (make_estimate(record.item()) for record in block.smoothed):
            if not self._begun:
                text = make(PARAMETERS_TYPE, data=parameters_text(to_flat(self._p), SLIP_NODE))
                self._write(PARAMETERS_TOPIC, PARAMETERS_TYPE, text, estimate.stamp_ns)
                self._begun = True
            for topic in (ODOMETRY, TRACK_SLIP):
                message = message_of(topic, estimate, self._p)
                self._write(SMOOTHED + topic, TOPICS[topic].type_name, message, estimate.stamp_ns)

    def _write(self, topic: str, type_name: str, message: Any, stamp_ns: int) -> None:
        self._bag.write(absolute(topic), type_name, serialize(message), stamp_ns)


def _require_one_time(bag: Bag, inputs: Inputs, window_s: float) -> None:
    """A clock that was set back makes two times of one: their stamps cannot be told apart."""
    rows = inputs.rows[inputs.rows["kind"] == SPROCKETS]
    back_s = -np.diff(rows["stamp_ns"]) * 1e-9
    for k in np.flatnonzero(back_s > window_s)[:1].tolist():
        at_s = (int(rows["log_time_ns"][k + 1]) - bag.start_ns) * 1e-9
        accepted = "accepted: a part with one time (--start, --stop)"
        raise InputError(
            f"bag '{bag.path}': the clock goes back by {back_s[k]:.1f} s at {at_s:.2f} s; {accepted}"
        )


def _errors(estimates: Rows, inputs: Inputs, reference: str | None, tread: float) -> Errors:
    series = inputs.series.get(reference or "")
    slip = slip_error(inputs.series, estimates, tread)
    if series is None or not len(estimates):
        return Errors(None, None, slip, None)
    path = reference_path(series, int(estimates["stamp_ns"][0]))
    found = score(path_of(estimates), path)
    if found is None:
        return Errors(None, None, slip, None)
    return Errors(found.position, found.heading, slip, mean_nees(estimates, path))
