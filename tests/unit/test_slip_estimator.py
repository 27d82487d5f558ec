# SPDX-License-Identifier: Apache-2.0
"""The estimator on a small exact truth: it converges, is honest, and guards itself."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from trackslip_estimation.measurements import Measurement, Outcome, PoseFix, Report, Sprockets, YawRate
from trackslip_estimation.motion import Motion
from trackslip_estimation.slip_estimator import Estimate, SlipEstimator
from trackslip_estimation.slip_parameters import SlipEstimatorParameters, load_slip_parameters

S = 1_000_000_000
Step = tuple[Report, Estimate | None]


def parameters(**changes: Any) -> SlipEstimatorParameters:
    """The thesis' model with fixed noise, whatever the defaults are; `__` stands for the dot."""
    noise = {
        "model": "free_slips",
        "noise.encoder": 0.002,
        "noise.slip_steady": 0.01,
        "noise.slip_moving": 0.02,
        "noise.slip_angle_steady": 0.0,
        "noise.slip_angle_turning": 0.0,
        "noise.gyro_bias": 1e-5,
        "noise.initial_slip": 0.1,
        "noise.initial_slip_angle": 0.01,
        "noise.initial_gyro_bias": 0.01,
    }
    start = {"start": "initial_pose", "initial_position_stddev": 0.03, "pose_timeouts": [1.0]}
    return load_slip_parameters(noise | start, {k.replace("__", "."): v for k, v in changes.items()})


def run(measurements: list[Measurement], **changes: Any) -> list[Step]:
    return list(map(SlipEstimator(parameters(**changes)).advance, measurements))


def estimates(steps: list[Step]) -> list[Estimate]:
    return [estimate for _, estimate in steps if estimate is not None]


@pytest.mark.parametrize(
    ("segment", "motion"),
    [
        ((20.0, 2.0, 2.0, 0.10, 0.10, 0.0), Motion.STRAIGHT),
        ((20.0, 2.0, 2.0, 0.12, 0.07, 0.0), Motion.STRAIGHT),
        ((20.0, 1.2, 2.0, -0.05, 0.20, 0.0), Motion.TURNING),
        ((20.0, 2.0, 1.2, 0.20, -0.05, 0.0), Motion.TURNING),
        ((20.0, -2.0, -1.2, 0.15, 0.05, 0.0), Motion.TURNING),
    ],
)
def test_known_slips_are_found(drive: Callable[..., Any], segment: tuple[float, ...], motion: Motion) -> None:
    last = estimates(run(drive([segment]).measurements))[-1]
    np.testing.assert_allclose(last.outputs.slips[:2], segment[3:5], atol=0.03)
    assert (np.sqrt(np.diag(last.outputs.slip_covariance))[:2] < 0.035).all()
    assert last.motion is motion


def test_slip_angle_is_found_with_a_heading_source(drive: Callable[..., Any]) -> None:
    found = drive([(30.0, 1.0, 2.0, 0.0, 0.2, 0.15)]).measurements
    last = estimates(run(found, noise__initial_slip_angle=0.2, noise__slip_angle_turning=0.005))[-1]
    assert last.outputs.slips[2] == pytest.approx(0.15, abs=0.03)


def test_pose_and_twist_follow_the_truth(drive: Callable[..., Any]) -> None:
    driven = drive([(5.0, 2.0, 2.0, 0.1, 0.1, 0.0), (10.0, 1.0, 2.0, 0.0, 0.2, 0.0)])
    for e in estimates(run(driven.measurements))[250:]:
        truth = driven.truth[e.stamp_ns]
        assert np.hypot(*(e.pose - truth[:3])[:2]) < 0.08
        assert np.cos(e.pose[2] - truth[2]) > np.cos(0.06)
    assert e.outputs.twist[0] == pytest.approx(0.159 * (1.0 + 1.6) / 2.0, abs=0.01)
    assert e.outputs.twist[2] == pytest.approx(0.159 * (1.6 - 1.0) / 0.73, abs=0.01)


