# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile bags, disks and files: each error is one line that states the cause, and nothing is left behind."""

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from fixtures.made_bags import TEXT, text, write_messages

from trackslip_bags.importing.csv_table import Requested, read_table
from trackslip_bags.messages import make, serialize
from trackslip_bags.metadata import METADATA
from trackslip_bags.reader import open_bag
from trackslip_bags.recovery.recover import recover
from trackslip_bags.tables import read_tables
from trackslip_bags.writer import BagWriter
from trackslip_common.errors import InputError
from trackslip_tools.cli.description import describe

NUMBER = "std_msgs/msg/Float64"


def text_bag(path: Path, count: int = 10, topic: str = "/text", first_ns: int = 1) -> Path:
    messages = ((topic, TEXT, first_ns + k, text(os.urandom(500).hex())) for k in range(count))
    return write_messages(path, messages)


def two_typed_bag(path: Path) -> Path:
    """Write a bag of two files: a topic has text in the first, and numbers in the second."""
    bag = BagWriter(path)
    bag.write("/both", TEXT, text("a"), 1)
    del bag.topics["/both"]
    bag.split()
    bag.write("/both", NUMBER, serialize(make(NUMBER, data=1.0)), 2)
    bag.close()
    return path


def read_all(path: Path) -> None:
    with open_bag(path) as bag:
        for _ in read_tables(bag, bag.topics):
            pass


@pytest.fixture
def pipe(tmp_path: Path) -> Callable[[str], Path]:
    """A function that makes a named pipe without a writer."""

    def make_pipe(name: str) -> Path:
        os.mkfifo(tmp_path / name)
        return tmp_path / name

    return make_pipe


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("topics_with_message_count.0.topic_metadata.type", math.nan),
        ("topics_with_message_count.0.topic_metadata.name", [1]),
        ("topics_with_message_count.0.topic_metadata.name", 1),
        ("topics_with_message_count.0.message_count", "ten"),
        ("topics_with_message_count.0.message_count", 1.5),
        ("topics_with_message_count.0.message_count", -1),
        ("topics_with_message_count.0", None),
        ("topics_with_message_count", "x"),
        ("duration.nanoseconds", math.inf),
        ("starting_time.nanoseconds_since_epoch", 1e300),
        ("relative_file_paths", [1]),
        ("relative_file_paths", [""]),
        ("relative_file_paths", ["\0"]),
        ("relative_file_paths", None),
        ("files", "x"),
        ("files", {}),
        ("compression_mode", 1),
        ("version", "x"),
        ("version", 10),
        *(
            ("", text)
            for text in ("", "hello", "[1, 2]", "rosbag2_bagfile_information: {version: 99}", "{{{")
        ),
    ],
)
def test_metadata_with_an_absurd_value_does_not_hide_the_messages(
    tmp_path: Path, place: str, value: Any
) -> None:
    """The content is read from the files, and the bag is reported as damaged; no place: the whole text."""
    file = text_bag(tmp_path / "bag") / METADATA
    tree = yaml.safe_load(file.read_text(encoding="utf-8"))
    entry = tree["rosbag2_bagfile_information"]
    *parents, last = (int(key) if key.isdigit() else key for key in place.split("."))
    for key in parents:
        entry = entry[key]
    entry[last] = value
    file.write_text(yaml.safe_dump(tree) if place else value, encoding="utf-8")
    with open_bag(tmp_path / "bag") as bag:
        assert "metadata" in bag.damage
        assert bag.damage.isprintable()
        assert "/text" in describe(bag)
        assert bag.message_count == sum(1 for _ in bag.messages()) == 10


def test_two_types_on_one_topic_are_named_as_such(tmp_path: Path) -> None:
    path = two_typed_bag(tmp_path / "bag")
    with pytest.raises(InputError, match=f"/both has messages of several types .{NUMBER} and {TEXT}."):
        read_all(path)
    with open_bag(path) as bag:
        assert f"{NUMBER}, {TEXT}" in describe(bag)


@pytest.mark.parametrize("first_ns", [2**63 - 5, 2**63, 2**64 - 20])
def test_log_times_beyond_63_bits(tmp_path: Path, first_ns: int) -> None:
    path = text_bag(tmp_path / "bag", first_ns=first_ns)
    with pytest.raises(InputError, match="after 2262"):
        read_all(path)
    with open_bag(path) as bag:
        describe(bag)
    recover(path, tmp_path / "recovered")
    read_all(tmp_path / "recovered")


@pytest.mark.parametrize(("name", "is_inside"), [("bag.mcap", False), ("bag", False), ("bag_0.mcap", True)])
def test_named_pipe_is_refused_without_blocking(
    pipe: Callable[[str], Path], name: str, is_inside: bool
) -> None:
    path = pipe(name)
    for read in (open_bag, lambda path: recover(path, path.with_name("out"))):
        with pytest.raises(InputError, match="no regular file"):
            read(path.parent if is_inside else path)


def test_named_pipe_as_a_csv_log_is_refused_without_blocking(pipe: Callable[[str], Path]) -> None:
    with pytest.raises(InputError, match="no regular file"):
        read_table(pipe("log.csv"), Requested((), (), ()))


def test_metadata_above_16_mb_is_not_parsed(tmp_path: Path) -> None:
    bag = text_bag(tmp_path / "bag")
    os.truncate(bag / METADATA, 2**30)
    assert "more than 16 MB" in open_bag(bag).damage
    recovery = recover(bag, tmp_path / "recovered")
    assert (recovery.messages, recovery.stated) == (10, None)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (f"a,b\n1,{'7' * 200_000}\n", "is not accepted"),
        (f'"{"a" * 200_000}",b\n1,2\n', "not a table"),
        (f"a,b\n{'7' * 1_100_000}", "a line of more than 1 MB"),
    ],
)
def test_huge_fields_of_a_csv_log(tmp_path: Path, content: str, expected: str) -> None:
    file = tmp_path / "log.csv"
    file.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=expected) as refused:
        read_table(file, Requested(("a", "b"), (), ()))
    assert len(str(refused.value)) < 1000
