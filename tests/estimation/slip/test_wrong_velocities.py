# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Wrong velocities over ground do not override fixes; sound ones show which other source is wrong."""

import math
from collections.abc import Callable, Mapping

import numpy as np
import pytest
from fixtures.drawn_machine import Machine, Recording, drive, parameters
from fixtures.fault_cases.case import GNSS, FaultCase, fix_parameters, stamp
from fixtures.fault_cases.injections import INJECTIONS
from fixtures.fault_cases.robot_logs import Truth, between, is_present, merged, read_log, reference_fixes
from fixtures.fault_cases.scoring import score
from fixtures.fault_cases.sensor_faults import SENSOR_FAULTS
from fixtures.pose_errors import pose_errors

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.events import Event
from trackslip_estimation.slip.measurements import Measurement, Sprockets, VelocityFix, YawRate

Spoil = Callable[[FloatArray, FloatArray], FloatArray]  # n times since BEGIN, s; velocities (n, 2), m/s

S = 1_000_000_000
SOURCE, STDDEV, BEGIN = "fix_velocity", 0.03, 40.0


def for_ten_seconds(spoil: Callable[[FloatArray], FloatArray]) -> Spoil:
    def spoilt(t: FloatArray, v: FloatArray) -> FloatArray:
        v, during = v.copy(), (t >= 0.0) & (t < 10.0)
        v[during] = spoil(v[during])
        return v

    return spoilt


FAULTS: Mapping[str, Spoil] = {
    "zero": for_ten_seconds(lambda v: 0.0 * v),
    "frozen": for_ten_seconds(lambda v: np.broadcast_to(v[0], v.shape)),
    "off": for_ten_seconds(lambda v: v + np.array((0.3, 0.1))),
    "a fifth too fast": for_ten_seconds(lambda v: 1.2 * v),
}


def as_measured(t: FloatArray, v: FloatArray) -> FloatArray:
    return v


def seen(spoil: Spoil, seed: int) -> tuple[Recording, list[Measurement]]:
    """A drive with fixes, and with spoilt velocities ten times a second."""
    recorded = drive(Machine(duration=90.0, seed=seed, fix_noise=0.05, fix_stated=0.05))
    noise, k = np.random.default_rng(seed + 70), np.arange(0, recorded.t.size, 2)
    velocities = np.gradient(recorded.poses[:, :2], recorded.t, axis=0)[k]
    velocities = spoil(recorded.t[k] - BEGIN, velocities + noise.normal(0.0, STDDEV, velocities.shape))
    stamps, R = (S + np.round(recorded.t[k] * S)).astype(np.int64), STDDEV**2 * np.eye(2)
    fixes = [VelocityFix(SOURCE, int(at), v, R) for at, v in zip(stamps, velocities, strict=True)]
    return recorded, sorted([*recorded.measurements, *fixes], key=lambda m: m.stamp_ns)


def estimator() -> SlipEstimator:
    receiver = {"standing_share": 0.0, "fault_rate": 3.3e-3, "jump_rate": 3.3e-4}
    values = {f"sources.box_pose.{name}": value for name, value in receiver.items()}
    return SlipEstimator(parameters(**values, velocity_sources=[SOURCE]))


@pytest.mark.parametrize("kind", FAULTS)
def test_wrong_velocities_do_not_degrade_fixes(kind: str) -> None:
    squares, nees = [], []
    for seed in range(3):
        truth, measurements = seen(FAULTS[kind], seed)
        steps = estimator().process_all(measurements)
        found = pose_errors((e for _, e in steps), truth.t, truth.poses).between(BEGIN, BEGIN + 20.0)
        squares.append(found.rms**2)
        nees.append(found.nees(2).mean())
    assert math.sqrt(np.mean(squares)) < 0.15
    assert np.mean(nees) < 5.0  # 2 if consistent


def beside_velocities(
    odometry: list[Measurement], truth: Truth, fix_rate: float, rate: float, begin: float, spoil: Spoil
) -> list[Measurement]:
    """Odometry with fixes, and with spoilt velocities as means over 0.6 s, from 40 s before ``begin``."""
    random, times = np.random.default_rng(int(begin)), np.arange(begin - 40.0, begin + 30.0, 1.0 / rate)
    moved = truth.at(times + 0.3)[:, :2] - truth.at(times - 0.3)[:, :2]
    velocities = spoil(times - begin, moved / 0.6 + random.normal(0.0, STDDEV, moved.shape))
    R = STDDEV**2 * np.eye(2)
    shown = [VelocityFix(SOURCE, stamp(t), v, R) for t, v in zip(times.tolist(), velocities, strict=True)]
    return merged(odometry, reference_fixes(truth, fix_rate, int(begin)), shown)


