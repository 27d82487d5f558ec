# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of a run of the soil estimator with its truth.

F_j      thrust of the soil on a track                                    N
M_r      moment of the lateral resistance, μ_l W l/3 of the mobilised μ_l N m
μ_r      coefficient of longitudinal resistance                           1
K        shear deformation modulus                                        m
F_max    maximal tractive effort of a track                               N
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_common.parameter_record import record_of
from trackslip_common.soils import soil
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.soil.classes import soil_thrust_limit
from trackslip_estimation.soil.records import TrackForces
from trackslip_estimation.soil.soil_estimator import SoilState
from trackslip_estimation.soil.thrust import ThrustParameters, new_transducers, update_offsets
from trackslip_sim.study.soil.trial import (
    START_NS,
    Readings,
    Setting,
    Trial,
    draw_readings,
    estimator_outputs,
    load_setting,
    simulate_trial,
)
from trackslip_sim.truth.record import Truth
from trackslip_tools.replay.scoring import MIN_MOVING_SPEED

Interval = tuple[float, float]

RECOGNISED = 0.8  # probability above which a class counts as recognised
_NAN = float("nan")
_NORMAL_QUANTILE = 1.645  # standard deviations that contain 90 % of a normal distribution
_STEADY_TIME = 2.0  # s, minimum duration of a turn
_MIN_DIFFERENCE = 0.1  # of the faster track's speed: minimum difference of the tracks in a turn
_MAX_VARIATION = 0.05  # of the faster track's speed: maximum change of each track


@dataclass(frozen=True)
class Result:
    """Result of one run: values at its end and their intervals from 5 to 95 %, relative to the truth.

    An error is an RMS over the RMS of the truth. Values without data, such as M_r without turns, are nan.
    """

    limit: float  # F_max
    limit_interval: Interval
    modulus: float  # K
    modulus_interval: Interval
    identifiable: bool
    reason: str  # why it is not identifiable
    probability: float  # of the true class
    mu_r: float
    mu_r_interval: Interval
    moment_error: float  # of M_r, in steady turns
    moment_interval: Interval  # of M_r, in the last steady turn
    driving_error: float  # of F_j, while the motor drives the track
    braking_error: float  # of F_j, while the track drives the motor
    offset_residue: float  # Pa, of the worse transducer after the standstill
    into: str  # soil beyond the first border crossed; empty: no border
    recognised_after: float  # s from the border to a probability of RECOGNISED; inf: never
    wrong_before: float  # probability of all wrong classes at the border


def run_trial(trial: Trial, setting: Setting | None = None) -> Result:
    """Simulate one trial, run the estimators, and compare them with the truth."""
    setting = setting or load_setting()
    truth = simulate_trial(trial, setting=setting)
    readings = draw_readings(trial, truth, setting)
    published = list(estimator_outputs(readings, setting))
    states = [output for output in published if isinstance(output, SoilState)]
    forces = [output for output in published if isinstance(output, TrackForces)]
    vehicle = setting.soil.vehicle.whole()
    return Result(
        **_strength_errors(states[-1], truth, vehicle),
        **_moment_errors(states, truth, vehicle),
        **_thrust_errors(forces, truth, vehicle, trial.standstill),
        offset_residue=_offset_residue(readings, setting, trial.standstill),
        **soil_change(states, truth),
    )


def _strength_errors(last: SoilState, truth: Truth, vehicle: Vehicle) -> dict[str, Any]:
    """Errors of the estimate at the end, against the soil under C."""
    ground, strength = soil(truth.soil_name()), last.strength
    modulus = ground.value("shear_modulus")
    limit = soil_thrust_limit(ground, vehicle)
    mu_r = ground.value("mu_r")
    return {
        "limit": strength.thrust_limit / limit,
        "limit_interval": _relative_interval(strength.thrust_limit_interval, limit),
        "modulus": strength.shear_modulus / modulus,
        "modulus_interval": _relative_interval(strength.shear_modulus_interval, modulus),
        "identifiable": strength.identifiable,
        "reason": strength.reason,
        "probability": last.classes[ground.name],
        "mu_r": last.mu_r / mu_r,
        "mu_r_interval": _relative_interval(_interval_of(last.mu_r, last.mu_r_variance), mu_r),
    }


