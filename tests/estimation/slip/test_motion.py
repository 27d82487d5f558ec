# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Standstill, straight, turning: classified from the sprockets, symmetric, without flicker."""

import math
from collections.abc import Iterable

import numpy as np
import pytest

from trackslip_estimation.slip.motion import (
    Motion,
    MotionParameters,
    MotionState,
    Speeds,
    classify,
    smoothed_speeds,
)

LIMITS = MotionParameters(
    standing_speed=0.05,
    turning_ratio=0.10,
    change_ratio=0.08,
    hysteresis=0.6,
    smoothing_time=0.15,
    memory_time=0.5,
)
DT = 0.01
COUNT = 2.0 * math.pi / (3 * 4096)  # rad
COUNTED = (COUNT / DT) ** 2 / 6.0  # (rad/s)², variance of a speed from two rounded counts


def drive(speeds: Iterable[tuple[float, float]], state: MotionState | None = None) -> list[MotionState]:
    """Motion states after each of the speeds, one per sample."""
    state = state or MotionState()
    seen = []
    for left, right in speeds:
        state = classify(state, Speeds(left, right), DT, LIMITS)
        seen.append(state)
    return seen


def constant(left: float, right: float, seconds: float = 3.0) -> list[tuple[float, float]]:
    return [(left, right)] * round(seconds / DT)


def motions(states: list[MotionState]) -> list[Motion]:
    """Motion states in the order of their start."""
    row = [s.motion for s in states]
    return [m for k, m in enumerate(row) if k == 0 or row[k - 1] != m]


@pytest.mark.parametrize(
    ("left", "right", "expected"),
    [
        (0.0, 0.0, Motion.STANDING),
        (0.04, -0.04, Motion.STANDING),
        (2.0, 2.0, Motion.STRAIGHT),
        (-2.0, -2.0, Motion.STRAIGHT),
        (2.0, 2.1, Motion.STRAIGHT),
        (1.0, 2.0, Motion.TURNING),
        (2.0, 1.0, Motion.TURNING),
        (-1.0, -2.0, Motion.TURNING),
        (1.0, -1.0, Motion.TURNING),
        (-1.0, 1.0, Motion.TURNING),
        (0.0, 0.5, Motion.TURNING),
        (0.5, 0.0, Motion.TURNING),
    ],
)
def test_steady_speeds(left: float, right: float, expected: Motion) -> None:
    for state in (
        drive(constant(left, right))[-1],
        drive(constant(0.0, 0.0) + constant(left, right, 5.0))[-1],
    ):
        assert state.motion is expected
        assert not state.changing
        assert state.are_slips_changing == (expected is not Motion.STRAIGHT)


def test_the_first_sample_counts_whole() -> None:
    assert MotionState().are_slips_changing
    state = classify(MotionState(), Speeds(2.0, 2.0), DT, LIMITS)
    assert (state.motion, state.left, state.right_mean) == (Motion.STRAIGHT, 2.0, 2.0)


@pytest.mark.parametrize(("inner", "outer"), [(1.0, 2.0), (-0.5, 2.0)])
@pytest.mark.parametrize("left_turn", [True, False])
def test_a_drive_with_one_turn(inner: float, outer: float, left_turn: bool) -> None:
    turn = constant(inner, outer) if left_turn else constant(outer, inner)
    states = drive(constant(0.0, 0.0) + constant(2.0, 2.0) + turn + constant(2.0, 2.0) + constant(0.0, 0.0))
    expected = [Motion.STANDING, Motion.STRAIGHT, Motion.TURNING, Motion.STRAIGHT, Motion.STANDING]
    assert motions(states) == expected


def test_change_is_detected_at_once_and_expires() -> None:
    states = drive(constant(1.0, 1.0) + constant(2.0, 2.0))
    changing = [s.changing for s in states]
    assert not any(changing[10:300])
    assert any(changing[300:310])
    assert not any(changing[-50:])
    assert set(motions(states)) == {Motion.STRAIGHT}
    assert states[310].are_slips_changing
    assert not states[-1].are_slips_changing


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_change_is_measured_against_the_speed_on_the_spot_too(sign: float) -> None:
    states = drive(constant(2.0, sign * 2.0) + constant(2.1, sign * 2.1))
    assert not any(s.changing for s in states[1:])
    assert any(s.changing for s in drive(constant(3.0, sign * 3.0), states[-1]))


