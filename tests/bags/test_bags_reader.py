# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The bag reader: every form of bag that rosbag2 writes, damaged bags, and files that are no bag."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from fixtures.made_bags import (
    IMU,
    MS,
    TEXT,
    damage_chunk,
    imu,
    text,
    write_foreign,
    write_imu,
    write_messages,
)
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import Bag, open_bag, require_topics
from trackslip_bags.recovery.recover import recover
from trackslip_bags.writer import BagWriter
from trackslip_common.errors import InputError
from trackslip_tools.cli.description import describe
from trackslip_tools.terminal_text import WIDTH

FORMS = [
    (StoragePlugin.SQLITE3, CompressionMode.NONE),
    (StoragePlugin.SQLITE3, CompressionMode.FILE),
    (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    (StoragePlugin.MCAP, CompressionMode.NONE),
    (StoragePlugin.MCAP, CompressionMode.FILE),
    (StoragePlugin.MCAP, CompressionMode.STORAGE),
]


def write_texts(path: Path, times_ns: list[int], topic: str = "/a") -> Path:
    return write_messages(path, ((topic, TEXT, time_ns, text(str(time_ns))) for time_ns in times_ns))


def times(bag: Bag) -> list[int]:
    return [message.log_time_ns for message in bag.messages()]


# First version of metadata.yaml with each field, by the version history in rosbags.
SINCE = {
    "ros_distro": 8,
    "type_description_hash": 7,
    "custom_data": 6,
    "files": 5,
    "offered_qos_profiles": 4,
    "compression_format": 3,
    "compression_mode": 3,
}
OTHER_QOS = "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 2\n" + "".join(
    f"  {name}:\n    sec: 2147483647\n    nsec: 4294967295\n"
    for name in ("deadline", "lifespan", "liveliness_lease_duration")
)
OTHER_QOS += "  liveliness: 1\n  avoid_ros_namespace_conventions: false"


@pytest.mark.parametrize(
    ("storage", "compression", "version"),
    [*((*form, 9) for form in FORMS), *((*FORMS[k % 6], k) for k in range(2, 9))],
)
def test_messages_come_whatever_the_metadata_state_of_their_topic(
    tmp_path: Path, storage: StoragePlugin, compression: CompressionMode, version: int
) -> None:
    """metadata.yaml has an earlier version, QoS edited by hand for a player, or lacks a topic."""
    messages = [("/a", TEXT, 30, text("last")), ("/a", TEXT, 10, text("first")), ("/b", IMU, 20, imu(20))]
    path = write_foreign(tmp_path / "bag", messages, storage, compression) / "metadata.yaml"
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    information = tree["rosbag2_bagfile_information"]
    del information["topics_with_message_count"][1:]
    first = information["topics_with_message_count"][0]
    first["message_count"], first["topic_metadata"]["offered_qos_profiles"] = 99, OTHER_QOS
    packed = compression is not CompressionMode.NONE
    for level in (information, first["topic_metadata"]):
        for name, since in SINCE.items():
            if version < since and not (packed and name.startswith("compression")):
                level.pop(name, None)
    information["version"] = version
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    with open_bag(tmp_path / "bag") as bag:
        assert (bag.damage, bag.start_ns, bag.end_ns, bag.message_count) == ("", 10, 30, 3)
        topics = {name: (info.type_name, info.count) for name, info in bag.topics.items()}
        assert topics == {"/a": (TEXT, 2), "/b": (IMU, 1)}
        assert [(m.topic, m.log_time_ns) for m in bag.messages()] == [("/a", 10), ("/b", 20), ("/a", 30)]
        assert [bag.deserialize(m.raw, TEXT).data for m in bag.messages(["/a"])] == ["first", "last"]


@pytest.mark.parametrize(("storage", "compression"), FORMS)
def test_split_bags_of_others_open(
    tmp_path: Path, storage: StoragePlugin, compression: CompressionMode
) -> None:
    """``ros2 bag record --max-bag-size`` writes one ``metadata.yaml`` for all files."""
    whole = tmp_path / "split"
    whole.mkdir()
    metadata: list[dict[str, Any]] = []
    for k in range(3):
        messages = [("/a", TEXT, 100 * k + i, text(f"{k}{i}")) for i in range(2)]
        part = write_foreign(tmp_path / f"split_{k}", messages, storage, compression)
        tree = yaml.safe_load((part / "metadata.yaml").read_text(encoding="utf-8"))
        metadata.append(tree["rosbag2_bagfile_information"])
        (file,) = metadata[-1]["relative_file_paths"]
        shutil.move(part / file, whole / file)
    first = metadata[0]
    first["relative_file_paths"] = [tree["relative_file_paths"][0] for tree in metadata]
    first["files"] = [tree["files"][0] for tree in metadata]
    first["duration"], first["message_count"] = {"nanoseconds": 201}, 6
    first["topics_with_message_count"][0]["message_count"] = 6
    (whole / "metadata.yaml").write_text(
        yaml.safe_dump({"rosbag2_bagfile_information": first}), encoding="utf-8"
    )
    with open_bag(whole) as bag:
        assert (bag.damage, bag.topics["/a"].count) == ("", 6)
        assert times(bag) == [0, 1, 100, 101, 200, 201]
        assert [bag.deserialize(m.raw, TEXT).data for m in bag.messages()][-1] == "21"


def test_a_bare_file_opens(tmp_path: Path) -> None:
    path = write_texts(tmp_path / "bag", [1, 2])
    with open_bag(path / "bag_0.mcap") as bag:
        assert (bag.damage, times(bag)) == ("", [1, 2])


def test_messages_are_in_log_order_and_ties_as_written(tmp_path: Path) -> None:
    written = ((50, "d"), (10, "a"), (10, "b"), (40, "c"), (2 * 10**9, "f"), (60, "e"))
    messages = (("/x" if data < "c" else "/y", TEXT, time_ns, text(data)) for time_ns, data in written)
    with open_bag(write_messages(tmp_path / "bag", messages)) as bag:
        assert "".join(bag.deserialize(m.raw, TEXT).data for m in bag.messages()) == "abcdef"


def test_topics_and_times_are_selected(tmp_path: Path) -> None:
    messages = (("/even" if i % 2 == 0 else "/odd", TEXT, i, text(str(i))) for i in range(10))
    with open_bag(write_messages(tmp_path / "bag", messages)) as bag:
        assert [m.log_time_ns for m in bag.messages(["even"], start_ns=2, stop_ns=8)] == [2, 4, 6]
        assert [m.log_time_ns for m in bag.messages(["/even", "odd"], start_ns=8)] == [8, 9]
        assert list(bag.messages(["neither"])) == []
        assert list(bag.messages([])) == []


@pytest.mark.parametrize("share", [0.15, 0.5, 0.99])
def test_a_cut_file_opens_up_to_its_last_whole_chunk(tmp_path: Path, share: float) -> None:
    """``tests/bags/test_recover.py`` cuts files without ``metadata.yaml``."""
    path = write_imu(tmp_path / "bag", 400)
    file = path / "bag_0.mcap"
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])
    with open_bag(path) as bag:
        assert bag.damage == "bag_0.mcap: cut short"
        log_times = times(bag)
        assert len(log_times) % 50 == 0
        assert log_times == [i * 10 * MS for i in range(len(log_times))]
        assert len(log_times) == bag.topics["/imu"].count == bag.message_count
        assert len(log_times) * 10 * MS >= (share - 0.3) * 4e9
        assert bag.end_ns == log_times[-1]
        assert next(iter(bag.messages(start_ns=bag.end_ns))).log_time_ns == bag.end_ns


