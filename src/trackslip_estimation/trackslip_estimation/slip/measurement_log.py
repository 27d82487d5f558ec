# SPDX-License-Identifier: Apache-2.0
"""Measurements as a log for ``filters.batch``: what the estimator takes, worked out once for many runs.

A run over the log ends as ``SlipEstimator`` does on the same measurements in the order of their stamps.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from trackslip_common.errors import InputError
from trackslip_estimation.slip.batch import ASIDE, BoolArray, Log, Row, Run, clock_ns, make_log, run
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import SET_POSE, Measurement, PoseFix, Sprockets
from trackslip_estimation.slip.models.model import SPROCKETS, Gaussian, Measured
from trackslip_estimation.slip.motion import STANDSTILL, MotionState
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, make_gates
from trackslip_estimation.slip.sprockets import SprocketTrack
from trackslip_estimation.slip.stepping import Leg, Stepper
from trackslip_estimation.slip.timeline import Key, key_of

StepAside: TypeAlias = Callable[[Stepper, Gaussian], Gaussian]

_ASIDE = Measured(ASIDE, np.empty(0), np.empty((0, 0)))


_OF_RUNS_ONLY = re.compile(
    r"(turning|icr|noise)\..*|gate_.*|(pose|yaw_rate|slip)_timeouts|filter|kappa|initial_.*"
)
_OF_FIXES_ONLY = re.compile(r"pose_(position|heading)_floors|pose_heading_ceilings")


class MeasurementLog(NamedTuple):
    """What runs over the measurements have in common, whatever the noise of their model."""

    start: Measurement  # what the estimate starts from, as it came
    log: Log
    asides: Mapping[int, StepAside]  # row → what no kernel does
    fixes: Mapping[int, PoseFix]  # row → as it came

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(k,) of the rows."""
        return self.start.stamp_ns + clock_ns(self.log)

    @property
    def published(self) -> BoolArray:
        """(k,) whether the estimator publishes after the row: at the sprocket samples."""
        published: BoolArray = self.log.flags[:, 0] == SPROCKETS
        return published


def read_measurements(measurements: Iterable[Measurement], p: SlipEstimatorParameters) -> MeasurementLog:
    """What the estimator takes of the measurements, in the order of the stamps, each once.

    Raises:
        InputError: there is none to start from.
    """
    estimator = SlipEstimator(p)
    taken, came = _taken(measurements, estimator)
    first = next((m for m in taken if estimator.begins_with(m)), None)
    if first is None:
        raise InputError(f"measurements: none of {len(taken)} to start from (start: {p.start})")
    track = SprocketTrack(round(p.sprocket_timeout * 1e9), p.max_sprocket_speed)
    for m in taken:
        if isinstance(m, Sprockets):
            track.add(m)
    numbers = {name: number for number, name in enumerate(p.timeouts_ns())}
    stepper, before = Stepper(p, track), Leg(first.stamp_ns)
    rows: list[Row] = []
    asides: dict[int, StepAside] = {}
    fixes: dict[int, PoseFix] = {}
    for m in (m for m in taken if key_of(m) > key_of(first)):
        for dt, leg, step in _way(stepper, before, m):
            if step is None:
                measured, given = stepper.measured(m, silent=leg.silent), came[key_of(m)]
                if isinstance(given, PoseFix):
                    fixes[len(rows)] = given
                rows.append(Row(dt, stepper.speeds(leg, m), leg.motion, numbers.get(m.source, 0), measured))
            else:
                asides[len(rows)] = step
                rows.append(Row(dt, STANDSTILL, MotionState(), 0, _ASIDE))
            before = leg
    return MeasurementLog(came[key_of(first)], make_log(rows), asides, fixes)


def reread(
    log: MeasurementLog, measurements: Iterable[Measurement], p: SlipEstimatorParameters, names: Iterable[str]
) -> MeasurementLog:
    """What ``read_measurements`` gives, where ``log`` was read with other values of ``names`` at most.

    How far fixes are believed stands in their rows alone, and only these are made anew for it.
    """
    shaping = [name for name in names if shapes_log(name)]
    if not shaping:
        return log
    if not all(map(_OF_FIXES_ONLY.fullmatch, shaping)):
        return read_measurements(measurements, p)
    flags, values, noises = log.log.flags.copy(), log.log.values.copy(), log.log.noises.copy()
    poses = p.poses()
    for row, fix in log.fixes.items():
        source = poses[fix.source]
        kind, value, noise = source.measured(source.prepared(fix))
        flags[row, 0], values[row], noises[row] = kind, 0.0, 0.0
        values[row, : value.size] = value
        noises[row, : value.size, : value.size] = noise
    return log._replace(log=log.log._replace(flags=flags, values=values, noises=noises))


def _way(stepper: Stepper, before: Leg, m: Measurement) -> Iterator[tuple[float, Leg, StepAside | None]]:
    """Seconds, leg and step of each row from one measurement to the next; no step where a kernel does it."""
    *passed, leg = stepper.legs(before, m.stamp_ns)
    for drive in passed:
        dt = (drive.stamp_ns - before.stamp_ns) * 1e-9
        yield dt, drive, partial(Stepper.driven, leg=drive, dt=dt)
        before = drive
    dt = (leg.stamp_ns - before.stamp_ns) * 1e-9
    if leg.silent:
        yield dt, leg, partial(Stepper.coasted, before=before, dt=dt)
        dt = 0.0
    if isinstance(m, PoseFix) and m.source == SET_POSE:
        yield dt, leg, partial(Stepper.placed, leg=leg, dt=dt, fix=m)
    else:
        yield dt, leg, None


def shapes_log(name: str) -> bool:
    """Whether a parameter (dotted name) has a part in a log; the others only in the runs over it."""
    return _OF_RUNS_ONLY.fullmatch(name) is None


def run_log(log: MeasurementLog, p: SlipEstimatorParameters, keep: BoolArray | None = None) -> Run:
    """The filter that the parameters choose over a log; see ``batch.run``.

    From those that the log was read with they may differ where ``shapes_log`` says no.
    """
    estimator = SlipEstimator(p)
    estimator.take(log.start)
    stepper = estimator.stepper

    def aside(row: int, state: Gaussian) -> Gaussian:
        return log.asides[row](stepper, state)

    return run(log.log, stepper.filter, estimator.history()[0].gaussian, make_gates(p), aside, keep)


def _taken(
    measurements: Iterable[Measurement], estimator: SlipEstimator
) -> tuple[list[Measurement], dict[Key, Measurement]]:
    """As the estimator takes them where they come in the order of their stamps, and as they came.

    Of repeats the first.
    """
    taken: dict[Key, Measurement] = {}
    came: dict[Key, Measurement] = {}
    for given in sorted(measurements, key=key_of):
        measurement, outcome = estimator.admit(given)
        if not outcome.refused:
            taken.setdefault(key_of(measurement), measurement)
            came.setdefault(key_of(measurement), given)
    return list(taken.values()), came
