# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of a report that need no bag: thinning of curves, rates and gaps of topics."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_tools.report.plots import extreme_indices
from trackslip_tools.report.recording import Timing


def test_gap_in_a_curve_is_kept() -> None:
    values = np.sin(np.arange(5000.0))
    values[2000:2300] = np.nan
    indices = extreme_indices([values], 200)
    is_missing = np.isnan(values[indices])
    assert is_missing.any()
    assert (np.diff(np.flatnonzero(is_missing)) == 1).all()  # one gap between two sections
    assert not is_missing[0]
    assert not is_missing[-1]


@given(
    size=st.integers(1, 3000),
    columns=st.integers(1, 3),
    limit=st.integers(10, 500),
    seed=st.integers(0, 1000),
    holes=st.floats(0.0, 1.0),
)
def test_thinning_keeps_both_ends_and_the_extremes_of_each_curve_within_the_limit(
    size: int, columns: int, limit: int, seed: int, holes: float
) -> None:
    rng = np.random.default_rng(seed)
    curves = [np.where(rng.random(size) < holes, np.nan, rng.normal(size=size)) for _ in range(columns)]
    indices = extreme_indices(curves, limit)
    assert len(indices) <= limit
    assert (np.diff(indices) > 0).all()
    assert (indices[0], indices[-1]) == (0, size - 1)
    assert size > limit or len(indices) == size
    for curve in curves:
        if np.isfinite(curve).any():
            assert np.nanmax(curve[indices]) == np.nanmax(curve)
            assert np.nanmin(curve[indices]) == np.nanmin(curve)


def test_rate_and_loss_of_a_steady_topic() -> None:
    times = np.arange(1000) * 0.01
    lossy = Timing(np.delete(times, np.arange(50, 950, 20)))
    assert lossy.is_regular
    assert lossy.period == pytest.approx(0.01)
    assert lossy.lost_share == pytest.approx(45 / 999, rel=1e-6)
    assert Timing(times).lost_share == pytest.approx(0.0, abs=1e-9)
    assert Timing(times).gaps == []


def test_a_silence_is_a_gap_with_its_times() -> None:
    times = np.concatenate((np.arange(0.0, 5.0, 0.1), np.arange(7.0, 12.0, 0.1)))
    timing = Timing(times)
    (gap,) = timing.gaps
    assert gap == pytest.approx((4.9, 7.0))
    assert timing.longest_interval == pytest.approx(2.1)


@pytest.mark.parametrize(
    "times", [np.empty(0), np.array((3.0,)), np.full(20, 3.0), np.cumsum(np.tile((0.001, 0.9), 30))]
)
def test_topic_without_a_steady_rate_has_no_missing_messages(times: np.ndarray) -> None:
    timing = Timing(times)
    assert not timing.is_regular
    assert np.isnan(timing.lost_share)
    assert timing.gaps == []
