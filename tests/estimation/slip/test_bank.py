# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The hypothesis bank: the most probable event, its probability, and independence of the order of arrival."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fixtures.drawn_machine import FIX, FIXES, GNSS, Machine, Recording, drive, parameters
from fixtures.records import assert_same_bits
from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.events import Event
from trackslip_estimation.slip.log import best_branch_script, make_log, run_log
from trackslip_estimation.slip.measurements import (
    HeadingFix,
    Measurement,
    PoseFix,
    Sprockets,
    VelocityFix,
    YawRate,
)
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import EVENT, to_records

S = 1_000_000_000
SENSOR_AND_FIX_RATES = [(20, FIXES), pytest.param(100, 1, marks=pytest.mark.slow)]  # Hz


def changed(recording: Recording, change: Callable[[PoseFix, float], PoseFix]) -> list[Measurement]:
    """The measurements of the drive with changed fixes; ``change`` gets each fix and its time, s."""
    return [change(m, m.stamp_ns / S - 1.0) if isinstance(m, PoseFix) else m for m in recording.measurements]


def moved(fix: PoseFix, east: float, north: float) -> PoseFix:
    return replace(fix, pose=fix.pose + np.array((east, north, 0.0)))


def with_compass(
    recording: Recording, measurements: list[Measurement], rate: int, stddev: float = 0.03
) -> list[Measurement]:
    """The measurements with those of a compass at ``rate`` Hz, with white errors of ``stddev`` rad."""
    random = np.random.default_rng(100)
    times = np.arange(0.0, recording.t[-1], 1.0 / rate)
    true = np.interp(times, recording.t, recording.poses[:, 2])
    shown = true + stddev * random.standard_normal(times.size)
    stamps = (S + np.round(times * S)).astype(np.int64).tolist()
    headings = [
        HeadingFix("compass", stamp_ns, float(h), stddev**2)
        for stamp_ns, h in zip(stamps, shown, strict=True)
    ]
    return sorted([*measurements, *headings], key=lambda m: m.stamp_ns)


def with_velocities(recording: Recording, measurements: list[Measurement], rate: int) -> list[Measurement]:
    """The measurements with velocities at ``rate`` Hz, with white errors of 0.05 m/s."""
    random, stddev = np.random.default_rng(100), 0.05
    times = np.arange(1.0, recording.t[-1], 1.0 / rate)
    shown = np.column_stack(
        [np.interp(times, recording.t, np.gradient(recording.poses[:, k], recording.t)) for k in (0, 1)]
    )
    shown = shown + stddev * random.standard_normal(shown.shape)
    velocities = [
        VelocityFix("fix_velocity", S + round(t * S), velocity, stddev**2 * np.eye(2))
        for t, velocity in zip(times.tolist(), shown, strict=True)
    ]
    return sorted([*measurements, *velocities], key=lambda m: m.stamp_ns)


def with_scaled_sprockets(
    recording: Recording, factors: tuple[float, float], begin: float, end: float
) -> list[Measurement]:
    """The measurements with left and right sprocket speeds scaled from ``begin`` to ``end``, s."""
    return [
        replace(m, left_speed=factors[0] * m.left_speed, right_speed=factors[1] * m.right_speed)
        if isinstance(m, Sprockets) and begin <= m.stamp_ns / S - 1.0 < end
        else m
        for m in recording.measurements
    ]


def errors(
    measurements: list[Measurement], recording: Recording, p: SlipEstimatorParameters
) -> tuple[FloatArray, FloatArray, SlipEstimator]:
    """(k,) position errors, m, and (k,) their NEES at the sprocket samples; the estimator at the end."""
    estimator = SlipEstimator(p)
    found = [e for _, e in estimator.process_all(measurements) if e is not None]
    times = np.array([e.stamp_ns / S - 1.0 for e in found])
    true = np.column_stack([np.interp(times, recording.t, recording.poses[:, k]) for k in (0, 1)])
    off = np.array([e.pose[:2] for e in found]) - true
    covariances = np.array([e.pose_covariance[:2, :2] for e in found])
    nees = np.einsum("ki,kij,kj->k", off, np.linalg.inv(covariances), off)
    return np.hypot(*off.T), nees, estimator


def heading_errors(
    measurements: list[Measurement], recording: Recording, p: SlipEstimatorParameters
) -> FloatArray:
    """(k,) heading errors, rad, at the sprocket samples."""
    found = [e for _, e in SlipEstimator(p).process_all(measurements) if e is not None]
    times = np.array([e.stamp_ns / S - 1.0 for e in found])
    off = np.array([e.pose[2] for e in found]) - np.interp(times, recording.t, recording.poses[:, 2])
    return np.asarray((off + math.pi) % math.tau - math.pi)


