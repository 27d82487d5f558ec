# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled loop of the soil estimator over all samples: interpolate, measure thrusts, filter, average.

The strength posterior and the soil state, needed a few times a second, are not compiled. For them the loop
stops with the sample open, and continues at the next call.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.compiled import compiled
from trackslip_common.record_types import Record, Table, dtype_of, make_table
from trackslip_common.units import GRAVITY
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil import dynamics, interpolation, pressure_watch
from trackslip_estimation.soil.dynamics import MU_R, Dynamics, new_dynamics
from trackslip_estimation.soil.flow_check import volumetric_efficiency
from trackslip_estimation.soil.ground_load import (
    BucketLoad,
    GravityCentre,
    GroundLoad,
    bucket_load_variance,
    new_bucket_load,
    new_gravity_centre,
    set_ground_load,
    update_bucket_load,
)
from trackslip_estimation.soil.interpolation import Interpolator, Sample, new_interpolator
from trackslip_estimation.soil.pressure_watch import (
    DROPPED,
    NO_FAULT,
    PressureFault,
    PressureWatch,
    UnusedReason,
)
from trackslip_estimation.soil.records import DIVERGED as REJECTED_DIVERGED
from trackslip_estimation.soil.records import (
    FORCES,
    IS_MACHINE_STATE,
    RESTARTED,
    ForcesRecord,
    SoilInputRecord,
)
from trackslip_estimation.soil.reserve import Reserve, thrust_reserve
from trackslip_estimation.soil.slip_seed import Seeder, is_seed_due
from trackslip_estimation.soil.soil_parameters import SoilConfig, SoilEstimatorParameters
from trackslip_estimation.soil.stall import evidence_time, stall_time, track_condition
from trackslip_estimation.soil.strength_average import GATHERING, Average, add_sample
from trackslip_estimation.soil.thrust import (
    Motor,
    ThrustRecord,
    Transducers,
    hold_thrust,
    measure_thrust,
    motor_of,
    new_transducers,
    unknown_thrust,
    update_noise,
    update_offsets,
)
from trackslip_estimation.soil.tracks import frame_speeds, track_speed

_STANDING, _STRAIGHT = int(Motion.STANDING), int(Motion.STRAIGHT)
_FORCES_CAPACITY = 256  # forces kept until they are fetched
_BRIEF = len(PressureFault)  # index of ``UnusedReason.BRIEF`` in ``LoopState.faults``
_AT_REST = _BRIEF + 1

_KNOWN_TILT = 0.05  # rad, standard deviation of a roll from which the loads of the tracks are known
_EVEN_SHARE = 0.1  # of the weight, by which the loads may differ to count as even

# Why the loop stopped
# No input left; no room for forces; the clock went back; the sample is open; the state is not finite
PROCESSED, FULL, RESTART, OPEN, DIVERGED = range(5)


class EstimatorState(Record):
    """State kept from one sample to the next, except the posterior."""

    has_begun: int
    newest_ns: int  # stamp of the newest sample
    motor: Motor
    transducers: Transducers
    thrust: ThrustRecord  # measured, or held since
    watch: PressureWatch
    centre: GravityCentre
    load: GroundLoad
    bucket_load: BucketLoad
    dynamics: Dynamics
    mu: Annotated[FloatArray, 2]  # μ_r, mobilised μ_l
    mu_variance: Annotated[FloatArray, 2]  # with the error of the efficiency
    volumetric_efficiency: float
    average: Average
    seeder: Seeder
    effective_samples: float  # of the strength posterior
    spinning: Annotated[FloatArray, 2]  # s of evidence that each track spins at the limit of the soil
    stalled: Annotated[FloatArray, 2]  # s of evidence that each track is commanded and does not turn
    forces: int  # number of forces to publish
    # Of the current sample
    sample: Sample
    is_open: int  # whether it waits for work that is not compiled:
    gathered: int  # with the average, see ``strength_average``;
    soil_due: int  # with the soil state
    forces_due: int
    seed_due: int


ESTIMATOR_STATE = dtype_of(EstimatorState)


class LoopState(NamedTuple):
    """Data of the loop, of constant size."""

    estimator: Table[EstimatorState]  # (1,)
    faults: IntArray  # (n,) samples whose pressures were not used, by PressureFault and UnusedReason
    interpolator: Interpolator
    limits: FloatArray  # (l,) F_max of the cells, N
    limit_probabilities: FloatArray  # (l,) of the newest soil state
    forces: Table[ForcesRecord]  # (n,) buffer of forces to publish


class LoopResult(NamedTuple):
    """Result of one call of the loop."""

    reason: int
    processed: int  # number of inputs
    forces: int  # number to publish


