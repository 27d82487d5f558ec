# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Gaps of sprocket samples and jumps of positions: no speed is invented, the covariance covers them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from fixtures.changes import changed

from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import SPROCKETS

S, MS = 1_000_000_000, 1_000_000
MODELS = ["turning", pytest.param("icr", marks=pytest.mark.slow), "free_slips"]


SHORT_TIMEOUT = {"start": "initial_pose", "sprocket_timeout": 0.1, "max_sprocket_speed": 20.0}
Sample = tuple[int, float, float]  # ms, position of both, measured speed of both


class UsedSpeeds(NamedTuple):
    """Sprocket speeds of a state at a stamp."""

    speeds: tuple[float, float, bool]  # left, right, and whether from counts
    coasting: bool


def states_at(samples: Sequence[Sample], asked_ms: Sequence[int]) -> list[UsedSpeeds]:
    """Speeds that the estimator uses at each stamp; the sprocket timeout is 100 ms."""
    p = load_slip_parameters(SHORT_TIMEOUT)
    found: list[Measurement] = [
        Sprockets("sprockets", S + ms * MS, speed, speed, (angle, angle)) for ms, angle, speed in samples
    ]
    begin = Sprockets("sprockets", S - 100 * MS, 0.0, 0.0)
    gyro = [YawRate("imu/data_raw", S + ms * MS, 0.0, 1.0) for ms in asked_ms]
    estimator = SlipEstimator(p)
    estimator.process_all([begin, *found, *gyro])
    window = estimator.window
    status, measurements, states = window.status, window.measurements, window.best
    entries = {
        int(m["stamp_ns"]): state
        for m, state in zip(measurements[: status["count"][0]], states, strict=False)
        if m["kind"] != SPROCKETS
    }
    asked = [entries[S + ms * MS] for ms in asked_ms]
    speeds = [state["speeds"].item() for state in asked]
    return [
        UsedSpeeds((*found, variance > 0.0), bool(state["coasting"]))
        for (*found, variance, _), state in zip(speeds, asked, strict=True)
    ]


STANDING = (0.0, 0.0, False)
HALF_A_COUNT = load_slip_parameters().encoder_resolution / 2.0 / 0.05  # rad/s, within 50 ms


def test_speed_is_known_only_in_the_first_part_of_a_long_gap() -> None:
    samples = ((300, 9.0, 5.0), (0, 0.0, 1.0), (50, 0.1, 1.0))
    for known in states_at(samples, (51, 100, 149)):  # speeds of the interval before
        assert known == (
            (pytest.approx(2.0, abs=HALF_A_COUNT), pytest.approx(2.0, abs=HALF_A_COUNT), True),
            False,
        )
    assert states_at(samples, (151, 299)) == [(STANDING, True)] * 2
    assert (
        states_at(samples, (300, 301, 399)) == [((5.0, 5.0, False), True)] + [((5.0, 5.0, False), False)] * 2
    )  # measured speed of the sample at its end
    assert states_at(samples, (401,)) == [(STANDING, True)]


def test_measured_speed_replaces_a_position_jump() -> None:
    samples = ((0, 0.0, 1.0), (50, 0.1, 2.0), (100, 77.0, 3.0), (150, 77.1, 4.0))
    jumped, continuous = states_at(samples, (70, 120))
    assert jumped.speeds == pytest.approx((3.0, 3.0, True), abs=2.0 * HALF_A_COUNT)
    assert not jumped.coasting
    assert continuous.speeds == pytest.approx((2.0, 2.0, True), abs=2.0 * HALF_A_COUNT)
    p = load_slip_parameters(SHORT_TIMEOUT)
    given = [Sprockets("sprockets", ms * MS, w, w, (angle, angle)) for ms, angle, w in samples]
    outcomes = [r.outcome for r, _ in SlipEstimator(p).process_all(given)]
    assert outcomes == [Outcome.ACCEPTED, Outcome.ACCEPTED, Outcome.JUMPED, Outcome.ACCEPTED]


