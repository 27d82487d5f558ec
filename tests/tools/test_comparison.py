# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Live estimates against replayed ones, as a whole and in batches."""

import math
from typing import Any

import numpy as np
import pytest

from trackslip_common.arrays import Rows
from trackslip_common.topics import ODOMETRY
from trackslip_estimation.slip.records import ESTIMATE
from trackslip_tools.replay.comparison import WAITING_NS, LiveComparer, LiveComparison, odometry_rows
from trackslip_tools.replay.live_order import HORIZON_NS, JournalCounts

STEP_NS = 10_000_000
FIELDS = ("x", "y", "z", "roll", "pitch", "heading", "v_x", "v_y", "yaw_rate")


def odometry(stamps: Any, **changes: Any) -> Rows:
    """Rows with numbers that follow from the stamp; ``changes`` are added to columns."""
    stamps_ns = np.asarray(stamps, dtype=np.int64) * STEP_NS
    fields = [("stamp_ns", np.int64, ()), *((name, np.float64, ()) for name in FIELDS)]
    covariances = [(name, np.float64, (3, 3)) for name in ("covariance", "twist_covariance")]
    rows = np.zeros(len(stamps_ns), fields + covariances)
    rows["stamp_ns"] = stamps_ns
    for k, name in enumerate(FIELDS):
        rows[name] = np.sin(stamps_ns * 1e-9 + k)
    rows["covariance"] = np.cos(stamps_ns * 1e-9)[:, np.newaxis, np.newaxis]
    for name, change in changes.items():
        rows[name] += change
    return rows


def compared(live: Rows, replayed: Rows, pieces: int = 1, **counts: Any) -> LiveComparison:
    comparer = LiveComparer()
    for live_part, replayed_part in zip(
        np.array_split(live, pieces), np.array_split(replayed, pieces), strict=True
    ):
        comparer.add(ODOMETRY, live_part, replayed_part)
    return comparer.result(JournalCounts(**counts))


def test_the_same_matches() -> None:
    comparison = compared(odometry(range(100)), odometry(range(100)))
    assert comparison == LiveComparison(100, 0, 0.0, 0, 0)
    assert comparison.matches


def test_empty_runs_do_not_match() -> None:
    assert not compared(odometry([]), odometry([])).matches


@pytest.mark.parametrize("name", [*FIELDS, "covariance", "twist_covariance"])
def test_difference_in_any_number_is_found(name: str) -> None:
    comparison = compared(odometry(range(100)), odometry(range(100), **{name: 1e-3}))
    assert comparison.largest_difference == pytest.approx(1e-3)
    assert not comparison.matches
    assert f"1.0e-03 in {name} of odometry" in str(comparison)


@pytest.mark.parametrize(("column", "name"), [(0, "roll"), (1, "pitch"), (2, "z")])
def test_difference_in_the_tilt_of_estimates_is_found(column: int, name: str) -> None:
    live = np.zeros(9, ESTIMATE)
    live["stamp_ns"] = np.arange(9) * STEP_NS
    tilted = live.copy()
    tilted["tilt"]["tilt"][:, column] = 1e-3
    comparison = compared(odometry_rows(live, live), odometry_rows(tilted, tilted))
    assert f"1.0e-03 in {name} of odometry" in str(comparison)


def test_heading_difference_is_the_shorter_angle() -> None:
    comparison = compared(odometry(range(9)), odometry(range(9), heading=2.0 * math.pi - 1e-4))
    assert comparison.largest_difference == pytest.approx(1e-4)


def test_nan_on_one_side_is_an_infinite_difference() -> None:
    assert compared(odometry(range(9)), odometry(range(9), v_y=math.nan)).largest_difference == math.inf
    both = odometry(range(9), v_y=math.nan)
    assert compared(both, both).matches


def test_last_estimate_of_a_stamp_is_compared() -> None:
    twice = np.concatenate((odometry([4], x=9.0), odometry(range(9))))
    assert compared(odometry(range(9)), twice).matches


def test_unmatched_estimates_are_counted_within_the_live_run() -> None:
    """Replayed estimates before the first live one and after the last are not counted."""
    live, replayed = odometry([k for k in range(10, 50) if k != 20]), odometry([*range(30), *range(33, 60)])
    assert compared(live, replayed).unmatched == 1 + 3


def test_estimates_after_the_last_journal_line_are_not_compared() -> None:
    live, replayed = odometry(range(100)), odometry(range(90))
    assert compared(live, replayed).unmatched == 10
    comparison = compared(live, replayed, last_sprockets_ns=89 * STEP_NS)
    assert (comparison.compared, comparison.unmatched) == (90, 0)


@pytest.mark.parametrize("pieces", [2, 7, 50])
def test_pieces_are_compared_as_the_whole_is(pieces: int) -> None:
    """One side is some seconds ahead of the other."""
    rng = np.random.default_rng(pieces)
    live = odometry(np.flatnonzero(rng.random(3000) < 0.99))
    replayed = odometry(np.flatnonzero(rng.random(3300) < 0.99), x=1e-12)
    assert compared(live, replayed, pieces) == compared(live, replayed)


def test_memory_is_bounded_where_one_side_is_missing() -> None:
    comparer = LiveComparer()
    for k in range(0, 100_000, 1000):
        comparer.add(ODOMETRY, odometry(range(k, k + 1000)), odometry([]))
    assert comparer._compared[ODOMETRY]._live is not None
    assert len(comparer._compared[ODOMETRY]._live) <= WAITING_NS // STEP_NS + 1
    assert comparer.result(JournalCounts()).unmatched == 100_000


def test_delayed_replay_is_matched_within_the_horizon() -> None:
    """A replay is delayed by its whole horizon where the journal lacks a line."""
    rows, batch = odometry(range(3 * HORIZON_NS // STEP_NS)), 500
    behind = HORIZON_NS // STEP_NS + batch
    comparer = LiveComparer()
    for end in range(batch, len(rows) + behind + batch, batch):
        replayed = rows[max(end - behind - batch, 0) : max(end - behind, 0)]
        comparer.add(ODOMETRY, rows[end - batch : end], replayed)
    assert comparer.result(JournalCounts()).matches
