# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The bag writer: a rosbag2 bag on disk, complete when closed and readable when killed."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from fixtures.made_bags import IMU, MS, TEXT, imu, summary_of, text, write_imu
from fixtures.patience import PATIENCE
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosReliability

from trackslip_bags.reader import open_bag
from trackslip_bags.types import known_schema
from trackslip_bags.writer import CHUNK_SPAN_NS, BagWriter
from trackslip_common.errors import InputError

QOS = """
- {history: keep_last, depth: 10, reliability: best_effort, durability: volatile, deadline: {sec: 0, nsec: 0},
   lifespan: {sec: 0, nsec: 0}, liveliness: automatic, liveliness_lease_duration: {sec: 0, nsec: 0},
   avoid_ros_namespace_conventions: false}
"""


def test_bytes_pass_unchanged_with_both_times(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/a", TEXT, text("one"), 2000, 1000)
        bag.write("/a", TEXT, b"\x00\x01\x00\x00 as it is", 3000)
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        records = list(reader.iter_messages())
        assert reader.get_header().profile == "ros2"
    times = [(message.log_time, message.publish_time) for _, _, message in records]
    assert times == [(2000, 1000), (3000, 3000)]
    assert records[1][2].data == b"\x00\x01\x00\x00 as it is"
    schema, channel, _ = records[0]
    assert schema is not None
    assert (schema.name, schema.encoding, schema.data) == (TEXT, "ros2msg", b"string data\n")
    assert (channel.topic, channel.message_encoding) == ("/a", "cdr")
    assert channel.metadata == {"offered_qos_profiles": "[]", "topic_type_hash": known_schema(TEXT).type_hash}


def test_chunks_are_compressed_checked_and_short(tmp_path: Path) -> None:
    chunks = summary_of(write_imu(tmp_path / "bag", 500) / "bag_0.mcap").chunk_indexes
    assert len(chunks) == 10
    for chunk in chunks:
        assert chunk.compression == "zstd"
        assert chunk.message_end_time - chunk.message_start_time < CHUNK_SPAN_NS
        assert chunk.message_index_length > 0


def test_a_clock_set_back_closes_the_chunk_too(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag")
    for stamp_ns in (3_600 * 10**9, 10 * MS, 20 * MS):
        bag.write("/imu", IMU, imu(stamp_ns), stamp_ns)
    with open_bag(bag.path) as opened:
        assert [m.log_time_ns for m in opened.messages()] == [3_600 * 10**9]
    bag.close()


def test_metadata_states_what_is_in_the_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DISTRO", "kilted")
    with BagWriter(tmp_path / "run") as bag:
        bag.add_topic("/imu", IMU, QOS)
        bag.add_topic("/silent", TEXT)
        for stamp_ns in (5000, 7000, 6000):
            bag.write("/imu", IMU, imu(stamp_ns), stamp_ns)
    assert bag.counts == {"/imu": 3, "/silent": 0}
    text = (tmp_path / "run" / "metadata.yaml").read_text(encoding="utf-8")
    assert "&" not in text  # no YAML anchors
    info = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert (info["version"], info["storage_identifier"], info["ros_distro"]) == (9, "mcap", "kilted")
    assert info["starting_time"] == {"nanoseconds_since_epoch": 5000}
    assert info["duration"] == {"nanoseconds": 2000}
    assert info["message_count"] == 3
    assert info["relative_file_paths"] == ["run_0.mcap"]
    assert info["files"][0]["path"] == "run_0.mcap"
    topics = {t["topic_metadata"]["name"]: t for t in info["topics_with_message_count"]}
    assert topics["/imu"]["message_count"] == 3
    assert topics["/imu"]["topic_metadata"]["type_description_hash"] == known_schema(IMU).type_hash
    assert topics["/imu"]["topic_metadata"]["offered_qos_profiles"][0]["reliability"] == "best_effort"
    with AnyReader([tmp_path / "run"]) as reader:  # checks hashes too
        by_topic = {connection.topic: connection for connection in reader.connections}
        assert by_topic["/imu"].ext.offered_qos_profiles[0].reliability == QosReliability.BEST_EFFORT
        assert [time_ns for _, time_ns, _ in reader.messages()] == [5000, 6000, 7000]


def test_a_bag_without_messages_is_whole(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/a", TEXT)
    with open_bag(tmp_path / "bag") as opened:
        assert (opened.damage, opened.message_count, opened.duration_s) == ("", 0, 0.0)
        assert list(opened.topics) == ["/a"]
        assert list(opened.messages()) == []


@pytest.mark.parametrize("kind", ["directory", "file", "bag"])
def test_nothing_is_overwritten(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "bag"
    if kind == "directory":
        path.mkdir()
    elif kind == "file":
        path.write_text("precious", encoding="utf-8")
    else:
        BagWriter(path).close()
    with pytest.raises(InputError, match="exists already"):
        BagWriter(path)


def test_a_path_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="cannot be created"):
        BagWriter(tmp_path / "file" / "bag")


def test_name_invalid_in_metadata_is_refused_before_writing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the name is not UTF-8; accepted") as caught:
        BagWriter(tmp_path / "bag\udcff")
    str(caught.value).encode()  # can be encoded
    assert list(tmp_path.iterdir()) == []


def test_a_topic_keeps_its_type(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/a", TEXT)
        bag.add_topic("/a", TEXT)
        with pytest.raises(InputError, match="'/a' is of type std_msgs/msg/String"):
            bag.write("/a", IMU, imu(0), 0)


def test_flush_saves_what_is_there(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag")
    bag.write("/imu", IMU, imu(0), 0)
    with pytest.raises(InputError):
        open_bag(bag.path)
    bag.flush()
    with open_bag(bag.path) as opened:
        assert opened.message_count == 1
        assert "cut short" in opened.damage
    bag.close()


KILLED = """
import os, signal, sys
sys.path[:] = {path!r}
from trackslip_bags.messages import header, make, serialize
from trackslip_bags.writer import BagWriter
bag = BagWriter({bag!r})
for i in range({count}):
    stamp_ns = i * 10_000_000
    data = serialize(make("sensor_msgs/msg/Imu", header=header(stamp_ns, "imu_link")))
    bag.write("/imu", "sensor_msgs/msg/Imu", data, stamp_ns)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_recorder_loses_less_than_a_chunk(tmp_path: Path) -> None:
    count = 437
    script = KILLED.format(path=sys.path, bag=str(tmp_path / "bag"), count=count)
    killed = subprocess.run([sys.executable, "-c", script], check=False, timeout=PATIENCE)
    assert killed.returncode < 0
    assert not (tmp_path / "bag" / "metadata.yaml").exists()
    with open_bag(tmp_path / "bag") as bag:
        assert "bag_0.mcap: cut short" in bag.damage
        times = [message.log_time_ns for message in bag.messages(["imu"])]
        assert times == [i * 10 * MS for i in range(len(times))]
        assert (count - len(times)) * 10 * MS <= CHUNK_SPAN_NS
        last = next(iter(bag.messages(start_ns=times[-1])))
        assert bag.deserialize(last.raw, last.type_name).header.frame_id == "imu_link"


@pytest.mark.parametrize("error", [KeyboardInterrupt, InputError])
def test_bag_of_an_interrupted_work_is_removed(tmp_path: Path, error: type[BaseException]) -> None:
    def work() -> None:
        with BagWriter(tmp_path / "bag") as bag:
            bag.write("/a", TEXT, text("one"), 2000)
            bag.flush()
            raise error

    with pytest.raises(error):
        work()
    assert not (tmp_path / "bag").exists()
