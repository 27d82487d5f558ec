# SPDX-License-Identifier: Apache-2.0
"""From one measurement to the next: prediction as the sprockets say, gate, update.

ν    innovation, what a measurement says beyond the prediction
d²   normalised innovation squared
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.filters.linear_algebra import wrap
from trackslip_estimation.filters.model import DRIVEN, POSE, YAW, Gaussian, pose_measured, rate_measured
from trackslip_estimation.gate import Gate, admit_bias, admit_pose
from trackslip_estimation.measurements import (
    SET_POSE,
    Measurement,
    Outcome,
    PoseFix,
    Report,
    Sprockets,
    YawRate,
)
from trackslip_estimation.motion import STANDSTILL, MotionState, Speeds, classify
from trackslip_estimation.silence import make_reach
from trackslip_estimation.slip_parameters import SlipEstimatorParameters, make_filter
from trackslip_estimation.sprocket_track import SprocketTrack

FloatArray = NDArray[np.float64]


class FilterState(NamedTuple):
    """All that the filter carries from one measurement to the next."""

    stamp_ns: int
    gaussian: Gaussian
    agreed_ns: Mapping[str, int]  # source → when it last was inside the plain gate; never changed in place
    motion: MotionState = MotionState()
    speeds: Speeds = STANDSTILL
    silent: bool = False  # the sprockets have said nothing for too long
    report: Report | None = None  # on the measurement that led here


class Stepper:
    """The step of the timeline; what it remembers is all in the ``FilterState``."""

    def __init__(self, p: SlipEstimatorParameters, track: SprocketTrack) -> None:
        self.filter = make_filter(p)
        self._reach = make_reach(p)
        self._track = track
        self.use(p)

    def use(self, p: SlipEstimatorParameters) -> None:
        """Parameters that may change while it runs; those behind the filter and its noise may not."""
        self._limits, self._max_gap = p.motion, p.max_gap
        self._gate = Gate(p.gate_probability, p.gate_relaxation)
        self._poses, self._gyros = p.poses(), p.gyros()

    def step(self, state: FilterState, measurement: Measurement) -> FilterState:
        """Predict to the stamp of the measurement, then update with it."""
        stamp_ns = measurement.stamp_ns
        speeds, known_ns = self._track.stretch(stamp_ns)
        if known_ns < stamp_ns:  # the rest is silence
            if state.stamp_ns <= known_ns:
                state = self._drive(state, self._track.stretch(known_ns)[0], known_ns)
            state = self._coast(state, stamp_ns)
            moved = state._replace(speeds=speeds)
        else:
            dt = (stamp_ns - state.stamp_ns) * 1e-9
            motion = classify(state.motion, speeds.left, speeds.right, dt, self._limits)
            moved = FilterState(stamp_ns, state.gaussian, state.agreed_ns, motion, speeds)
        return self._measure(moved, (stamp_ns - state.stamp_ns) * 1e-9, measurement)

    def _drive(self, state: FilterState, speeds: Speeds, stamp_ns: int) -> FilterState:
        """Predicted with known sprocket speeds."""
        dt = (stamp_ns - state.stamp_ns) * 1e-9
        motion = classify(state.motion, speeds.left, speeds.right, dt, self._limits)
        gaussian = self._predicted(state.gaussian, speeds, dt, motion)
        return FilterState(stamp_ns, gaussian, state.agreed_ns, motion, speeds)

    def _coast(self, state: FilterState, stamp_ns: int) -> FilterState:
        """Predicted in silence. Beyond the largest gap nothing grows: the pose is lost, gates are open."""
        reach, motion = self._reach, MotionState()
        dt = min((stamp_ns - state.stamp_ns) * 1e-9, self._max_gap)
        gaussian = state.gaussian if state.silent else reach.enter(state.gaussian, dt)
        gaussian = reach.spread(self._predicted(gaussian, STANDSTILL, dt, motion), dt)
        return FilterState(stamp_ns, reach.forget(gaussian), state.agreed_ns, motion, silent=True)

    def _measure(self, state: FilterState, dt: float, measurement: Measurement) -> FilterState:
        """``dt`` s later, with the measurement taken or not."""
        if isinstance(measurement, Sprockets):
            held = self.filter.step(state.gaussian, state.speeds, dt, state.motion, DRIVEN)
            outcome = Outcome.JUMPED if self._track.jumps(measurement.stamp_ns) else Outcome.ACCEPTED
            return state._replace(gaussian=held.updated, report=_report(measurement, outcome))
        if isinstance(measurement, YawRate):
            return self._turn(state, dt, measurement)
        if measurement.source == SET_POSE:
            moved = self._predicted(state.gaussian, state.speeds, dt, state.motion)
            return state._replace(
                gaussian=_placed(moved, measurement), report=_report(measurement, Outcome.ACCEPTED)
            )
        return self._fix(state, dt, measurement)

    def _turn(self, state: FilterState, dt: float, measurement: YawRate) -> FilterState:
        """A gyro's rate; in silence it tells nothing of its bias."""
        unknown = self._reach.unseen_yaw_rate**2 if state.silent else 0.0
        measured = rate_measured(measurement.rate, measurement.variance + unknown)
        held = self.filter.step(state.gaussian, state.speeds, dt, state.motion, measured)
        timeout_ns = self._gyros[measurement.source].timeout_ns
        report, surprising = self._gated(state, measurement, held.nis, 1, timeout_ns)
        if report.outcome is Outcome.GATED:
            return state._replace(gaussian=held.predicted, report=report)
        if surprising:
            expected = self.filter.outputs(held.predicted, state.speeds).twist[2] + held.predicted.mean[-1]
            wide = admit_bias(held.predicted, float(measurement.rate - expected))
            held = self.filter.step(wide, state.speeds, 0.0, state.motion, measured)
        return _agreed(state, held.updated, report)  # surprised or not: now its bias explains it

    def _fix(self, state: FilterState, dt: float, fix: PoseFix) -> FilterState:
        """A pose, held against that of its sensor."""
        source = self._poses[fix.source]
        gaussian = state.gaussian
        if source.is_apart:
            gaussian = source.to_sensor(self._predicted(gaussian, state.speeds, dt, state.motion))
            dt = 0.0
        heading = source.tells_heading(fix)
        measured = pose_measured(fix.pose, fix.covariance, heading)
        held = self.filter.step(gaussian, state.speeds, dt, state.motion, measured)
        report, surprising = self._gated(state, fix, held.nis, measured.value.size, source.timeout_ns)
        if report.outcome is Outcome.GATED:
            return state._replace(gaussian=source.from_sensor(held.predicted), report=report)
        if surprising:
            innovation = fix.pose - held.predicted.mean[POSE]
            innovation[YAW] = wrap(innovation[YAW]) if heading else 0.0
            wide = admit_pose(held.predicted, innovation)
            held = self.filter.step(wide, state.speeds, 0.0, state.motion, measured)
            return state._replace(gaussian=source.from_sensor(held.updated), report=report)
        return _agreed(state, source.from_sensor(held.updated), report)

    def _predicted(self, state: Gaussian, speeds: Speeds, dt: float, motion: MotionState) -> Gaussian:
        """``dt`` s later, nothing measured."""
        return self.filter.step(state, speeds, dt, motion, DRIVEN).predicted

    def _gated(
        self, state: FilterState, measurement: Measurement, nis: float, dof: int, timeout_ns: int
    ) -> tuple[Report, bool]:
        """The report, and whether the measurement passes only because the gate is wide."""
        limit = self._gate.limits[dof]
        gate = limit * self._gate.width(state.stamp_ns - state.agreed_ns[measurement.source], timeout_ns)
        outcome = Outcome.ACCEPTED if nis <= gate else Outcome.GATED
        return Report(measurement.source, measurement.stamp_ns, outcome, nis, gate, dof), nis > limit


def _report(measurement: Measurement, outcome: Outcome) -> Report:
    return Report(measurement.source, measurement.stamp_ns, outcome)


def _agreed(state: FilterState, gaussian: Gaussian, report: Report) -> FilterState:
    """The state after a measurement that it expected."""
    agreed_ns = {**state.agreed_ns, report.source: report.stamp_ns}
    return state._replace(gaussian=gaussian, agreed_ns=agreed_ns, report=report)


def _placed(state: Gaussian, fix: PoseFix) -> Gaussian:
    """A user's word for the pose, instead of the estimated one; what else was learned stays."""
    mean, covariance = state.mean.copy(), state.covariance.copy()
    mean[POSE] = fix.pose
    covariance[POSE, :] = covariance[:, POSE] = 0.0
    covariance[POSE, POSE] = fix.covariance
    return Gaussian(mean, covariance)
