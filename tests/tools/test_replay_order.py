# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live order: by the journal if there is one, by log time for measurements absent from it."""

import numpy as np
import pytest
from fixtures.arrival_rows import rows_of
from fixtures.records import assert_same_bits

from trackslip_common.arrays import Rows
from trackslip_estimation.slip.measurements import YawRate
from trackslip_estimation.slip.records import YAW_RATE
from trackslip_tools.replay.arrivals import IS_COMMAND
from trackslip_tools.replay.comparable import LINE
from trackslip_tools.replay.live_order import HORIZON_NS, JournalCounts, LiveOrder

SOURCES = ("a", "b", "gnss", "reset", "sprockets")


def arrival(source: str, stamp: int, log: int, rate: float = 0.0) -> tuple[int, YawRate]:
    return log, YawRate(source, stamp, rate, 1.0)


def journal(*lines: tuple[int, str, int]) -> Rows:
    """Numbered lines of a journal, from (log time, source, stamp)."""
    numbered = [(log, k, SOURCES.index(source), stamp, 0) for k, (log, source, stamp) in enumerate(lines)]
    return np.array(numbered, dtype=LINE)


def ordered(
    arrivals: list[tuple[int, YawRate]], lines: Rows, cuts: tuple[int, ...] = ()
) -> tuple[Rows, JournalCounts]:
    """Rows in live order, read in sections that end at the ``cuts``."""
    rows = rows_of(sorted(arrivals, key=lambda a: a[0]), SOURCES)  # in the order of a bag
    commands, sprockets = [SOURCES.index("reset")], SOURCES.index("sprockets")
    order = LiveOrder(SOURCES, {*lines["source"].tolist()}, commands, sprockets)
    parts, begin = [], 0
    for end in (*cuts, 10**15):
        section = [
            part[(part["log_time_ns"] >= begin) & (part["log_time_ns"] < end)] for part in (rows, lines)
        ]
        parts.append(order.push(section[0], section[1], end))
        begin = end
    return np.concatenate((*parts, order.finish())), order.counts


ORDERS: dict[str, tuple[list[tuple[int, YawRate]], Rows, str]] = {
    "log times without a journal": (
        [arrival("a", 5, 30), arrival("b", 9, 10), arrival("a", 1, 20)],
        journal(),
        "b9 a1 a5",
    ),
    "journal over log times": (
        [arrival("a", 1, 10), arrival("b", 1, 11), arrival("a", 2, 12), arrival("b", 2, 13)],
        journal((20, "b", 1), (21, "b", 2), (22, "a", 2), (23, "a", 1)),
        "b1 b2 a2 a1",
    ),
    "log times of a source that the journal lacks": (
        [arrival("a", k, 10 * k) for k in (1, 2, 3)] + [arrival("gnss", k, 10 * k + 3) for k in (0, 1, 2, 9)],
        journal((11, "a", 1), (21, "a", 2), (31, "a", 3)),
        "gnss0 a1 gnss1 a2 gnss2 a3 gnss9",
    ),
    "no message that the estimator did not get": (
        [arrival("a", k, k) for k in (1, 2, 3)],
        journal((5, "a", 1), (6, "a", 3)),
        "a1 a3",
    ),
}


@pytest.mark.parametrize("name", ORDERS)
def test_order_of_replay(name: str) -> None:
    arrivals, lines, expected = ORDERS[name]
    rows, _ = ordered(arrivals, lines)
    assert [f"{SOURCES[row['source']]}{row['stamp_ns']}" for row in rows] == expected.split()


def test_a_manual_pose_without_a_stamp_is_found_by_the_line_of_its_use() -> None:
    arrivals = [arrival("a", 1, 10), arrival("gnss", 0, 11), arrival("a", 2, 12), arrival("gnss", 0, 13)]
    lines = journal((20, "a", 1), (21, "a", 2), (22, "gnss", 2), (23, "gnss", 0))
    rows, counts = ordered(arrivals, lines)
    assert [(SOURCES[row["source"]], int(row["log_time_ns"])) for row in rows] == [
        ("a", 10),
        ("a", 12),
        ("gnss", 13),
        ("gnss", 11),
    ]
    assert counts.lost_inputs == 0


def test_journal_line_without_a_message_is_skipped_and_counted() -> None:
    arrivals = [arrival("a", k, k) for k in (1, 3)]
    lines = journal((5, "a", 1), (6, "a", 2), (7, "b", 2), (8, "a", 3))
    rows, counts = ordered(arrivals, lines)
    assert rows["stamp_ns"].tolist() == [1, 3]
    assert counts.lost_inputs == 2


