# SPDX-License-Identifier: Apache-2.0
"""The slip estimator: measurements in, in any order; pose, slips and slip angle out.

Live node and replay run this same class. It knows no clock: time is in the stamps.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from trackslip_estimation.filters.filter import Held
from trackslip_estimation.filters.model import POSE, Gaussian, Measured, Outputs, pose_measured, rate_measured
from trackslip_estimation.measurements import Measurement, Outcome, PoseFix, Report, Sprockets, YawRate
from trackslip_estimation.motion import STANDSTILL, Motion, MotionState, Speeds, classify
from trackslip_estimation.slip_parameters import SlipEstimatorParameters, make_filter
from trackslip_estimation.timeline import SprocketTrack, Timeline

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is published at the stamp of each sprocket sample."""

    stamp_ns: int
    pose: FloatArray  # (3,) x m, y m, heading rad, site frame
    pose_covariance: FloatArray  # (3, 3)
    outputs: Outputs
    motion: Motion


class FilterState(NamedTuple):
    """All that the filter carries from one measurement to the next."""

    stamp_ns: int
    gaussian: Gaussian
    motion: MotionState = MotionState()
    speeds: Speeds = STANDSTILL
    rejected_in_a_row: Mapping[str, int] = MappingProxyType({})
    report: Report | None = None  # on the measurement that led here


class SlipEstimator:
    """A filter over a window of measurements kept in stamp order."""

    def __init__(self, parameters: SlipEstimatorParameters) -> None:
        self.parameters = parameters
        self._filter = make_filter(parameters)
        self._gates = {dof: float(chi2.ppf(parameters.gate_probability, dof)) for dof in (1, 2, 3)}
        self._track = SprocketTrack()
        self._timeline: Timeline[FilterState] | None = None
        self._newest_sprocket_ns = -1

    @property
    def started(self) -> bool:
        """Whether there is an estimate."""
        return self._timeline is not None

    def take(self, measurement: Measurement) -> Report:
        """Use one measurement, in its place by stamp, and say what became of it."""

        def refused(outcome: Outcome) -> Report:
            return Report(measurement.source, measurement.stamp_ns, outcome)

        if not measurement.is_finite():
            return refused(Outcome.INVALID)
        if self._timeline is None:
            return refused(self._start(measurement))
        reason = self._timeline.refusal(measurement)
        if reason is not None:
            return refused(reason)
        redo_from_ns = None
        if isinstance(measurement, Sprockets):
            self._track.add(measurement)
            redo_from_ns = self._track.last_before(measurement.stamp_ns)
        self._latest = self._timeline.insert(measurement, redo_from_ns)
        self._track.forget_before(self._timeline.oldest_ns)
        assert self._latest.report is not None
        return self._latest.report

    def advance(self, measurement: Measurement) -> tuple[Report, Estimate | None]:
        """``take``, and the estimate to publish if this was the newest sprocket sample."""
        report = self.take(measurement)
        newest = isinstance(measurement, Sprockets) and measurement.stamp_ns > self._newest_sprocket_ns
        if report.outcome is not Outcome.ACCEPTED or not newest:
            return report, None
        self._newest_sprocket_ns = measurement.stamp_ns
        return report, self._estimate(self._latest)

    def estimate(self) -> Estimate:
        """The state at the newest stamp.

        Raises:
            RuntimeError: nothing has started the estimate yet.
        """
        if self._timeline is None:
            raise RuntimeError("no estimate yet")
        return self._estimate(self._timeline.newest)

    def _estimate(self, state: FilterState) -> Estimate:
        mean, covariance = state.gaussian
        outputs = self._filter.outputs(state.gaussian, state.speeds)
        return Estimate(state.stamp_ns, mean[POSE], covariance[POSE, POSE], outputs, state.motion.motion)

    def _start(self, measurement: Measurement) -> Outcome:
        """Begin with a fix, or with the initial pose at the first sprocket sample; else wait."""
        p = self.parameters
        window_ns = round(p.history_window * 1e9)
        if isinstance(measurement, Sprockets):
            self._track.add(measurement)
            self._track.forget_before(measurement.stamp_ns - window_ns)
        if p.start == "first_fix" and isinstance(measurement, PoseFix):
            pose, covariance = measurement.pose, measurement.covariance
        elif p.start == "initial_pose" and isinstance(measurement, Sprockets):
            pose = np.array((p.initial_x, p.initial_y, p.initial_yaw))
            deviations = (p.initial_position_stddev, p.initial_position_stddev, p.initial_yaw_stddev)
            covariance = np.diag(np.square(deviations))
        else:
            return Outcome.WAITING
        begin = self._latest = FilterState(measurement.stamp_ns, self._filter.initial(pose, covariance))
        self._timeline = Timeline(window_ns, begin, measurement, self._step)
        return Outcome.ACCEPTED

    def _step(self, state: FilterState, measurement: Measurement) -> FilterState:
        """Predict to the stamp of the measurement, then update with it."""
        moved = self._predict(state, measurement.stamp_ns)
        if isinstance(measurement, Sprockets):
            driven = self._filter.drive(moved.gaussian, moved.speeds)
            taken = Report(measurement.source, measurement.stamp_ns, Outcome.ACCEPTED)
            return moved._replace(gaussian=driven, report=taken)
        return self._update(moved, measurement, self._hold(moved, measurement))

    def _predict(self, state: FilterState, stamp_ns: int) -> FilterState:
        """The model over the time since the state."""
        dt = (stamp_ns - state.stamp_ns) * 1e-9
        speeds = self._track.speeds(stamp_ns)
        motion = classify(state.motion, speeds.left, speeds.right, dt, self.parameters.motion)
        gaussian = self._filter.predict(state.gaussian, speeds, dt, motion)
        return FilterState(stamp_ns, gaussian, motion, speeds, state.rejected_in_a_row)

    def _hold(self, state: FilterState, measurement: YawRate | PoseFix) -> Held:
        measured: Measured
        if isinstance(measurement, YawRate):
            measured = rate_measured(measurement.rate, measurement.variance)
        else:
            measured = pose_measured(measurement.pose, measurement.covariance, self.parameters.use_heading)
        return self._filter.hold(state.gaussian, state.speeds, measured)

    def _update(self, state: FilterState, measurement: Measurement, held: Held) -> FilterState:
        """Gate, then update; a source rejected too often in a row is believed again."""
        gate = self._gates[held.dof]
        run = state.rejected_in_a_row.get(measurement.source, 0)
        accepted = held.nis <= gate or run >= self.parameters.gate_patience
        gaussian = held.updated if accepted else state.gaussian
        outcome = Outcome.ACCEPTED if accepted else Outcome.GATED
        runs = state.rejected_in_a_row
        if run or not accepted:
            runs = MappingProxyType({**runs, measurement.source: 0 if accepted else run + 1})
        report = Report(measurement.source, measurement.stamp_ns, outcome, held.nis, gate, held.dof)
        return state._replace(gaussian=gaussian, rejected_in_a_row=runs, report=report)
