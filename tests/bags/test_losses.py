# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Lost messages are seen by the gaps in their publishers' numbers."""

from trackslip_bags.recording import Losses


def test_gaps_are_counted_for_each_publisher_of_a_topic() -> None:
    losses = Losses()
    for publisher, number in ((b"a", 7), (b"b", 100), (b"a", 8), (b"b", 104), (b"a", 10)):
        losses.see("/x", publisher, number)
    losses.see("/y", b"a", 11)
    assert losses.total == {"/x": 3 + 1}


def test_what_comes_again_is_no_loss() -> None:
    losses = Losses()
    for number in (5, 6, 5, 6, 7):
        losses.see("/latched", b"a", number)
    assert not losses.total


def test_news_are_reported_once() -> None:
    losses = Losses()
    losses.add("/b", 2)
    losses.add("/a", 1)
    losses.add("/a", 0)
    assert losses.news() == "1 messages of /a, 2 messages of /b"
    assert losses.news() == ""
    losses.add("/a", 4)
    assert losses.news() == "4 messages of /a"
    assert losses.total == {"/a": 5, "/b": 2}
