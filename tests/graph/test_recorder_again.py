# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A recorder that is deactivated and activated again starts another bag without the previous state."""

import errno
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fixtures.own_node import started

from trackslip_bags.nodes.record import RecordNode
from trackslip_bags.reader import open_bag
from trackslip_common.nodes.health import ERROR, OK, WARN


@pytest.fixture
def recorder(domain: int, tmp_path: Path) -> Iterator[RecordNode]:
    with started(RecordNode, domain, output=str(tmp_path / "bag")) as node:
        yield node


def reactivate(node: RecordNode) -> None:
    node.trigger_deactivate()
    node.trigger_activate()


def receive(node: RecordNode, number: int, **info: Any) -> None:
    about = {"received_timestamp": number, "source_timestamp": number, "publication_sequence_number": number}
    node._write("/topic", "std_msgs/msg/String", b"\0\1\0\0\1\0\0\0\0", about | info)


def no_space(*_: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_activated_again_with_output_set_it_writes_to_a_new_directory(
    recorder: RecordNode, tmp_path: Path
) -> None:
    received_ns = [time.time_ns() + number for number in range(3)]
    for number in received_ns:
        assert recorder.active
        receive(recorder, number)
        reactivate(recorder)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "bag_2", "bag_3", "bag_4"]
    for name, number in zip(("bag", "bag_2", "bag_3"), received_ns, strict=True):
        with open_bag(tmp_path / name) as bag:
            (message,) = bag.messages(["/topic"])
            assert abs(message.log_time_ns - number) < 1_000_000  # the clock is slewed


def test_existing_bag_name_is_skipped(recorder: RecordNode, tmp_path: Path) -> None:
    (tmp_path / "bag_2").mkdir()
    reactivate(recorder)
    assert recorder.active
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "bag_2", "bag_3"]


def test_publishers_are_counted_separately_for_each_bag(recorder: RecordNode) -> None:
    """A second publisher in the next bag has its own sequence numbers; they are no gaps."""
    recorder._raw_subscriptions.single_publisher_topics = {"/topic"}
    reactivate(recorder)
    receive(recorder, 1, publisher_gid=None)
    receive(recorder, 1000, publisher_gid=None)
    assert recorder._recording.losses.total.total() == 0


def test_restarted_recorder_writes_another_bag(recorder: RecordNode, tmp_path: Path) -> None:
    """The same ``output`` after a respawn, or for two machines that record into one directory."""
    other = RecordNode()
    other.start()
    other.end()
    other.destroy_node()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "bag_2"]


@pytest.mark.parametrize(("minutes", "level"), [(50, WARN), (70, OK)])
def test_a_disk_that_fills_is_reported_an_hour_ahead(
    recorder: RecordNode, minutes: int, level: bytes
) -> None:
    free = minutes * 60_000_000
    recorder._recording._disk_watch.add(free + 60_000_000, 0.0)
    recorder._recording._disk_watch.add(free, 60.0)
    health = recorder.health()[0]
    assert health.level == level
    assert health.values["disk full in (min)"] == minutes
    assert health.message.startswith(f"the disk is full in {minutes} min") == (level == WARN)


def test_another_bag_begins_once_a_full_disk_can_be_written_again(
    domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that was full for a minute does not cost the rest of the day; what was lost stays reported."""
    monkeypatch.setattr("trackslip_bags.nodes.record._RETRY_PERIOD", 0.0)
    with started(RecordNode, domain, output=str(tmp_path / "bag")) as node:
        with monkeypatch.context() as full:
            full.setattr(node._recording.bag, "flush", no_space)
            full.setattr("trackslip_bags.writer.FileIO", no_space)
            receive(node, 1)
            node._save()
            assert node.health()[0].message.startswith("cannot write (No space left on device)")
            assert [path.name for path in tmp_path.iterdir()] == ["bag"]
        node._save()
        receive(node, 2)
        health = node.health()[0]
        assert (health.level, health.message) == (ERROR, f"messages were lost: {tmp_path / 'bag_2'}")
    assert node.has_failed
    with open_bag(tmp_path / "bag_2") as bag:
        assert bag.topics["/topic"].count == 1


def test_no_bag_begins_on_a_disk_with_room_for_a_few_seconds_only(
    domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a log that is rotated now and then leaves a tiny bag every 30 s, all day."""
    monkeypatch.setattr("trackslip_bags.nodes.record._RETRY_PERIOD", 0.0)
    with started(RecordNode, domain, output=str(tmp_path / "bag")) as node:
        node._recording.disk_error = "cannot write (No space left on device)"
        with monkeypatch.context() as nearly_full:
            usage = shutil.disk_usage(tmp_path)._replace(free=1_000_000)
            nearly_full.setattr("shutil.disk_usage", lambda _: usage)
            node._save()
        assert [path.name for path in tmp_path.iterdir()] == ["bag"]
        node._save()
        assert (tmp_path / "bag_2").exists()
