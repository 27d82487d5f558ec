# SPDX-License-Identifier: Apache-2.0
"""Topics as columns: the numbers that rosbags reads, whatever the strings; kept, and never stale."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys.store import Typestore

from trackslip_bags import column_cache
from trackslip_bags.column_cache import cache_directory, read_columns
from trackslip_bags.columns import IrregularError, columns_of
from trackslip_bags.messages import header, make, serialize
from trackslip_bags.reader import Bag, open_bag
from trackslip_bags.types import ensure
from trackslip_bags.writer import BagWriter
from trackslip_common.errors import InputError

JOINTS, IMU, REPORT = (
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Imu",
    "trackslip_msgs/msg/MeasurementReport",
)


def joints(
    k: int, frame: str = "base_link", names: tuple[str, ...] = ("left_sprocket", "right_sprocket")
) -> Any:
    rng = np.random.default_rng(k)
    return make(
        JOINTS,
        header=header(10**9 + 17 * k, frame),
        name=list(names),
        position=rng.normal(size=len(names)),
        velocity=rng.normal(size=len(names)),
        effort=np.empty(0),
    )


def report(k: int, source: str) -> Any:
    return make(
        REPORT,
        header=header(10**9 + k, ""),
        source=source,
        sequence=k,
        outcome=k % 3,
        nis=float(k) / 7.0,
        gate=9.0,
        dof=1,
    )


def leaf(message: Any, name: str) -> Any:
    for part in name.split("."):
        message = getattr(message, part)
    return message


def assert_columns(type_name: str, messages: list[Any], store: Typestore) -> None:
    columns = columns_of(store, type_name, [serialize(message) for message in messages])
    assert columns
    for name, column in columns.items():
        assert len(column) == len(messages)
        for k, message in enumerate(messages):
            np.testing.assert_array_equal(column[k], leaf(message, name), err_msg=name)


@pytest.mark.parametrize(
    ("type_name", "messages"),
    [
        (JOINTS, [joints(k) for k in range(20)]),
        (JOINTS, [joints(k, frame="x" * (k % 5)) for k in range(20)]),
        (JOINTS, [joints(k, names=("a", "bcd") if k % 2 else ("abc", "d")) for k in range(9)]),
        (REPORT, [report(k, ("sprockets", "imu/data_raw", "box_pose")[k % 3]) for k in range(30)]),
        (IMU, [make(IMU, header=header(k, "imu_link")) for k in range(3)]),
    ],
)
def test_columns_hold_what_the_messages_hold(type_name: str, messages: list[Any]) -> None:
    """Strings of other lengths move the numbers behind them."""
    assert_columns(type_name, messages, ensure(type_name))


@pytest.mark.parametrize(
    "raws",
    [
        [serialize(joints(0)), serialize(joints(1, names=("left_sprocket",)))],  # other counts
        [serialize(joints(0)), serialize(joints(1))[:-30]],  # cut short
        [serialize(joints(0)) + bytes(100)],
        [b"\0\0" + serialize(joints(0))[2:]],  # big-endian
        [b"\0"],
        [serialize(joints(0, frame=f"frame{k:03}")) for k in range(100)],  # nothing alike
    ],
)
def test_what_makes_no_columns_is_told(raws: list[bytes]) -> None:
    with pytest.raises(IrregularError):
        columns_of(ensure(JOINTS), JOINTS, raws)


def test_a_sequence_of_messages_makes_no_columns() -> None:
    name = "diagnostic_msgs/msg/DiagnosticArray"
    message = make(name, header=header(1, ""), status=[])
    with pytest.raises(IrregularError, match="status holds messages"):
        columns_of(ensure(name), name, [serialize(message)])


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return cache_directory()


def write(path: Path, count: int = 20) -> Path:
    with BagWriter(path) as bag:
        for k in range(count):
            bag.write("/sprockets", JOINTS, serialize(joints(k)), 1000 + k)
    return path


def read(path: Path) -> Any:
    with open_bag(path) as bag:
        return read_columns(bag, ["/sprockets"])["/sprockets"]


def test_a_second_reading_does_not_touch_the_bag(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "bag")
    first = read(path)
    assert len(list(cache.iterdir())) == 1
    monkeypatch.setattr(column_cache, "_read", lambda *_: pytest.fail("read again"))
    again = read(path)
    np.testing.assert_array_equal(first.log_times_ns, again.log_times_ns)
    assert first.columns.keys() == again.columns.keys()
    for name, column in first.columns.items():
        np.testing.assert_array_equal(column, again.columns[name])
    part = again.between(1005, 1010)
    np.testing.assert_array_equal(part.order, range(5, 10))
    np.testing.assert_array_equal(part.columns["velocity"], first.columns["velocity"][5:10])


def test_a_recorded_bag_is_read_chunk_by_chunk(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Bag, "messages", lambda *_: pytest.fail("one by one"))
    assert len(read(write(tmp_path / "bag")).order) == 20


def _by_rosbags(storage: StoragePlugin, mode: CompressionMode) -> Callable[[Path], Any]:
    def write_(path: Path) -> None:
        writer = Writer(path, version=9, storage_plugin=storage)
        writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            connection = writer.add_connection("/sprockets", JOINTS, typestore=ensure(JOINTS))
            for k in range(20):
                writer.write(connection, 1000 + k, serialize(joints(k)))

    return write_


def _message_by_message(path: Path) -> None:
    """As ``ros2 bag record --compression-mode message`` writes MCAP."""
    with BagWriter(path) as bag:
        for k in range(20):
            bag.write("/sprockets", JOINTS, zstandard.compress(serialize(joints(k))), 1000 + k)
    about = (path / "metadata.yaml").read_text(encoding="utf-8")
    for key, value in (("format", "zstd"), ("mode", "MESSAGE")):
        about = re.sub(rf"compression_{key}: .*", f"compression_{key}: {value}", about)
    (path / "metadata.yaml").write_text(about, encoding="utf-8")


def _in_two_files(path: Path) -> None:
    with BagWriter(path) as bag:
        for k in range(20):
            bag.write("/sprockets", JOINTS, serialize(joints(k)), 1000 + k)
            if k == 7:
                bag.split()


def _cut(path: Path) -> None:
    file = next(write(path).glob("*.mcap"))
    file.write_bytes(file.read_bytes()[:-8])


@pytest.mark.parametrize(
    "write_other",
    [
        _by_rosbags(StoragePlugin.MCAP, CompressionMode.NONE),
        _by_rosbags(StoragePlugin.MCAP, CompressionMode.STORAGE),
        _by_rosbags(StoragePlugin.MCAP, CompressionMode.FILE),
        _by_rosbags(StoragePlugin.SQLITE3, CompressionMode.NONE),
        _by_rosbags(StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        _message_by_message,
        _in_two_files,
        _cut,
    ],
)
def test_bags_of_every_form_make_the_same_columns(
    tmp_path: Path, cache: Path, write_other: Callable[[Path], Any]
) -> None:
    write_other(tmp_path / "other")
    found, expected = read(tmp_path / "other"), read(write(tmp_path / "bag"))
    np.testing.assert_array_equal(found.order, expected.order)
    np.testing.assert_array_equal(found.log_times_ns, expected.log_times_ns)
    assert found.columns.keys() == expected.columns.keys()
    for name, column in expected.columns.items():
        assert found.columns[name].dtype == column.dtype
        np.testing.assert_array_equal(found.columns[name], column)


def test_damage_inside_is_told(tmp_path: Path, cache: Path) -> None:
    file = next(write(tmp_path / "bag").glob("*.mcap"))
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    data = bytearray(file.read_bytes())
    inside = summary.chunk_indexes[0].chunk_start_offset + 80
    data[inside : inside + 64] = b"\xff" * 64
    file.write_bytes(data)
    with pytest.raises(InputError, match=r"damaged inside \(.*\); trackslip recover saves the rest$"):
        read(tmp_path / "bag")


def test_another_state_of_the_bag_is_read_anew(tmp_path: Path, cache: Path) -> None:
    path = write(tmp_path / "bag")
    assert len(read(path).order) == 20
    for file in path.iterdir():
        file.unlink()
    path.rmdir()
    write(path, count=30)
    assert len(read(path).order) == 30
    os.utime(next(path.glob("*.mcap")), ns=(1, 1))
    read(path)
    assert len(list(cache.iterdir())) == 3


def _nothing(cache: Path) -> None:
    cache.parent.mkdir(parents=True)
    cache.write_text("no directory")


def _damage(cache: Path) -> None:
    for file in cache.glob("*.npz"):
        file.write_bytes(file.read_bytes()[:100])


@pytest.mark.parametrize(("before", "after"), [(_nothing, None), (None, _damage)])
def test_a_cache_of_no_use_is_no_matter(
    tmp_path: Path, cache: Path, before: Callable[[Path], None] | None, after: Callable[[Path], None] | None
) -> None:
    path = write(tmp_path / "bag")
    if before is not None:
        before(cache)
    assert len(read(path).order) == 20
    if after is not None:
        after(cache)
    assert len(read(path).order) == 20


def test_old_files_make_room(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(column_cache, "_FILES", 2)
    for k in range(4):
        read(write(tmp_path / f"bag{k}"))
    assert len(list(cache.iterdir())) == 2
