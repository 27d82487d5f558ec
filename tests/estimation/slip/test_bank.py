# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The hypothesis bank: the most probable event, its probability, and independence of the order of arrival."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fixtures.changes import changed
from fixtures.drawn_machine import FIX, FIXES, GNSS, Machine, Recording, drive, parameters
from fixtures.fault_cases.case import Truth, seconds
from fixtures.fault_cases.injections import (
    INJECTIONS,
    change_fixes,
    displace_between,
    displaced,
    scale_sprockets,
)
from fixtures.fault_cases.robot_logs import Compass, merged, reference_headings
from fixtures.pose_errors import PoseErrors, errors_over
from fixtures.records import assert_same_bits
from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.events import Event
from trackslip_estimation.slip.log import best_branch_script, make_log, run_log
from trackslip_estimation.slip.measurements import (
    HeadingFix,
    Measurement,
    PoseFix,
    VelocityFix,
    YawRate,
)
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.records import EVENT, to_records

S = 1_000_000_000
RECEIVER = Machine(duration=50.0, track_error=0.05, fix_noise=0.03, fix_stated=0.03)
SLOW_RECEIVER = replace(RECEIVER, fix_rate=1)
SENSOR_AND_FIX_RATES = [(20, FIXES), pytest.param(100, 1, marks=pytest.mark.slow)]  # Hz


def with_compass(
    recording: Recording, measurements: list[Measurement], rate: int, stddev: float = 0.03
) -> list[Measurement]:
    """The measurements with those of a compass at ``rate`` Hz, with white errors of ``stddev`` rad."""
    truth = Truth(recording.t, recording.poses)
    return merged(measurements, reference_headings(truth, Compass("compass", rate, stddev), seed=100))


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
    return merged(measurements, velocities)


def with_gyro(
    measurements: Iterable[Measurement], change: Callable[[float], float], begin: float, end: float = math.inf
) -> list[Measurement]:
    """The measurements with changed yaw rates from ``begin`` to ``end``, s."""
    return changed(measurements, YawRate, lambda m: replace(m, rate=change(m.rate)), 1.0 + begin, 1.0 + end)


def displaced_truth(recording: Recording, east: float, north: float, since: float = 0.0) -> Recording:
    """The recording of a machine that was moved at ``since`` s."""
    moved = np.where(recording.t[:, None] >= since, (east, north, 0.0), 0.0)
    return recording._replace(poses=recording.poses + moved)


def run(
    measurements: list[Measurement], truth: Recording, **values: object
) -> tuple[PoseErrors, SlipEstimator]:
    """Errors with a receiver, which may have faults, and the estimator at the end."""
    return errors_over(measurements, truth, parameters(**GNSS, **values))


def events(estimator: SlipEstimator) -> list[Event]:
    """Events of the most probable branch at the end."""
    branch = estimator.window.branches[0, estimator.window.count - 1]
    return [Event(branch["history"][n % 16]["event"]) for n in range(int(branch["events"]))]


@pytest.mark.parametrize(
    ("fault", "event"),
    [
        ("multipath 0.5 m 10 s", Event.OFFSET),
        ("multipath 3.0 m 10 s", Event.OFFSET),
        ("frozen 8 s", Event.REPEATS),  # detected by identical bits
    ],
)
def test_faulty_receiver_does_not_move_the_estimate(fault: str, event: Event) -> None:
    recording = drive(RECEIVER)
    faulty = INJECTIONS[fault].inject(recording.measurements, 20.0, 0.03).measurements
    found, estimator = run(faulty, recording)
    assert found.distances.max() < 0.15
    assert found.inconsistent < 0.02
    assert event in events(estimator)


def test_explanation_of_frozen_fixes_states_its_duration() -> None:
    recording = drive(replace(RECEIVER, duration=26.0))
    frozen = INJECTIONS["frozen 8 s"].inject(recording.measurements, 20.0, 0.03).measurements
    found = run(frozen, recording)[1].competing_explanations.explanations[0]
    assert found.text == f"{FIX} repeats one measurement"
    assert 19.0 < found.since_ns / S - 1.0 < 23.0


