# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Encoder resolution estimated from the positions of a log, or from its speeds."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_bags.importing.importer import encoder_resolution
from trackslip_bags.importing.samples import Samples

T = np.arange(0.0, 60.0, 0.02)  # s
ANGLES = 20.0 * np.column_stack((np.sin(T / 7.0), np.sin(T / 9.0)))  # rad, back and forth


def sprockets(positions: np.ndarray, speeds: np.ndarray | None = None, t: np.ndarray = T) -> list[Samples]:
    """Samples of sprockets with positions, rad, and speeds, rad/s, both (n, 2), at times (n,), s."""
    stamps = np.round(t * 1e9).astype(np.int64)
    values = {"position": positions, "velocity": np.zeros_like(positions) if speeds is None else speeds}
    return [Samples("sprockets", "sprockets", [""], stamps, stamps, values)]


def of_speeds(speeds: np.ndarray, t: np.ndarray = T) -> float:
    """Resolution from a log without positions."""
    return encoder_resolution(sprockets(np.full_like(speeds, np.nan), speeds, t))


@given(st.one_of(st.tuples(st.integers(8, 40_000), st.just(16)), st.tuples(st.integers(8, 1000), st.just(4))))
def test_counts_of_any_size_are_found_in_logs_of_some_digits(case: tuple[int, int]) -> None:
    counts, digits = case
    resolution = math.tau / counts
    estimate = encoder_resolution(sprockets(np.round(np.floor(ANGLES / resolution) * resolution, digits)))
    assert estimate == pytest.approx(resolution, rel=1e-6 if digits > 4 else 0.01)


@pytest.mark.parametrize("jitter", [0.0, 0.003])
@pytest.mark.parametrize("counts", [16, 100, 1000])
def test_speeds_that_are_differences_of_counts_show_them(counts: int, jitter: float) -> None:
    """A driver divides by the period of its timer, or by the time between its stamps."""
    t = T + np.random.default_rng(1).uniform(-jitter, jitter, len(T))
    resolution = math.tau / counts
    angles = 10.0 * np.column_stack((np.sin(t / 7.0), np.sin(t / 9.0)))
    moved = np.diff(np.floor(angles / resolution) * resolution, axis=0, prepend=0.0)
    for periods in (np.full(len(t), 0.02), np.diff(t, prepend=-0.02)):
        assert of_speeds(moved / periods[:, None], t) == pytest.approx(resolution, rel=0.05)


@pytest.mark.parametrize("digits", [2, 3, 5])
def test_speeds_of_few_digits_are_no_coarse_counts(digits: int) -> None:
    speeds = np.round(np.gradient(ANGLES, T, axis=0), digits)
    assert of_speeds(speeds) <= 0.02 * 10.0**-digits * 1.001


@pytest.mark.parametrize(
    "change",
    [lambda a: a, lambda a: a * np.nan, np.zeros_like, lambda a: np.cumsum(np.sign(a), axis=0) * 0.04],
)
def test_positions_without_counts_have_none(change: Callable[[np.ndarray], np.ndarray]) -> None:
    assert encoder_resolution(sprockets(change(ANGLES))) == pytest.approx(0.0, abs=1e-4)


def test_the_coarser_side_counts() -> None:
    coarse, fine = math.tau / 100, math.tau / 1000
    angles = np.floor(ANGLES / (coarse, fine)) * (coarse, fine)
    assert encoder_resolution(sprockets(angles)) == pytest.approx(coarse)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("length", [0, 1, 2, 5, 40])
def test_few_positions_have_no_counts(length: int) -> None:
    positions = np.cumsum(np.tile((7.0, 1.0), (2, length)).T, axis=0)[:length]  # no two small ones in a row
    assert encoder_resolution(sprockets(positions, positions, np.arange(length))) == 0.0


def test_a_log_without_sprockets_has_no_counts() -> None:
    assert encoder_resolution([]) == 0.0