def test_bag_without_metadata_is_read_whole(tmp_path: Path) -> None:
    path = write_imu(tmp_path / "bag", 400)
    (path / "metadata.yaml").unlink()
    with open_bag(path) as bag:
        assert len(times(bag)) == 400
        assert bag.damage == "no metadata.yaml"


def test_a_split_recording_is_read_as_one(tmp_path: Path) -> None:
    whole = tmp_path / "split"
    whole.mkdir()
    for number in (2, 10, 1):  # in numerical order
        part = write_texts(tmp_path / str(number), [number * 100, number * 100 + 1])
        shutil.copy(part / f"{number}_0.mcap", whole / f"split_{number}.mcap")
    last = whole / "split_10.mcap"
    last.write_bytes(last.read_bytes()[:-8])
    with open_bag(whole) as bag:
        assert times(bag) == [100, 101, 200, 201, 1000, 1001]
        assert (bag.start_ns, bag.end_ns, bag.topics["/a"].count) == (100, 1001, 6)
        assert bag.damage == "split_10.mcap: cut short"


def test_damage_inside_is_reported_not_read(tmp_path: Path) -> None:
    path = write_imu(tmp_path / "bag", 400)
    damage_chunk(path / "bag_0.mcap", 3)
    remedy = r"damaged inside \([^\n]*\); trackslip recover saves the rest\Z"
    with open_bag(path) as bag, pytest.raises(InputError, match=remedy):
        list(bag.messages())


@pytest.mark.parametrize(("name", "content"), [("bag.mcap", b"\x89MCAP0\r\n"), ("bag", None)])
def test_file_that_is_no_bag_is_refused_in_one_line(tmp_path: Path, name: str, content: bytes | None) -> None:
    path = tmp_path / name
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        open_bag(path)
    message = str(caught.value)
    assert str(path) in message
    assert "accepted: a rosbag2 directory" in message
    assert "\n" not in message


def test_missing_topics_are_named_with_those_present(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/silent", TEXT)
        writer.write("/a", TEXT, text(""), 0)
    with open_bag(tmp_path / "bag") as bag:
        require_topics(bag, ["a"])
        with pytest.raises(InputError, match=r"no messages on /silent, /sprockets; it holds: /a$"):
            require_topics(bag, {"sprockets", "silent", "/a"})


def test_missing_topic_is_named_with_the_namespaces_that_have_it(tmp_path: Path) -> None:
    bag = write_messages(tmp_path / "bag", [(f"/{name}/sprockets", TEXT, 1, text("")) for name in "ab"])
    with open_bag(bag) as opened, pytest.raises(InputError, match=r"a, b \(--namespace a\)"):
        require_topics(opened, ["sprockets"])


@pytest.mark.parametrize("name", ["/sprockets", f"/{'a_long_name/' * 5}sprockets"])
def test_the_description_names_every_topic_and_fits_a_terminal(name: str, tmp_path: Path) -> None:
    """The type name is the longest of ours, and the topic has 12 letters."""
    kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    messages = ((name, kind, k * 250 * MS, serialize(make(kind))) for k in range(5))
    with open_bag(write_messages(tmp_path / "bag", messages)) as bag:
        lines = describe(bag).splitlines()
    assert "duration  1.000 s" in lines
    assert {name, "5", "5.00", kind} <= set(" ".join(lines[3:]).split())
    assert max(map(len, lines[3:])) <= max(WIDTH, len(name) + 2 + len(kind))


@pytest.mark.parametrize("read", [open_bag, lambda path: recover(path, path.with_name("out"))])
def test_bag_of_ros_1_is_refused_with_the_import_command(
    read: Callable[[Path], object], tmp_path: Path
) -> None:
    file = tmp_path / "robot.bag"
    file.write_bytes(b"#ROSBAG V2.0\n" + bytes(5000))
    with pytest.raises(InputError, match="is of ROS 1: trackslip import"):
        read(file)
