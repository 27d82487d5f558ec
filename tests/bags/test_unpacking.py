# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Small files that decompress to large ones: rejected without allocating the stated memory."""

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from fixtures.made_bags import summary_of
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from trackslip_bags import unpacking
from trackslip_bags.chunks import read_stretches
from trackslip_bags.importing.robot_bags import Ros1Bags
from trackslip_bags.messages import make
from trackslip_bags.reader import open_bag
from trackslip_bags.unpacking import MAX_SIZE, decompress, decompress_file, decompress_message
from trackslip_common.errors import InputError

MEMORY = 1_500_000_000  # bytes of address space of the reader
PACKED = {
    "zstd": lambda size: zstandard.ZstdCompressor().compress(b"\0" * size),
    "zstd_in_frames": lambda size: zstandard.ZstdCompressor().compress(b"\0" * (size // 10)) * 10,
    "lz4": lambda size: lz4.frame.compress(b"\0" * size),
}


@pytest.mark.parametrize("kind", PACKED)
def test_chunk_is_unpacked_to_what_it_states(kind: str) -> None:
    assert decompress(PACKED[kind](5000), 5000, kind.partition("_")[0]) == b"\0" * 5000


@pytest.mark.parametrize("kind", PACKED)
@pytest.mark.parametrize("stated", [0, 4999, 5001])
def test_chunk_of_another_size_than_stated_is_refused(kind: str, stated: int) -> None:
    with pytest.raises(ValueError, match="another size"):
        decompress(PACKED[kind](5000), stated, kind.partition("_")[0])


def test_chunk_above_the_size_limit_is_refused() -> None:
    with pytest.raises(ValueError, match="4000 MB; accepted"):
        decompress(b"", 4_000_000_000, "zstd")


def test_message_above_the_unpacked_limit_is_refused() -> None:
    packer = zstandard.ZstdCompressor().compressobj()
    pieces = [packer.compress(b"\0" * 1_000_000) for _ in range(MAX_SIZE // 1_000_000 + 1)]
    packed = b"".join([*pieces, packer.flush()])
    with pytest.raises(ValueError, match=f"more than {MAX_SIZE // 10**6} MB"):
        decompress_message(packed)
    assert decompress_message(zstandard.ZstdCompressor().compress(b"abc")) == b"abc"


@pytest.mark.parametrize("kind", ["BZ2", "LZ4"])
def test_chunk_of_ros1_above_the_unpacked_limit_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    file, store = tmp_path / "robot.bag", get_typestore(Stores.ROS1_NOETIC)
    name = "std_msgs/msg/String"
    bag = Ros1Writer(file)
    bag.set_compression(Ros1Writer.CompressionFormat[kind])
    with bag:
        connection = bag.add_connection("/a", name, typestore=store)
        bag.write(connection, 1, store.serialize_ros1(make(name, data="a" * 100_000), name))
    assert file.stat().st_size < 10_000
    with Ros1Bags([file]) as bags:
        assert [len(message.content.data) for message in bags.read(["/a"])] == [100_000]
    monkeypatch.setattr(unpacking, "MAX_SIZE", 50_000)
    with Ros1Bags([file]) as bags, pytest.raises(InputError, match="unpacks to more than"):
        list(bags.read(["/a"]))


def test_file_that_unpacks_to_too_much(tmp_path: Path) -> None:
    file = tmp_path / "bag.db3.zstd"
    piece = zstandard.ZstdCompressor().compress(b"\0" * 20_000_000)
    file.write_bytes(piece * 20)
    with pytest.raises(ValueError, match="unpack to more than"):
        decompress_file(file)
    file.write_bytes(piece)
    decompress_file(file)


def _info(bag: Path) -> None:
    with open_bag(bag) as opened:
        for _ in read_stretches(opened, ["/a"]):
            pass


def test_chunk_stating_4_gb_is_refused(tmp_path: Path, bomb: Callable[[Path, int], None]) -> None:
    """A chunk states 4 GB in a process with less memory."""
    file = tmp_path / "bomb.mcap"
    bomb(file, 4_000_000_000)
    assert file.stat().st_size < 200_000
    code = f"from bags.test_unpacking import _info; from pathlib import Path; _info(Path({str(file)!r}))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY)),
        check=False,
    )
    assert "InputError" in done.stderr
    assert "4000 MB" in done.stderr


def test_chunk_whose_stated_size_is_wrong_is_refused(
    tmp_path: Path, bomb: Callable[[Path, int], None]
) -> None:
    file = tmp_path / "bomb.mcap"
    bomb(file, 1000)
    with pytest.raises(InputError, match=r"damaged inside .*another size"):
        _info(file)


@pytest.fixture
def bomb() -> Callable[[Path, int], None]:
    """A function that writes a file with one chunk of 0.1 MB that states another size."""

    def write(file: Path, stated: int) -> None:
        with file.open("wb") as stream:
            writer = Writer(stream, compression=CompressionType.ZSTD)
            writer.start("ros2")
            schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
            channel = writer.register_channel("/a", "cdr", schema)
            writer.add_message(channel, 1, b"\0" * 100_000, 1)
            writer.finish()
        _restate(file, stated)

    return write


def _restate(file: Path, stated: int) -> None:
    """Write another uncompressed size into the chunk and into the chunk index."""
    (index,) = summary_of(file).chunk_indexes
    before, after = (n.to_bytes(8, "little") for n in (index.uncompressed_size, stated))
    data = file.read_bytes()
    assert data.count(before) == 2
    file.write_bytes(data.replace(before, after))
