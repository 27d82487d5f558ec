# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes that the gate refuses: none is believed alone, several are that agree over the way driven."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fixtures.drawn_machine import Machine, drive, parameters, turned

from trackslip_estimation.slip.alignment import rigid_motion
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import SET_POSE, Measurement, Outcome, PoseFix
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import REFUSED


def run(measurements: list[Measurement], **changed: object) -> tuple[np.ndarray, np.ndarray, list[Outcome]]:
    """Poses (k, 3) and covariances (k, 3, 3) that were published, and what became of each fix."""
    steps = SlipEstimator(parameters(**changed)).process_all(measurements)
    published = [estimate for _, estimate in steps if estimate is not None]
    poses = np.array([estimate.pose for estimate in published])
    covariances = np.array([estimate.pose_covariance for estimate in published])
    fixes = [r.outcome for m, (r, _) in zip(measurements, steps, strict=True) if isinstance(m, PoseFix)]
    return poses, covariances, fixes


def moved(fix: PoseFix, east: float, north: float) -> PoseFix:
    return PoseFix(fix.source, fix.stamp_ns, fix.pose + np.array((east, north, 0.0)), fix.covariance)


def test_a_rigid_motion_is_found_exactly() -> None:
    random = np.random.default_rng(1)
    places, angle = random.normal(0.0, 2.0, (6, 2)), 2.0
    turn = np.array(((math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))))
    refused = np.zeros(6, REFUSED)
    refused["predicted_x"], refused["predicted_y"] = places.T
    refused["x"], refused["y"] = (places @ turn.T + np.array((10.0, -3.0))).T
    refused["variance"] = 0.01
    found = rigid_motion(refused, 6, 0.0)
    assert found.rotation == pytest.approx(angle)
    assert found.chi2 == pytest.approx(0.0, abs=1e-12)
    at = np.subtract(found.target, turn @ np.array(found.origin))
    assert at == pytest.approx((10.0, -3.0))


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_a_way_that_fixes_hardly_show_was_taken_for_a_heading(share: float) -> None:
    """Found by random outages: a machine starts later than its tracks, and noise turned it."""
    random, angle = np.random.default_rng(2), 0.7
    turn = np.array(((math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))))
    driven = np.zeros((12, 2))
    driven[9:, 0] = 0.02, 0.04, 0.06
    shares = []
    for _ in range(400):
        fixes = share * driven @ turn.T + random.normal(0.0, 0.006, (12, 2))
        refused = np.zeros(12, REFUSED)
        refused["predicted_x"], refused["predicted_y"] = driven.T
        refused["x"], refused["y"] = fixes.T
        refused["variance"] = 0.006**2
        found = rigid_motion(refused, 12, 0.0)
        shares.append(np.angle(np.exp(1j * (found.rotation - angle))) / found.stddev)
    assert 0.4 < np.mean(np.square(shares)) < 1.3


@pytest.mark.parametrize("angle", [math.pi / 2.0, math.pi, -2.0])
def test_a_wrong_heading_is_found_within_ten_metres(angle: float) -> None:
    recorded = drive(Machine(duration=60.0))
    poses, covariances, _ = run(turned(recorded.measurements, angle))
    truth = recorded.poses[1:]  # the first sample comes before there is an estimate
    driven = np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))
    late = np.flatnonzero(driven > 10.0)[0] + 1
    errors = np.angle(np.exp(1j * (poses[late:, 2] - truth[late:, 2] - angle)))
    assert np.all(np.abs(errors) < 4.0 * np.sqrt(covariances[late:, 2, 2]))
    assert np.abs(errors[-1]) < 0.05


def test_an_unknown_heading_is_published_wide_and_then_found() -> None:
    recorded = drive(Machine(duration=60.0))
    poses, covariances, fixes = run(turned(recorded.measurements, 2.5), initial_yaw_stddev=math.pi)
    deviations = np.sqrt(covariances[:, 2, 2])
    assert np.all(deviations[:20] > 1.0)  # at rest nothing shows it
    found = np.flatnonzero(deviations < 0.3)[0]
    assert found / 20.0 < 20.0  # s
    errors = np.angle(np.exp(1j * (poses[found:, 2] - recorded.poses[1 + found :, 2] - 2.5)))
    assert np.all(np.abs(errors) < 4.0 * deviations[found:])
    assert Outcome.GATED not in fixes[-40:]


def test_a_heading_of_which_nobody_said_anything_was_believed() -> None:
    """To 0.02 rad, of what is 0 unless stated: positions alone were refused until it was found."""
    recorded = drive(Machine(duration=30.0))
    poses, covariances, _ = run(turned(recorded.measurements, math.pi / 2.0), initial_yaw_stddev=0.0)
    errors = np.angle(np.exp(1j * (poses[:, 2] - recorded.poses[1:, 2] - math.pi / 2.0)))
    assert np.all(np.abs(errors) < 3.0 * np.sqrt(covariances[:, 2, 2]))
    assert load_slip_parameters({"start": "initial_pose"}).initial_pose()[1][2, 2] == 0.02**2


