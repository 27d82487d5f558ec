# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The slip estimator: measurements in, in any order; pose, slips and slip angle out.

Live node and replay run this same class. It knows no clock: time is in the stamps.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.attitude.records import AttitudeRefusal
from trackslip_estimation.attitude.status import attitude_text
from trackslip_estimation.slip.bank.rows import probability_of_best
from trackslip_estimation.slip.config import make_config
from trackslip_estimation.slip.explanations import Explained, Happened, Sources, explanations, history
from trackslip_estimation.slip.learned import Learned, learned_of, meaning, start_from
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
from trackslip_estimation.slip.records import ESTIMATE, GYROS, RESULT, TRACKS, to_records
from trackslip_estimation.slip.window import Records, Window, enlarged, make_window

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

_CAPACITY = 512  # entries of a window at first: some seconds


@dataclass(frozen=True, eq=False)
class Tilt:
    """How the machine leans, and how high it is."""

    tilt: FloatArray  # (3,) roll rad, pitch rad (nose down positive), height m
    covariance: FloatArray  # (3, 3)
    rates: FloatArray  # (3,) about x, y, z, rad/s
    rate_variances: FloatArray  # (3,)
    force: FloatArray  # (3,) specific force, upward at rest, m/s²
    force_variance: float  # of each axis


@dataclass(frozen=True, eq=False)
class Swing:
    """How the upper structure is turned against the undercarriage."""

    angle: float  # rad, counter-clockwise, in (−π, π]
    rate: float  # rad/s
    covariance: FloatArray  # (2, 2)