def events(estimator: SlipEstimator) -> list[Event]:
    """Events of the most probable branch at the end."""
    branch = estimator.window.branches[0, estimator.window.count - 1]
    return [Event(branch["history"][n % 16]["event"]) for n in range(int(branch["events"]))]


@pytest.mark.parametrize("size", [0.5, 3.0])
def test_multipath_does_not_move_the_estimate(size: float) -> None:
    recording = drive(Machine(duration=50.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03))
    displaced = changed(recording, lambda m, t: moved(m, 0.8 * size, 0.6 * size) if 20.0 <= t < 30.0 else m)
    error, nees, estimator = errors(displaced, recording, parameters(**GNSS))
    assert error.max() < 0.15
    assert np.mean(nees > 13.8) < 0.02
    assert Event.OFFSET in events(estimator)


def test_frozen_fixes_are_detected_by_identical_bits() -> None:
    recording = drive(Machine(duration=50.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03))
    last = [np.zeros(3)]

    def freeze(m: PoseFix, t: float) -> PoseFix:
        if not 20.0 <= t < 28.0:
            last[0] = m.pose
        return replace(m, pose=last[0])

    error, nees, estimator = errors(changed(recording, freeze), recording, parameters(**GNSS))
    assert error.max() < 0.15
    assert np.mean(nees > 13.8) < 0.02
    assert Event.REPEATS in events(estimator)


def test_explanation_of_frozen_fixes_states_its_duration() -> None:
    recording = drive(Machine(duration=26.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03))
    last = [np.zeros(3)]

    def freeze(m: PoseFix, t: float) -> PoseFix:
        if t < 20.0:
            last[0] = m.pose
        return replace(m, pose=last[0])

    _, _, estimator = errors(changed(recording, freeze), recording, parameters(**GNSS))
    found = estimator.competing_explanations.explanations[0]
    assert found.text == f"{FIX} repeats one measurement"
    assert 19.0 < found.since_ns / S - 1.0 < 23.0


def test_covariance_spans_both_explanations_of_a_jump() -> None:
    """One source alone cannot show whether its fixes are displaced or the machine was moved."""
    recording = drive(Machine(duration=90.0, fix_noise=0.03, fix_stated=0.03))
    jumped = changed(recording, lambda m, t: moved(m, 2.0, 1.0) if t >= 20.0 else m)
    estimator = SlipEstimator(parameters(**GNSS))
    for _, e in estimator.process_all(jumped):
        if e is None or not e.stamp_ns / S - 1.0 > 22.0:
            continue
        t = e.stamp_ns / S - 1.0
        true = np.array([np.interp(t, recording.t, recording.poses[:, k]) for k in (0, 1)])
        off = e.pose[:2] - true - np.array((2.0, 1.0))
        assert off @ np.linalg.solve(e.pose_covariance[:2, :2], off) < 13.8
        if t > 60.0:
            assert np.hypot(*off) < 0.15


@pytest.mark.parametrize("seed", range(2))
def test_gaussian_fixes_cause_no_event(seed: int) -> None:
    recording = drive(Machine(duration=60.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03, seed=seed))
    error, nees, estimator = errors(recording.measurements, recording, parameters(**GNSS))
    assert not events(estimator)
    assert 1.0 < nees.mean() < 3.0
    assert error.max() < 0.1


@pytest.mark.parametrize("turned", [math.pi, -2.0])
def test_a_wrong_start_heading_is_found_within_metres(turned: float) -> None:
    recording = drive(Machine(duration=40.0))
    p = parameters(**GNSS, start="first_fix", initial_yaw=turned)
    error, _, estimator = errors(recording.measurements, recording, p)
    assert error[300:].max() < 0.1
    assert Event.TURNED in events(estimator)


def off_evenly(part: int, heading_noise: float = 10.0) -> tuple[float, float]:
    """RMS position error, m, and mean NEES while fixes are 1 m off in direction ``part`` of twelve."""
    noise = Machine(duration=47.0, fix_noise=0.03, fix_stated=0.03, track_error=0.05)
    recording = drive(replace(noise, seed=part, heading_noise=heading_noise))
    off = [15.0, 21.0, 31.0, 37.0], [0.0, 1.0, 1.0, 0.0]
    cos, sin = math.cos(part * math.tau / 12.0), math.sin(part * math.tau / 12.0)
    given = changed(recording, lambda m, t: moved(m, cos * np.interp(t, *off), sin * np.interp(t, *off)))
    p = parameters(**GNSS, **{"sources.box_pose.use_heading": heading_noise < 1.0})
    error, nees, _ = errors(given, recording, p)
    return float(np.sqrt(np.mean(error**2))), float(nees.mean())


