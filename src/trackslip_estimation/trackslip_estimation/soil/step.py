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
    Offsets,
    ThrustRecord,
    hold_thrust,
    measure_thrust,
    motor_of,
    new_offsets,
    unknown_thrust,
    update_offsets,
)
from trackslip_estimation.soil.tracks import frame_speeds, track_speed

_STANDING, _STRAIGHT = int(Motion.STANDING), int(Motion.STRAIGHT)
_FORCES_CAPACITY = 256  # forces kept until they are fetched
_BRIEF = len(PressureFault)  # index of ``UnusedReason.BRIEF`` in ``LoopState.faults``
_AT_REST = _BRIEF + 1

# Why the loop stopped
# No input left; no room for forces; the clock went back; the sample is open; the state is not finite
PROCESSED, FULL, RESTART, OPEN, DIVERGED = range(5)


class EstimatorState(Record):
    """State kept from one sample to the next, except the posterior."""

    has_begun: int
    newest_ns: int  # stamp of the newest sample
    motor: Motor
    offsets: Offsets
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

    known: Table[EstimatorState]  # (1,)
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
    known, motor = make_table(EstimatorState, ESTIMATOR_STATE, 1), motor_of(p.vehicle.whole())
    known["motor"], known["thrust"] = motor, unknown_thrust(motor[0])
    known["offsets"], known["dynamics"] = new_offsets(p.thrust), new_dynamics(p.dynamics)
    known["centre"], known["bucket_load"] = new_gravity_centre(p.vehicle), new_bucket_load(p.vehicle.whole())
    known["volumetric_efficiency"] = np.nan
    return known


@compiled
def advance(
    state: LoopState, inputs: Table[SoilInputRecord], first: int, config: Table[SoilConfig]
) -> LoopResult:
    """Process inputs (n,) from index ``first`` on until none is left or the caller must act."""
    p, known, interpolator = config[0], state.known[0], state.interpolator
    known.forces = 0
    while True:
        while known.is_open or interpolation.is_ready(interpolator, p.moments):
            if known.forces == len(state.forces):
                return LoopResult(FULL, first, known.forces)
            if not known.is_open:
                interpolation.pop_oldest(interpolator, p.moments, known.sample)
                _step(known, state.faults, p)
                if not _is_finite(known):
                    interpolator.rejected[IS_MACHINE_STATE, REJECTED_DIVERGED] += 1
                    return LoopResult(DIVERGED, first, known.forces)
                known.is_open = known.gathered != GATHERING or known.soil_due or known.seed_due
                if known.is_open:
                    return LoopResult(OPEN, first, known.forces)
            known.is_open = False
            if known.forces_due:
                _publish_forces(state, p)
        if first == len(inputs):
            return LoopResult(PROCESSED, first, known.forces)
        first += 1
        if interpolation.add_input(interpolator, inputs[first - 1]) == RESTARTED:
            return LoopResult(RESTART, first, known.forces)


@compiled
def _step(known: EstimatorState, faults: IntArray, p: SoilConfig) -> None:
    """Process the current sample."""
    sample = known.sample
    before_ns = known.newest_ns if known.has_begun else sample.stamp_ns
    known.has_begun, known.newest_ns = True, sample.stamp_ns
    sample.dt = (sample.stamp_ns - before_ns) * 1e-9
    left, right = frame_speeds(sample.twist, p.vehicle.tread)
    sample.tracks[0], sample.tracks[1] = (
        track_speed(left, sample.slips[0]),
        track_speed(right, sample.slips[1]),
    )
    fault = pressure_watch.evaluate_pressures(known.watch, sample, p.watch, p.vehicle.relief_pressure)
    is_closed = max(abs(sample.spools[0]), abs(sample.spools[1])) < p.thrust.closed_spool
    set_ground_load(known.load, known.centre, sample, p)
    is_level = abs(known.load.pull) < p.load.level_share * p.vehicle.mass * GRAVITY
    is_standing = fault == NO_FAULT and is_closed and is_level and sample.motion == _STANDING
    if update_offsets(known.offsets, sample.pressures, is_standing, sample.dt, p.thrust):
        faults[_AT_REST] += 1
    update_bucket_load(known.bucket_load, sample, p.load)
    if fault == NO_FAULT:
        _measure_thrusts(known, sample, p)
    else:
        faults[fault if known.watch.is_reported[fault] or fault == DROPPED else _BRIEF] += 1
        hold_thrust(known.thrust, sample.dt, p.thrust, known.motor)
    for k in range(2):
        known.stalled[k] = stall_time(known.stalled[k], sample, k, p.stall, p.vehicle.relief_pressure)
    dynamics.step(known.dynamics, sample, known.thrust, known.load, p)
    for k in range(2):
        mean, variance = known.dynamics.mean[MU_R + k], known.dynamics.covariance[MU_R + k, MU_R + k]
        known.mu[k], known.mu_variance[k] = mean, variance + (p.thrust.efficiency_stddev * mean) ** 2
    normal = known.load.normal[0] + known.load.normal[1]
    of_pull = known.load.pull_variance + (p.thrust.efficiency_stddev * known.load.pull) ** 2
    of_pull += bucket_load_variance(known.bucket_load, known.mu[0] * normal - known.load.pull, p.load)
    known.mu_variance[0] += of_pull / max(normal, 1.0) ** 2  # time-correlated, so not averaged by the filter
    known.gathered = add_sample(known.average, sample, known.thrust, known.load, p.strength)
    known.seed_due = is_seed_due(known.seeder, sample, known.thrust, p)
    known.soil_due = _is_due(before_ns, sample.stamp_ns, p.soil_period)
    known.forces_due = _is_due(before_ns, sample.stamp_ns, p.forces_period)


