# SPDX-License-Identifier: Apache-2.0
"""The live order: by the journal where there is one, by log time for what it does not know."""

from trackslip_bags.input_filters import Arrival
from trackslip_estimation.slip.measurements import Measurement, YawRate
from trackslip_tools.replay.inputs import Taken, in_live_order, journal_gaps


def arrival(source: str, stamp: int, log: int, rate: float = 0.0) -> Arrival:
    return Arrival(log, YawRate(source, stamp, rate, 1.0))


def order(arrivals: list[Arrival], journal: list[Taken]) -> list[tuple[str, int]]:
    arrivals = sorted(arrivals, key=lambda a: a.log_time_ns)  # as a bag gives them
    return [(m.source, m.stamp_ns) for m in in_live_order(arrivals, journal)]


def journal(*lines: tuple[int, str, int]) -> list[Taken]:
    """(log time, source, stamp) of each line, numbered."""
    return [Taken(log, k, source, stamp) for k, (log, source, stamp) in enumerate(lines)]


def test_without_a_journal_log_time_orders() -> None:
    arrivals = [arrival("a", 5, 30), arrival("b", 9, 10), arrival("a", 1, 20)]
    assert order(arrivals, []) == [("b", 9), ("a", 1), ("a", 5)]


def test_the_journal_orders_whatever_the_log_says() -> None:
    arrivals = [arrival("a", 1, 10), arrival("b", 1, 11), arrival("a", 2, 12), arrival("b", 2, 13)]
    lines = journal((20, "b", 1), (21, "b", 2), (22, "a", 2), (23, "a", 1))
    assert order(arrivals, lines) == [("b", 1), ("b", 2), ("a", 2), ("a", 1)]


def test_a_source_that_the_journal_does_not_know_is_merged_by_log_time() -> None:
    arrivals = [arrival("a", k, 10 * k) for k in (1, 2, 3)] + [
        arrival("gnss", k, 10 * k + 3) for k in (0, 1, 2, 9)
    ]
    lines = journal((11, "a", 1), (21, "a", 2), (31, "a", 3))
    assert order(arrivals, lines) == [
        ("gnss", 0),
        ("a", 1),
        ("gnss", 1),
        ("a", 2),
        ("gnss", 2),
        ("a", 3),
        ("gnss", 9),
    ]


def test_what_live_never_took_is_not_taken() -> None:
    """The recorder heard stamp 2, the estimator did not: its journal is complete."""
    arrivals = [arrival("a", k, k) for k in (1, 2, 3)]
    assert order(arrivals, journal((5, "a", 1), (6, "a", 3))) == [("a", 1), ("a", 3)]


def test_a_line_whose_message_the_bag_lacks_is_passed_over() -> None:
    arrivals = [arrival("a", k, k) for k in (1, 3)]
    assert order(arrivals, journal((5, "a", 1), (6, "a", 2), (7, "b", 2), (8, "a", 3))) == [
        ("a", 1),
        ("a", 3),
    ]


def test_repeats_are_taken_as_often_and_in_the_order_in_which_they_came() -> None:
    arrivals = [arrival("a", 1, 10, rate=0.1), arrival("a", 1, 11, rate=0.2), arrival("a", 2, 12)]
    lines = journal((20, "a", 1), (21, "a", 2), (22, "a", 1), (23, "a", 1))
    found: list[Measurement] = list(in_live_order(arrivals, lines))
    assert [(m.stamp_ns, m.rate) for m in found if isinstance(m, YawRate)] == [(1, 0.1), (2, 0.0), (1, 0.2)]


def test_lost_lines_are_counted() -> None:
    lines = journal(*[(k, "a", k) for k in range(10)])
    assert journal_gaps([]) == 0
    assert journal_gaps(lines) == 0
    assert journal_gaps(lines[:-2]) == 0  # the end of a recording is no loss
    assert journal_gaps(lines[3:]) == 3
    assert journal_gaps([lines[0], *lines[4:7], lines[9]]) == 5