def test_covariance_spans_both_explanations_of_a_jump() -> None:
    """One source alone cannot show whether its fixes are displaced or the machine was moved."""
    recording = drive(replace(RECEIVER, duration=90.0, track_error=0.0))
    jumped = displace_between(recording.measurements, 20.0, math.inf, (2.0, 1.0))
    found, _ = run(jumped, displaced_truth(recording, 2.0, 1.0))
    assert found.between(22.0).nees(2).max() < 13.8
    assert found.between(60.0).distances.max() < 0.15


@pytest.mark.parametrize("seed", range(2))
def test_gaussian_fixes_cause_no_event(seed: int) -> None:
    recording = drive(replace(RECEIVER, duration=60.0, seed=seed))
    found, estimator = run(recording.measurements, recording)
    assert not events(estimator)
    assert 1.0 < found.nees(2).mean() < 3.0
    assert found.distances.max() < 0.1


@pytest.mark.parametrize("turned", [math.pi, -2.0])
def test_a_wrong_start_heading_is_found_within_metres(turned: float) -> None:
    recording = drive(Machine(duration=40.0))
    found, estimator = run(recording.measurements, recording, start="first_fix", initial_yaw=turned)
    assert found.between(15.0).distances.max() < 0.1
    assert Event.TURNED in events(estimator)


def off_evenly(part: int, heading_noise: float = 10.0) -> tuple[float, float]:
    """RMS position error, m, and mean NEES while fixes are 1 m off in direction ``part`` of twelve."""
    recording = drive(replace(RECEIVER, duration=47.0, seed=part, heading_noise=heading_noise))
    off = [15.0, 21.0, 31.0, 37.0], [0.0, 1.0, 1.0, 0.0]
    direction = np.array((math.cos(part * math.tau / 12.0), math.sin(part * math.tau / 12.0)))
    drifting = change_fixes(
        recording.measurements, lambda fix, t: displaced(fix, *(np.interp(t, *off) * direction))
    )
    found, _ = run(drifting, recording, **{"sources.box_pose.use_heading": heading_noise < 1.0})
    return found.rms, float(found.nees(2).mean())


@pytest.mark.parametrize("heading_noise", [10.0, 0.02])  # rad; of one antenna, and of two
def test_fixes_that_drift_off_do_not_pull_the_estimate(heading_noise: float) -> None:
    """The displacement of the fixes grows within 6 s, lasts for 10 s, and ends."""
    rms, nees = np.median([off_evenly(part, heading_noise) for part in range(12)], axis=0)
    assert rms < 0.22
    assert nees < 3.5


def test_fixes_with_a_persistent_offset_are_used_again_within_a_minute() -> None:
    recording, grows = drive(replace(RECEIVER, duration=110.0)), ([15.0, 21.0], [0.0, 0.7])
    off = change_fixes(
        recording.measurements,
        lambda fix, t: displaced(fix, float(np.interp(t, *grows)), -float(np.interp(t, *grows))),
    )
    found, estimator = run(off, displaced_truth(recording, 0.7, -0.7))
    assert Event.WANDERS in events(estimator)
    assert found.between(75.0).distances.max() < 0.2


def test_branches_start_at_least_half_the_look_back_time_ago() -> None:
    """A branch that fixes contradict keeps a snapshot of at least half the look-back time."""
    recording, random = drive(Machine(duration=30.0, fix_rate=1)), np.random.default_rng(0)
    noisy = change_fixes(
        recording.measurements, lambda fix, t: displaced(fix, *0.05 * random.standard_normal(2))
    )
    p = parameters(**GNSS)
    estimator, longest, ages = SlipEstimator(p), p.bank.look_back_time, []
    for m in noisy:
        estimator.process(m)
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
    recording = drive(RECEIVER)
    swapped = INJECTIONS["tracks swapped 3 s"].inject(recording.measurements, 20.0, 0.03).measurements
    found, _ = run(swapped, recording)
    assert found.distances.max() < 0.2
    assert found.inconsistent < 0.02


@pytest.mark.parametrize("far", [8.0, 5000.0])
@pytest.mark.parametrize("knows_heading", [True, False])
def test_first_fix_far_off_has_no_effect_after_7_seconds(far: float, knows_heading: bool) -> None:
    recording = drive(replace(RECEIVER, duration=20.0, track_error=0.0))
    far_off = displace_between(recording.measurements, 0.0, 0.1, (far, 0.0))
    found, _ = run(far_off, recording, initial_yaw_stddev=0.05 if knows_heading else 0.0)
    assert found.between(7.5).distances.max() < 0.3
    assert found.between(7.5).inconsistent < 0.05