def test_sample_without_a_valid_speed_counts_as_silence() -> None:
    samples = ((0, 0.0, 1.0), (50, 0.1, 2.0), (100, 77.0, 99.0), (150, 99.0, 99.0))
    assert states_at(samples, (70, 100, 200)) == [(STANDING, True)] * 3
    assert not states_at(samples, (49,))[0].coasting


def test_variance_with_refused_samples_grows_as_in_silence(
    drive: Callable[..., Any],
) -> None:
    """A rejected sample must not end the silence."""
    driven = drive([(5.0, 2.0, 2.0, 0.05, 0.05, 0.0), (10.0, 1.0, 2.0, 0.0, 0.1, 0.0)])
    kept = without(driven.measurements, (PoseFix,), 6.0, 10.0)
    too_fast = {"left_speed": 99.0, "right_speed": 99.0, "positions": None}
    rejected = changed(kept, Sprockets, lambda m: replace(m, **too_fast), 6.001, 10.0)
    spread = []
    for found in (rejected, without(kept, (Sprockets,), 6.0, 10.0)):
        estimator = run([m for m in found if m.stamp_ns < 9.9 * S])[2]
        spread.append(np.sqrt(np.trace(estimator.estimate().pose_covariance[:2, :2])))
    assert spread[0] > 0.7 * spread[1]


def test_slips_stay_those_of_the_ground_while_sprockets_are_silent(drive: Callable[..., Any]) -> None:
    """The machine drives on, beside fixes, while the speeds of its tracks are unknown."""
    driven = drive([(20.0, 3.0, 3.0, 0.1, 0.1, 0.0)])
    outputs = run(without(driven.measurements, (Sprockets,), 15.0, 20.0))[2].estimate().outputs
    assert outputs.twist[0] > 0.1
    np.testing.assert_allclose(outputs.slips[:2], 0.1, atol=0.1)
    assert np.sqrt(np.diag(outputs.slip_covariance)[:2]).min() >= 0.25


def run(found: list[Measurement], **changes: Any) -> tuple[list[Outcome], list[Estimate], SlipEstimator]:
    estimator = SlipEstimator(load_slip_parameters({"start": "initial_pose"}, changes))
    steps = [estimator.process(m) for m in found]
    return [r.outcome for r, _ in steps], [e for _, e in steps if e is not None], estimator


def without(
    found: list[Measurement], kinds: tuple[type, ...], start_s: float, stop_s: float
) -> list[Measurement]:
    return [m for m in found if not (isinstance(m, kinds) and start_s * S < m.stamp_ns < stop_s * S)]


@pytest.mark.parametrize("model", MODELS)
def test_covariance_covers_the_distance_in_silence(drive: Callable[..., Any], model: str) -> None:
    """4 s without sprockets and fixes while the machine drives and turns."""
    driven = drive([(5.0, 2.0, 2.0, 0.05, 0.05, 0.0), (10.0, 1.0, 2.0, 0.0, 0.1, 0.0)])
    kept = without(driven.measurements, (Sprockets, PoseFix), 6.0, 10.0)
    estimator = SlipEstimator(load_slip_parameters({"start": "initial_pose", "model": model}))
    spread = []
    for m in kept:
        estimator.process(m)
        if isinstance(m, YawRate) and 6.6 * S < m.stamp_ns < 9.9 * S:
            now = estimator.estimate()
            spread.append(float(np.sqrt(np.trace(now.pose_covariance[:2, :2]))))
            assert now.motion is Motion.UNKNOWN
            error = now.pose - driven.truth[m.stamp_ns][:3]
            assert error[:2] @ np.linalg.solve(now.pose_covariance[:2, :2], error[:2]) < 9.0
    assert spread == sorted(spread)
    assert 1.0 < spread[-1] < 4.0  # at most the distance it can drive