@pytest.mark.parametrize("heading_noise", [10.0, 0.02])  # rad; of one antenna, and of two
def test_fixes_that_drift_off_do_not_pull_the_estimate(heading_noise: float) -> None:
    """The displacement of the fixes grows within 6 s, lasts for 10 s, and ends."""
    rms, nees = np.median([off_evenly(part, heading_noise) for part in range(12)], axis=0)
    assert rms < 0.18
    assert nees < 3.5


def test_fixes_with_a_persistent_offset_are_used_again_within_a_minute() -> None:
    recording = drive(Machine(duration=110.0, fix_noise=0.03, fix_stated=0.03, track_error=0.05))
    off = [15.0, 21.0], [0.0, 0.7]
    given = changed(recording, lambda m, t: moved(m, np.interp(t, *off), -np.interp(t, *off)))
    there = recording._replace(poses=recording.poses + np.array((0.7, -0.7, 0.0)))
    error, _, estimator = errors(given, there, parameters(**GNSS))
    assert Event.WANDERS in events(estimator)
    assert error[error.size * 75 // 110 :].max() < 0.2


def test_branches_start_at_least_half_the_look_back_time_ago() -> None:
    """A branch that fixes contradict keeps a snapshot of at least half the look-back time."""
    recording, random = drive(Machine(duration=30.0, fix_rate=1)), np.random.default_rng(0)
    noisy = changed(recording, lambda m, t: moved(m, *0.05 * random.standard_normal(2)))
    p = parameters(**GNSS)
    estimator, longest, ages = SlipEstimator(p), p.bank.look_back_time, []
    for m in noisy:
        estimator.process_all([m])
        last = estimator.window.count - 1
        stamps = estimator.window.measurements["stamp_ns"]
        for branch in estimator.window.branches[: int(estimator.window.counts[last]), last]:
            older, younger = (stamps[last] - stamps[s["entry"]] for s in branch["snapshots"])
            assert younger <= older <= (longest + 0.1) * S
            if older != younger:
                ages.append(older / S)
    assert min(ages) >= longest / 2.0
    assert max(ages) > 0.9 * longest


def test_position_is_kept_while_tracks_are_swapped() -> None:
    recording = drive(Machine(duration=50.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03))
    swapped = [
        replace(m, left_speed=m.right_speed, right_speed=m.left_speed)
        if isinstance(m, Sprockets) and 21 * S <= m.stamp_ns < 24 * S
        else m
        for m in recording.measurements
    ]
    error, nees, _ = errors(swapped, recording, parameters(**GNSS))
    assert error.max() < 0.2
    assert np.mean(nees > 13.8) < 0.02


def test_first_fix_that_is_an_outlier_is_detected_by_the_next_ones() -> None:
    """The first fix is 3 m off and states 2 cm."""
    recording = drive(Machine(duration=20.0, track_error=0.05))
    first = next(m.stamp_ns for m in recording.measurements if isinstance(m, PoseFix))
    displaced = changed(recording, lambda m, t: moved(m, 3.0, 0.0) if m.stamp_ns == first else m)
    error, _, _ = errors(displaced, recording, parameters(**GNSS))
    assert error[error.size // 6 :].max() < 0.1


@pytest.mark.parametrize("far", [8.0, 5000.0])
@pytest.mark.parametrize("knows_heading", [True, False])
def test_first_fix_far_off_has_no_effect_after_7_seconds(far: float, knows_heading: bool) -> None:
    recording = drive(Machine(duration=20.0, fix_noise=0.03, fix_stated=0.03))
    given = changed(recording, lambda m, t: moved(m, far, 0.0) if t < 0.1 else m)
    p = parameters(initial_yaw_stddev=0.05 if knows_heading else 0.0, **GNSS)
    error, nees, _ = errors(given, recording, p)
    assert error[150:].max() < 0.3  # 7.5 s at 20 Hz
    assert np.mean(nees[150:] > 13.8) < 0.05


def test_moved_machine_is_found_at_any_distance() -> None:
    far = 1000.0  # m
    recording = drive(Machine(duration=60.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03))
    given = changed(recording, lambda m, t: moved(m, far, 0.0) if t >= 20.0 else m)
    there = recording._replace(poses=recording.poses + np.where(recording.t[:, None] >= 20.0, (far, 0, 0), 0))
    error, nees, _ = errors(given, there, parameters(**GNSS))
    times = np.linspace(0.0, 60.0, len(error))
    assert error[times > 50.0].max() < 0.2
    assert np.mean(nees[times > 21.0] > 13.8) < 0.02  # until then the covariance spans both explanations


def test_machine_moved_while_fixes_scatter_is_found() -> None:
    recording, random = (
        drive(Machine(duration=70.0, fix_noise=0.03, fix_stated=0.03)),
        np.random.default_rng(0),
    )

    def change(m: PoseFix, t: float) -> PoseFix:
        east, north = random.uniform(-300.0, 300.0, 2) if 20.0 <= t < 25.0 else (0.0, 0.0)
        return moved(m, (300.0 if t >= 20.0 else 0.0) + east, north)

    there = recording._replace(
        poses=recording.poses + np.where(recording.t[:, None] >= 20.0, (300.0, 0, 0), 0)
    )
    error, _, estimator = errors(changed(recording, change), there, parameters(**GNSS))
    assert Event.SCATTERS in events(estimator)
    assert error[-100:].max() < 0.2


def test_skidding_machine_follows_centimetre_fixes_within_two_seconds() -> None:
    """The machine skids sideways by 0.25 m within a second."""
    recording = drive(Machine(duration=40.0, track_error=0.05, fix_noise=0.02, fix_stated=0.02, fix_rate=5))
    true = recording.poses.copy()
    true[:, 0] += 0.25 * np.clip(recording.t - 20.0, 0.0, 1.0)
    skidded = changed(recording, lambda m, t: moved(m, 0.25 * min(max(t - 20.0, 0.0), 1.0), 0.0))
    error, nees, estimator = errors(skidded, recording._replace(poses=true), parameters(**GNSS))
    assert Event.OFFSET not in events(estimator)
    late = np.arange(error.size) > error.size * 23.0 / 40.0
    assert error[late].max() < 0.1
    assert np.mean(nees > 13.8) < 0.03


def test_centimetre_fixes_off_for_ten_seconds_are_no_certain_skid() -> None:
    """A jump of 0.3 m between two fixes may be a skid or a fault of the receiver."""
    machine = Machine(duration=50.0, track_error=0.1, fix_noise=0.02, fix_stated=0.02, fix_rate=1)
    recording = drive(machine)
    off = changed(recording, lambda m, t: moved(m, 0.24, 0.18) if 20.0 <= t < 30.0 else m)
    _, nees, _ = errors(off, recording, parameters(**GNSS))
    assert np.mean(nees > 13.8) < 0.02


def test_fixes_off_after_an_outage_are_no_skid() -> None:
    """A machine may skid during 20 s without fixes, but not by a share of the distance driven."""
    recorded = drive(Machine(duration=80.0, fix_rate=5))
    off = changed(recorded, lambda fix, t: moved(fix, 0.8, 0.6) if 50.0 <= t < 60.0 else fix)
    spoilt = [m for m in off if not isinstance(m, PoseFix) or not 31 * S <= m.stamp_ns < 51 * S]
    error, _, _ = errors(spoilt, recorded, parameters(**GNSS))
    after = np.arange(error.size) > error.size * 50.0 / 80.0
    assert error[after].max() < 0.4


def test_impossible_slip_is_taken_for_a_wrong_heading() -> None:
    """A slip of 2 and a heading that is wrong by half a turn predict the same motion."""
    recording = drive(Machine(duration=60.0, track_error=0.05))
    p = parameters(**GNSS, initial_yaw=math.pi, initial_yaw_stddev=0.3)
    error, _, estimator = errors(recording.measurements, recording, p)
    last = estimator.window.best[estimator.window.count - 1]
    assert abs(last["mean"][8]) < 0.3
    assert abs(math.remainder(last["mean"][2] - recording.poses[-1, 2], math.tau)) < 0.2
    assert error[error.size // 2 :].max() < 0.15


@pytest.mark.parametrize(
    "shown", [(0.0, 0.0), (0.0, 1.0), (1.0, -1.0)], ids=["both 0", "left 0", "right reversed"]
)
@pytest.mark.parametrize(("sensor_rate", "fix_rate"), SENSOR_AND_FIX_RATES)
def test_estimate_follows_fixes_while_encoders_fail(
    shown: tuple[float, float], sensor_rate: int, fix_rate: int
) -> None:
    machine = Machine(duration=40.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03)
    recording = drive(replace(machine, sensor_rate=sensor_rate, fix_rate=fix_rate))
    begin, end = 20.0, 30.0
    broken = with_scaled_sprockets(recording, shown, begin, end)
    error, nees, estimator = errors(broken, recording, parameters(**GNSS))
    t = np.arange(error.size) * 40.0 / error.size
    assert {Event.FAILED, Event.SLIPPED} & set(events(estimator))
    assert error.max() < 1.5
    assert error[(t > end + 3.0)].max() < 0.2
    assert np.mean(nees[t > begin] > 13.8) < 0.1


@pytest.mark.parametrize("fastest", [5.0, 20.0])  # rad/s, the configured maximum of a sprocket
def test_estimate_follows_fixes_while_every_other_count_is_lost(fastest: float) -> None:
    recording = drive(Machine(duration=50.0, track_error=0.05, fix_noise=0.05, fix_stated=0.05, fix_rate=1))
    begin, end = 20.0, 35.0
    halved = with_scaled_sprockets(recording, (0.5, 0.5), begin, end)
    p = parameters(**GNSS, max_sprocket_speed=fastest)
    error, nees, estimator = errors(halved, recording, p)
    t = np.arange(error.size) * 50.0 / error.size
    assert np.sqrt(np.mean(error[t > begin] ** 2)) < 0.2
    assert np.mean(nees[t > begin] > 13.8) < 0.06
    happened = [e.event for e in estimator.read_events() if e.source == "sprockets"]
    assert happened == [Event.FAILED, Event.RECOVERED]


def test_encoder_that_fails_is_found_beside_a_compass_at_20_hz() -> None:
    """Headings between two fixes must not shorten the time before now at which an event is looked for."""
    machine = Machine(duration=50.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03, fix_rate=1)
    recording = drive(machine)
    broken = [
        replace(m, right_speed=-m.right_speed)
        if isinstance(m, Sprockets) and 21 * S <= m.stamp_ns < 31 * S
        else m
        for m in recording.measurements
    ]
    p = parameters(**GNSS, heading_sources=["compass"])
    error, nees, _ = errors(with_compass(recording, broken, 20), recording, p)
    assert np.sqrt(np.mean(error**2)) < 0.15
    assert np.mean(nees > 13.8) < 0.05


@pytest.mark.parametrize(("factor", "seed"), [(-1.0, 0), (0.0, 0), (0.0, 2)])
def test_compass_shows_that_the_gyro_fails(factor: float, seed: int) -> None:
    machine = Machine(duration=50.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03, fix_rate=1, seed=seed)
    recording = drive(replace(machine, sensor_rate=100))
    fails = range(21 * S, 36 * S)
    broken = [
        replace(m, rate=factor * m.rate) if isinstance(m, YawRate) and m.stamp_ns in fails else m
        for m in recording.measurements
    ]
    measurements, p = with_compass(recording, broken, 50), parameters(**GNSS, heading_sources=["compass"])
    error, nees, _ = errors(measurements, recording, p)
    assert np.sqrt(np.mean(error**2)) < 0.06
    assert np.mean(nees > 13.8) < 0.03
    assert np.abs(heading_errors(measurements, recording, p)).max() < 0.35


@pytest.mark.parametrize(
    ("scale", "bias"), [(-1.0, 0.0), (0.0, 0.0), (1.0, 0.03)], ids=["reversed", "0", "biased"]
)
@pytest.mark.parametrize(("sensor_rate", "rate"), [(20, 10), (100, 5)])
def test_pair_of_antennas_shows_that_the_gyro_fails(
    sensor_rate: int, rate: int, scale: float, bias: float
) -> None:
    """Each fix agrees with the position: it must not hide that the headings since the last one did not."""
    machine = Machine(duration=50.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03)
    recording = drive(replace(machine, sensor_rate=sensor_rate, fix_rate=rate))
    fails = range(22 * S, 34 * S)
    broken = [
        replace(m, rate=scale * m.rate + bias) if isinstance(m, YawRate) and m.stamp_ns in fails else m
        for m in recording.measurements
    ]
    measurements = with_compass(recording, broken, rate, 0.005)
    p = parameters(**GNSS, heading_sources=["compass"])
    error, nees, _ = errors(measurements, recording, p)
    assert np.sqrt(np.mean(error**2)) < 0.04
    assert np.mean(nees > 13.8) < 0.02
    assert np.abs(heading_errors(measurements, recording, p)).max() < 0.35


@pytest.mark.parametrize("fix_rate", [1, 5])
@pytest.mark.parametrize("fault", ["stays", "counts backward", "drifts"])
def test_wrong_compass_is_found_without_a_gyro(fault: str, fix_rate: int) -> None:
    """Its error changes as fast as the machine turns."""
    machine = Machine(
        duration=60.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03, fix_rate=fix_rate, seed=1
    )
    recording = drive(machine)
    tracks: list[Measurement] = [m for m in recording.measurements if not isinstance(m, YawRate)]
    fails, wrong, last = range(21 * S, 33 * S), list[Measurement](), 0.0
    for m in with_compass(recording, tracks, 10, 0.02):
        if isinstance(m, HeadingFix):
            shown = {
                "stays": last,
                "counts backward": 2.0 * last - m.heading,
                "drifts": m.heading + 0.05 * (m.stamp_ns / S - 21.0),
            }
            is_wrong = m.stamp_ns in fails
            last = last if is_wrong else m.heading
            wrong.append(replace(m, heading=math.remainder(shown[fault], math.tau)) if is_wrong else m)
        else:
            wrong.append(m)
    error, nees, _ = errors(wrong, recording, parameters(**GNSS, heading_sources=["compass"]))
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert np.mean(nees > 13.8) < 0.05


@pytest.mark.parametrize(
    "factors", [(1.0, -1.0), (0.0, 0.0), (0.0, 1.0)], ids=["right reversed", "both 0", "left 0"]
)
def test_failed_encoders_are_found_beside_velocities_of_a_receiver(
    factors: tuple[float, float],
) -> None:
    """Velocities and fixes that agree with each other must win against the tracks."""
    machine = Machine(duration=50.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03, fix_rate=1)
    recording = drive(machine)
    broken = with_scaled_sprockets(recording, factors, 20.0, 32.0)
    p = parameters(**GNSS, velocity_sources=["fix_velocity"])
    error, nees, _ = errors(with_velocities(recording, broken, 5), recording, p)
    assert np.sqrt(np.mean(error**2)) < 0.3
    assert np.mean(nees > 13.8) < 0.05


def test_sprockets_that_show_zero_recover_only_when_they_show_a_motion() -> None:
    """Encoders show 0 from 20 s on; the machine halts at 30 s, where they are right by chance, until 45 s."""
    machine = Machine(duration=60.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03, fix_rate=1)
    recording = drive(replace(machine, stuck=(30.0, 45.0)))
    broken = with_scaled_sprockets(recording, (0.0, 0.0), 20.0, 50.0)
    halted = [m for m in broken if m.stamp_ns / S - 1.0 < 44.0]
    error, _, estimator = errors(halted, recording, parameters(**GNSS))
    assert events(estimator)[-1] is Event.FAILED
    error, nees, estimator = errors(broken, recording, parameters(**GNSS))
    assert events(estimator)[-1] is Event.RECOVERED
    assert error[-error.size // 12 :].max() < 0.15
    assert np.mean(nees > 13.8) < 0.05


@pytest.mark.parametrize("factors", [(0.0, 0.0), (1.0, -1.0)], ids=["both 0", "right reversed"])
@pytest.mark.parametrize("fix_rate", [1, 5])
def test_failed_encoders_are_found_before_the_heading_is_known(
    fix_rate: int, factors: tuple[float, float]
) -> None:
    """Fixes that show a longer displacement than the sprockets contradict them at any heading."""
    machine = Machine(duration=40.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03, fix_rate=fix_rate)
    recording = drive(machine)
    broken = with_scaled_sprockets(recording, factors, 0.0, 20.0)
    p = parameters(**GNSS, start="first_fix", initial_yaw_stddev=2.0)
    error, nees, _ = errors(broken, recording, p)
    t = np.arange(error.size) * 40.0 / error.size
    assert error[t > 6.0].max() < 1.0
    assert np.mean(nees[t > 6.0] > 13.8) < 0.05
    assert error[t > 26.0].max() < 0.2


@pytest.mark.parametrize("fix_rate", [1, 5, 10])
def test_lost_counts_beside_fixes_at_any_rate_keep_the_estimate_consistent(fix_rate: int) -> None:
    """The cost of an implausible slip must not depend on the number of fixes."""
    machine = Machine(duration=50.0, track_error=0.05, fix_noise=0.02, fix_stated=0.02, fix_rate=fix_rate)
    inconsistent, squares = list[float](), list[float]()
    for seed in range(3):
        recording = drive(replace(machine, seed=seed))
        lost = [
            replace(m, left_speed=0.5 * m.left_speed, right_speed=0.5 * m.right_speed)
            if isinstance(m, Sprockets) and 20 * S <= m.stamp_ns - S < 35 * S
            else m
            for m in recording.measurements
        ]
        error, nees, _ = errors(lost, recording, parameters(**GNSS))
        inconsistent.append(float(np.mean(nees > 13.8)))
        squares.append(float(np.mean(error**2)))
    assert np.mean(inconsistent) < 0.06
    assert np.sqrt(np.mean(squares)) < 0.3


def test_lost_counts_beside_fixes_with_headings_keep_the_estimate_consistent() -> None:
    """The explanation of lost counts must win against a wandering receiver with slip."""
    machine = Machine(seed=9, fix_rate=5, heading_noise=0.01, track_error=0.1, gyro_noise=0.002)
    recording = drive(machine)
    lost = [
        replace(m, left_speed=0.45 * m.left_speed, right_speed=0.45 * m.right_speed)
        if isinstance(m, Sprockets) and 20 * S <= m.stamp_ns - S < 40 * S
        else m
        for m in recording.measurements
    ]
    error, nees, _ = errors(lost, recording, parameters(**GNSS, **{"sources.box_pose.use_heading": True}))
    assert np.sqrt(np.mean(error**2)) < 0.06
    assert np.mean(nees > 13.8) < 0.02


def test_motion_is_unknown_while_counts_are_lost() -> None:
    recording = drive(Machine(duration=30.0, fix_noise=0.03, fix_stated=0.03))
    estimator = SlipEstimator(parameters(**GNSS))
    for m in recording.measurements:
        if isinstance(m, Sprockets) and m.stamp_ns > 21 * S:
            m = replace(m, left_speed=0.5 * m.left_speed, right_speed=0.5 * m.right_speed)
        estimator.process(m)
    assert estimator.estimate().motion is Motion.UNKNOWN
    assert estimator.competing_explanations.explanations[0].text == "sprockets count half of the distance"


@pytest.mark.parametrize(("factor", "most"), [(-1.0, 0.2), (0.5, 0.35)])  # most: rad, of the heading error
@pytest.mark.parametrize(("sensor_rate", "fix_rate"), SENSOR_AND_FIX_RATES)
def test_failing_gyro_does_not_turn_the_estimate(
    factor: float, most: float, sensor_rate: int, fix_rate: int
) -> None:
    """The gyro turns the heading before fixes contradict it; the estimate must not keep that error."""
    machine = Machine(duration=50.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03)
    recording = drive(replace(machine, sensor_rate=sensor_rate, fix_rate=fix_rate))
    broken = [
        replace(m, rate=factor * m.rate)
        if isinstance(m, YawRate) and 20.0 <= m.stamp_ns / S - 1.0 < 35.0
        else m
        for m in recording.measurements
    ]
    error, nees, _ = errors(broken, recording, parameters(**GNSS))
    assert error[error.size * 4 // 5 :].max() < 0.15
    assert np.mean(nees > 13.8) < 0.05
    late = heading_errors(broken, recording, parameters(**GNSS))[error.size * 3 // 5 :]
    assert np.abs(late).max() < most


@pytest.mark.parametrize(("rate", "seed"), [(5, 1), (10, 0)])
def test_change_of_gyro_bias_does_not_turn_the_estimate(rate: int, seed: int) -> None:
    """The bias turns the heading before fixes contradict it; wandering fixes are a competing explanation."""
    recording = drive(
        Machine(duration=60.0, track_error=0.01, fix_noise=0.02, fix_stated=0.02, fix_rate=rate, seed=seed)
    )
    biased = [
        replace(m, rate=m.rate + 0.03) if isinstance(m, YawRate) and m.stamp_ns / S - 1.0 > 20.0 else m
        for m in recording.measurements
    ]
    error, nees, _ = errors(biased, recording, parameters(**GNSS))
    assert error.max() < 0.2
    assert np.mean(nees > 13.8) < 0.1


@pytest.mark.parametrize(
    ("turn", "rate", "noise", "track_error"),  # rad/s, 1/s, m, 1
    [(0.3, FIXES, 0.03, 0.05), (0.25, 10, 0.02, 0.01)],
)
def test_wandering_fixes_do_not_pull_the_estimate(
    turn: float, rate: int, noise: float, track_error: float
) -> None:
    """Slow wandering resembles slip and fast wandering resembles noise; the covariance covers both."""
    machine = Machine(
        duration=50.0, track_error=track_error, fix_noise=noise, fix_stated=noise, fix_rate=rate
    )
    recording = drive(machine)

    def around(m: PoseFix, t: float) -> PoseFix:
        turned = min(max(turn * (t - 20.0), 0.0), math.tau)
        return moved(m, 0.6 * math.sin(turned), 0.6 - 0.6 * math.cos(turned))

    error, nees, estimator = errors(changed(recording, around), recording, parameters(**GNSS))
    assert Event.WANDERS in events(estimator)
    assert np.mean(nees > 13.8) < 0.05
    assert np.sqrt(np.mean(error**2)) < 0.2


def test_noisy_frozen_fixes_leave_no_error_once_they_resume() -> None:
    """Frozen fixes with noise cannot be distinguished from a stuck machine until they resume."""
    recording = drive(Machine(duration=70.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03))
    random = np.random.default_rng(1)
    last = next(m for m in recording.measurements if isinstance(m, PoseFix))

    def stay(m: PoseFix, t: float) -> PoseFix:
        nonlocal last
        last = m if t < 20.0 else last
        return replace(m, pose=last.pose + random.normal(0.0, 0.03, 3)) if 20.0 <= t < 28.0 else m

    error, _, estimator = errors(changed(recording, stay), recording, parameters(**GNSS))
    assert {Event.SLIPPED, Event.STAYS} & set(events(estimator))
    assert error[error.size * 60 // 70 :].max() < 0.2


def test_stuck_machine_follows_its_fixes() -> None:
    recording = drive(
        Machine(duration=60.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03, stuck=(20.0, 40.0))
    )
    error, _, estimator = errors(recording.measurements, recording, parameters(**GNSS))
    assert Event.SLIPPED in events(estimator)
    assert error[error.size * 22 // 60 : error.size * 40 // 60].max() < 0.1


def faulty(seed: int) -> list[Measurement]:
    """A drive with 8 s of multipath, an outlier, frozen fixes and spinning tracks."""
    recording = drive(Machine(duration=8.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03, seed=seed))
    random = np.random.default_rng(seed)
    begin, end = sorted(random.uniform(2.0, 7.0, 2))
    spike = random.uniform(2.0, 7.0)

    def change(m: PoseFix, t: float) -> PoseFix:
        if begin <= t < end:
            return moved(m, 0.8, -0.6)
        return moved(m, 7.0, 0.0) if abs(t - spike) < 0.3 else m

    spins = random.uniform(2.0, 6.0)
    return [
        replace(m, left_speed=3.0 * m.left_speed)
        if isinstance(m, Sprockets) and spins <= m.stamp_ns / S - 1.0 < spins + 1.0
        else m
        for m in changed(recording, change)
    ]


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 50), st.randoms(use_true_random=False), st.floats(0.05, 1.2))
def test_branches_do_not_depend_on_the_order_of_arrival(seed: int, random: Any, late_s: float) -> None:
    measurements = faulty(seed)
    begin = next(k for k, m in enumerate(measurements) if m.source == FIX) + 1
    rest = sorted(measurements[begin:], key=lambda m: m.stamp_ns + random.uniform(0.0, late_s) * S)
    in_order, shuffled = SlipEstimator(parameters(**GNSS)), SlipEstimator(parameters(**GNSS))
    in_order.process_all(measurements)
    for m in [*measurements[:begin], *rest]:
        shuffled.process(m)
    one, other = in_order.window, shuffled.window
    last, end = one.count - 1, other.count - 1
    assert one.counts[last] == other.counts[end]
    for s in range(one.counts[last]):
        assert_same_bits(one.states[s, last : last + 1], other.states[s, end : end + 1])
        assert one.branches[s, last]["weight"] == other.branches[s, end]["weight"]


def test_empty_script_stays_finite_over_a_long_log_with_a_wandering_receiver() -> None:
    """Without events the weight of the only branch is never reset; its exponential must stay finite."""
    recording = drive(Machine(duration=100.0, fix_noise=0.01, fix_stated=0.9, fix_rate=10))
    p = parameters(**GNSS)
    log = make_log(to_records(recording.measurements, SlipEstimator(p).sources), p)
    for block in run_log(log, p, np.zeros(0, EVENT)):
        assert np.isfinite(block.states["mean"]).all()
        assert block.window.status["divergences"][0] == 0


@pytest.mark.parametrize("seed", range(2))
def test_run_by_its_own_script_ends_in_the_best_branch(seed: int) -> None:
    """The final states are equal except for receiver errors, which follow the best branch of their time."""
    p = parameters(**GNSS, **{"receivers.white_odds": 1e3})
    log = make_log(to_records(faulty(seed), SlipEstimator(p).sources), p)
    script = best_branch_script(log, p)
    *_, free = (block.states[-1:].copy() for block in run_log(log, p))
    *_, scripted = (block.states[-1:].copy() for block in run_log(log, p, script))
    np.testing.assert_array_equal(free["mean"], scripted["mean"])
    np.testing.assert_array_equal(free["covariance"], scripted["covariance"])