@pytest.mark.skipif(not is_present("marmotte"), reason="needs the logs of ../shared/data")
@pytest.mark.parametrize("kind", ["zero", "frozen"])
def test_repeated_velocities_do_not_displace_a_robot_that_turns_often(kind: str) -> None:
    """Without a gyro, and with ten velocities to each fix; its speed is no more continuous than theirs."""
    log, begin = read_log("marmotte").without_gyro(), 80.0
    measurements = beside_velocities(log.odometry, log.truth, 1.0, 10.0, begin, FAULTS[kind])
    window = (begin, begin + 20.0)
    inputs = between(measurements, begin - 40.0, window[1])
    found = score(FaultCase(log.parameters(GNSS, velocity_sources=[SOURCE]), inputs, log.truth, window))
    assert found.rmse < 0.2
    assert found.inconsistent < 0.06
    assert found.heading_rmse < 0.8  # not reversed


@pytest.mark.skipif(not is_present("marmotte"), reason="needs the logs of ../shared/data")
def test_velocities_that_were_zero_for_long_are_sound_again_at_once() -> None:
    log, begin = read_log("marmotte"), 60.0
    measurements = beside_velocities(log.odometry, log.truth, 1.0, 5.0, begin, FAULTS["zero"])
    window = (begin, begin + 20.0)
    inputs = between(measurements, begin - 40.0, window[1])
    found = score(FaultCase(log.parameters(GNSS, velocity_sources=[SOURCE]), inputs, log.truth, window))
    assert found.largest < 0.5


@pytest.mark.skipif(not is_present("warthog"), reason="needs the logs of ../shared/data")
def test_sound_velocities_show_that_fixes_drift() -> None:
    log, begin = read_log("warthog"), 184.0
    measurements = beside_velocities(log.odometry, log.truth, 5.0, 5.0, begin, as_measured)
    injected = SENSOR_FAULTS["ramp to 1.5 m and back"].inject(measurements, begin, 0.05)
    inputs = between(injected.measurements, begin - 40.0, injected.window[1])
    parameters = log.parameters(GNSS, velocity_sources=[SOURCE])
    found = score(FaultCase(parameters, inputs, log.truth, injected.window))
    assert found.rmse < 0.25
    assert found.inconsistent < 0.1


@pytest.mark.parametrize(
    ("fault", "begin", "fix_rate", "with_gyro"),
    [
        ("both encoders show 0 10 s", 30.0, 1.0, True),
        ("both encoders show 0 10 s", 30.0, 1.0, False),
        ("multipath 3.0 m 10 s", 44.0, 5.0, False),
    ],
)
def test_sound_velocities_show_what_fails(fault: str, begin: float, fix_rate: float, with_gyro: bool) -> None:
    machine = Machine(duration=90.0, seed=3, track_error=0.03, fix_noise=0.05, fix_stated=0.05)
    recorded = drive(machine)
    odometry = [
        m for m in recorded.measurements if isinstance(m, Sprockets) or (with_gyro and isinstance(m, YawRate))
    ]
    truth = Truth(recorded.t, recorded.poses)
    measurements = beside_velocities(odometry, truth, fix_rate, 5.0, begin, as_measured)
    injected = {**INJECTIONS, **SENSOR_FAULTS}[fault].inject(measurements, begin, 0.05)
    inputs = between(injected.measurements, 0.0, begin + 25.0)
    parameters = fix_parameters(GNSS, layer={}, velocity_sources=[SOURCE])
    found = score(FaultCase(parameters, inputs, truth, injected.window))
    assert found.rmse < 0.25
    assert found.inconsistent < 0.1


def test_velocity_as_stated_causes_no_event() -> None:
    _, measurements = seen(as_measured, 1)
    running = estimator()
    running.process_all(measurements)
    assert not {e.event for e in running.read_events()} - {Event.OUTLIER}


def test_wrong_velocity_is_named_and_sound_again_afterwards() -> None:
    _, measurements = seen(FAULTS["off"], 1)
    running, texts = estimator(), []
    for m in measurements:
        running.process(m)
        if abs(m.stamp_ns - 50 * S) < S // 50:
            texts = [e.text for e in running.competing_explanations.explanations]
    assert any(text.startswith(f"{SOURCE} is 0.") and text.endswith(" m/s off") for text in texts)
    assert [e.source for e in running.read_events() if e.event is Event.RECOVERED] == [SOURCE]