@pytest.mark.parametrize("model", ["turning", "icr"])
def test_machine_keeps_its_speed_at_first_in_silence(drive: Callable[..., Any], model: str) -> None:
    driven = drive([(5.0, 2.0, 2.0, 0.05, 0.05, 0.0), (10.0, 2.0, 2.0, 0.05, 0.05, 0.0)])
    kept = without(driven.measurements, (Sprockets, PoseFix), 6.0, 9.0)
    found = {e.stamp_ns: e for e in run(kept, model=model)[1]}
    moved = found[9 * S].pose[:2] - found[6 * S].pose[:2]
    true = driven.truth[9 * S][:2] - driven.truth[6 * S][:2]
    assert 0.5 < np.linalg.norm(moved) / np.linalg.norm(true) < 1.2


@pytest.mark.parametrize("model", ["turning", "icr"])
def test_gyro_propagates_the_heading_through_silence(drive: Callable[..., Any], model: str) -> None:
    driven = drive([(5.0, 2.0, 2.0, 0.05, 0.05, 0.0), (10.0, 1.0, 2.0, 0.0, 0.1, 0.0)])
    kept = without(driven.measurements, (Sprockets, PoseFix), 6.0, 9.0)
    found = {e.stamp_ns: e for e in run(kept, model=model)[1]}[9 * S]
    assert abs(found.pose[2] - driven.truth[9 * S][2]) < 0.05
    assert np.sqrt(found.pose_covariance[2, 2]) < 0.1


@pytest.mark.parametrize("model", MODELS)
def test_the_bias_is_not_learned_from_a_turn_in_silence(drive: Callable[..., Any], model: str) -> None:
    driven = drive(
        [(5.0, 0.0, 0.0, 0.0, 0.0, 0.0), (5.0, -2.0, 2.0, 0.0, 0.0, 0.0), (9.0, 0.0, 0.0, 0.0, 0.0, 0.0)]
    )
    kept = without(driven.measurements, (Sprockets,), 5.0, 10.0)
    last = run(kept, model=model)[1][-1]
    assert abs(last.outputs.twist[2]) < 0.01
    assert np.cos(last.pose[2] - driven.truth[last.stamp_ns][2]) > np.cos(0.05)


@pytest.mark.parametrize("model", MODELS)
def test_next_fixes_after_silence_restore_the_pose(drive: Callable[..., Any], model: str) -> None:
    driven = drive([(20.0, 2.0, 1.8, 0.05, 0.05, 0.0)])
    for seconds in (2.0, 4.0, 8.0):
        kept = without(driven.measurements, (Sprockets, PoseFix, YawRate), 6.0, 6.0 + seconds)
        for e in run(kept, model=model)[1]:
            if e.stamp_ns > (6.0 + seconds + 1.0) * S:
                assert np.hypot(*(e.pose - driven.truth[e.stamp_ns][:3])[:2]) < 0.15


