# SPDX-License-Identifier: Apache-2.0
"""Measurements as a log for ``filters.batch``: the estimator's own inputs, worked out once for many runs."""

import math
from collections.abc import Iterable
from typing import NamedTuple

from trackslip_common.errors import InputError
from trackslip_estimation.filters.batch import Log, Row, make_log
from trackslip_estimation.filters.model import DRIVEN, Measured, pose_measured, rate_measured
from trackslip_estimation.measurements import Measurement, Sprockets, YawRate
from trackslip_estimation.motion import MotionParameters, MotionState, classify
from trackslip_estimation.sprocket_track import SprocketTrack
from trackslip_estimation.timeline import key_of

_FOR_EVER_NS = 2**62  # a log is taken as it is: no stretch in it is too long


class MeasurementLog(NamedTuple):
    """What runs over the measurements have in common, whatever their model and noise."""

    start: Measurement  # the first measurement of the kind that was asked for
    stamps_ns: tuple[int, ...]  # of the rows
    log: Log


def read_measurements(
    measurements: Iterable[Measurement], motion: MotionParameters, use_heading: bool, start: type[Measurement]
) -> MeasurementLog:
    """From the first ``start`` (PoseFix or Sprockets) on, in the order of the stamps, each once.

    Raises:
        InputError: there is no such measurement.
    """
    by_key = {key_of(m): m for m in reversed(list(measurements)) if m.is_finite()}
    ordered = [by_key[key] for key in sorted(by_key)]
    first = next((m for m in ordered if isinstance(m, start)), None)
    if first is None:
        raise InputError(f"measurements: no {start.__name__} to start from")
    track = SprocketTrack(_FOR_EVER_NS, math.inf)
    for m in ordered:
        if isinstance(m, Sprockets):
            track.add(m)
    after = [m for m in ordered if key_of(m) > key_of(first)]
    sources = {name: k for k, name in enumerate(sorted({m.source for m in after}))}
    rows, state, before_ns = [], MotionState(), first.stamp_ns
    for m in after:
        dt = (m.stamp_ns - before_ns) * 1e-9
        speeds = track.stretch(m.stamp_ns)[0]
        state = classify(state, speeds.left, speeds.right, dt, motion)
        rows.append(Row(dt, speeds, state, sources[m.source], _measured(m, use_heading)))
        before_ns = m.stamp_ns
    return MeasurementLog(first, tuple(m.stamp_ns for m in after), make_log(rows))


def _measured(measurement: Measurement, use_heading: bool) -> Measured:
    """A measurement as the filters take it."""
    if isinstance(measurement, Sprockets):
        return DRIVEN
    if isinstance(measurement, YawRate):
        return rate_measured(measurement.rate, measurement.variance)
    return pose_measured(measurement.pose, measurement.covariance, use_heading)
