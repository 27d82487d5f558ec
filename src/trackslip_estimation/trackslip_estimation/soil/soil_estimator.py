# SPDX-License-Identifier: Apache-2.0
"""The soil estimator: slips and pressures in; forces, resistances and the strength of the soil out.

Live node and replay run this same class. It knows no clock: time is in the stamps. It takes from the slip
estimator and gives nothing back but a seed after a turn, which nobody hears unless a user wants it.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from trackslip_common.soils import load_soils
from trackslip_common.tally import Tally
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.classes import SoilClasses
from trackslip_estimation.soil.dynamics import Dynamics
from trackslip_estimation.soil.flow_check import FlowCheck
from trackslip_estimation.soil.moments import Moment, Moments, Pressures
from trackslip_estimation.soil.pressure_watch import PressureFault, PressureWatch
from trackslip_estimation.soil.records import HYDRAULICS, Refusal, SlipSeed, SoilInput, TrackForces
from trackslip_estimation.soil.reserve import Reserve, thrust_reserve
from trackslip_estimation.soil.slip_seed import SlipSeeder
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters
from trackslip_estimation.soil.strength_posterior import (
    StrengthPosterior,
    StrengthSample,
    StrengthSummary,
)
from trackslip_estimation.soil.thrust import Thrust, ThrustMeter
from trackslip_estimation.soil.tracks import track_speeds

FloatArray = NDArray[np.float64]

_LIKELY = 0.5  # probability
_UNKNOWN = np.full(2, np.nan)


@dataclass(frozen=True)
class SoilState:
    """What is known of the soil."""

    stamp_ns: int
    mu_r: float
    mu_r_variance: float
    mu_l: float
    mu_l_variance: float
    strength: StrengthSummary
    classes: dict[str, float]  # probability of each class of soil, and of none of them


SoilOutput: TypeAlias = TrackForces | SoilState | SlipSeed


class SoilEstimator:
    """Thrusts, sub-model 2 and the strength posterior, moment by moment."""

    _newest_ns: int | None  # stamp of the newest moment
    _thrust: Thrust | None  # seen, or as it was last seen
    _limit_chances: FloatArray  # probability of each F_max, of the newest state
    _strength: StrengthSummary | None  # of the newest state

    def __init__(self, p: SoilEstimatorParameters) -> None:
        self.parameters = p
        self.tally = Tally()
        self.restarts = 0
        self._moments = Moments(p.moments, self.tally)
        self._begin_anew()

    @property
    def faults(self) -> tuple[PressureFault, ...]:
        """What is wrong with the pressures."""
        return self._watch.faults

    @property
    def strength(self) -> StrengthSummary:
        """K and F_max now, and whether they are identifiable."""
        return self._posterior.summary()

    @property
    def volumetric_efficiency(self) -> float | None:
        """η_V as spools and speeds have it; a hint."""
        return self._flow.efficiency

    @property
    def struggling(self) -> tuple[bool, bool]:
        """Whether the left and the right track are getting stuck: spinning at the limit of the soil."""
        left, right = self._spinning >= self.parameters.stuck_time
        return bool(left), bool(right)

    def use(self, p: SoilEstimatorParameters) -> None:
        """Other values of what may change while it runs."""
        self.parameters = p

    def advance(self, given: SoilInput) -> list[SoilOutput]:
        """Take one input; what is to be published after it, in the order of the stamps."""
        if self._moments.add(given) is Refusal.RESTARTED:
            self._begin_anew()
            self.restarts += 1
        return [output for moment in self._moments.ready() for output in self._step(moment)]

    def _begin_anew(self) -> None:
        """Forget all that was learned; the transducers are still the same, but who knows for how long."""
        p = self.parameters
        self._newest_ns = None
        self._watch = PressureWatch(p.watch, p.vehicle)
        self._meter = ThrustMeter(p.thrust, p.vehicle)
        self._dynamics = Dynamics(p.dynamics, p.vehicle)
        self._posterior = StrengthPosterior(p.strength, p.vehicle)
        self._classes = SoilClasses(
            p.classes,
            load_soils().values(),
            p.vehicle,
            self._posterior.log_moduli,
            self._posterior.log_limits,
        )
        self._flow = FlowCheck(p.vehicle)
        self._seeder = SlipSeeder(p.seed, p.vehicle.contact_length)
        self._strength = None
        self._thrust = None
        self._spinning = np.zeros(2)  # s

    def _step(self, now: Moment) -> list[SoilOutput]:
        before_ns = now.stamp_ns if self._newest_ns is None else self._newest_ns
        dt, self._newest_ns = (now.stamp_ns - before_ns) * 1e-9, now.stamp_ns
        tracks = track_speeds(now.odometry.twist, now.slips.mean, self.parameters.vehicle)
        pressures = self._trusted(now, tracks, dt)
        thrust = self._measured(now, pressures, tracks, dt)
        self._thrust = thrust or self._meter.unseen(self._thrust, dt)
        twist, covariance = now.odometry.twist, now.odometry.twist_covariance
        motion, turn = now.slips.motion, float(tracks[1] - tracks[0])
        self._dynamics.step(dt, motion, twist, covariance, turn, thrust)
        forces, variances = (_UNKNOWN, _UNKNOWN) if thrust is None else (thrust.force, thrust.variance)
        place = now.odometry.place
        self._posterior.update(
            StrengthSample(dt, tracks, twist, covariance, forces, variances, motion, place)
        )
        seed = self._seeder.step(now.stamp_ns, dt, motion, tracks, thrust, self._strength)
        return self._outputs(now, before_ns) + ([] if seed is None else [seed])

    def _measured(
        self, now: Moment, pressures: Pressures | None, tracks: FloatArray, dt: float
    ) -> Thrust | None:
        """What trusted pressures come to; on the way they show their offsets and the flow."""
        p = self.parameters
        if pressures is None:
            self._meter.offsets.step(None, dt)
            return None
        closed = bool((np.abs(pressures.spools) < p.thrust.closed_spool).all())
        standing = closed and now.slips.motion is Motion.STANDING
        self._meter.offsets.step(pressures.values if standing else None, dt)
        speeds = tracks / p.vehicle.rolling_radius
        if now.slips.motion is Motion.STRAIGHT:
            self._flow.add(pressures.spools, speeds, dt)
        return self._meter.measure(pressures.values, speeds)

    def _trusted(self, now: Moment, tracks: FloatArray, dt: float) -> Pressures | None:
        """The pressures of the moment, if they can be true."""
        fault = self._watch.judge(now.pressures, tracks, now.slips.motion, dt)
        if fault is None:
            return now.pressures
        self.tally.add(HYDRAULICS, fault)
        return None

    def _outputs(self, now: Moment, before_ns: int) -> list[SoilOutput]:
        """On the grid of either period; the first moment starts both."""
        p = self.parameters
        outputs: list[SoilOutput] = []
        if _passes(before_ns, now.stamp_ns, p.soil_period):
            outputs.append(self._state(now.stamp_ns))
        if _passes(before_ns, now.stamp_ns, p.forces_period):
            outputs.append(self._forces(now))
        return outputs

    def _forces(self, now: Moment) -> TrackForces:
        p, thrust = self.parameters, self._thrust
        assert thrust is not None
        variances = thrust.total_variance(p.thrust.efficiency_stddev)
        reserves = self._reserves(thrust.force, variances)
        spins = np.abs(now.slips.mean[:2]) > p.high_slip
        spent = np.array([reserve.exhausted > _LIKELY for reserve in reserves])
        self._spinning = np.where(spins & spent, self._spinning + p.forces_period, 0.0)
        signs = self._dynamics.signs(now.odometry.twist, now.odometry.twist_covariance)
        half, (mu_r, variance) = 0.5 * p.vehicle.weight, self._mu()[0]
        return TrackForces(
            now.stamp_ns,
            _pair(thrust.force),
            _pair(variances),
            _pair(half * mu_r * signs),
            _pair(half**2 * (variance * signs**2 + mu_r**2 * (1.0 - signs**2))),
            _pair([reserve.share for reserve in reserves]),
        )

    def _reserves(self, forces: FloatArray, variances: FloatArray) -> list[Reserve]:
        """Of left and right track, with F_max as in the newest state; unknown before it has shown."""
        if self._posterior.effective_samples < 1.0:
            return [Reserve(float("nan"), 0.0)] * 2
        limits, share = self._posterior.log_limits, 1.0 - self.parameters.low_reserve
        pairs = zip(forces.tolist(), variances.tolist(), strict=True)
        return [thrust_reserve(f, v, limits, self._limit_chances, share) for f, v in pairs]

    def _state(self, stamp_ns: int) -> SoilState:
        (mu_r, mu_r_variance), (mu_l, mu_l_variance) = self._mu()
        grid = self._posterior.grid
        self._limit_chances = grid.sum(axis=0)
        classes = self._classes.probabilities(grid)
        self._strength = self.strength
        return SoilState(stamp_ns, mu_r, mu_r_variance, mu_l, mu_l_variance, self._strength, classes)

    def _mu(self) -> list[tuple[float, float]]:
        """μ_r and μ_l, each with its variance, the error of the efficiency included."""
        scale = self.parameters.thrust.efficiency_stddev
        means, variances = self._dynamics.mu, np.diag(self._dynamics.mu_covariance)
        return [(float(m), float(v + (scale * m) ** 2)) for m, v in zip(means, variances, strict=True)]


def _passes(before_ns: int, now_ns: int, period: float) -> bool:
    """Whether a multiple of the period lies in (before, now]; always at the first moment."""
    period_ns = round(period * 1e9)
    return before_ns == now_ns or before_ns // period_ns != now_ns // period_ns


def _pair(values: Iterable[float]) -> tuple[float, float]:
    left, right = values
    return float(left), float(right)