@pytest.mark.parametrize("model", MODELS[:2])
@pytest.mark.parametrize("turn", [-3.0, 0.0])
def test_heading_lost_in_silence_is_corrected_to_the_right_side(
    drive: Callable[..., Any], model: str, turn: float
) -> None:
    """3 s without sprockets and gyro make the heading unknown; fixes at standstill do not show it.

    It stays within four standard deviations as the machine drives off.
    """
    kinematics = load_slip_parameters().vehicle.kinematics
    speed = turn / 3.0 * kinematics.tread / kinematics.rolling_radius / 2.0  # of each sprocket, for 3 s
    for seed in range(4):
        driven = drive(
            [
                (5.0, 2.0, 2.0, 0.0, 0.0, 0.0),
                (3.0, -speed, speed, 0.0, 0.0, 0.0),
                (4.0, 0.0, 0.0, 0.0, 0.0, 0.0),
                (8.0, 2.0, 2.0, 0.0, 0.0, 0.0),
            ],
            seed=seed,
            fix_sigma=(0.006, 0.008, 0.02),
        )
        kept = without(driven.measurements, (Sprockets, YawRate), 5.0, 8.0)
        published = run(kept, model=model, **{"sources.box_pose.use_heading": False})[1]
        errors = np.array([e.pose - driven.truth[e.stamp_ns][:3] for e in published])
        errors[:, 2] = np.angle(np.exp(1j * errors[:, 2]))
        deviations = np.sqrt([np.diag(e.pose_covariance) for e in published])
        assert (np.abs(errors) < 4.0 * deviations).all()
        assert abs(errors[-1, 2]) < 0.1


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("with_gyro", [True, False])
def test_pose_is_published_through_20_s_without_sprockets(
    drive: Callable[..., Any], model: str, with_gyro: bool
) -> None:
    """No fix or gyro reading has the outcome AHEAD.

    The pose is propagated from fix to fix with a large covariance. Soon after the sprockets are back it is
    as accurate as before.
    """
    driven = drive([(10.0, 2.0, 2.0, 0.05, 0.05, 0.0), (30.0, 1.5, 2.0, 0.05, 0.2, 0.0)])
    found = without(driven.measurements, (Sprockets,), 15.0, 35.0)
    if not with_gyro:
        found = without(found, (YawRate,), 15.0, 35.0)
    estimator = SlipEstimator(load_slip_parameters({"model": model}))
    outcomes, silent, back, usual = [], [], [], 0.0
    for m in found:
        report, e = estimator.process(m)
        if m.stamp_ns > 15 * S:
            outcomes.append(report.outcome)
        if e is None:
            continue
        error = e.pose - driven.truth[e.stamp_ns][:3]
        error[2] = np.angle(np.exp(1j * error[2]))
        deviations = np.sqrt(np.diag(e.pose_covariance))
        if 14 * S < e.stamp_ns < 15 * S:
            usual = max(usual, float(deviations[0]))
        if 16 * S < e.stamp_ns < 35 * S:
            assert (np.abs(error) < 4.0 * deviations).all()
            assert e.motion is Motion.UNKNOWN
            silent.append((e.stamp_ns, float(deviations[0])))
        if e.stamp_ns > 37 * S:
            back.append(np.hypot(*error[:2]))
    assert {Outcome.AHEAD, Outcome.TOO_LATE, Outcome.RESTARTED}.isdisjoint(outcomes)
    assert outcomes.count(Outcome.GATED) <= 2
    stamps, spread = np.array(silent).T
    assert np.diff(stamps).max() <= (0.1 if with_gyro else 0.2) * S
    assert spread.min() > 1.3 * usual
    assert max(back) < 0.1


def test_encoder_restart_at_another_position_is_counted_without_effect(
    drive: Callable[..., Any],
) -> None:
    driven = drive([(10.0, 2.0, 1.5, 0.05, 0.05, 0.0)])

    def restarted(m: Sprockets) -> Sprockets:
        assert m.positions is not None
        return replace(m, positions=(m.positions[0] + 100.0, m.positions[1] - 3.0))

    jumped = changed(driven.measurements, Sprockets, restarted, 5.0)
    outcomes, published, _ = run(jumped)
    assert outcomes.count(Outcome.JUMPED) == 1
    clean = run(driven.measurements)[1]
    assert [e.stamp_ns for e in published] == [e.stamp_ns for e in clean]
    for one, other in zip(published, clean, strict=True):
        np.testing.assert_allclose(one.pose, other.pose, atol=0.02)
        assert np.abs(one.outputs.twist).max() < 1.0