def new_loop_state(p: SoilEstimatorParameters, limits: FloatArray) -> LoopState:
    """Return the initial data of the loop."""
    faults = np.zeros(_BRIEF + len(UnusedReason), np.int64)
    forces = make_table(ForcesRecord, FORCES, _FORCES_CAPACITY)
    return LoopState(
        initial_state(p), faults, new_interpolator(p.moments), limits, np.zeros_like(limits), forces
    )


def initial_state(p: SoilEstimatorParameters) -> Table[EstimatorState]:
    """Return the state (1,) before the first sample."""
    estimator, motor = make_table(EstimatorState, ESTIMATOR_STATE, 1), motor_of(p.vehicle.whole())
    estimator["motor"], estimator["thrust"] = motor, unknown_thrust(motor[0])
    estimator["transducers"] = new_transducers(p.thrust)
    estimator["dynamics"] = new_dynamics(p.dynamics)
    estimator["centre"] = new_gravity_centre(p.vehicle)
    estimator["bucket_load"] = new_bucket_load(p.vehicle.whole())
    estimator["volumetric_efficiency"] = np.nan
    return estimator


@compiled
def advance(
    state: LoopState, inputs: Table[SoilInputRecord], first: int, config: Table[SoilConfig]
) -> LoopResult:
    """Process inputs (n,) from index ``first`` on until none is left or the caller must act."""
    p, estimator, interpolator = config[0], state.estimator[0], state.interpolator
    estimator.forces = 0
    while True:
        while estimator.is_open or interpolation.is_ready(interpolator, p.moments):
            if estimator.forces == len(state.forces):
                return LoopResult(FULL, first, estimator.forces)
            if not estimator.is_open:
                interpolation.pop_oldest(interpolator, p.moments, estimator.sample)
                _step(estimator, state.faults, p)
                if not _is_finite(estimator):
                    interpolator.rejected[IS_MACHINE_STATE, REJECTED_DIVERGED] += 1
                    return LoopResult(DIVERGED, first, estimator.forces)
                estimator.is_open = (
                    estimator.gathered != GATHERING or estimator.soil_due or estimator.seed_due
                )
                if estimator.is_open:
                    return LoopResult(OPEN, first, estimator.forces)
            estimator.is_open = False
            if estimator.forces_due:
                _append_forces(state, p)
        if first == len(inputs):
            return LoopResult(PROCESSED, first, estimator.forces)
        first += 1
        if interpolation.add_input(interpolator, inputs[first - 1]) == RESTARTED:
            return LoopResult(RESTART, first, estimator.forces)


@compiled
def _step(estimator: EstimatorState, faults: IntArray, p: SoilConfig) -> None:
    """Process the current sample."""
    sample = estimator.sample
    before_ns = estimator.newest_ns if estimator.has_begun else sample.stamp_ns
    estimator.has_begun, estimator.newest_ns = True, sample.stamp_ns
    sample.dt = (sample.stamp_ns - before_ns) * 1e-9
    left, right = frame_speeds(sample.twist, p.vehicle.tread)
    sample.tracks[0] = track_speed(left, sample.slips[0])
    sample.tracks[1] = track_speed(right, sample.slips[1])
    is_closed = max(abs(sample.spools[0]), abs(sample.spools[1])) < p.thrust.closed_spool
    set_ground_load(estimator.load, estimator.centre, sample, p)
    is_level = abs(estimator.load.pull) < p.load.level_share * p.vehicle.mass * GRAVITY
    is_downhill = not is_level and estimator.load.pull * sample.twist[0] > 0.0
    left_load, right_load = estimator.load.normal
    is_even = abs(left_load - right_load) < _EVEN_SHARE * (left_load + right_load)
    is_even = is_even and sample.tilt_variance[0] < _KNOWN_TILT**2
    fault = pressure_watch.evaluate_pressures(
        estimator.watch, sample, p.watch, p.vehicle.relief_pressure, is_downhill, is_even
    )
    is_standing = fault == NO_FAULT and is_closed and is_level and sample.motion == _STANDING
    if sample.has_pressures:
        update_noise(estimator.transducers, sample.reading, p.thrust)
    if update_offsets(estimator.transducers, sample.pressures, is_standing, sample.dt, p.thrust):
        faults[_AT_REST] += 1
    update_bucket_load(estimator.bucket_load, sample, p.load)
    if fault == NO_FAULT:
        _measure_thrusts(estimator, sample, p)
    else:
        faults[fault if estimator.watch.is_reported[fault] or fault == DROPPED else _BRIEF] += 1
        hold_thrust(estimator.thrust, sample.dt, p.thrust, estimator.motor)
    for k in range(2):
        estimator.stalled[k] = stall_time(estimator.stalled[k], sample, k, p.stall, p.vehicle.relief_pressure)
    dynamics.step(estimator.dynamics, sample, estimator.thrust, estimator.load, p)
    for k in range(2):
        mean, variance = estimator.dynamics.mean[MU_R + k], estimator.dynamics.covariance[MU_R + k, MU_R + k]
        estimator.mu[k], estimator.mu_variance[k] = mean, variance + (p.thrust.efficiency_stddev * mean) ** 2
    normal = estimator.load.normal[0] + estimator.load.normal[1]
    pull_variance = estimator.load.pull_variance + (p.thrust.efficiency_stddev * estimator.load.pull) ** 2
    pull_variance += bucket_load_variance(
        estimator.bucket_load, estimator.mu[0] * normal - estimator.load.pull, p.load
    )
    # time-correlated, so not averaged by the filter
    estimator.mu_variance[0] += pull_variance / max(normal, 1.0) ** 2
    estimator.gathered = add_sample(estimator.average, sample, estimator.thrust, estimator.load, p.strength)
    estimator.seed_due = is_seed_due(estimator.seeder, sample, estimator.thrust, p)
    estimator.soil_due = _is_due(before_ns, sample.stamp_ns, p.soil_period)
    estimator.forces_due = _is_due(before_ns, sample.stamp_ns, p.forces_period)


