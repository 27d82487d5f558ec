# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The slip estimator: measurements in any order → pose, slips and slip angle.

Live node and replay share this class. It reads no clock: time is in the stamps.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.attitude.records import AttitudeRejection
from trackslip_estimation.attitude.status import attitude_text
from trackslip_estimation.slip.bank.rows import probability_of_best
from trackslip_estimation.slip.config import make_config
from trackslip_estimation.slip.explanations import (
    BRAKE_NAME,
    AcceptedEvent,
    CompetingExplanations,
    Sources,
    accepted_events,
    describe_branches,
)
from trackslip_estimation.slip.learned import Learned, extract_learned, learned_context, set_learned_priors
from trackslip_estimation.slip.measurements import (
    FORGET,
    FREEZE,
    RESET,
    Command,
    Fault,
    Input,
    Measurement,
    Outcome,
    Reload,
    Report,
)
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.process import clear, fill_last_estimate, process
from trackslip_estimation.slip.records import BRAKE, ESTIMATE, GYROS, RESULT, TRACKS, to_records
from trackslip_estimation.slip.window import Records, Window, enlarged_copy, make_window

Step = tuple[Report, "Estimate | None"]
TiltFields = tuple[int, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, float]  # of ``TILT``
SwingFields = tuple[int, float, float, FloatArray]  # of ``SWINGING``
EstimateFields = tuple[  # of ``ESTIMATE``
    int,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    TiltFields,
    float,
    float,
    FloatArray,
    FloatArray,
    int,
    SwingFields,
]
ResultFields = tuple[int, int, int, float, float, int, int, bool, EstimateFields]  # of ``RESULT``

_CAPACITY = 512  # initial entries of a window: some seconds


@dataclass(frozen=True, eq=False)
class Tilt:
    """Attitude and height of the machine."""

    tilt: FloatArray  # (3,) roll rad, pitch rad (nose down positive), height m
    covariance: FloatArray  # (3, 3)
    rates: FloatArray  # (3,) about x, y, z, rad/s
    rate_variances: FloatArray  # (3,)
    force: FloatArray  # (3,) specific force, upward at rest, m/s²
    force_variance: float  # of each axis


@dataclass(frozen=True, eq=False)
class Swing:
    """Angle of the upper structure relative to the undercarriage."""

    angle: float  # rad, counter-clockwise, in (−π, π]
    rate: float  # rad/s
    covariance: FloatArray  # (2, 2)


@dataclass(frozen=True, eq=False)
class Outputs:
    """Outputs of a state, with covariances."""

    twist: FloatArray  # (3,) v_x m/s, v_y m/s, yaw rate rad/s at C, in the machine's axes
    twist_covariance: FloatArray  # (3, 3)
    horizontal: FloatArray  # (3,) horizontal twist: along the heading, to its left, yaw rate
    tilt: Tilt | None  # None: the ground is assumed to be flat
    rise: float  # ż, m/s; 0 on flat ground
    rise_variance: float
    slips: FloatArray  # (3,) left slip, right slip, slip angle rad
    slip_covariance: FloatArray  # (3, 3)
    swing: Swing | None = None  # None: no sensor is on the upper structure


@dataclass(frozen=True, eq=False)
class Estimate:
    """An estimate, published at the stamp of each sprocket sample."""

    stamp_ns: int
    pose: FloatArray  # (3,) x m, y m, heading rad, site frame
    pose_covariance: FloatArray  # (3, 3)
    outputs: Outputs
    motion: Motion


