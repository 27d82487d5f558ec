# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The bag of a recorder: lost messages, the order of those sent again, and a disk that fails or is full."""

import logging
import shutil
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from trackslip_bags.recording import LogTimes, Losses, Recording, RecordParameters

S = 1_000_000_000
LOG = logging.getLogger("recorder")
MESSAGE = b"\0\1\0\0\1\0\0\0\0"
Begin = Callable[..., Recording]


@pytest.fixture
def begin(tmp_path: Path) -> Begin:
    """A function that begins a recording with parameters."""
    rest: dict[str, Any] = {"more_topics": "", "split_size": 0, "split_duration": 0.0, "max_disk": 0}

    def start(**parameters: Any) -> Recording:
        return Recording(RecordParameters(output=str(tmp_path / "bag"), **(rest | parameters)), LOG)

    return start


def write(recording: Recording, number: int) -> None:
    recording.write("/topic", "std_msgs/msg/String", MESSAGE, number, number)


def fail() -> None:
    raise OSError(28, "No space left on device")


def test_messages_after_a_disk_error_are_counted_as_lost(begin: Begin) -> None:
    recording = begin()
    write(recording, 1)
    recording.save()
    write(recording, 2)
    recording.bag.flush = fail  # type: ignore[method-assign]
    recording.save()
    write(recording, 3)
    recording.close()
    assert recording.disk_error == "cannot write (No space left on device)"
    assert recording.losses.total == {"/topic": 2}


def test_deleted_bag_is_a_disk_error(begin: Begin, tmp_path: Path) -> None:
    recording = begin()
    write(recording, 1)
    shutil.rmtree(tmp_path / "bag")
    recording.save()
    recording.close()
    assert recording.disk_error == "cannot write (No such file or directory)"


def test_disk_error_of_one_bag_does_not_affect_the_next(begin: Begin) -> None:
    """A write of the first bag fails after the next bag is begun."""
    failed: Future[None] = Future()
    failed.set_exception(OSError(5, "Input/output error"))
    first = begin()
    first._saving = failed
    first.close()
    second = begin()
    write(second, 7)
    second.save()
    second.close()
    assert first.disk_error == "cannot write (Input/output error)"
    assert second.disk_error == ""
    assert second.losses.total.total() == 0


def test_oldest_files_are_removed_at_the_disk_limit(begin: Begin, tmp_path: Path) -> None:
    recording = begin(max_disk=1)
    for number in (1, 2, 3):
        write(recording, number)
        recording.bag.split()
    (tmp_path / "mine.mcap").write_bytes(bytes(10_000))
    recording.save()
    assert recording.disk_error == ""
    assert sorted(path.name for path in tmp_path.rglob("*.mcap")) == ["bag_3.mcap", "mine.mcap"]
    recording.close()


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


class SetClock:
    """A host's clock that a test sets, beside a steady one that starts at 500 s."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.steady_ns, self.offset_ns = 500 * S, -490 * S
        monkeypatch.setattr("time.monotonic_ns", lambda: self.steady_ns)
        monkeypatch.setattr("time.time_ns", lambda: self.steady_ns + self.offset_ns)

    def wait_until(self, host_ns: int) -> int:
        self.steady_ns = host_ns - self.offset_ns
        return host_ns


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SetClock:
    return SetClock(monkeypatch)


def test_log_times_increase_when_messages_wait_for_a_retransmission(clock: SetClock) -> None:
    """Message 1 is lost and sent again; 2 and 3 are received before it and delivered after it."""
    order = LogTimes()
    clock.wait_until(14 * S)
    received = {0: 10 * S, 1: 13 * S, 2: 11 * S, 3: 12 * S, 4: 14 * S}
    logged = [order.log_time_ns("odometry", received_ns)[0] for received_ns in received.values()]
    assert logged == [10 * S, 13 * S, 13 * S, 13 * S, 14 * S]
    assert order.log_time_ns("sprockets", 11 * S) == (11 * S, False)


@pytest.mark.parametrize("back_s", [2, 3600])
def test_log_times_go_on_evenly_when_the_clock_is_set_back(clock: SetClock, back_s: int) -> None:
    clock.offset_ns += 10_000 * S
    order, start_ns = LogTimes(), clock.steady_ns + clock.offset_ns
    logged = []
    for k in range(6):
        if k == 3:
            clock.offset_ns -= back_s * S
        clock.steady_ns += S
        for topic in ("odometry", "sprockets"):
            logged.append(order.log_time_ns(topic, clock.steady_ns + clock.offset_ns)[0])
    assert logged == [start_ns + k * S for k in range(1, 7) for _ in range(2)]
    assert order.lead_ns == back_s * S


def test_log_times_follow_a_clock_that_is_set_from_1970_to_the_present(clock: SetClock) -> None:
    order, present_ns = LogTimes(), 1_780_000_000 * S
    before_ns = clock.wait_until(20 * S)
    assert order.log_time_ns("odometry", before_ns) == (before_ns, False)
    clock.offset_ns += present_ns
    after_ns = clock.wait_until(21 * S + present_ns)
    assert order.log_time_ns("odometry", after_ns) == (after_ns, True)
    waited = order.log_time_ns("sprockets", before_ns + 1)[0]  # received before, delivered after
    assert abs(waited - after_ns) < 5 * S


def test_a_clock_that_is_set_while_recording_is_named_with_a_remedy(
    begin: Begin, clock: SetClock, caplog: pytest.LogCaptureFixture
) -> None:
    recording = begin()
    write(recording, clock.wait_until(20 * S))
    clock.offset_ns -= 5 * S
    write(recording, clock.wait_until(16 * S))
    assert "set: log times stay 5.0 s ahead of it until the recorder is started again" in caplog.text
    clock.offset_ns += 100 * S
    write(recording, clock.wait_until(117 * S))
    assert "set: log times follow it; set it before the drive" in caplog.text
    recording.close()