@compiled
def _is_finite(estimator: EstimatorState) -> bool:
    """Whether the estimates that the next sample depends on are finite."""
    total = (
        estimator.thrust.force.sum() + estimator.thrust.variance.sum() + estimator.transducers.offset.sum()
    )
    total += estimator.transducers.offset_variance.sum() + estimator.mu.sum() + estimator.mu_variance.sum()
    total += estimator.dynamics.mean.sum() + estimator.dynamics.covariance.sum()
    return bool(math.isfinite(total))


@compiled
def _measure_thrusts(estimator: EstimatorState, sample: Sample, p: SoilConfig) -> None:
    """Measure the thrusts from plausible pressures and, in straight motion, η_V."""
    speeds = np.empty(2)  # of the sprockets, rad/s
    for k in range(2):
        speeds[k] = sample.tracks[k] / p.vehicle.rolling_radius
    if sample.motion == _STRAIGHT:
        estimator.volumetric_efficiency = volumetric_efficiency(
            estimator.volumetric_efficiency,
            sample.spools,
            speeds,
            estimator.motor.full_flow_speed,
            sample.dt,
            p.flow,
        )
    measure_thrust(
        estimator.thrust, sample.pressures, speeds, estimator.transducers, p.thrust, estimator.motor
    )


@compiled
def _is_due(before_ns: int, now_ns: int, period: float) -> bool:
    """Whether a multiple of the period lies in (before, now]; always true at the first sample."""
    period_ns = round(period * 1e9)
    return before_ns == now_ns or before_ns // period_ns != now_ns // period_ns


@compiled
def _append_forces(state: LoopState, p: SoilConfig) -> None:
    """Append the forces of the current sample; update the evidence of spinning."""
    estimator = state.estimator[0]
    sample, thrust, forces = estimator.sample, estimator.thrust, state.forces[estimator.forces]
    estimator.forces += 1
    forces.stamp_ns = sample.stamp_ns
    mu_r, variance = estimator.mu[0], estimator.mu_variance[0]
    for k, sign in enumerate(dynamics.expected_signs(sample.twist, sample.twist_covariance, p)):
        force = thrust.force[k]
        forces.thrust[k] = force
        forces.thrust_variance[k] = thrust.variance[k] + (p.thrust.efficiency_stddev * force) ** 2
        normal, strength = estimator.load.normal[k], estimator.load.strength[k]
        forces.resistance[k] = normal * mu_r * sign
        forces.resistance_variance[k] = normal**2 * (variance * sign**2 + mu_r**2 * (1.0 - sign**2))
        thrust_variance = (
            forces.thrust_variance[k] + (force / strength) ** 2 * estimator.load.strength_variance[k]
        )
        reserve = _reserve(state, force / strength, thrust_variance / strength**2, p)
        forces.reserve[k] = reserve.share
        is_spinning = sample.slips[k] > p.high_slip and reserve.exhausted > p.stuck_probability
        estimator.spinning[k] = evidence_time(
            estimator.spinning[k], is_spinning, p.forces_period, p.stuck_time
        )
        forces.trouble[k] = track_condition(estimator.stalled[k], estimator.spinning[k], p)


@compiled
def _reserve(state: LoopState, force: float, variance: float, p: SoilConfig) -> Reserve:
    """Return the reserve of a track with F_max of the newest soil state; nan before one effective sample."""
    if state.estimator[0].effective_samples < 1.0:
        return Reserve(math.nan, 0.0)
    return thrust_reserve(force, variance, state.limits, state.limit_probabilities, 1.0 - p.low_reserve)
