# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``calibrate`` and the estimator's states agree on the same drive of the truth model."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.models.model import GYRO_BIAS, GYRO_SCALE
from trackslip_estimation.slip.models.turning import ASYMMETRY, EFFICIENCY
from trackslip_estimation.slip.parameters import NODE, load_slip_parameters
from trackslip_estimation.slip.records import to_records
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.simulate import simulate
from trackslip_tools.calibration.calibrate import Calibration, calibrate
from trackslip_tools.calibration.recording import Recording, Series, motion_states

P = load_slip_parameters()
SOURCES = ("imu/data_raw", "box_pose")
SECONDS = 180.0
GYRO_NOISE, FIX_NOISE = 0.003, (0.02, 0.02, 0.02)  # rad/s; m, m, rad


@dataclass(frozen=True)
class Machine:
    """Deviations of a machine and its gyro from their nominal parameters."""

    soil: str
    scale: float
    bias: float  # rad/s
    asymmetry: float  # rad/m
    seed: int


MACHINES = (
    Machine("sand", 0.98, 0.004, 0.015, 1),
    Machine("dry_clay", 1.02, -0.006, -0.02, 2),
    Machine("sandy_loam", 1.0, 0.002, 0.0, 3),
)


@cache
def drive(soil: str) -> Truth:
    return simulate(load_scenario("field_trial").with_duration(SECONDS), soil=soil, vehicle=P.vehicle.whole())


@cache
def recorded(machine: Machine) -> Recording:
    """The drive with an additional rotation of ε per metre of sprocket travel."""
    truth, rng = drive(machine.soil), np.random.default_rng(machine.seed)
    t, gyro_times, fix_times = (np.arange(0.1, SECONDS - 0.1, period) for period in (0.01, 0.0844, 0.24))
    states = truth.interpolate(t)
    angles = np.column_stack((states.left_angle, states.right_angle))
    turn = machine.asymmetry * P.vehicle.kinematics.rolling_radius * angles.mean(axis=1)
    heading = states.yaw + turn
    velocity = (states.v_x + 1j * states.v_y) * np.exp(1j * heading)
    positions = np.concatenate(([0.0], np.cumsum((velocity[1:] + velocity[:-1]) / 2.0 * np.diff(t))))
    rates = np.zeros((len(gyro_times), 3))
    rate = np.interp(gyro_times, t, states.yaw_rate + np.gradient(turn, t))
    rates[:, 2] = machine.scale * rate + machine.bias + rng.normal(0.0, GYRO_NOISE, len(gyro_times))
    columns = positions.real, positions.imag, heading
    poses = np.column_stack([np.interp(fix_times, t, column) for column in columns])
    poses += rng.normal(0.0, FIX_NOISE, poses.shape)
    variances = np.tile(np.square(FIX_NOISE), (len(fix_times), 1))
    sprockets = Series(t, np.round(angles / P.encoder_resolution) * P.encoder_resolution)
    return Recording(
        sprockets,
        Series(gyro_times, rates),
        Series(fix_times, np.column_stack((poses, variances))),
        Series(np.empty(0), np.empty((0, 4))),
        motion_states(sprockets, P.motion),
    )


def measurements(recording: Recording) -> Iterator[Measurement]:
    for t, (left, right) in zip(*recording.sprockets, strict=True):
        yield Sprockets("sprockets", round(t * 1e9), 0.0, 0.0, (left, right))
    for t, rates in zip(*recording.gyro, strict=True):
        yield YawRate(SOURCES[0], round(t * 1e9), rates[2], GYRO_NOISE**2)
    for t, row in zip(*recording.poses, strict=True):
        yield PoseFix(SOURCES[1], round(t * 1e9), row[:3], np.diag(row[3:]))


@cache
def calibrated(machine: Machine) -> Calibration:
    return calibrate([recorded(machine)], P, SOURCES, everything=True)


@cache
def learned(machine: Machine) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of the state at the end of the drive."""
    estimator = SlipEstimator(P)
    in_order = sorted(measurements(recorded(machine)), key=lambda m: m.stamp_ns)
    estimator.process_records(to_records(in_order, estimator.sources))
    last = estimator.window.best[int(estimator.window.status["count"][0]) - 1]
    return last["mean"], last["covariance"]


STATES = {
    "gyro_scale": (GYRO_SCALE, 1.0),
    "gyro_bias": (GYRO_BIAS, 0.0),
    "asymmetry": (ASYMMETRY, 0.0),
    "turning_efficiency": (EFFICIENCY, 0.0),
}


def both(machine: Machine, name: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Value and half of the 95 % interval, by calibration and by the estimator."""
    calibration, (mean, P_) = calibrated(machine), learned(machine)
    finding = calibration.findings[name]
    assert finding.value is not None, finding.reason
    assert finding.interval is not None
    half = (finding.interval[1] - finding.interval[0]) / 2.0
    if name == "turning_efficiency":  # the calibration covers all turns, the state mainly the last ones
        half = max(half, 2.0 * calibration.parameters[NODE]["turning.initial_efficiency_stddev"])
    index, offset = STATES[name]
    return (finding.value, half), (offset + float(mean[index]), 2.0 * math.sqrt(P_[index, index]))


@pytest.mark.slow
@pytest.mark.parametrize("machine", MACHINES, ids=lambda m: m.soil)
@pytest.mark.parametrize("name", STATES)
def test_calibration_and_learned_states_agree_within_their_intervals(machine: Machine, name: str) -> None:
    """Both intervals are of 95 %: the difference lies within √(a² + b²) with the same probability."""
    (value, half), (state, state_half) = both(machine, name)
    assert abs(value - state) <= math.hypot(half, state_half)


@pytest.mark.parametrize("machine", MACHINES, ids=lambda m: m.soil)
@pytest.mark.parametrize("name", ["gyro_scale", "gyro_bias", "asymmetry"])
def test_calibration_and_learned_states_contain_the_true_values(machine: Machine, name: str) -> None:
    true = {"gyro_scale": machine.scale, "gyro_bias": machine.bias, "asymmetry": machine.asymmetry}[name]
    for value, half in both(machine, name):
        assert abs(value - true) <= 1.5 * half
