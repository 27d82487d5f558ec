# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The recorder's disk: files it may remove, files it keeps, and the time until the disk is full."""

from pathlib import Path

import pytest
from fixtures.made_bags import TEXT, text

from trackslip_bags.disk import (
    LIBRARY,
    DiskWatch,
    RecordedFile,
    files_over_budget,
    is_recording,
    recorded_files,
    remove_recorded,
)
from trackslip_bags.reader import open_bag
from trackslip_bags.writer import BagWriter

DATA = text("a")


def recording(path: Path, files: int = 1, library: str = LIBRARY) -> Path:
    with BagWriter(path, library=library) as bag:
        for k in range(files):
            if k:
                bag.split()
            bag.write("/text", TEXT, DATA, k)
    return path


def test_a_recording_is_recognised_also_after_a_kill_during_closing(tmp_path: Path) -> None:
    path = recording(tmp_path / "bag", 2)
    assert is_recording(path)
    (path / "metadata.yaml").rename(path / ".trackslip-0123456789abcdef.new")
    assert is_recording(path)


@pytest.mark.parametrize("name", ["notes.txt", "other_0.mcap", "bag_x.mcap", "bag_7.mcap"])
def test_a_directory_with_anything_else_in_it_is_no_recording(tmp_path: Path, name: str) -> None:
    path = recording(tmp_path / "bag")
    (path / name).write_text("mine", encoding="utf-8")
    assert not is_recording(path)
    assert not list(recorded_files(tmp_path))


@pytest.mark.parametrize("content", [b"", bytes(5000)])
def test_a_file_that_a_power_cut_left_blank_belongs_to_its_recording(tmp_path: Path, content: bytes) -> None:
    """Else ``max_disk`` would not count the bag, and never remove it."""
    path = recording(tmp_path / "bag")
    (path / "bag_1.mcap").write_bytes(content)
    assert {file.path.name for file in recorded_files(tmp_path)} == {"bag_0.mcap", "bag_1.mcap"}


def test_bags_of_others_links_and_files_are_no_recordings(tmp_path: Path) -> None:
    recording(tmp_path / "imported", library="trackslip")
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    (tmp_path / "empty").mkdir()
    real = recording(tmp_path / "bag")
    (tmp_path / "link").symlink_to(real)
    assert {file.path.parent for file in recorded_files(tmp_path)} == {real}
    assert not is_recording(tmp_path / "nowhere")


def test_oldest_bags_are_removed_first_except_the_open_one() -> None:
    bag, other, busy = Path("bag"), Path("other"), Path("busy")
    writing = bag / "bag_1.mcap"
    files = [
        RecordedFile(writing, 100, 1.0),
        RecordedFile(bag / "bag_0.mcap", 100, 990.0),
        RecordedFile(other / "other_0.mcap", 100, 20.0),
        RecordedFile(other / "other_1.mcap", 100, 30.0),
        RecordedFile(busy / "busy_0.mcap", 100, 980.0),
    ]

    def removed(max_size: int) -> list[str]:
        return [file.name for file in files_over_budget(files, max_size, bag, writing, now_s=1000.0)]

    assert removed(500) == []
    assert removed(499) == ["other_0.mcap"]
    assert removed(300) == ["other_0.mcap", "other_1.mcap"]
    assert removed(0) == ["other_0.mcap", "other_1.mcap", "bag_0.mcap"]


@pytest.mark.parametrize("now_s", [100.0, 1.8e9])
def test_a_clock_that_starts_in_1970_makes_the_open_bag_no_older(now_s: float) -> None:
    bag, other = Path("bag"), Path("other")
    writing = bag / "bag_1.mcap"
    files = [
        RecordedFile(writing, 100, now_s),
        RecordedFile(bag / "bag_0.mcap", 100, 70.0),
        RecordedFile(other / "other_0.mcap", 100, 1.7e9),
    ]
    assert files_over_budget(files, 200, bag, writing, now_s) == [other / "other_0.mcap"]


def test_bag_is_read_after_removal_of_its_oldest_file(tmp_path: Path) -> None:
    path = recording(tmp_path / "bag", 3)
    remove_recorded(path / "bag_0.mcap")
    with open_bag(path) as bag:
        assert [message.log_time_ns for message in bag.messages()] == [1, 2]
    remove_recorded(path / "bag_1.mcap")
    remove_recorded(path / "bag_2.mcap")
    assert not path.exists()


def test_metadata_does_not_list_removed_files(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag")
    for k in range(4):
        bag.write("/text", TEXT, DATA, k)
        if k < 3:
            bag.split()
    bag.remove_file("bag_2.mcap")
    bag.remove_file("bag_1.mcap")
    bag.close()
    with open_bag(tmp_path / "bag") as opened:
        assert opened.damage == ""
        assert opened.message_count == 2
        assert [message.log_time_ns for message in opened.messages()] == [0, 3]


def test_minutes_left_are_from_the_rate_of_the_last_minute() -> None:
    watch = DiskWatch()
    assert watch.minutes_left is None
    for second in range(200):
        watch.add(10_000_000 - 1000 * min(second, 100), float(second))
        if second == 5:
            assert watch.minutes_left is None
        if second == 90:
            assert watch.minutes_left == pytest.approx((10_000_000 - 90_000) / 60_000)
    assert watch.minutes_left is None


def test_link_planted_in_the_place_of_the_metadata_is_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("of another user", encoding="utf-8")
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/text", TEXT, DATA, 1)
        for name in ("metadata.yaml", "metadata.yaml.tmp"):
            (tmp_path / "bag" / name).symlink_to(victim)
    assert victim.read_text(encoding="utf-8") == "of another user"
    assert not (tmp_path / "bag" / "metadata.yaml").is_symlink()
