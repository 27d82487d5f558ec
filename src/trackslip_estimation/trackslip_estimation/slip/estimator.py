# SPDX-License-Identifier: Apache-2.0
"""The slip estimator: measurements in, in any order; pose, slips and slip angle out.

Live node and replay run this same class. It knows no clock: time is in the stamps.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trackslip_common.clock_monitor import Continuity, Course
from trackslip_estimation.slip.measurements import (
    FREEZE,
    RESET,
    SET_POSE,
    Command,
    Input,
    Measurement,
    Outcome,
    PoseFix,
    Reload,
    Report,
    SlipFix,
    Sprockets,
    YawRate,
)
from trackslip_estimation.slip.models.model import POSE, YAW, Gaussian, Outputs
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.sprockets import SprocketTrack
from trackslip_estimation.slip.stepping import FilterState, Stepper
from trackslip_estimation.slip.timeline import Timeline

FloatArray = NDArray[np.float64]

_OUTCOMES = {
    Course.IN_LINE: Outcome.ACCEPTED,
    Course.AHEAD: Outcome.AHEAD,
    Course.BEHIND: Outcome.TOO_LATE,
    Course.BACK: Outcome.RESTARTED,
}
_NO_DIRECTION = math.pi**2 / 12.0  # rad², variance of a direction that may be any of half a turn


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is published at the stamp of each sprocket sample."""

    stamp_ns: int
    pose: FloatArray  # (3,) x m, y m, heading rad, site frame
    pose_covariance: FloatArray  # (3, 3)
    outputs: Outputs
    motion: Motion