def test_the_place_was_left_to_itself_until_the_heading_was_found() -> None:
    """It went away to any side for as long, claiming to know how far ahead it is."""
    recorded = drive(Machine(duration=20.0))
    poses, covariances, fixes = run(turned(recorded.measurements, math.pi), initial_yaw_stddev=0.0)
    until = np.flatnonzero(covariances[:, 2, 2] < 1.0)[0]
    errors = (poses + recorded.poses[1:])[:until, :2]  # half a turn
    nees = np.einsum("ki,kij,kj->k", errors, np.linalg.inv(covariances[:until, :2, :2]), errors)
    assert np.hypot(*errors.T).max() < 2.5  # twice what it drives in a second
    assert np.mean(nees) < 4.0
    assert np.max(nees) < 14.0
    assert Outcome.GATED not in fixes


def test_a_machine_that_slid_sideways_was_turned_to_its_course() -> None:
    """Its fixes showed where it looked: the heading was 1.4 rad off for as long as it slid."""
    recorded = drive(
        Machine(duration=40.0, sliding=(20.0, 30.0), roll=-0.26, heading_noise=0.02, fix_rate=10)
    )
    poses, _, fixes = run(recorded.measurements, **{"sources.box_pose.use_heading": True})
    errors = poses - recorded.poses[1:]  # the first sample comes before there is an estimate
    assert np.abs(errors[:, 2]).max() < 0.2
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.7  # 1.5 s of what no track shows
    assert gated_in_a_row(fixes) < 25  # 10 to 21 by seed: what no track shows


def test_no_single_fix_moves_the_pose_beyond_its_doubt() -> None:
    recorded = drive(Machine(duration=30.0)).measurements
    k = [k for k, m in enumerate(recorded) if isinstance(m, PoseFix)][40]
    spoilt = [*recorded]
    spoilt[k] = moved(recorded[k], 20.0, 0.0)
    clean, wrong = run(recorded), run(spoilt)
    assert wrong[2][40] is Outcome.GATED
    assert np.max(np.abs(wrong[0] - clean[0])) < 0.05


def test_silence_does_not_widen_the_gate() -> None:
    """Found in a random drive: after an outage one fix with a wrong heading was believed."""
    recorded = drive(Machine(duration=60.0)).measurements
    silent = [m for m in recorded if not isinstance(m, PoseFix) or m.stamp_ns < 21e9 or m.stamp_ns > 55e9]
    back = next(k for k, m in enumerate(silent) if isinstance(m, PoseFix) and m.stamp_ns > 55e9)
    spoilt = [*silent[:back], moved(silent[back], 30.0, 30.0), *silent[back + 1 :]]
    clean, wrong = run(silent), run(spoilt)
    fixes = [m for m in spoilt if isinstance(m, PoseFix)]
    index = next(k for k, m in enumerate(fixes) if m.stamp_ns > 55e9)
    assert wrong[2][index] is Outcome.GATED
    assert np.max(np.abs(wrong[0][-1] - clean[0][-1])) < 0.1


def test_refused_fixes_that_contradict_each_other_are_never_believed() -> None:
    random = np.random.default_rng(3)
    recorded = drive(Machine(duration=60.0))
    scattered = [
        moved(m, *random.uniform(10.0, 40.0, 2)) if isinstance(m, PoseFix) and m.stamp_ns > 30e9 else m
        for m in recorded.measurements
    ]
    poses, covariances, fixes = run(scattered)
    assert all(outcome is Outcome.GATED for outcome in fixes[60:])
    errors = poses[-1, :2] - recorded.poses[-1, :2]
    assert errors @ np.linalg.solve(covariances[-1, :2, :2], errors) < 13.8  # χ², 0.999


def test_fixes_that_agree_elsewhere_are_believed() -> None:
    recorded = drive(Machine(duration=60.0))
    elsewhere = [
        moved(m, 8.0, -5.0) if isinstance(m, PoseFix) and m.stamp_ns > 30e9 else m
        for m in recorded.measurements
    ]
    poses, _, fixes = run(elsewhere)
    assert fixes[60] is Outcome.GATED
    assert poses[-1, :2] - recorded.poses[-1, :2] == pytest.approx((8.0, -5.0), abs=0.1)


def at_rest(rate: float, offset: float, heading: float | None = None) -> list[Measurement]:
    """40 s at rest; from 20 s on fixes of ``rate`` Hz say ``offset`` m to the east (and ``heading``, rad)."""
    recorded = [m for m in drive(Machine(duration=1.0)).measurements if not isinstance(m, PoseFix)]
    one = {m.source: m for m in reversed(recorded)}
    random, still = np.random.default_rng(2), []
    for k in range(800):
        still += [replace(m, stamp_ns=10**9 + k * 5 * 10**7) for m in one.values()]
    variance, yaw = (100.0, 0.0) if heading is None else (1e-4, heading)
    for k in range(round(40.0 * rate)):
        t = k / rate
        east, north = random.normal(0.0, 0.02, 2)
        pose = np.array((east + offset * (t >= 20.0), north, yaw * (t >= 20.0)))
        covariance = np.diag((0.02**2, 0.02**2, variance))
        still.append(PoseFix("box_pose", 10**9 + round(t * 1e9), pose, covariance))
    return sorted(still, key=lambda m: m.stamp_ns)