class SlipEstimator:
    """A filter over a window of measurements kept in stamp order."""

    def __init__(
        self,
        parameters: SlipEstimatorParameters,
        window_ns: int | None = None,
        learned: Learned | None = None,
        script: Records | None = None,
    ) -> None:
        """``window_ns``: largest delay of a measurement; None: the history window of the parameters.

        ``learned``: states learned before, with parameters of the same ``LearnedContext.machine``.
        ``script``: (n,) of ``EVENT``, the only events of a single branch.
        """
        self._window_ns, self._start = window_ns, learned
        self._accepted_events: list[AcceptedEvent] = []
        self._set_parameters(parameters)
        self.window: Window = make_window(_CAPACITY, int(self.config["poses"][0]), script)
        self.process_records(to_records((), self.sources))  # compiles now, not at the first measurement

    @property
    def started(self) -> bool:
        """Whether there is an estimate."""
        return bool(self.window.status["started"][0])

    @property
    def frozen(self) -> bool:
        """Whether poses are ignored."""
        return bool(self.window.status["frozen"][0])

    @property
    def restarts(self) -> int:
        """Restarts because the clock went back; resets by a user do not count."""
        return int(self.window.status["restarts"][0])

    @property
    def divergences(self) -> int:
        """Restarts because the state was not finite."""
        return int(self.window.status["divergences"][0])

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the estimate: of the newest sprocket sample, or of other sources while there are none."""
        clock = self.window.status["clock"][0]
        return int(clock["head_ns"]) if clock["running"] else None

    @property
    def attitude(self) -> str:
        """Source of the attitude in words, or why the ground is assumed to be flat."""
        if not self.started:
            return "flat: no estimate yet"
        return attitude_text(self.window.best[self.window.count - 1]["attitude"], self.parameters.tilt_source)

    @property
    def learned(self) -> Learned | None:
        """Learned states of machine and ground; None before the first."""
        if not self.started:
            return self._start
        learned = extract_learned(self.window.best[self.window.count - 1], self.learned_context, self.sources)
        return learned if learned.is_finite else self._start

    @property
    def competing_explanations(self) -> CompetingExplanations:
        """Competing explanations, the most probable first; none without an estimate."""
        explanations = describe_branches(self.window, self._named_sources) if self.started else []
        return CompetingExplanations(self.newest_ns or 0, explanations)

    @property
    def certainty(self) -> float:
        """Probability of the most probable branch; 0 without an estimate."""
        return float(probability_of_best(self.window, self.window.count - 1)) if self.started else 0.0

    def read_events(self) -> list[AcceptedEvent]:
        """Events of the most probable branch: its latest 16, and older ones of earlier calls."""
        if self.started:
            branch = self.window.branches[0, self.window.count - 1]
            self._accepted_events = accepted_events(
                branch, self._named_sources, self._accepted_events, self.certainty
            )
        return self._accepted_events

    def apply_command(self, command: Command | Reload) -> Report:
        """Reset, forget, freeze or unfreeze, or use new values of parameters.

        The estimate after a reset starts from the learned states; ``FORGET`` is a reset without them.

        Raises:
            InputError: a new value is invalid; nothing changes then.
        """
        if isinstance(command, Reload):
            self._set_parameters(self.parameters.changed(command.values))
        elif command.source in (RESET, FORGET):
            self._start = self.learned if command.source == RESET else None
            clear(self.window)
            self._set_parameters(self.parameters)
        else:
            self.window.status["frozen"] = command.source == FREEZE
        return Report(command.source, command.stamp_ns, Outcome.ACCEPTED)

    def process_records(self, arrivals: Records) -> Records:
        """Process (k,) records of ``MEASUREMENT`` in the order of their arrival; (k,) of ``RESULT``."""
        results = np.zeros(len(arrivals), RESULT)
        done = 0
        while True:
            done += process(self.window, arrivals[done:], results[done:], self.config)
            if done == len(arrivals):
                return results
            self.window = enlarged_copy(self.window)

    def process(self, arrival: Input) -> Step:
        """Process one measurement in the order of stamps, or apply a command.

        Returns its report, and the estimate to publish if it was the newest sprocket sample.
        """
        if isinstance(arrival, (Command, Reload)):
            return self.apply_command(arrival), None
        return self.process_all((arrival,))[0]

    def process_all(self, measurements: Iterable[Measurement]) -> list[Step]:
        """``process`` of each in one call."""
        arrivals = list(measurements)
        results = self.process_records(to_records(arrivals, self.sources))
        return [make_step(result, m.source) for result, m in zip(results.tolist(), arrivals, strict=True)]

    def estimate(self) -> Estimate:
        """The estimate at the newest stamp of any source.

        Raises:
            RuntimeError: there is no estimate yet.
        """
        if not self.started:
            raise RuntimeError("no estimate yet")
        records = np.zeros(1, ESTIMATE)
        fill_last_estimate(self.window, self.config, records)
        return make_estimate(records[0].item())

    def _set_parameters(self, p: SlipEstimatorParameters) -> None:
        self.parameters = p
        self.sources = {name: number for number, name in enumerate(p.timeouts_ns())}
        self.config = make_config(p, self._window_ns)
        self.learned_context = learned_context(p)
        names = {number: name for name, number in self.sources.items()}
        names |= {TRACKS: "sprockets", GYROS: "gyro", BRAKE: BRAKE_NAME}
        c = self.config[0]
        offset_states = c["offsets"].tolist(), c["yaw_offsets"].tolist()
        self._named_sources = Sources(names, *offset_states, set(p.velocities()), set(p.swing_encoders()))
        if self._start is not None:
            set_learned_priors(self._start, self.config, self.learned_context, self.sources)


def make_step(result: ResultFields, source: str) -> Step:
    """Report and estimate of a record of ``RESULT``, given as a tuple, which is faster to read."""
    stamp_ns, outcome, dof, nis, gate, attitude, fault, published, estimate = result
    rejection, reason = AttitudeRejection(attitude) if attitude else None, Fault(fault) if fault else None
    report = Report(source, stamp_ns, Outcome(outcome), nis, gate, dof, rejection, reason)
    return report, make_estimate(estimate) if published else None


def make_estimate(fields: EstimateFields) -> Estimate:
    """The estimate of a record of ``ESTIMATE``, given as a tuple."""
    stamp_ns, pose, pose_covariance, twist, twist_covariance, horizontal, tilt = fields[:7]
    rise, rise_variance, slips, slip_covariance, motion, swing = fields[7:]
    tilt_ = Tilt(*tilt[1:]) if tilt[0] else None
    swing_ = Swing(*swing[1:]) if swing[0] else None
    outputs = Outputs(
        twist, twist_covariance, horizontal, tilt_, rise, rise_variance, slips, slip_covariance, swing_
    )
    return Estimate(stamp_ns, pose, pose_covariance, outputs, Motion(motion))