def test_moved_machine_is_found_at_any_distance() -> None:
    far, recording = 1000.0, drive(replace(RECEIVER, duration=60.0))
    moved = displace_between(recording.measurements, 20.0, math.inf, (far, 0.0))
    found, _ = run(moved, displaced_truth(recording, far, 0.0, since=20.0))
    assert found.between(50.0).distances.max() < 0.2
    assert found.between(21.0).inconsistent < 0.02  # until then the covariance spans both explanations


def test_machine_moved_while_fixes_scatter_is_found() -> None:
    recording = drive(replace(RECEIVER, duration=70.0, track_error=0.0))
    random = np.random.default_rng(0)

    def scatter(fix: PoseFix, t: float) -> PoseFix:
        east, north = random.uniform(-300.0, 300.0, 2) if 20.0 <= t < 25.0 else (0.0, 0.0)
        return displaced(fix, (300.0 if t >= 20.0 else 0.0) + east, north)

    scattered = change_fixes(recording.measurements, scatter)
    found, estimator = run(scattered, displaced_truth(recording, 300.0, 0.0, since=20.0))
    assert Event.SCATTERS in events(estimator)
    assert found.between(65.0).distances.max() < 0.2


def test_skidding_machine_follows_centimetre_fixes_within_two_seconds() -> None:
    """The machine skids sideways by 0.25 m within a second."""
    recording = drive(Machine(duration=40.0, track_error=0.05, fix_rate=5))
    true = recording.poses.copy()
    true[:, 0] += 0.25 * np.clip(recording.t - 20.0, 0.0, 1.0)
    skidded = change_fixes(
        recording.measurements, lambda fix, t: displaced(fix, 0.25 * min(max(t - 20.0, 0.0), 1.0), 0.0)
    )
    found, estimator = run(skidded, recording._replace(poses=true))
    assert Event.OFFSET not in events(estimator)
    assert found.between(23.0).distances.max() < 0.1
    assert found.inconsistent < 0.03


def test_centimetre_fixes_off_for_ten_seconds_are_no_certain_skid() -> None:
    """A jump of 0.3 m between two fixes may be a skid or a fault of the receiver."""
    recording = drive(Machine(duration=50.0, track_error=0.1, fix_rate=1))
    found, _ = run(displace_between(recording.measurements, 20.0, 30.0, (0.24, 0.18)), recording)
    assert found.inconsistent < 0.02


def test_fixes_off_after_an_outage_are_no_skid() -> None:
    """A machine may skid during 20 s without fixes, but not by a share of the distance driven."""
    recording = drive(Machine(duration=80.0, fix_rate=5))
    off = displace_between(recording.measurements, 50.0, 60.0, (0.8, 0.6))
    spoilt = change_fixes(off, lambda fix, t: None if 30.0 <= t < 50.0 else fix)
    assert run(spoilt, recording)[0].between(50.0).distances.max() < 0.4


def test_impossible_slip_is_taken_for_a_wrong_heading() -> None:
    """A slip of 2 and a heading that is wrong by half a turn predict the same motion."""
    recording = drive(Machine(duration=60.0, track_error=0.05))
    found, estimator = run(recording.measurements, recording, initial_yaw=math.pi, initial_yaw_stddev=0.3)
    last = estimator.window.best[estimator.window.count - 1]
    assert abs(last["mean"][8]) < 0.3
    assert abs(found.off[-1, 2]) < 0.2
    assert found.between(30.0).distances.max() < 0.15


@pytest.mark.parametrize(
    "shown", [(0.0, 0.0), (0.0, 1.0), (1.0, -1.0)], ids=["both 0", "left 0", "right reversed"]
)
@pytest.mark.parametrize(("sensor_rate", "fix_rate"), SENSOR_AND_FIX_RATES)
def test_estimate_follows_fixes_while_encoders_fail(
    shown: tuple[float, float], sensor_rate: int, fix_rate: int
) -> None:
    recording = drive(replace(RECEIVER, duration=40.0, sensor_rate=sensor_rate, fix_rate=fix_rate))
    found, estimator = run(scale_sprockets(recording.measurements, 20.0, 30.0, *shown), recording)
    assert {Event.FAILED, Event.SLIPPED} & set(events(estimator))
    assert found.distances.max() < 1.5
    assert found.between(33.0).distances.max() < 0.2
    assert found.between(20.0).inconsistent < 0.1