@pytest.mark.parametrize("before", [constant(2.0, 2.0), constant(1.0, 2.0)])
def test_motion_state_is_kept_between_the_limits(before: list[tuple[float, float]]) -> None:
    """|ω_R − ω_L| is 0.08 of the mean: less than 0.10, more than 0.06."""
    states = drive(before)
    assert drive(constant(2.0, 2.167), states[-1])[-1].motion is states[-1].motion


@pytest.mark.parametrize("before", [constant(0.0, 0.0), constant(0.2, 0.2)])
def test_motion_state_is_kept_at_slow_creep_between_the_limits(before: list[tuple[float, float]]) -> None:
    states = drive(before)
    assert drive(constant(0.04, 0.04, 6.0), states[-1])[-1].motion is states[-1].motion


def counted(left: float, right: float, seconds: float) -> list[tuple[float, float]]:
    """Speeds from differences of positions rounded to counts."""
    t = np.arange(round(seconds / DT) + 1) * DT
    angles = np.round(np.outer(t, (left, right)) / COUNT + (0.2, 0.7)) * COUNT
    return [(float(a), float(b)) for a, b in np.diff(angles, axis=0) / DT]


@pytest.mark.parametrize(
    ("left", "right", "expected"),
    [
        (0.5, 0.5, Motion.STRAIGHT),
        (1.37, 1.371, Motion.STRAIGHT),
        (0.9, 0.95, Motion.STRAIGHT),
        (0.5, 0.6, Motion.TURNING),
        (1.0, 0.7, Motion.TURNING),
    ],
)
def test_counts_do_not_toggle_the_motion_state(left: float, right: float, expected: Motion) -> None:
    states = drive(counted(left, right, 20.0))[100:]
    assert {s.motion for s in states} == {expected}
    assert not any(s.changing for s in states)


def test_speeds_are_low_passed_where_rounding_explains_their_changes() -> None:
    state, found = MotionState(), []
    for left, right in counted(1.37, 1.371, 5.0) + counted(1.6, 1.2, 5.0):
        speeds = Speeds(left, right, COUNTED, COUNT**2 / 12.0)
        state = classify(state, speeds, DT, LIMITS)
        found.append(smoothed_speeds(speeds, state, LIMITS))
    variances = np.array([one.variance for one in found])
    assert variances[100:500].max() < COUNTED / 100.0
    assert found[500] == (*counted(1.6, 1.2, DT)[0], COUNTED, COUNT**2 / 12.0)
    assert variances[-100:].max() < COUNTED / 100.0


@pytest.mark.parametrize("difference", [0.0, 0.03, -0.03, 0.3])
def test_speed_difference_within_rounding_is_not_published(difference: float) -> None:
    """Speeds are not low-passed while they change; one count in 10 ms is 0.05 rad/s."""
    now = Speeds(1.5, 1.5 + difference, COUNTED, COUNT**2 / 12.0)
    changing = MotionState(Motion.STRAIGHT, left=1.0, right=1.0, departure=0.5)
    left, right, variance, _ = smoothed_speeds(now, changing, LIMITS)
    assert (left + right) / 2.0 == pytest.approx(1.5 + difference / 2.0)
    assert right - left == pytest.approx(difference if difference == 0.3 else 0.0)
    assert variance == COUNTED
    exact = now._replace(variance=0.0)
    assert smoothed_speeds(exact, changing, LIMITS) == exact


def test_shaking_on_the_spot_is_standstill() -> None:
    rng = np.random.default_rng(1)
    jitter = [(float(a), float(b)) for a, b in rng.integers(-1, 2, (2000, 2)) * COUNT / DT / 2.0]
    assert {s.motion for s in drive(jitter)[100:]} == {Motion.STANDING}


def test_splitting_time_changes_nothing_while_speeds_are_steady() -> None:
    start = drive(constant(0.0, 0.0))[-1]
    once = classify(start, Speeds(1.0, 2.0), 0.2, LIMITS)
    often = start
    for _ in range(20):
        often = classify(often, Speeds(1.0, 2.0), 0.01, LIMITS)
    assert (once.left, once.right_mean) == pytest.approx((often.left, often.right_mean))
    assert once.motion is often.motion
