# SPDX-License-Identifier: Apache-2.0
"""From one measurement to the next: prediction as the sprockets say, gate, update."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.slip.coasting import make_reach
from trackslip_estimation.slip.gating import compile_for, take
from trackslip_estimation.slip.measurements import (
    SET_POSE,
    Measurement,
    Outcome,
    PoseFix,
    Report,
    SlipFix,
    Sprockets,
    YawRate,
)
from trackslip_estimation.slip.models.model import (
    DRIVEN,
    POSE,
    Gaussian,
    Measured,
    Outputs,
    rate_measured,
    slips_measured,
)
from trackslip_estimation.slip.motion import STANDSTILL, MotionState, Speeds, classify, smoothed
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, make_filter, make_gates
from trackslip_estimation.slip.sprockets import SprocketTrack

FloatArray = NDArray[np.float64]


class Leg(NamedTuple):
    """A stretch of time up to a stamp, and what the sprockets did in it."""

    stamp_ns: int
    motion: MotionState = MotionState()
    speeds: Speeds = STANDSTILL
    silent: bool = False  # they have said nothing for too long


class FilterState(NamedTuple):
    """All that the filter carries from one measurement to the next."""

    stamp_ns: int
    gaussian: Gaussian
    agreed_ns: Mapping[str, int]  # source → when it last was inside the plain gate; never changed in place
    motion: MotionState = MotionState()
    speeds: Speeds = STANDSTILL
    silent: bool = False
    report: Report | None = None  # on the measurement that led here
    predicted: Gaussian | None = None  # before it; None at a start and at a user's word


class Stepper:
    """The step of the timeline; what it remembers is all in the ``FilterState``."""

    def __init__(self, p: SlipEstimatorParameters, track: SprocketTrack) -> None:
        self.filter = make_filter(p)
        compile_for(self.filter)
        smoothed(STANDSTILL, classify(MotionState(), STANDSTILL, 0.01, p.motion), p.motion)  # these too
        self._reach = make_reach(p)
        self._track = track
        self._resolution = p.encoder_resolution
        self.use(p)

    def use(self, p: SlipEstimatorParameters) -> None:
        """Parameters that may change while it runs; those behind the filter and its noise may not."""
        self._limits, self._max_gap = p.motion, p.max_gap
        self._gates, self._poses = make_gates(p), p.poses()
        self._numbers = {name: number for number, name in enumerate(p.timeouts_ns())}

    def step(self, state: FilterState, measurement: Measurement) -> FilterState:
        """Predict to the stamp of the measurement, then update with it."""
        before, gaussian = Leg(state.stamp_ns, state.motion, state.speeds, state.silent), state.gaussian
        *passed, leg = self.legs(before, measurement.stamp_ns)
        for drive in passed:
            gaussian = self.driven(gaussian, drive, (drive.stamp_ns - before.stamp_ns) * 1e-9)
            before = drive
        dt = (leg.stamp_ns - before.stamp_ns) * 1e-9
        if leg.silent:
            gaussian, dt = self.coasted(gaussian, before, dt), 0.0
        return self._measure(gaussian, leg, dt, measurement, state.agreed_ns)

    def outputs(self, state: FilterState) -> Outputs:
        """Twist and slips."""
        return self.filter.outputs(state.gaussian, self._smoothed(state.speeds, state.motion))

    def legs(self, before: Leg, stamp_ns: int) -> tuple[Leg, ...]:
        """The way from one stamp to the next: one leg, but two where the sprockets fall silent between."""
        speeds, known_ns = self._track.stretch(stamp_ns)
        if known_ns >= stamp_ns:
            return (self._drive(before, speeds, stamp_ns),)
        silence = Leg(stamp_ns, speeds=speeds, silent=True)
        if before.stamp_ns > known_ns:
            return (silence,)
        return self._drive(before, self._track.stretch(known_ns)[0], known_ns), silence

    def _drive(self, before: Leg, speeds: Speeds, stamp_ns: int) -> Leg:
        dt = (stamp_ns - before.stamp_ns) * 1e-9
        return Leg(stamp_ns, classify(before.motion, speeds, dt, self._limits, self._resolution), speeds)

    def driven(self, state: Gaussian, leg: Leg, dt: float) -> Gaussian:
        """``dt`` s later, nothing measured."""
        return self.filter.step(state, leg.speeds, dt, leg.motion, DRIVEN).predicted

    def coasted(self, state: Gaussian, before: Leg, dt: float) -> Gaussian:
        """``dt`` s of silence later. Beyond the largest gap nothing grows: the pose is lost, gates open."""
        reach, dt = self._reach, min(dt, self._max_gap)
        if not before.silent:
            state = reach.enter(state, self.filter.outputs(state, before.speeds), dt)
        return reach.forget(reach.spread(self.driven(state, Leg(0), dt), dt))

    def placed(self, state: Gaussian, leg: Leg, dt: float, fix: PoseFix) -> Gaussian:
        """``dt`` s later, with a user's word for the pose; what else was learned stays."""
        mean, covariance = self.driven(state, leg, dt)
        mean[POSE] = fix.pose
        covariance[POSE, :] = covariance[:, POSE] = 0.0
        covariance[POSE, POSE] = fix.covariance
        return Gaussian(mean, covariance)

    def speeds(self, leg: Leg, measurement: Measurement) -> Speeds:
        """Those that predict the measurement. A gyro is compared with them: their rounding would be in its
        innovation and its Jacobian both, and bias what it teaches of turning. So are slips.
        """
        compared = isinstance(measurement, (YawRate, SlipFix))
        return self._smoothed(leg.speeds, leg.motion) if compared else leg.speeds

    def _smoothed(self, speeds: Speeds, motion: MotionState) -> Speeds:
        return smoothed(speeds, motion, self._limits, self._resolution)

    def measured(self, measurement: Measurement, *, silent: bool) -> Measured:
        """A measurement as the filter takes it; in silence a gyro tells nothing of its bias."""
        if isinstance(measurement, Sprockets):
            return DRIVEN
        if isinstance(measurement, YawRate):
            unknown = self._reach.unseen_yaw_rate**2 if silent else 0.0
            return rate_measured(measurement.rate, measurement.variance + unknown)
        if isinstance(measurement, SlipFix):
            return slips_measured(measurement.slips, measurement.covariance)
        return self._poses[measurement.source].measured(measurement)

    def _measure(
        self, state: Gaussian, leg: Leg, dt: float, measurement: Measurement, agreed_ns: Mapping[str, int]
    ) -> FilterState:
        """``dt`` s later, with the measurement taken or not."""
        name, stamp_ns = measurement.source, measurement.stamp_ns
        predicted: Gaussian | None
        if isinstance(measurement, Sprockets):
            outcome = Outcome.JUMPED if self._track.jumps(stamp_ns) else Outcome.ACCEPTED
            predicted = after = self.driven(state, leg, dt)
            report = Report(name, stamp_ns, outcome)
        elif isinstance(measurement, PoseFix) and name == SET_POSE:
            predicted, after = None, self.placed(state, leg, dt, measurement)
            report = Report(name, stamp_ns, Outcome.ACCEPTED)
        else:
            measured = self.measured(measurement, silent=leg.silent)
            number, apart_ns = self._numbers[name], stamp_ns - agreed_ns[name]
            speeds = self.speeds(leg, measurement)
            taken = take(self.filter, state, speeds, dt, leg.motion, measured, number, apart_ns, self._gates)
            predicted, after = taken.before, taken.after
            outcome = Outcome.ACCEPTED if taken.accepted else Outcome.GATED
            report = Report(name, stamp_ns, outcome, taken.nis, taken.gate, measured.value.size)
            agreed_ns = {**agreed_ns, name: stamp_ns} if taken.agreed else agreed_ns
        return FilterState(stamp_ns, after, agreed_ns, leg.motion, leg.speeds, leg.silent, report, predicted)
