# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Angles that restart after each turn are unwrapped; continuous ones stay unchanged."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.turns import TurnCounter, unwrap_angles

RATE = 50.0  # Hz
TIMES = np.arange(500) / RATE
STAMPS_NS = np.round(TIMES * 1e9).astype(np.int64)


def wrapped(angles: np.ndarray, first: float, turn: float = math.tau) -> np.ndarray:
    """Angles wrapped to the turn that begins with ``first``."""
    return (angles - first) % turn + first


@pytest.mark.parametrize("turn", [math.tau, 360.0])
@pytest.mark.parametrize("first", [-0.5, 0.0])
@pytest.mark.parametrize(("speed", "swing"), [(0.8, 0.08), (-11.0, 0.08), (0.0, 0.6)])
def test_angles_that_wrap_are_followed(turn: float, first: float, speed: float, swing: float) -> None:
    """At 11 turns a second an angle moves by a fifth of a turn between two samples."""
    angles = turn * (0.3 + speed * TIMES + swing * np.sin(3.0 * TIMES))
    unwrapped = unwrap_angles(STAMPS_NS, wrapped(angles, turn * first, turn), turn=turn)
    np.testing.assert_allclose(unwrapped - unwrapped[0], angles - angles[0], atol=1e-9 * turn)


@given(
    st.floats(-1e4, 1e4),
    st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=200),
    st.floats(0.01, 100.0),
)
def test_continuous_angles_are_unchanged_bit_for_bit(start, speeds, factor):
    """In the node, which receives angles one by one, and in the import, which has all of them."""
    angles = start + np.cumsum(speeds) * min(factor, 1.5 * math.pi / 3.0 - 1e-6)
    stamps_ns = np.arange(len(angles)) * 20_000_000
    assert unwrap_angles(stamps_ns, angles).tobytes() == angles.tobytes()
    counter = TurnCounter()
    one_by_one = [counter.unwrap(*row) for row in zip(stamps_ns.tolist(), angles.tolist(), strict=True)]
    assert np.array(one_by_one).tobytes() == angles.tobytes()


def test_angle_jump_that_the_speed_confirms_is_no_wrap() -> None:
    """Two samples of a fast joint at 1 Hz, both within one turn."""
    stamps_ns, angles = np.array((0, 10**9)), np.array((0.5, 6.0))
    assert unwrap_angles(stamps_ns, angles, np.array((5.4, 5.6))).tolist() == [0.5, 6.0]
    assert unwrap_angles(stamps_ns, angles, np.array((0.0, -0.8)))[1] == pytest.approx(6.0 - math.tau)
    assert unwrap_angles(stamps_ns, angles, np.zeros(2))[1] == pytest.approx(6.0 - math.tau)


def test_jump_after_a_gap_is_not_unwrapped() -> None:
    angles = np.array((0.5, 6.0))
    assert unwrap_angles(np.array((0, 3 * 10**9)), angles).tolist() == [0.5, 6.0]
    assert unwrap_angles(np.array((0, 10**8)), angles)[1] == pytest.approx(6.0 - math.tau)


def test_nan_angles_are_skipped() -> None:
    angles = wrapped(5.0 * TIMES, -math.pi)
    angles[::7] = math.nan
    unwrapped = unwrap_angles(STAMPS_NS, angles)
    assert np.isnan(unwrapped[::7]).all()
    finite = np.isfinite(unwrapped)
    np.testing.assert_allclose(unwrapped[finite], (5.0 * TIMES)[finite], atol=1e-9)


def test_angle_beyond_one_turn_is_continuous() -> None:
    """The first step may be unwrapped wrongly; no later one is."""
    counter = TurnCounter()
    unwrapped = [counter.unwrap(k * 100_000_000, angle) for k, angle in enumerate((0.2, 5.9, 11.6, 17.3))]
    assert np.diff(unwrapped[1:]) == pytest.approx([5.7, 5.7])