def _moment_errors(states: Sequence[SoilState], truth: Truth, vehicle: Vehicle) -> dict[str, Any]:
    times = _times(states)
    steady = np.flatnonzero(steady_turns(truth, times))
    if not steady.size:
        return {"moment_error": _NAN, "moment_interval": (_NAN, _NAN)}
    arm = vehicle.weight * vehicle.contact_length / 3.0
    true = truth.interpolate(times[steady]).turning_moment / arm
    last = states[int(steady[-1])]
    return {
        "moment_error": _relative_rms(np.array([states[k].mu_l for k in steady.tolist()]), true),
        "moment_interval": _relative_interval(_interval_of(last.mu_l, last.mu_l_variance), float(true[-1])),
    }


def _thrust_errors(
    forces: Sequence[TrackForces], truth: Truth, vehicle: Vehicle, begin: float
) -> dict[str, Any]:
    """Thrust errors over both tracks while they move, after ``begin`` s."""
    forces = [force for force, t in zip(forces, _times(forces), strict=True) if t > begin]
    at = truth.interpolate(_times(forces))
    true = np.column_stack((at.left_thrust, at.right_thrust))
    estimated = np.array([force.thrust for force in forces]).reshape(true.shape)
    tracks = vehicle.rolling_radius * np.column_stack((at.left_speed, at.right_speed))
    is_moving, is_driven = np.abs(tracks) > MIN_MOVING_SPEED, true * tracks > 0.0
    return {
        "driving_error": _relative_rms(estimated[is_moving & is_driven], true[is_moving & is_driven]),
        "braking_error": _relative_rms(estimated[is_moving & ~is_driven], true[is_moving & ~is_driven]),
    }


def _offset_residue(readings: Readings, setting: Setting, standstill: float) -> float:
    """Largest pressure offset, Pa, that remains after the estimator's calibration at standstill."""
    p, period = setting.soil.thrust, 1.0 / setting.study.sprocket_rate
    transducers, numbers = new_transducers(p)[0], record_of(ThrustParameters, p)[0]
    for reading in readings.pressures[: round(standstill / period)]:
        pressures = np.array((reading.left_pressure, reading.right_pressure))
        update_offsets(transducers, pressures, True, period, numbers)
    return float(np.abs(transducers["offset"] - readings.offsets).max())


def soil_change(states: Sequence[SoilState], truth: Truth) -> dict[str, Any]:
    """Detection of the first border between soils: delay, s, and wrong probability at the border."""
    crossings = np.flatnonzero(np.diff(truth.soil_index))
    if not crossings.size:
        return {"into": "", "recognised_after": _NAN, "wrong_before": _NAN}
    k = int(crossings[0])
    before, into, crossed = truth.soil_name(k), truth.soil_name(k + 1), float(truth.t[k + 1])
    timed = list(zip(_times(states).tolist(), states, strict=True))
    delays = [t - crossed for t, state in timed if t > crossed and state.classes[into] > RECOGNISED]
    right_before = [state.classes[before] for t, state in timed if t <= crossed]
    return {
        "into": into,
        "recognised_after": delays[0] if delays else math.inf,
        "wrong_before": 1.0 - right_before[-1],
    }


def steady_turns(truth: Truth, times: FloatArray) -> BoolArray:
    """(n,) whether at times (n,), s, the tracks turned at constant speeds for ``_STEADY_TIME`` s."""
    window = times[:, np.newaxis] - np.linspace(0.0, _STEADY_TIME, 21)
    tracks = np.stack([np.interp(window, truth.t, speed) for speed in (truth.left_speed, truth.right_speed)])
    fastest = np.abs(tracks).max(axis=(0, 2))
    turning = (np.abs(tracks[1] - tracks[0]) > _MIN_DIFFERENCE * fastest[:, np.newaxis]).all(axis=1)
    constant = (np.ptp(tracks, axis=2) < _MAX_VARIATION * fastest).all(axis=0)
    steady: BoolArray = turning & constant
    return steady


def _times(published: Sequence[SoilState] | Sequence[TrackForces]) -> FloatArray:
    """(n,) times of the truth, s."""
    return np.array([(one.stamp_ns - START_NS) * 1e-9 for one in published])


def _interval_of(mean: float, variance: float) -> Interval:
    half_width = _NORMAL_QUANTILE * math.sqrt(variance)
    return mean - half_width, mean + half_width


def _relative_interval(interval: Interval, truth: float) -> Interval:
    low, high = interval
    return low / truth, high / truth


def _relative_rms(estimated: FloatArray, true: FloatArray) -> float:
    """RMS of the error over the RMS of the truth; nan of no values."""
    if not true.size:
        return _NAN
    return float(np.sqrt(np.mean(np.square(estimated - true)) / np.mean(np.square(true))))
