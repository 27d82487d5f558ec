# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Counts and times at a recorder: lost messages, and the order of those sent again."""

from trackslip_bags.recording import LogTimes, Losses

S = 1_000_000_000


def test_gaps_are_counted_for_each_publisher_of_a_topic() -> None:
    losses = Losses()
    for publisher, number in ((b"a", 7), (b"b", 100), (b"a", 8), (b"b", 104), (b"a", 10)):
        losses.count_gap("/x", publisher, number)
    losses.count_gap("/y", b"a", 11)
    assert losses.total == {"/x": 3 + 1}


def test_repeated_sequence_number_is_not_counted_as_lost() -> None:
    losses = Losses()
    for number in (5, 6, 5, 6, 7):
        losses.count_gap("/latched", b"a", number)
    assert not losses.total


def test_each_loss_is_reported_once() -> None:
    losses = Losses()
    losses.add("/b", 2)
    losses.add("/a", 1)
    losses.add("/a", 0)
    assert losses.new_losses_text() == "1 messages of /a, 2 messages of /b"
    assert losses.new_losses_text() == ""
    losses.add("/a", 4)
    assert losses.new_losses_text() == "4 messages of /a"
    assert losses.total == {"/a": 5, "/b": 2}


def test_log_times_increase_when_messages_wait_for_a_retransmission() -> None:
    """Message 1 is lost and sent again; 2 and 3 are received before it and delivered after it."""
    order = LogTimes()
    received = {0: 10 * S, 1: 13 * S, 2: 11 * S, 3: 12 * S, 4: 14 * S}
    logged = [order.log_time_ns("odometry", received_ns) for received_ns in received.values()]
    assert logged == [10 * S, 13 * S, 13 * S, 13 * S, 14 * S]
    assert order.log_time_ns("sprockets", 11 * S) == 11 * S


def test_log_times_follow_a_clock_that_is_set_back() -> None:
    order = LogTimes()
    received = (100 * S, 40 * S, 41 * S, 140 * S)
    assert tuple(order.log_time_ns("odometry", received_ns) for received_ns in received) == received