@pytest.mark.parametrize("model", MODELS)
def test_standstill_corrects_the_bias(drive: Callable[..., Any], model: str) -> None:
    """After 10 s at most a tenth of 0.02 rad/s remains, as yaw rate and in the heading."""
    driven = drive(
        [(10.0, 0.0, 0.0, 0.0, 0.0, 0.0), (5.0, 2.0, 2.0, 0.05, 0.05, 0.0)], gyro_bias=0.02, fix_every=10**9
    )
    changes = {"noise.initial_gyro_bias": 0.03, "turning.initial_gyro_bias_stddev": 0.03}
    found = [m for m in driven.measurements if not isinstance(m, PoseFix)]
    published = run(
        found, model=model, initial_yaw_stddev=0.001, **changes, **{"icr.initial_gyro_bias_stddev": 0.03}
    )[1]
    by_stamp = {e.stamp_ns: e for e in published}
    assert abs(by_stamp[15 * S].pose[2] - by_stamp[10 * S].pose[2]) < 0.1 * 0.02 * 5.0 + 0.005


@pytest.mark.parametrize("model", MODELS)
def test_slips_are_frozen_and_direction_is_uncertain_at_standstill(
    drive: Callable[..., Any], model: str
) -> None:
    driven = drive([(6.0, 2.0, 2.0, 0.05, 0.05, 0.0), (8.0, 0.0, 0.0, 0.0, 0.0, 0.0)])
    standing = [
        e
        for e in run(driven.measurements, model=model, **{"events.slip_rate": 1e-9})[1]
        if e.stamp_ns > 7 * S
    ]
    assert {e.motion for e in standing} == {Motion.STANDING}
    first, last = standing[0].outputs, standing[-1].outputs
    np.testing.assert_allclose(last.slips[:2], first.slips[:2], atol=0.005)
    assert (np.diag(last.slip_covariance)[:2] > 0.0).all()
    assert (np.diag(last.slip_covariance)[:2] <= np.diag(first.slip_covariance)[:2] + 1e-9).all()
    direction = np.sqrt(last.slip_covariance[2, 2])
    assert direction > (0.5 if model != "free_slips" else 0.01)  # a state in the thesis' model, and kept


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("received_from", [3.06, 3.2, 3.8])
def test_covariance_covers_the_distance_between_first_fix_and_first_sample(
    drive: Callable[..., Any], model: str, received_from: float
) -> None:
    """After a restart during motion the first fix precedes the first sample; the machine stops in between."""
    driven = drive(
        [(3.0, 2.0, 2.0, 0.05, 0.05, 0.0), (5.0, 0.0, 0.0, 0.0, 0.0, 0.0)], fix_sigma=(0.005, 0.005, 0.002)
    )
    fix_ns = round(2.8 * S)
    kept = [
        m
        for m in driven.measurements
        if (isinstance(m, PoseFix) and m.stamp_ns == fix_ns)
        or (isinstance(m, YawRate) and m.stamp_ns > fix_ns)
        or (isinstance(m, Sprockets) and m.stamp_ns >= received_from * S)
    ]
    published = run(kept, model=model, start="first_fix")[1]
    for e in published:
        if e.stamp_ns >= received_from * S:
            error = np.abs(e.pose - driven.truth[e.stamp_ns][:3])
            assert (error < 3.0 * np.sqrt(np.diag(e.pose_covariance))).all()
    assert np.abs(published[-1].pose[:2] - driven.truth[published[-1].stamp_ns][:2]).max() > 0.02


@pytest.mark.parametrize("model", MODELS)
def test_first_sample_soon_after_the_first_fix_keeps_the_covariance(
    drive: Callable[..., Any], model: str
) -> None:
    driven = drive([(5.0, 2.0, 2.0, 0.05, 0.05, 0.0)], fix_sigma=(0.005, 0.005, 0.002))
    fix = next(m for m in driven.measurements if isinstance(m, PoseFix) and m.stamp_ns > S)
    kept = [m for m in driven.measurements if isinstance(m, Sprockets) and m.stamp_ns > fix.stamp_ns]
    first = run([fix, *kept], model=model, start="first_fix")[1][0]
    assert np.sqrt(first.pose_covariance[0, 0]) < 0.007
