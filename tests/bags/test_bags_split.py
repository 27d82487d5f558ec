# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of several files: when the writer begins the next file, and reading them as one bag."""

import math
import random
from pathlib import Path

import pytest
import yaml
from fixtures.made_bags import IMU, MS, TEXT, imu, text
from mcap.reader import make_reader

from trackslip_bags.metadata import METADATA
from trackslip_bags.reader import open_bag
from trackslip_bags.tables import read_tables
from trackslip_bags.writer import BagWriter
from trackslip_common.errors import InputError


def write_two(path: Path, count: int, duration: float = math.inf) -> Path:
    """Write IMU at 100 Hz, and a single message on another topic."""
    with BagWriter(path, split_duration=duration) as bag:
        bag.write("/once", TEXT, text("first"), 0)
        for i in range(count):
            bag.write("/imu", IMU, imu(i * 10 * MS), i * 10 * MS)
    return path


def test_files_of_a_split_bag_span_the_configured_duration_and_are_read_as_one(tmp_path: Path) -> None:
    """Foxglove and ``mcap`` open each file alone: all topics with their definitions, all checksums."""
    path = write_two(tmp_path / "run", 450, duration=1.0)
    info = yaml.safe_load((path / "metadata.yaml").read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
    names = [f"run_{k}.mcap" for k in range(5)]
    assert sorted(file.name for file in path.glob("*.mcap")) == names
    assert info["relative_file_paths"] == [file["path"] for file in info["files"]] == names
    starts = [file["starting_time"]["nanoseconds_since_epoch"] for file in info["files"]]
    assert starts == [k * 1000 * MS for k in range(5)]
    assert [file["duration"]["nanoseconds"] for file in info["files"]] == [990 * MS] * 4 + [490 * MS]
    assert [file["message_count"] for file in info["files"]] == [101, 100, 100, 100, 50]
    assert info["message_count"] == 451
    assert info["duration"] == {"nanoseconds": 4490 * MS}
    counts = {t["topic_metadata"]["name"]: t["message_count"] for t in info["topics_with_message_count"]}
    assert counts == {"/once": 1, "/imu": 450}
    expected = sorted([0, *(i * 10 * MS for i in range(450))])
    with open_bag(path) as bag:
        assert (bag.damage, [m.log_time_ns for m in bag.messages()]) == ("", expected)
    alone: list[int] = []
    for name in names:
        with (path / name).open("rb") as file:
            mcap = make_reader(file, validate_crcs=True)
            alone += [message.log_time for _, _, message in mcap.iter_messages()]
            summary = mcap.get_summary()
        assert summary is not None
        assert {channel.topic for channel in summary.channels.values()} == {"/once", "/imu"}
        assert {(s.name, s.encoding) for s in summary.schemas.values()} == {
            (k, "ros2msg") for k in (TEXT, IMU)
        }
    assert alone == expected


def test_files_are_read_in_the_order_recorded_whatever_the_metadata_list(tmp_path: Path) -> None:
    path = write_two(tmp_path / "run", 1050, duration=1.0) / METADATA
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    tree["rosbag2_bagfile_information"]["relative_file_paths"].sort()  # run_10 before run_2
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    with open_bag(path.parent) as bag:
        assert [file.name for file in bag.files] == [f"run_{k}.mcap" for k in range(11)]
        times = [message.log_time_ns for message in bag.messages()]
        assert times == sorted(times)
        assert all(stretch.passed_twice is None for stretch in read_tables(bag, ["/imu"]))


def test_a_large_file_is_followed_by_another(tmp_path: Path) -> None:
    noise = random.Random(1)
    with BagWriter(tmp_path / "bag", split_size=100_000) as bag:
        for i in range(200):
            data = text(noise.randbytes(5000).hex())
            bag.write("/noise", TEXT, data, i * 100 * MS)
    sizes = [file.stat().st_size for file in sorted(tmp_path.glob("bag/*.mcap"), key=lambda f: len(f.name))]
    assert len(sizes) > 5
    assert all(100_000 <= size < 200_000 for size in sizes[:-1])


def test_a_clock_set_back_does_not_split_at_every_message(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", split_duration=10.0) as bag:
        for at_s in (1000, 1001, 2, 3, 4, 5):
            bag.write("/once", TEXT, text(str(at_s)), at_s * 1000 * MS)
    assert len(list(tmp_path.glob("bag/*.mcap"))) == 2


@pytest.mark.parametrize("missing", [(0,), (2,), (1, 3)])
def test_missing_files_of_a_split_bag_are_named_beside_damaged_ones(
    tmp_path: Path, missing: tuple[int, ...]
) -> None:
    path = write_two(tmp_path / "run", 450, duration=1.0)
    for k in missing:
        (path / f"run_{k}.mcap").unlink()
    last = path / "run_4.mcap"
    last.write_bytes(last.read_bytes()[:-8])
    with open_bag(path) as bag:
        assert bag.damage.startswith(", ".join(f"run_{k}.mcap" for k in missing) + " missing")
        assert bag.damage.endswith("; run_4.mcap: cut short")


def test_a_bag_without_its_only_file_is_refused_with_its_name(tmp_path: Path) -> None:
    path = write_two(tmp_path / "run", 10)
    (path / "run_0.mcap").unlink()
    with pytest.raises(InputError, match=r"cannot be read \(run_0\.mcap missing, which metadata\.yaml lists"):
        open_bag(path)