@dataclass(frozen=True, eq=False)
class Outputs:
    """What a state means, with covariances."""

    twist: FloatArray  # (3,) v_x m/s, v_y m/s, yaw rate rad/s at C, in the machine's axes
    twist_covariance: FloatArray  # (3, 3)
    horizontal: FloatArray  # (3,) what of it is: along the heading, to its left, rate of the heading
    tilt: Tilt | None  # None: the ground counts as flat
    rise: float  # of the height, m/s; 0 on ground that counts as flat
    rise_variance: float
    slips: FloatArray  # (3,) left slip, right slip, slip angle rad
    slip_covariance: FloatArray  # (3, 3)
    swing: Swing | None = None  # None: nothing sits on it


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

    def __init__(
        self,
        parameters: SlipEstimatorParameters,
        window_ns: int | None = None,
        learned: Learned | None = None,
        script: Records | None = None,
    ) -> None:
        """``window_ns``: how late a measurement may come, where it is not the parameters' history window.

        ``learned``: what was learned before of this machine, with parameters of the same ``Meaning.machine``.
        ``script``: (n,) of ``EVENT``: then there is one branch, and these are its only events.
        """
        self._window_ns, self._start = window_ns, learned
        self._happened: list[Happened] = []
        self._use(parameters)
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
        """Since the clock went back, not those a user asked for."""
        return int(self.window.status["restarts"][0])

    @property
    def divergences(self) -> int:
        """How often the estimate restarted because its state was not finite."""
        return int(self.window.status["divergences"][0])

    @property
    def newest_ns(self) -> int | None:
        """The time of the estimate: newest stamp of the sprockets, or of what carries on in their silence."""
        clock = self.window.status["clock"][0]
        return int(clock["head_ns"]) if clock["running"] else None

    @property
    def attitude(self) -> str:
        """Where the machine leans, or why the ground counts as flat."""
        if not self.started:
            return "flat: no estimate yet"
        return attitude_text(self.window.best[self.window.count - 1]["attitude"], self.parameters.tilt_source)

    @property
    def learned(self) -> Learned | None:
        """What is known by now of machine and ground; None where nothing was learned yet."""
        if not self.started:
            return self._start
        found = learned_of(self.window.best[self.window.count - 1], self.meaning, self.sources)
        return found if found.is_finite else self._start

    @property
    def explained(self) -> Explained:
        """What may have happened, the most probable first; nothing without an estimate."""
        found = explanations(self.window, self._named) if self.started else []
        return Explained(self.newest_ns or 0, found)

    @property
    def certainty(self) -> float:
        """Probability of the most probable branch; 0 without an estimate."""
        return float(probability_of_best(self.window, self.window.count - 1)) if self.started else 0.0

    def read_events(self) -> list[Happened]:
        """Events of the most probable branch; it keeps the last 16, those before are of earlier calls."""
        if self.started:
            branch = self.window.branches[0, self.window.count - 1]
            self._happened = history(branch, self._named, self._happened, self.certainty)
        return self._happened

    def apply_command(self, command: Command | Reload) -> Report:
        """Reset, forget, freeze or unfreeze, or use new values of parameters.

        A reset keeps what was learned: the next estimate starts from it. ``FORGET`` is a reset that does not.

        Raises:
            InputError: a new value of a parameter is refused; then nothing changes.
        """
        if isinstance(command, Reload):
            self._use(self.parameters.changed(command.values))
        elif command.source in (RESET, FORGET):
            self._start = self.learned if command.source == RESET else None
            clear(self.window)
            self._use(self.parameters)
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
            self.window = enlarged(self.window)

    def process(self, given: Input) -> Step:
        """Use one measurement in its place by stamp, or apply a command.

        Returns what became of it, and the estimate to publish if this was the newest sprocket sample.
        """
        if isinstance(given, (Command, Reload)):
            return self.apply_command(given), None
        return self.process_all((given,))[0]

    def process_all(self, measurements: Iterable[Measurement]) -> list[Step]:
        """``process`` of each, at once."""
        given = list(measurements)
        results = self.process_records(to_records(given, self.sources))
        return [make_step(result, m.source) for result, m in zip(results.tolist(), given, strict=True)]

    def estimate(self) -> Estimate:
        """The state at the newest stamp, of whichever source.

        Raises:
            RuntimeError: nothing has started the estimate yet.
        """
        if not self.started:
            raise RuntimeError("no estimate yet")
        records = np.zeros(1, ESTIMATE)
        fill_last_estimate(self.window, self.config, records)
        return make_estimate(records[0].item())

    def _use(self, p: SlipEstimatorParameters) -> None:
        self.parameters = p
        self.sources = {name: number for number, name in enumerate(p.timeouts_ns())}
        self.config = make_config(p, self._window_ns)
        self.meaning = meaning(p)
        names = {number: name for name, number in self.sources.items()} | {TRACKS: "sprockets", GYROS: "gyro"}
        c = self.config[0]
        places = c["offsets"].tolist(), c["yaw_offsets"].tolist()
        self._named = Sources(names, *places, set(p.velocities()), set(p.angles()))
        if self._start is not None:
            start_from(self._start, self.config, self.meaning, self.sources)


def make_step(result: ResultFields, source: str) -> Step:
    """What a record of ``RESULT`` says; a tuple of its fields is faster to look at."""
    stamp_ns, outcome, dof, nis, gate, attitude, fault, published, estimate = result
    refusal, lack = AttitudeRefusal(attitude) if attitude else None, Fault(fault) if fault else None
    report = Report(source, stamp_ns, Outcome(outcome), nis, gate, dof, refusal, lack)
    return report, make_estimate(estimate) if published else None


def make_estimate(fields: EstimateFields) -> Estimate:
    """What a record of ``ESTIMATE`` says."""
    stamp_ns, pose, pose_covariance, twist, twist_covariance, horizontal, tilt = fields[:7]
    rise, rise_variance, slips, slip_covariance, motion, swing = fields[7:]
    leans = Tilt(*tilt[1:]) if tilt[0] else None
    swung = Swing(*swing[1:]) if swing[0] else None
    outputs = Outputs(
        twist, twist_covariance, horizontal, leans, rise, rise_variance, slips, slip_covariance, swung
    )
    return Estimate(stamp_ns, pose, pose_covariance, outputs, Motion(motion))
