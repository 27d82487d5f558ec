# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag that playback publishes, and their times."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from fixtures.made_bags import TEXT, text, write_messages

from trackslip_bags.input_filters import InputFilters, Withhold
from trackslip_bags.playback import OWN_OUTPUTS, Playback, PlayedMessage, played_messages, played_topics
from trackslip_bags.reader import open_bag

S = 1_000_000_000
BEGIN_NS = 1_000 * S


def three() -> Iterator[PlayedMessage]:
    """Messages at 0, 1 and 3 s."""
    for t in (0, 1, 3):
        yield PlayedMessage("/a", BEGIN_NS + t * S, str(t).encode())


def taken(playback: Playback, now_s: float) -> list[str]:
    return [message.raw.decode() for message in playback.due_messages(now_s)]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A bag of ten messages, one per second, on each of four topics."""
    messages = (
        (topic, TEXT, BEGIN_NS + t * S, text(f"{topic} {t}"))
        for t in range(10)
        for topic in ("/sprockets", "/odometry", "/clock", "/diagnostics")
    )
    return write_messages(tmp_path / "bag", messages)


def test_messages_are_due_at_their_log_time() -> None:
    playback = Playback(three, rate=1.0)
    assert taken(playback, 50.0) == ["0"]
    assert taken(playback, 50.9) == []
    assert taken(playback, 51.0) == ["1"]
    assert not playback.is_finished
    assert taken(playback, 60.0) == ["3"]
    assert playback.is_finished
    assert playback.counts == {"/a": 3}


def test_playback_does_not_wait_for_the_years_that_a_clock_was_set_by() -> None:
    """The computer started in 1970, without a battery, and got the time after two messages."""
    stamps = (5 * S, 6 * S, 1_700_000_000 * S, 1_700_000_001 * S)
    playback = Playback(lambda: (PlayedMessage("/a", t, str(t // S).encode()) for t in stamps), rate=1.0)
    assert taken(playback, 0.0) == ["5"]
    assert taken(playback, 1.0) == ["6"]
    assert taken(playback, 1.1) == ["1700000000"]
    assert taken(playback, 2.1) == ["1700000001"]
    assert playback.is_finished


def test_playback_rate_scales_time() -> None:
    playback = Playback(three, rate=2.0)
    assert taken(playback, 0.0) == ["0"]
    assert taken(playback, 0.5) == ["1"]
    assert playback.bag_ns == BEGIN_NS + 1 * S
    assert taken(playback, 1.49) == []
    assert taken(playback, 1.5) == ["3"]


def test_pause_stops_messages_and_the_clock() -> None:
    playback = Playback(three, rate=1.0, paused=True)
    assert taken(playback, 0.0) == []
    assert taken(playback, 100.0) == []
    assert playback.bag_ns == BEGIN_NS
    playback.paused = False
    assert taken(playback, 100.0) == ["0"]
    playback.paused = True
    assert taken(playback, 200.0) == []
    playback.paused = False
    assert taken(playback, 201.0) == ["1"]


def test_message_not_fetched_remains_due() -> None:
    playback = Playback(three, rate=1.0)
    assert taken(playback, 0.0) == ["0"]
    first = next(playback.due_messages(10.0))
    assert first.raw == b"1"
    assert taken(playback, 10.0) == ["3"]


def test_clock_does_not_run_ahead_of_due_messages() -> None:
    """After a stall of 3 s at four times the speed, the clock stops at the messages that are still due."""
    playback = Playback(three, rate=4.0)
    assert taken(playback, 0.0) == ["0"]
    messages = playback.due_messages(3.0)
    assert playback.bag_ns == BEGIN_NS
    next(messages)
    assert playback.bag_ns == BEGIN_NS + 3 * S
    assert [message.raw for message in messages] == [b"3"]
    assert playback.bag_ns == BEGIN_NS + 3 * S


def test_a_loop_begins_again_with_its_time() -> None:
    playback = Playback(three, rate=1.0, loop=True)
    assert taken(playback, 0.0) == ["0"]
    assert taken(playback, 1.0) == ["1"]
    assert taken(playback, 3.0)[:2] == ["3", "0"]
    assert not playback.is_finished
    assert playback.bag_ns == BEGIN_NS
    assert taken(playback, 4.0) == ["1"]


def test_outputs_of_estimators_are_played_only_on_request(path: Path) -> None:
    with open_bag(path) as bag:
        assert played_topics(bag, InputFilters(), []) == {"/sprockets": TEXT}
        assert played_topics(bag, InputFilters(), ["odometry", "/clock"]).keys() == {
            "/sprockets",
            "/odometry",
        }
        assert {m.topic for m in played_messages(bag, InputFilters(), ["/sprockets"])} == {"/sprockets"}
    estimates = {"odometry", "odometry/local", "attitude", "swing/estimate", "machine_state", "track_slip"}
    assert estimates | {"slip_estimator/parameters"} <= OWN_OUTPUTS
    assert not {"sprockets", "box_pose", "scan"} & OWN_OUTPUTS


def test_window_names_and_outages_are_those_of_any_replay(path: Path) -> None:
    filters = InputFilters(
        start_s=2.0, stop_s=8.0, remap={"sprockets": "tracks"}, withhold=(Withhold("tracks", 4.0, 6.0),)
    )
    with open_bag(path) as bag:
        topics = played_topics(bag, filters, [])
        assert topics == {"/tracks": TEXT}
        played = list(played_messages(bag, filters, topics))
        assert [(m.log_time_ns - BEGIN_NS) // S for m in played] == [2, 3, 6, 7]
        assert bag.deserialize(played[0].raw, TEXT).data == "/sprockets 2"