def test_the_claimed_pose_covariance_is_honest(drive: Callable[..., Any]) -> None:
    """Slips that walk as the filter supposes. 40 seeds at three times 5 s apart: 120 × χ²(3), nearly
    independent; the mean must lie within the 10⁻⁴ tails of 40 × χ²(3) on either side, 1.98 to 4.32.
    """
    walk = {"noise__slip_steady": 0.02, "noise__slip_moving": 0.02}
    values = []
    for seed in range(40):
        segments = [(5.0, 2.0, 2.0, 0.0, 0.0, 0.0), (10.0, 1.2, 2.0, 0.0, 0.0, 0.0)]
        driven = drive(
            segments,
            seed=seed,
            step_ms=50,
            gyro_every=2,
            fix_every=10,
            slip_walk=0.02,
            encoder=0.002,
            gyro_bias=0.002,
        )
        steps = run(driven.measurements, noise__initial_slip=0.02, **walk)
        by_stamp = {e.stamp_ns: e for e in estimates(steps)}
        for t in (5, 10, 15):
            e, truth = by_stamp[t * S], driven.truth[t * S]
            error = e.pose - truth[:3]
            error[2] = np.angle(np.exp(1j * error[2]))
            values.append(error @ np.linalg.solve(e.pose_covariance, error))
    low, high = chi2.ppf((1e-4, 1.0 - 1e-4), 3 * 40) / 40
    assert low < np.mean(values) < high
    assert np.mean(np.array(values) < chi2.ppf(0.95, 3)) > 0.85


def turning_slips(left: float, right: float, kappa: float, eta: float, common: float) -> tuple[float, float]:
    """(i_L, i_R) of sub-model 1b: v = (1 − i₀) V − η|D|/2, φ̇ = κ D/B."""
    V, D = (left + right) / 2.0, right - left  # over r
    v, turn = (1.0 - common) * V - eta * abs(D) / 2.0, kappa * D / 2.0
    return 1.0 - (v - turn) / left, 1.0 - (v + turn) / right


def turning_drive(drive: Callable[..., Any], **options: Any) -> Any:
    """Straight on and turns either way, on one soil: κ 0.45, η 0.4, i₀ 0.01."""
    legs = (
        (5.0, 2.0, 2.0),
        (6.0, 1.0, 2.0),
        (5.0, 2.0, 2.0),
        (6.0, 2.0, 0.8),
        (5.0, 2.2, 2.2),
        (6.0, 1.2, 2.2),
    )
    return drive([(t, a, b, *turning_slips(a, b, 0.45, 0.4, 0.01), 0.0) for t, a, b in legs], **options)


def test_what_turns_taught_holds_in_the_next_one(drive: Callable[..., Any]) -> None:
    """Sub-model 1b: fixes and gyro are lost before the last turn, and its slips are right all the same."""
    driven = turning_drive(drive)
    found = [m for m in driven.measurements if isinstance(m, Sprockets) or m.stamp_ns < 26 * S]
    by_stamp = {e.stamp_ns: e for e in estimates(run(found, model="turning"))}
    for t in (29 * S, 33 * S):
        np.testing.assert_allclose(by_stamp[t].outputs.slips[:2], driven.truth[t][3:5], atol=0.05)
    assert np.hypot(*(by_stamp[33 * S].pose - driven.truth[33 * S][:3])[:2]) < 0.15


def test_sub_model_1b_claims_no_more_than_it_knows(drive: Callable[..., Any]) -> None:
    """The truth has none of the misfit that the model allows for: NEES stays below its mean of 3, and a
    filter that is not absurdly humble stays above a sixth of it.
    """
    values = []
    for seed in range(10):
        driven = turning_drive(drive, seed=seed, step_ms=50, gyro_every=2, fix_every=10, encoder=0.001)
        by_stamp = {e.stamp_ns: e for e in estimates(run(driven.measurements, model="turning"))}
        for t in (8 * S, 14 * S, 20 * S, 26 * S, 32 * S):
            e, truth = by_stamp[t], driven.truth[t]
            error = e.pose - truth[:3]
            error[2] = np.angle(np.exp(1j * error[2]))
            values.append(error @ np.linalg.solve(e.pose_covariance, error))
    assert 0.5 < np.mean(values) < 4.5
    assert max(values) < chi2.ppf(1.0 - 1e-4, 3)