@compiled
def _is_finite(known: EstimatorState) -> bool:
    """Whether the estimates that the next sample depends on are finite."""
    total = known.thrust.force.sum() + known.thrust.variance.sum() + known.offsets.mean.sum()
    total += known.offsets.variance.sum() + known.mu.sum() + known.mu_variance.sum()
    total += known.dynamics.mean.sum() + known.dynamics.covariance.sum()
    return bool(math.isfinite(total))


@compiled
def _measure_thrusts(known: EstimatorState, sample: Sample, p: SoilConfig) -> None:
    """Measure the thrusts from plausible pressures and, in straight motion, η_V."""
    speeds = np.empty(2)  # of the sprockets, rad/s
    for k in range(2):
        speeds[k] = sample.tracks[k] / p.vehicle.rolling_radius
    if sample.motion == _STRAIGHT:
        known.volumetric_efficiency = volumetric_efficiency(
            known.volumetric_efficiency, sample.spools, speeds, known.motor.full_flow_speed, sample.dt, p.flow
        )
    measure_thrust(known.thrust, sample.pressures, speeds, known.offsets, p.thrust, known.motor)


@compiled
def _is_due(before_ns: int, now_ns: int, period: float) -> bool:
    """Whether a multiple of the period lies in (before, now]; always true at the first sample."""
    period_ns = round(period * 1e9)
    return before_ns == now_ns or before_ns // period_ns != now_ns // period_ns


@compiled
def _publish_forces(state: LoopState, p: SoilConfig) -> None:
    """Append the forces of the current sample; update the evidence of spinning."""
    known = state.known[0]
    sample, thrust, forces = known.sample, known.thrust, state.forces[known.forces]
    known.forces += 1
    forces.stamp_ns = sample.stamp_ns
    mu_r, variance = known.mu[0], known.mu_variance[0]
    for k, sign in enumerate(dynamics.expected_signs(sample.twist, sample.twist_covariance, p)):
        force = thrust.force[k]
        forces.thrust[k] = force
        forces.thrust_variance[k] = thrust.variance[k] + (p.thrust.efficiency_stddev * force) ** 2
        normal, strength = known.load.normal[k], known.load.strength[k]
        forces.resistance[k] = normal * mu_r * sign
        forces.resistance_variance[k] = normal**2 * (variance * sign**2 + mu_r**2 * (1.0 - sign**2))
        spread = forces.thrust_variance[k] + (force / strength) ** 2 * known.load.strength_variance[k]
        reserve = _reserve(state, force / strength, spread / strength**2, p)
        forces.reserve[k] = reserve.share
        spins = sample.slips[k] > p.high_slip and reserve.exhausted > p.stuck_probability
        known.spinning[k] = evidence_time(known.spinning[k], spins, p.forces_period, p.stuck_time)
        forces.trouble[k] = track_condition(known.stalled[k], known.spinning[k], p)


@compiled
def _reserve(state: LoopState, force: float, variance: float, p: SoilConfig) -> Reserve:
    """Return the reserve of a track with F_max of the newest soil state; nan before one effective sample."""
    if state.known[0].effective_samples < 1.0:
        return Reserve(math.nan, 0.0)
    return thrust_reserve(force, variance, state.limits, state.limit_probabilities, 1.0 - p.low_reserve)