@pytest.mark.parametrize("fastest", [5.0, 20.0])  # rad/s, the configured maximum of a sprocket
def test_estimate_follows_fixes_while_every_other_count_is_lost(fastest: float) -> None:
    recording = drive(replace(SLOW_RECEIVER, fix_noise=0.05, fix_stated=0.05))
    halved = scale_sprockets(recording.measurements, 20.0, 35.0, 0.5, 0.5)
    found, estimator = run(halved, recording, max_sprocket_speed=fastest)
    assert found.between(20.0).rms < 0.2
    assert found.between(20.0).inconsistent < 0.06
    happened = [e.event for e in estimator.read_events() if e.source == "sprockets"]
    assert happened == [Event.FAILED, Event.RECOVERED]


def test_encoder_that_fails_is_found_beside_a_compass_at_20_hz() -> None:
    """Headings between two fixes must not shorten the time before now at which an event is looked for."""
    recording = drive(SLOW_RECEIVER)
    broken = scale_sprockets(recording.measurements, 20.0, 30.0, 1.0, -1.0)
    found, _ = run(with_compass(recording, broken, 20), recording, heading_sources=["compass"])
    assert found.rms < 0.15
    assert found.inconsistent < 0.05


@pytest.mark.parametrize(("factor", "seed"), [(-1.0, 0), (0.0, 2)])
def test_compass_shows_that_the_gyro_fails(factor: float, seed: int) -> None:
    recording = drive(replace(SLOW_RECEIVER, seed=seed, sensor_rate=100))
    broken = with_gyro(recording.measurements, lambda rate: factor * rate, 20.0, 35.0)
    found, _ = run(with_compass(recording, broken, 50), recording, heading_sources=["compass"])
    assert found.rms < 0.06
    assert found.inconsistent < 0.03
    assert np.abs(found.off[:, 2]).max() < 0.35


@pytest.mark.parametrize(
    ("scale", "bias"), [(-1.0, 0.0), (0.0, 0.0), (1.0, 0.03)], ids=["reversed", "0", "biased"]
)
@pytest.mark.parametrize(("sensor_rate", "rate"), [(20, 10), pytest.param(100, 5, marks=pytest.mark.slow)])
def test_pair_of_antennas_shows_that_the_gyro_fails(
    sensor_rate: int, rate: int, scale: float, bias: float
) -> None:
    """Each fix agrees with the position: it must not hide that the headings since the last one did not."""
    recording = drive(replace(RECEIVER, sensor_rate=sensor_rate, fix_rate=rate))
    broken = with_gyro(recording.measurements, lambda shown: scale * shown + bias, 21.0, 33.0)
    found, _ = run(with_compass(recording, broken, rate, 0.005), recording, heading_sources=["compass"])
    assert found.rms < 0.04
    assert found.inconsistent < 0.02
    assert np.abs(found.off[:, 2]).max() < 0.35


@pytest.mark.parametrize("fix_rate", [1, 5])
@pytest.mark.parametrize("fault", ["stays", "counts backward", "drifts"])
def test_wrong_compass_is_found_without_a_gyro(fault: str, fix_rate: int) -> None:
    """Its error changes as fast as the machine turns."""
    recording = drive(replace(RECEIVER, duration=60.0, fix_rate=fix_rate, seed=1))
    tracks: list[Measurement] = [m for m in recording.measurements if not isinstance(m, YawRate)]
    wrong, last = list[Measurement](), 0.0
    for m in with_compass(recording, tracks, 10, 0.02):
        if isinstance(m, HeadingFix):
            t, right = seconds(m), m.heading
            shown = {
                "stays": last,
                "counts backward": 2.0 * last - right,
                "drifts": right + 0.05 * (t - 20.0),
            }
            is_wrong = 20.0 <= t < 32.0
            m = replace(m, heading=math.remainder(shown[fault], math.tau)) if is_wrong else m
            last = last if is_wrong else right
        wrong.append(m)
    found, _ = run(wrong, recording, heading_sources=["compass"])
    assert found.rms < 0.1
    assert found.inconsistent < 0.05