@pytest.mark.parametrize("model", ["turning", "free_slips"])
def test_covariances_stay_symmetric_and_positive(drive: Callable[..., Any], model: str) -> None:
    segments = [
        (3.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (5.0, 2.0, 2.0, 0.1, 0.1, 0.0),
        (5.0, -1.0, 1.0, 0.3, 0.3, 0.1),
    ]
    for e in estimates(run(drive(segments, seed=3).measurements, model=model)):
        for P in (e.pose_covariance, e.outputs.slip_covariance, e.outputs.twist_covariance):
            np.testing.assert_allclose(P, P.T, atol=1e-12)
            assert np.linalg.eigvalsh(P)[0] > -1e-12
        assert np.linalg.eigvalsh(e.pose_covariance)[0] > 0.0


def spiked(measurements: list[Measurement], which: range, jump: float = 5.0) -> list[Measurement]:
    """Fixes number ``which`` moved by ``jump`` m."""
    fixes = [m for m in measurements if isinstance(m, PoseFix)]
    moved = {id(fixes[k]) for k in which}
    return [
        replace(m, pose=m.pose + np.array((jump, 0.0, 0.0)))
        if isinstance(m, PoseFix) and id(m) in moved
        else m
        for m in measurements
    ]


def test_a_spike_is_gated_and_leaves_no_trace(drive: Callable[..., Any]) -> None:
    driven = drive([(8.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    steps = run(spiked(driven.measurements, range(20, 22)))
    gated = [r for r, _ in steps if r.outcome is Outcome.GATED]
    assert [r.source for r in gated] == ["box_pose", "box_pose"]
    assert all(r.nis > r.gate for r in gated)
    last = estimates(steps)[-1]
    assert abs(last.pose - driven.truth[last.stamp_ns][:3])[0] < 0.08


@pytest.mark.parametrize("model", ["turning", "free_slips"])
@pytest.mark.parametrize(("jump", "seconds"), [(1.0, 4.0), (-5.0, 5.5), (50.0, 7.5)])
def test_a_source_that_insists_is_believed(
    drive: Callable[..., Any], model: str, jump: float, seconds: float
) -> None:
    """A true jump: the gate widens tenfold a second after the first, and the filter goes there at once.

    What it learned of the slips stays, and its covariance is that of one that knows its place again.
    """
    driven = drive([(15.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    fixes = sum(isinstance(m, PoseFix) for m in driven.measurements)
    steps = run(spiked(driven.measurements, range(20, fixes), jump), model=model)
    outcomes = [r.outcome for r, _ in steps if r.source == "box_pose"]
    gated = [k for k, outcome in enumerate(outcomes) if outcome is Outcome.GATED]
    assert gated == list(range(20, 20 + len(gated)))  # in a row, and no more once it is believed
    assert 1.0 <= len(gated) / 5.0 <= seconds
    believed_ns = next(m.stamp_ns for m in driven.measurements if isinstance(m, PoseFix)) + int(
        (20 + len(gated)) * 0.2 * S
    )
    for e in estimates(steps):
        if e.stamp_ns > believed_ns + S:
            assert e.pose[0] - driven.truth[e.stamp_ns][0] == pytest.approx(jump, abs=0.1)
            assert np.sqrt(np.diag(e.pose_covariance)[:2]).max() < 0.05
            np.testing.assert_allclose(e.outputs.slips[:2], 0.1, atol=0.08)


def test_the_gate_widens_by_source_and_closes_again(drive: Callable[..., Any]) -> None:
    driven = drive([(12.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    outage = [m for m in driven.measurements if not isinstance(m, PoseFix) or not 4 * S < m.stamp_ns < 8 * S]
    reports = [r for r, _ in run(outage, gate_relaxation=7.0)]
    closed = chi2.ppf(0.9999, 3)
    after = [r.gate for r in reports if r.source == "box_pose" and r.stamp_ns >= 8 * S]
    assert after[0] == pytest.approx(closed * 7.0 ** (4.0 - 1.0))
    assert set(after[1:]) == {closed}
    assert {r.gate for r in reports if r.source == "imu/data_raw" and r.dof} == {chi2.ppf(0.9999, 1)}


def test_a_gyro_that_insists_has_another_bias(drive: Callable[..., Any]) -> None:
    """A step of 0.3 rad/s: refused for the timeout and a little more, then learned in one go."""
    driven = drive([(20.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    stepped = [
        replace(m, rate=m.rate + 0.3) if isinstance(m, YawRate) and m.stamp_ns > 10 * S else m
        for m in driven.measurements
    ]
    steps = run(stepped, yaw_rate_timeouts=[2.0])
    gated = [r.stamp_ns for r, _ in steps if r.source == "imu/data_raw" and r.outcome is Outcome.GATED]
    assert 10 * S < min(gated) < 10.2 * S
    assert 12 * S < max(gated) < 16 * S
    for e in estimates(steps):
        assert abs(e.pose[2] - driven.truth[e.stamp_ns][2]) < 0.06


def test_reports_state_the_gate(drive: Callable[..., Any]) -> None:
    found = drive([(2.0, 2.0, 2.0, 0.1, 0.1, 0.0)]).measurements
    for use_heading, dof in ((True, 3), (False, 2)):
        reports = [r for r, _ in run(found, gate_probability=0.99, use_heading=use_heading)]
        for source, expected in (("box_pose", dof), ("imu/data_raw", 1)):
            some = next(r for r in reports if r.source == source and np.isfinite(r.nis))
            assert (some.dof, some.gate) == (expected, pytest.approx(chi2.ppf(0.99, expected)))
            assert some.nis > 0.0


def test_nis_is_honest(drive: Callable[..., Any]) -> None:
    """300 fixes of three numbers, drawn with the noise they claim: the mean within 10⁻⁴ tails of χ²."""
    driven = drive([(60.0, 2.0, 2.0, 0.1, 0.1, 0.0)], seed=5)
    nis = np.array([r.nis for r, _ in run(driven.measurements) if r.source == "box_pose"])
    nis = nis[np.isfinite(nis)]
    low, high = chi2.ppf((1e-4, 1.0 - 1e-4), 3 * nis.size) / nis.size
    assert low < nis.mean() < high


def test_gyro_bias_is_learned_while_standing(drive: Callable[..., Any]) -> None:
    """Unlearned, 0.02 rad/s for 10 s of driving would turn the heading by 0.2 rad."""
    go = (10.0, 2.0, 2.0, 0.1, 0.1, 0.0)
    options: dict[str, Any] = {"gyro_bias": 0.02, "fix_every": 10**9}
    errors = {}
    for standing in (0.0, 20.0):
        segments = [(standing, 0.0, 0.0, 0.0, 0.0, 0.0), go] if standing else [go]
        driven = drive(segments, **options)
        found = [m for m in driven.measurements if not isinstance(m, PoseFix)]
        last = estimates(run(found, initial_yaw_stddev=0.001, noise__initial_gyro_bias=0.03))[-1]
        errors[standing] = abs(last.pose[2] - driven.truth[last.stamp_ns][2])
    assert errors[20.0] < 0.03
    assert errors[0.0] > 2.0 * errors[20.0]


def test_slips_are_frozen_while_standing(drive: Callable[..., Any]) -> None:
    segments = [(5.0, 2.0, 2.0, 0.1, 0.1, 0.0), (6.0, 0.0, 0.0, 0.0, 0.0, 0.0)]
    driven = drive(segments)
    found = [m for m in driven.measurements if not (isinstance(m, PoseFix) and m.stamp_ns > 5 * S)]
    standing = [e for e in estimates(run(found)) if e.motion is Motion.STANDING]
    assert len(standing) > 200
    first, last = standing[0], standing[-1]
    assert (np.diag(last.outputs.slip_covariance) <= np.diag(first.outputs.slip_covariance) + 1e-12).all()
    np.testing.assert_allclose(last.outputs.slips, first.outputs.slips, atol=3e-3)
    np.testing.assert_allclose(last.pose, first.pose, atol=5e-3)
    assert (np.diag(last.pose_covariance) <= np.diag(first.pose_covariance) + 1e-6).all()


def test_nothing_is_learned_of_slips_by_standing_from_the_start(drive: Callable[..., Any]) -> None:
    last = estimates(run(drive([(5.0, 0.0, 0.0, 0.0, 0.0, 0.0)]).measurements))[-1]
    np.testing.assert_allclose(last.outputs.slips, 0.0, atol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(last.outputs.slip_covariance)), (0.1, 0.1, 0.01), rtol=1e-6)


def test_standing_fixes_pin_the_pose(drive: Callable[..., Any]) -> None:
    found = drive([(10.0, 0.0, 0.0, 0.0, 0.0, 0.0)]).measurements
    last = estimates(run(found, initial_position_stddev=1.0))[-1]
    assert np.sqrt(last.pose_covariance[0, 0]) == pytest.approx(0.03 / np.sqrt(51), rel=0.05)
    assert np.hypot(*last.pose[:2]) < 0.03


def test_it_waits_for_the_first_fix_and_starts_there(drive: Callable[..., Any]) -> None:
    driven = drive([(4.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    late = [m for m in driven.measurements if not isinstance(m, PoseFix) or m.stamp_ns >= 2 * S]
    estimator = SlipEstimator(parameters(start="first_fix"))
    with pytest.raises(RuntimeError):
        estimator.estimate()
    steps = []
    for m in late:
        started = estimator.started
        steps.append(estimator.advance(m))
        assert started == (steps[-1][0].outcome is not Outcome.WAITING) or isinstance(m, PoseFix)
    waiting = [r for r, _ in steps if r.outcome is Outcome.WAITING]
    assert {r.source for r in waiting} == {"sprockets", "imu/data_raw"}
    assert max(r.stamp_ns for r in waiting) <= 2 * S
    assert estimates(steps)[0].stamp_ns > 2 * S
    start = next(m for m in late if isinstance(m, PoseFix))
    first = estimates(steps)[0]
    np.testing.assert_allclose(first.pose, start.pose, atol=0.02)


def test_a_given_start_is_the_first_estimate() -> None:
    estimator = SlipEstimator(
        parameters(initial_x=1.0, initial_y=-2.0, initial_yaw=0.5, initial_yaw_stddev=0.1)
    )
    assert estimator.take(YawRate("imu/data_raw", 5, 0.0, 1e-4)).outcome is Outcome.WAITING
    assert estimator.take(PoseFix("box_pose", 6, np.zeros(3), np.eye(3))).outcome is Outcome.WAITING
    report, estimate = estimator.advance(Sprockets("sprockets", 7, 0.0, 0.0, (0.0, 0.0)))
    assert report.outcome is Outcome.ACCEPTED
    assert estimate is not None
    np.testing.assert_array_equal(estimate.pose, (1.0, -2.0, 0.5))
    np.testing.assert_allclose(np.diag(estimate.pose_covariance), (0.0009, 0.0009, 0.01))


def test_positions_alone_drive_it_whatever_the_speeds_say(drive: Callable[..., Any]) -> None:
    found = drive([(3.0, 2.0, 2.0, 0.0, 0.0, 0.0)], fix_every=10**9).measurements
    lying = [replace(m, left_speed=7.0, right_speed=-3.0) if isinstance(m, Sprockets) else m for m in found]
    last = estimates(run([m for m in lying if not isinstance(m, PoseFix)]))[-1]
    np.testing.assert_allclose(last.pose, (0.159 * 2.0 * 3.0, 0.0, 0.0), atol=0.01)
    assert last.outputs.twist[0] == pytest.approx(0.318, abs=1e-3)


def test_an_outage_of_fixes_widens_the_covariance_and_a_fix_heals_it(drive: Callable[..., Any]) -> None:
    driven = drive([(30.0, 2.0, 1.8, 0.1, 0.1, 0.0)])
    kept = [m for m in driven.measurements if not (isinstance(m, PoseFix) and 10 * S < m.stamp_ns < 20 * S)]
    spread = {e.stamp_ns: float(np.sqrt(np.trace(e.pose_covariance[:2, :2]))) for e in estimates(run(kept))}
    assert spread[19 * S] > 3.0 * spread[10 * S]
    assert spread[30 * S] < 1.3 * spread[10 * S]


def test_rounding_to_counts_weakens_the_gyro_only_where_it_is_felt(drive: Callable[..., Any]) -> None:
    """A coarser encoder makes the predicted yaw rate less sure, so the same surprise weighs less."""
    found = drive([(1.0, 2.0, 2.0, 0.0, 0.0, 0.0)]).measurements
    fine, coarse = (
        [r.nis for r, _ in run(found, encoder_resolution=size) if r.source == "imu/data_raw"]
        for size in (0.0, 0.05)
    )
    assert (np.array(coarse[1:]) < 0.9 * np.array(fine[1:])).mean() > 0.8
    speeds = drive([(1.0, 2.0, 2.0, 0.0, 0.0, 0.0)], positions=False).measurements
    same = [
        [r.nis for r, _ in run(speeds, encoder_resolution=size) if r.source == "imu/data_raw"]
        for size in (0.0, 0.05)
    ]
    assert same[0] == same[1]
