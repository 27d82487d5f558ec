# SPDX-License-Identifier: Apache-2.0
"""The slip estimator: measurements in, in any order; pose, slips and slip angle out.

Live node and replay run this same class. It knows no clock: time is in the stamps.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from trackslip_estimation.filters import ekf
from trackslip_estimation.filters.ekf import Gaussian, Linearised
from trackslip_estimation.filters.slip_model import POSE, SLIPS, SlipModel
from trackslip_estimation.measurements import Measurement, Outcome, PoseFix, Report, Sprockets, YawRate
from trackslip_estimation.motion import Motion, MotionState, classify
from trackslip_estimation.slip_parameters import SlipEstimatorParameters
from trackslip_estimation.timeline import Speeds, SprocketTrack, Timeline

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is published at the stamp of each sprocket sample."""

    stamp_ns: int
    pose: FloatArray  # (3,) x m, y m, heading rad, site frame
    pose_covariance: FloatArray  # (3, 3)
    twist: FloatArray  # (3,) v_x m/s, v_y m/s, yaw rate rad/s, machine frame
    twist_covariance: FloatArray  # (3, 3)
    slips: FloatArray  # (3,) left slip, right slip, slip angle rad
    slip_covariance: FloatArray  # (3, 3)
    motion: Motion


@dataclass(frozen=True, eq=False)
class FilterState:
    """All that the filter carries from one measurement to the next."""

    stamp_ns: int
    gaussian: Gaussian
    motion: MotionState = MotionState()
    speeds: Speeds = Speeds(0.0, 0.0, 0.0)
    rejected_in_a_row: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    report: Report | None = None  # on the measurement that led here


class SlipEstimator:
    """Kinematic EKF over a window of measurements kept in stamp order."""

    def __init__(self, parameters: SlipEstimatorParameters) -> None:
        self.parameters = parameters
        vehicle = parameters.vehicle
        self._model = SlipModel(vehicle.rolling_radius, vehicle.tread, parameters.noise)
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
        report = self._timeline.insert(measurement, redo_from_ns).report
        self._track.forget_before(self._timeline.oldest_ns)
        assert report is not None
        return report

    def advance(self, measurement: Measurement) -> tuple[Report, Estimate | None]:
        """``take``, and the estimate to publish if this was the newest sprocket sample."""
        report = self.take(measurement)
        newest = isinstance(measurement, Sprockets) and measurement.stamp_ns > self._newest_sprocket_ns
        if report.outcome is not Outcome.ACCEPTED or not newest:
            return report, None
        self._newest_sprocket_ns = measurement.stamp_ns
        return report, self.estimate()

    def estimate(self) -> Estimate:
        """The state at the newest stamp.

        Raises:
            RuntimeError: nothing has started the estimate yet.
        """
        if self._timeline is None:
            raise RuntimeError("no estimate yet")
        state = self._timeline.newest
        x, P = state.gaussian
        left, right, _ = state.speeds
        J = self._model.twist_jacobian(x, left, right)
        return Estimate(
            stamp_ns=state.stamp_ns,
            pose=x[POSE],
            pose_covariance=P[POSE, POSE],
            twist=self._model.twist(x, left, right),
            twist_covariance=J @ P @ J.T,
            slips=x[SLIPS],
            slip_covariance=P[SLIPS, SLIPS],
            motion=state.motion.motion,
        )

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
        begin = FilterState(measurement.stamp_ns, Gaussian(*self._model.initial(pose, covariance)))
        self._timeline = Timeline(window_ns, begin, measurement.stamp_ns, self._step)
        return Outcome.ACCEPTED

    def _step(self, state: FilterState, measurement: Measurement) -> FilterState:
        """Predict to the stamp of the measurement, then update with it."""
        moved = self._predict(state, measurement.stamp_ns)
        if isinstance(measurement, Sprockets):
            taken = Report(measurement.source, measurement.stamp_ns, Outcome.ACCEPTED)
            return replace(moved, report=taken)
        return self._update(moved, measurement, self._linearise(moved, measurement))

    def _predict(self, state: FilterState, stamp_ns: int) -> FilterState:
        """Sub-model 1 over the time since the state, driven by the sprockets."""
        dt = (stamp_ns - state.stamp_ns) * 1e-9
        speeds = self._track.speeds(stamp_ns)
        left, right, _ = speeds
        motion = state.motion
        if dt > 0.0:
            motion = classify(motion, left, right, dt, self.parameters.motion)
        mean, F, G = self._model.move(state.gaussian.mean, left, right, dt)
        Q = self._model.process_noise(G, left, right, dt, motion)
        gaussian = ekf.predict(state.gaussian, mean, F, Q)
        return replace(state, stamp_ns=stamp_ns, gaussian=gaussian, motion=motion, speeds=speeds)

    def _linearise(self, state: FilterState, measurement: YawRate | PoseFix) -> Linearised:
        x = state.gaussian.mean
        if isinstance(measurement, YawRate):
            variance = measurement.variance + self._quantisation_variance(state.speeds.interval)
            return self._model.yaw_rate(x, *state.speeds[:2], measurement.rate, variance)
        return self._model.pose(x, measurement.pose, measurement.covariance, self.parameters.use_heading)

    def _quantisation_variance(self, interval: float) -> float:
        """Variance of φ̇ predicted from positions rounded to counts and ``interval`` s apart, (rad/s)²."""
        if interval <= 0.0:
            return 0.0
        p = self.parameters
        rounding = p.encoder_resolution**2 / 12.0
        per_track = 2.0 * rounding * (p.vehicle.rolling_radius / p.vehicle.tread / interval) ** 2
        return 2.0 * per_track

    def _update(self, state: FilterState, measurement: Measurement, measured: Linearised) -> FilterState:
        """Gate, then update; a source rejected too often in a row is believed again."""
        innovation = ekf.weigh(state.gaussian, measured)
        dof = measured.innovation.size
        gate = self._gates[dof]
        run = state.rejected_in_a_row.get(measurement.source, 0)
        accepted = innovation.nis <= gate or run >= self.parameters.gate_patience
        gaussian = ekf.update(state.gaussian, measured, innovation) if accepted else state.gaussian
        outcome = Outcome.ACCEPTED if accepted else Outcome.GATED
        runs = {**state.rejected_in_a_row, measurement.source: 0 if accepted else run + 1}
        report = Report(measurement.source, measurement.stamp_ns, outcome, innovation.nis, gate, dof)
        return replace(state, gaussian=gaussian, rejected_in_a_row=MappingProxyType(runs), report=report)