@pytest.mark.parametrize(
    "factors", [(1.0, -1.0), (0.0, 0.0), (0.0, 1.0)], ids=["right reversed", "both 0", "left 0"]
)
def test_failed_encoders_are_found_beside_velocities_of_a_receiver(factors: tuple[float, float]) -> None:
    """Velocities and fixes that agree with each other must win against the tracks."""
    recording = drive(SLOW_RECEIVER)
    broken = scale_sprockets(recording.measurements, 20.0, 32.0, *factors)
    given_ = with_velocities(recording, broken, 5)
    found, _ = run(given_, recording, velocity_sources=["fix_velocity"])
    assert found.rms < 0.3
    assert found.inconsistent < 0.05


def test_sprockets_that_show_zero_recover_only_when_they_show_a_motion() -> None:
    """Encoders show 0 from 20 s on; the machine halts at 30 s, where they are right by chance, until 45 s."""
    recording = drive(replace(SLOW_RECEIVER, duration=60.0, stuck=(30.0, 45.0)))
    broken = scale_sprockets(recording.measurements, 20.0, 50.0, 0.0, 0.0)
    _, estimator = run([m for m in broken if seconds(m) < 44.0], recording)
    assert events(estimator)[-1] is Event.FAILED
    found, estimator = run(broken, recording)
    assert events(estimator)[-1] is Event.RECOVERED
    assert found.between(55.0).distances.max() < 0.15
    assert found.inconsistent < 0.05


@pytest.mark.parametrize("factors", [(0.0, 0.0), (1.0, -1.0)], ids=["both 0", "right reversed"])
@pytest.mark.parametrize("fix_rate", [1, 5])
def test_failed_encoders_are_found_before_the_heading_is_known(
    fix_rate: int, factors: tuple[float, float]
) -> None:
    """Fixes that show a longer displacement than the sprockets contradict them at any heading."""
    recording = drive(replace(RECEIVER, duration=40.0, fix_rate=fix_rate))
    broken = scale_sprockets(recording.measurements, 0.0, 20.0, *factors)
    found, _ = run(broken, recording, start="first_fix", initial_yaw_stddev=2.0)
    assert found.between(6.0).distances.max() < 1.0
    assert found.between(6.0).inconsistent < 0.05
    assert found.between(26.0).distances.max() < 0.2


@pytest.mark.parametrize("fix_rate", [1, 10])
def test_lost_counts_beside_fixes_at_any_rate_keep_the_estimate_consistent(fix_rate: int) -> None:
    """The cost of an implausible slip must not depend on the number of fixes."""
    machine, runs = Machine(duration=50.0, track_error=0.05, fix_rate=fix_rate), list[PoseErrors]()
    for seed in range(3):
        recording = drive(replace(machine, seed=seed))
        runs.append(run(scale_sprockets(recording.measurements, 20.0, 35.0, 0.5, 0.5), recording)[0])
    assert np.mean([found.inconsistent for found in runs]) < 0.06
    assert np.sqrt(np.mean([found.rms**2 for found in runs])) < 0.3


def test_lost_counts_beside_fixes_with_headings_keep_the_estimate_consistent() -> None:
    """The explanation of lost counts must win against a wandering receiver with slip."""
    recording = drive(Machine(seed=9, fix_rate=5, heading_noise=0.01, track_error=0.1, gyro_noise=0.002))
    lost = scale_sprockets(recording.measurements, 20.0, 40.0, 0.45, 0.45)
    found, _ = run(lost, recording, **{"sources.box_pose.use_heading": True})
    assert found.rms < 0.06
    assert found.inconsistent < 0.02


def test_motion_is_unknown_while_counts_are_lost() -> None:
    recording = drive(replace(RECEIVER, duration=30.0, track_error=0.0))
    lost = scale_sprockets(recording.measurements, 20.01, math.inf, 0.5, 0.5)
    _, estimator = run(lost, recording)
    assert estimator.estimate().motion is Motion.UNKNOWN
    assert estimator.competing_explanations.explanations[0].text == "sprockets count half of the distance"


