# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sprocket speeds from whole counts: no count is lost, and rounding is reduced."""

import math

import numpy as np
import pytest
from fixtures.filter_steps import config_of
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.counts import COUNTS, begin_counts, filter_counts, store_counts


def speeds_of(positions: FloatArray, periods: FloatArray, resolution: float) -> tuple[FloatArray, FloatArray]:
    """(n, 2) speeds of both sprockets and (n,) variances of their mean, from (n + 1, 2) positions."""
    c, counts = config_of(encoder_resolution=resolution)[0], np.zeros(1, COUNTS)[0]
    found, variances = np.zeros((len(periods), 2)), np.zeros(len(periods))
    begin_counts(counts, c)
    for k, (shown, dt) in enumerate(zip(np.diff(positions, axis=0), periods, strict=True)):
        followed = filter_counts(counts, shown[0] / dt, shown[1] / dt, dt, c)
        store_counts(followed, counts)
        found[k], variances[k] = (followed.left.mean, followed.right.mean), followed.mean_variance
    return found, variances


def turned(speeds: FloatArray, dt: float, resolution: float) -> FloatArray:
    """(n + 1, 2) positions in whole counts at the ends of intervals with (n, 2) speeds."""
    angles = np.array((0.2, 0.7)) + np.vstack((np.zeros(2), np.cumsum(speeds, axis=0) * dt))
    counts: FloatArray = np.floor(angles / resolution) * resolution
    return counts


@given(
    st.lists(
        st.tuples(st.integers(-3, 3), st.integers(-3, 3), st.floats(1e-3, 0.3)), min_size=1, max_size=60
    ),
    st.floats(1e-4, 0.5),
)
def test_distance_error_is_at_most_half_a_count(
    steps: list[tuple[int, int, float]], resolution: float
) -> None:
    moved, periods = np.array([step[:2] for step in steps]), np.array([step[2] for step in steps])
    positions = np.vstack((np.zeros(2), np.cumsum(moved, axis=0))) * resolution
    speeds, variances = speeds_of(positions, periods, resolution)
    off = np.cumsum(speeds * periods[:, None], axis=0) - positions[1:]
    assert np.abs(off).max() <= resolution * (0.5 + 1e-6)
    assert (variances >= 0.0).all()


@given(st.lists(st.tuples(st.floats(-3.0, 3.0), st.floats(1e-3, 0.3)), min_size=1, max_size=30))
def test_positions_without_counts_are_unchanged(steps: list[tuple[float, float]]) -> None:
    positions = np.repeat(np.cumsum([0.0] + [step[0] for step in steps])[:, None], 2, axis=1)
    periods = np.array([step[1] for step in steps])
    speeds, variances = speeds_of(positions, periods, 0.0)
    np.testing.assert_allclose(speeds, np.diff(positions, axis=0) / periods[:, None], rtol=1e-9, atol=1e-6)
    assert variances.max() < 1e-12


@pytest.mark.parametrize("rate", [20, 100])
@pytest.mark.parametrize("counts", [16, 100, 1000])
def test_rounding_error_in_turns_is_reduced(counts: int, rate: int) -> None:
    """2.5 rad/s, in curves to both sides."""
    t, resolution = np.arange(60 * rate) / rate, math.tau / counts
    turn = 0.25 * np.sin(math.tau * t / 20.0)
    true = 2.5 * np.column_stack((1.0 - turn, 1.0 + turn))
    positions = turned(true, 1.0 / rate, resolution)
    off = speeds_of(positions, np.full(len(t), 1.0 / rate), resolution)[0] - true
    rounded = np.diff(positions, axis=0) * rate - true
    share = {16: 0.2, 100: 0.4, 1000: 0.8}[counts]
    assert np.std(off[3 * rate :]) < share * np.std(rounded[3 * rate :])


@pytest.mark.parametrize("rate", [20, 100])
def test_variance_is_that_of_the_remaining_rounding(rate: int) -> None:
    resolution, dt = math.tau / 4096, 1.0 / rate
    walk = np.random.default_rng(3).normal(0.0, 0.2 * math.sqrt(dt), (120 * rate, 2))
    true = np.array((20.0, -20.0)) + np.cumsum(walk, axis=0)
    speeds, variances = speeds_of(turned(true, dt, resolution), np.full(len(true), dt), resolution)
    squares = (speeds - true)[rate:] ** 2
    assert np.mean(squares) == pytest.approx(np.mean(variances[rate:]), rel=0.4)


@pytest.mark.parametrize("counts", [16, 1000])
def test_speed_of_a_stopped_sprocket_is_zero(counts: int) -> None:
    true = np.vstack((np.full((100, 2), 2.5), np.zeros((200, 2))))
    resolution = math.tau / counts
    speeds, _ = speeds_of(turned(true, 0.05, resolution), np.full(300, 0.05), resolution)
    assert np.abs(speeds[101:].sum(axis=0) * 0.05).max() <= resolution
    assert np.abs(speeds[-40:]).max() < 0.01