def gated_in_a_row(outcomes: list[Outcome]) -> int:
    """The longest run of fixes that the gate refused."""
    runs = "".join("x" if outcome is Outcome.GATED else " " for outcome in outcomes).split()
    return max(map(len, runs), default=0)


@pytest.mark.parametrize("rate", [1.0, 0.2])
def test_at_rest_consistent_fixes_are_refused_three_times_at_the_most(rate: float) -> None:
    """Found on a real log: a machine stood for 160 s, 1 m off, and all of its fixes were refused."""
    poses, covariances, fixes = run(at_rest(rate, 1.0))
    assert 1 <= gated_in_a_row(fixes) <= 3
    assert poses[-1, :2] == pytest.approx((1.0, 0.0), abs=0.05)
    assert poses[-1, 2] == pytest.approx(0.0, abs=0.02)
    assert math.sqrt(covariances[-1, 0, 0]) < 0.02


def test_at_rest_a_jump_of_two_seconds_is_not_believed() -> None:
    """They agree with each other, but over no way driven, and do not insist."""
    poses, _, _ = run([m for m in at_rest(10.0, 5.0) if m.stamp_ns < 23e9])
    assert np.max(np.abs(poses[:, :2])) < 0.1


def test_at_rest_fixes_that_turn_the_machine_are_never_believed() -> None:
    """A box seen from a corner may be a quarter turn off; a machine that stands does not turn."""
    poses, _, fixes = run(at_rest(5.0, 1.0, heading=math.pi / 2.0), **{"sources.box_pose.use_heading": True})
    assert all(outcome is Outcome.GATED for outcome in fixes[101:])
    assert np.max(np.abs(poses)) < 0.1


def placed(measurements: list[Measurement], at: float, pose: tuple[float, float, float]) -> list[Measurement]:
    """With a manual pose, half a metre and 0.1 rad uncertain, ``at`` s of the drive."""
    manual = PoseFix(SET_POSE, 10**9 + round(at * 1e9) + 1, np.array(pose), np.diag((0.25, 0.25, 0.01)))
    return sorted([*measurements, manual], key=lambda m: m.stamp_ns)


def test_at_rest_fixes_correct_a_manual_pose_however_many_came_before() -> None:
    """As more of one stand they counted for next to nothing: after an hour it stayed where it was placed."""
    poses, covariances, _ = run(placed(at_rest(10.0, 0.0, heading=0.0), 20.0, (0.5, 0.0, 0.0)))
    index = round(20.5 * 20.0)  # five fixes later
    assert poses[index - 10, 0] == pytest.approx(0.5, abs=0.01)
    assert poses[index, :2] == pytest.approx((0.0, 0.0), abs=0.05)
    assert math.sqrt(covariances[index, 0, 0]) < 0.05


def runs_around(measurements: list[Measurement], at_ns: int) -> tuple[int, int]:
    """The longest run of fixes that err to one side, just before and just after a stamp."""
    estimator, counts = SlipEstimator(parameters()), [0, 0]
    for m in measurements:
        estimator.process(m)
        newest = estimator.window.states[estimator.window.count - 1]["runs"]["count"].max()
        if m.stamp_ns < at_ns:
            counts[0] = int(newest)
        elif m.stamp_ns == at_ns:
            counts[1] = int(newest)
    return counts[0], counts[1]


def test_a_run_of_fixes_to_one_side_ends_where_the_pose_is_placed() -> None:
    """Three before and one after would have widened slip and place together, for nothing."""
    ahead = [
        moved(m, 0.05, 0.0) if isinstance(m, PoseFix) and m.stamp_ns > 4e9 else m
        for m in drive(Machine(duration=8.0)).measurements
    ]
    manual = placed(ahead, 6.0, (1.0, 0.0, 0.0))
    before, after = runs_around(manual, 7 * 10**9 + 1)
    assert before >= 2
    assert after == 0


def test_a_run_of_fixes_to_one_side_ends_where_fixes_that_agree_move_the_pose() -> None:
    elsewhere = [
        moved(m, 8.0, -5.0) if isinstance(m, PoseFix) and m.stamp_ns > 30e9 else m
        for m in drive(Machine(duration=40.0)).measurements
    ]
    outcomes = iter(run(elsewhere)[2])
    ends = [m.stamp_ns for m in elsewhere if isinstance(m, PoseFix) and next(outcomes) is not Outcome.GATED]
    assert runs_around(elsewhere, next(ns for ns in ends if ns > 30e9))[1] == 0