class SlipEstimator:
    """A filter over a window of measurements kept in stamp order."""

    _timeline: Timeline[FilterState] | None
    _latest: FilterState  # the one that the newest input made
    _published_ns: int  # stamp of the newest estimate
    _track: SprocketTrack
    stepper: Stepper
    _continuity: Continuity

    def __init__(self, parameters: SlipEstimatorParameters, window_ns: int | None = None) -> None:
        """``window_ns``: how late a measurement may come, where it is not the parameters' history window."""
        self._window_ns = round(parameters.history_window * 1e9) if window_ns is None else window_ns
        self.frozen = False
        self.restarts = 0  # since the clock went back, not those a user asked for
        self._use(parameters)
        self._begin_anew()

    @property
    def started(self) -> bool:
        """Whether there is an estimate."""
        return self._timeline is not None

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest sprocket sample, which is the time of the estimate."""
        return self._continuity.head_ns

    def obey(self, asked: Command | Reload) -> Report:
        """Do what a user asks.

        Raises:
            InputError: a new value of a parameter is refused; then nothing changes.
        """
        if isinstance(asked, Reload):
            self._use(self.parameters.changed(asked.values))
            self.stepper.use(self.parameters)
        elif asked.source == RESET:
            self._begin_anew()
        else:
            self.frozen = asked.source == FREEZE
        return Report(asked.source, asked.stamp_ns, Outcome.ACCEPTED)

    def take(self, measurement: Measurement) -> Report:
        """Use one measurement, in its place by stamp, and say what became of it."""
        given = measurement

        def refused(outcome: Outcome) -> Report:
            return Report(given.source, given.stamp_ns, outcome)

        measurement, outcome = self.admit(given)
        if outcome.refused:
            return refused(outcome)
        if outcome is Outcome.RESTARTED:
            self._begin_anew()
            self.restarts += 1
            self._course(measurement)
        if self._timeline is None:
            began = self._start(measurement)
            return refused(outcome if outcome is Outcome.RESTARTED else began)
        reason = self._timeline.refusal(measurement)
        if reason is not None:
            return refused(reason)
        self._latest = self._timeline.insert(measurement, self._redo_from(measurement))
        self._track.forget_before(self._timeline.oldest_ns)
        report = self._latest.report
        assert report is not None
        return report if report.stamp_ns == given.stamp_ns else replace(report, stamp_ns=given.stamp_ns)

    def admit(self, given: Measurement) -> tuple[Measurement, Outcome]:
        """The measurement as its source's parameters want it, and what its numbers and its stamp say."""
        if not self.is_usable(given):
            return given, Outcome.INVALID
        if self.frozen and isinstance(given, PoseFix) and given.source != SET_POSE:
            return given, Outcome.FROZEN
        measurement = self.prepared(given)
        if measurement.stamp_ns == 0 and measurement.source == SET_POSE:
            return given, Outcome.WAITING  # for the first sprocket sample: now is not known yet
        return measurement, _OUTCOMES[self._course(measurement)]

    def advance(self, given: Input) -> tuple[Report, Estimate | None]:
        """``take`` or ``obey``, and the estimate to publish if this was the newest sprocket sample."""
        if isinstance(given, (Command, Reload)):
            return self.obey(given), None
        report = self.take(given)
        newest = isinstance(given, Sprockets) and given.stamp_ns > self._published_ns
        if report.outcome.refused or not newest or not self.started:
            return report, None
        self._published_ns = given.stamp_ns
        return report, self.estimate_of(self._latest)

    def estimate(self) -> Estimate:
        """The state at the newest stamp.

        Raises:
            RuntimeError: nothing has started the estimate yet.
        """
        if self._timeline is None:
            raise RuntimeError("no estimate yet")
        return self.estimate_of(self._timeline.newest)

    def history(self) -> list[FilterState]:
        """The states in the window, in the order of their stamps."""
        return [] if self._timeline is None else self._timeline.states

    def _use(self, p: SlipEstimatorParameters) -> None:
        self.parameters = p
        self._poses, self._gyros = p.poses(), p.gyros()

    def _begin_anew(self) -> None:
        """Forget all measurements and all that was learned."""
        p = self.parameters
        self._published_ns = -1
        self._timeline = None
        self._track = SprocketTrack(round(p.sprocket_timeout * 1e9), p.max_sprocket_speed)
        self.stepper = Stepper(p, self._track)
        self._continuity = Continuity(round(p.max_gap * 1e9), p.jump_confirmations)

    def is_usable(self, measurement: Measurement) -> bool:
        """Whether its numbers are such."""
        if isinstance(measurement, PoseFix) and measurement.source != SET_POSE:
            return measurement.is_finite(self._poses[measurement.source].use_heading)
        return measurement.is_finite()

    def prepared(self, measurement: Measurement) -> Measurement:
        """As its source's parameters want it."""
        if isinstance(measurement, (Sprockets, SlipFix)):
            return measurement
        if isinstance(measurement, YawRate):
            return self._gyros[measurement.source].prepared(measurement)
        if measurement.source != SET_POSE:
            return self._poses[measurement.source].prepared(measurement)
        now_ns = self.newest_ns if measurement.stamp_ns == 0 else None
        return measurement if now_ns is None else replace(measurement, stamp_ns=now_ns)

    def _course(self, measurement: Measurement) -> Course:
        if not isinstance(measurement, Sprockets):
            return self._continuity.other(measurement.stamp_ns)
        oldest_ns = None if self._timeline is None else self._timeline.oldest_ns
        late = self.newest_ns is not None and measurement.stamp_ns <= self.newest_ns
        contradicts = late and self._track.contradicts(measurement)
        return self._continuity.sprockets(measurement.stamp_ns, oldest_ns, contradicts)

    def _redo_from(self, measurement: Measurement) -> int | None:
        """A sprocket sample tells what was extrapolated from the one before it on, or from the start."""
        if not isinstance(measurement, Sprockets):
            return None
        self._track.add(measurement)
        last_ns = self._track.last_before(measurement.stamp_ns)
        return -1 if last_ns is None else last_ns

    def estimate_of(self, state: FilterState) -> Estimate:
        """What a state means."""
        return make_estimate(state.stamp_ns, state.gaussian, self.stepper.outputs(state), state.motion.motion)

    def _start(self, measurement: Measurement) -> Outcome:
        """Begin with a fix, a user's word, or the initial pose at the first sprocket sample; else wait."""
        p, window_ns = self.parameters, self._window_ns
        if isinstance(measurement, Sprockets):
            self._track.add(measurement)
            self._track.forget_before(measurement.stamp_ns - window_ns)
        if not self.begins_with(measurement):
            return Outcome.WAITING
        if isinstance(measurement, PoseFix):
            gaussian = self._start_at(measurement)
        else:
            gaussian = self.stepper.filter.initial(*p.initial_pose())
        agreed_ns = dict.fromkeys(p.timeouts_ns(), measurement.stamp_ns)
        begin = self._latest = FilterState(measurement.stamp_ns, gaussian, agreed_ns)
        self._timeline = Timeline(window_ns, begin, measurement, self.stepper.step)
        return Outcome.ACCEPTED

    def begins_with(self, measurement: Measurement) -> bool:
        """Whether the estimate can start from it: a fix, a user's word, or a sprocket sample."""
        first_fix = self.parameters.start == "first_fix"
        if isinstance(measurement, PoseFix):
            return first_fix or measurement.source == SET_POSE
        return isinstance(measurement, Sprockets) and not first_fix

    def _start_at(self, fix: PoseFix) -> Gaussian:
        """At a fix; a heading that it does not have is that of the parameters."""
        pose, covariance = fix.pose.copy(), fix.covariance.copy()
        if not (fix.is_finite() and covariance[YAW, YAW] <= math.pi**2):
            initial_pose, initial_covariance = self.parameters.initial_pose()
            covariance[YAW, :] = covariance[:, YAW] = 0.0
            pose[YAW], covariance[YAW, YAW] = initial_pose[YAW], initial_covariance[YAW, YAW]
        gaussian = self.stepper.filter.initial(pose, covariance)
        return gaussian if fix.source == SET_POSE else self._poses[fix.source].from_sensor(gaussian)


def make_estimate(stamp_ns: int, state: Gaussian, outputs: Outputs, motion: Motion) -> Estimate:
    """What is published of a state."""
    if outputs.slip_covariance[2, 2] == 0.0:  # at a standstill there is no direction
        any_direction = np.diag((0.0, 0.0, _NO_DIRECTION))
        outputs = replace(outputs, slip_covariance=any_direction + outputs.slip_covariance)
    return Estimate(stamp_ns, state.mean[POSE], state.covariance[POSE, POSE], outputs, motion)