@pytest.mark.parametrize(("factor", "most"), [(-1.0, 0.2), (0.5, 0.35)])  # most: rad, of the heading error
@pytest.mark.parametrize(("sensor_rate", "fix_rate"), SENSOR_AND_FIX_RATES)
def test_failing_gyro_does_not_turn_the_estimate(
    factor: float, most: float, sensor_rate: int, fix_rate: int
) -> None:
    """The gyro turns the heading before fixes contradict it; the estimate must not keep that error."""
    recording = drive(replace(RECEIVER, sensor_rate=sensor_rate, fix_rate=fix_rate))
    found, _ = run(with_gyro(recording.measurements, lambda rate: factor * rate, 20.0, 35.0), recording)
    assert found.between(40.0).distances.max() < 0.15
    assert found.inconsistent < 0.05
    assert np.abs(found.between(30.0).off[:, 2]).max() < most


@pytest.mark.parametrize(("rate", "seed"), [(5, 1), (10, 0)])
def test_change_of_gyro_bias_does_not_turn_the_estimate(rate: int, seed: int) -> None:
    """The bias turns the heading before fixes contradict it; wandering fixes are a competing explanation."""
    recording = drive(Machine(duration=60.0, track_error=0.01, fix_rate=rate, seed=seed))
    found, _ = run(with_gyro(recording.measurements, lambda shown: shown + 0.03, 20.01), recording)
    assert found.distances.max() < 0.2
    assert found.inconsistent < 0.1


@pytest.mark.parametrize(
    ("turn", "rate", "noise", "track_error"),  # rad/s, 1/s, m, 1
    [(0.3, FIXES, 0.03, 0.05), (0.25, 10, 0.02, 0.01)],
)
def test_wandering_fixes_do_not_pull_the_estimate(
    turn: float, rate: int, noise: float, track_error: float
) -> None:
    """Slow wandering resembles slip and fast wandering resembles noise; the covariance covers both."""
    recording = drive(
        Machine(duration=50.0, track_error=track_error, fix_noise=noise, fix_stated=noise, fix_rate=rate)
    )

    def around(fix: PoseFix, t: float) -> PoseFix:
        turned = min(max(turn * (t - 20.0), 0.0), math.tau)
        return displaced(fix, 0.6 * math.sin(turned), 0.6 - 0.6 * math.cos(turned))

    found, estimator = run(change_fixes(recording.measurements, around), recording)
    assert Event.WANDERS in events(estimator)
    assert found.inconsistent < 0.05
    assert found.rms < 0.2


def test_noisy_frozen_fixes_leave_no_error_once_they_resume() -> None:
    """Frozen fixes with noise cannot be distinguished from a stuck machine until they resume."""
    recording, random = drive(replace(RECEIVER, duration=70.0)), np.random.default_rng(1)
    frozen = INJECTIONS["frozen 8 s"].inject(recording.measurements, 20.0, 0.03).measurements
    jittering = change_fixes(
        frozen,
        lambda fix, t: displaced(fix, *random.normal(0.0, 0.03, 3)[:2]) if 20.0 <= t < 28.0 else fix,
    )
    found, estimator = run(jittering, recording)
    assert {Event.SLIPPED, Event.STAYS} & set(events(estimator))
    assert found.between(60.0).distances.max() < 0.2


def faulty(seed: int) -> list[Measurement]:
    """A drive with 8 s of multipath, an outlier, frozen fixes and spinning tracks."""
    recording, random = drive(replace(RECEIVER, duration=8.0, seed=seed)), np.random.default_rng(seed)
    begin, end = sorted(random.uniform(2.0, 7.0, 2))
    spike = random.uniform(2.0, 7.0)

    def change(fix: PoseFix, t: float) -> PoseFix:
        if begin <= t < end:
            return displaced(fix, 0.8, -0.6)
        return displaced(fix, 7.0, 0.0) if abs(t - spike) < 0.3 else fix

    spins = random.uniform(2.0, 6.0)
    return scale_sprockets(change_fixes(recording.measurements, change), spins, spins + 1.0, 3.0, 1.0)


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