def test_repeats_are_replayed_in_their_number_and_order() -> None:
    arrivals = [arrival("a", 1, 10, rate=0.1), arrival("a", 1, 11, rate=0.2), arrival("a", 2, 12)]
    rows, _ = ordered(arrivals, journal((20, "a", 1), (21, "a", 2), (22, "a", 1), (23, "a", 1)))
    found = [(int(row["stamp_ns"]), float(row["value"][0])) for row in rows]
    assert found == [(1, 0.1), (2, 0.0), (1, 0.2)]


def test_commands_are_read_from_their_journal_lines() -> None:
    rows, counts = ordered([arrival("a", 1, 10)], journal((20, "reset", 7), (21, "a", 1)))
    assert rows["kind"].tolist() == [IS_COMMAND, YAW_RATE]
    assert (rows[0]["stamp_ns"], rows[0]["log_time_ns"]) == (7, 20)
    assert counts.lost_inputs == 0


def test_lost_lines_are_counted() -> None:
    lines = journal(*[(k, "a", k) for k in range(10)])

    def lost(recorded: Rows) -> int:
        return ordered([], recorded)[1].lost_lines

    assert lost(journal()) == 0
    assert lost(lines) == 0
    assert lost(lines[:-2]) == 0  # the end of a recording is not a loss
    assert lost(lines[3:]) == 3
    assert lost(lines[[0, 4, 5, 6, 9]]) == 5


def test_lines_whose_numbers_go_back_are_not_counted_as_missing() -> None:
    lines = journal(*[(k, "a", k) for k in range(1000)])
    mixed = lines[np.argsort(np.arange(1000) % 500, kind="stable")]
    mixed["log_time_ns"] = np.arange(1000)
    counts = ordered([], mixed)[1]
    assert counts.disordered_lines == 499


@pytest.mark.parametrize("cuts", [(), (5, 11, 12, 30)])
def test_copies_of_journal_lines_are_ignored(cuts: tuple[int, ...]) -> None:
    lines = journal(*[(10 * k, "a", k) for k in range(1, 9)])
    copies = lines.copy()
    copies["log_time_ns"] += 3
    both = np.sort(np.concatenate((lines, copies)), order="log_time_ns")
    arrivals = [arrival("a", k, 10 * k + late) for k in range(1, 9) for late in (-2, -1)]
    rows, counts = ordered(arrivals, both, cuts)
    assert rows["stamp_ns"].tolist() == [*range(1, 9)]
    assert counts == ordered(arrivals[::2], lines)[1]


def test_lines_without_numbers_begin_no_runs() -> None:
    lines = journal(*[(10 * k, "a", k) for k in range(1, 9)])
    lines["sequence"] = 0
    rows, counts = ordered([arrival("a", k, 10 * k) for k in range(1, 9)], lines)
    assert set(rows["kind"].tolist()) == {YAW_RATE}
    assert (counts.lost_lines, counts.disordered_lines) == (0, 0)


@pytest.mark.parametrize("seed", range(5))
def test_stretches_are_ordered_as_the_whole_is(seed: int) -> None:
    """Lines are up to a quarter of the horizon before or after their message, in another order."""
    rng = np.random.default_rng(seed)
    step = HORIZON_NS // 10
    arrivals = [arrival("ab"[k % 2], k, k * step) for k in range(200) if rng.random() < 0.95]
    arrivals += [arrival("gnss", k, k * step + 7) for k in range(0, 200, 9)]
    late = rng.integers(-HORIZON_NS // 4, HORIZON_NS // 4, 200)
    logged = sorted((k * step + int(late[k]), k) for k in range(200))
    lines = journal(*((max(t, 0), "ab"[k % 2], k) for t, k in logged))
    whole, counts = ordered(arrivals, lines)
    cuts = tuple(np.sort(rng.integers(0, 200 * step, 40)).tolist())
    found, counts_of_cuts = ordered(arrivals, lines, cuts)
    assert_same_bits(found, whole)
    assert counts_of_cuts == counts
    assert counts.lost_inputs > 0


def test_memory_is_bounded_without_journal_lines() -> None:
    live_order = LiveOrder(SOURCES, {0}, [], 4)
    for k in range(100):
        now = k * HORIZON_NS
        rows = rows_of([arrival("a", now + i, now + i) for i in range(10)], SOURCES)
        assert not len(live_order.push(rows, journal(), now + HORIZON_NS))
    assert len(live_order._rows) <= 30


def test_memory_is_bounded_where_all_lines_have_one_log_time() -> None:
    live_order = LiveOrder(SOURCES, {0}, [], 4)
    for k in range(50):
        lines = journal(*((0, "a", i) for i in range(1000)))
        lines["sequence"] += 1000 * k
        live_order.push(rows_of([], SOURCES), lines, 1)
    assert len(live_order._recent) <= 10_000
