# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of topics have the numbers that live nodes read, for any strings and any form of bag."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.made_bags import write_foreign, write_messages
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from trackslip_bags.messages import header, make, serialize
from trackslip_bags.reader import Bag, open_bag
from trackslip_bags.tables import TopicTable, read_tables
from trackslip_bags.types import ensure_type
from trackslip_common.errors import InputError
from trackslip_common.message_fields import RECORDS, PoseFields, SprocketFields
from trackslip_common.message_reading import read as read_record
from trackslip_common.message_reading import selectors_of

JOINTS, IMU, REPORT = (
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Imu",
    "trackslip_msgs/msg/MeasurementReport",
)
ODOMETRY = "nav_msgs/msg/Odometry"
SIDES = ("left_sprocket", "right_sprocket")


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


def odometry(k: int) -> Any:
    rng = np.random.default_rng(k)
    message = make(ODOMETRY, header=header(10**18 + k, "odom"), child_frame_id="base_link")
    message.pose.covariance[:], message.twist.covariance[:] = rng.normal(size=(2, 36))
    message.pose.pose.position.x, message.twist.twist.linear.y = rng.normal(size=2).tolist()
    return message


def bag_of(path: Path, type_name: str, raws: list[bytes]) -> Bag:
    return open_bag(
        write_messages(path, (("/topic", type_name, 1000 + k, raw) for k, raw in enumerate(raws)))
    )


def numbers(rows: Any, texts: list[str]) -> list[Any]:
    """Rows in the form of ``read``'s result, arrays as lists."""
    records = []
    for row in rows:
        values = {name: row[name].tolist() for name in rows.dtype.names}
        records.append({n: texts[v] if n == "source" else v for n, v in values.items()})
    return records


def expected(kind: Any, messages: list[Any]) -> list[Any]:
    records = [read_record(kind, message)._asdict() for message in messages]
    return [{n: v.tolist() if isinstance(v, np.ndarray) else v for n, v in r.items()} for r in records]


def tables(bag: Bag, topic: str = "/topic") -> list[TopicTable]:
    return [stretch[topic] for stretch in read_tables(bag, [topic]) if topic in stretch]


@pytest.mark.parametrize(
    ("type_name", "messages"),
    [
        (JOINTS, [joints(k) for k in range(20)]),
        (JOINTS, [joints(k, frame="x" * (k % 5)) for k in range(20)]),
        (JOINTS, [joints(k, names=SIDES if k % 2 else SIDES[::-1]) for k in range(9)]),
        (JOINTS, [joints(k, names=(*SIDES, "swing") if k % 2 else SIDES) for k in range(9)]),
        (JOINTS, [joints(0), joints(1, names=("a", "bcd")), joints(2, names=SIDES[:1]), joints(3, names=())]),
        (JOINTS, [joints(k, frame=f"frame{k:03}") for k in range(100)]),  # all different
        (REPORT, [report(k, ("sprockets", "imu/data_raw", "box_pose")[k % 3]) for k in range(30)]),
        (IMU, [make(IMU, header=header(k, "imu_link")) for k in range(3)]),
        (ODOMETRY, [odometry(k) for k in range(5)]),
    ],
)
def test_rows_hold_what_live_reads(type_name: str, messages: list[Any], tmp_path: Path) -> None:
    """Strings of other lengths move the numbers after them; the order of joints may change."""
    kind = RECORDS[type_name]
    with bag_of(tmp_path / "bag", type_name, [serialize(m) for m in messages]) as bag:
        (table,) = tables(bag)
        records = numbers(table.rows(kind), table.texts)
    np.testing.assert_equal(records, expected(kind, messages))


@pytest.mark.parametrize("type_name", RECORDS)
def test_every_record_class_fits_its_message(type_name: str, tmp_path: Path) -> None:
    kind, message = RECORDS[type_name], make(type_name)
    assert list(selectors_of(kind)) == list(kind._fields)
    with bag_of(tmp_path / "bag", type_name, [serialize(message)]) as bag:
        (table,) = tables(bag)
        np.testing.assert_equal(numbers(table.rows(kind), table.texts), expected(kind, [message]))


@pytest.mark.parametrize(
    "raw",
    [
        serialize(joints(1))[:-30],  # truncated
        serialize(joints(0)) + bytes(100),
        b"\0",
        serialize(joints(0))[:28] + b"\xff" * 4 + serialize(joints(0))[32:],  # 4·10⁹ names
    ],
)
def test_a_message_that_is_not_of_its_type_is_refused(raw: bytes, tmp_path: Path) -> None:
    with bag_of(tmp_path / "bag", JOINTS, [serialize(joints(0)), raw]) as bag:
        (table,) = tables(bag)
        with pytest.raises(InputError, match="bad sensor_msgs/msg/JointState"):
            table.rows(SprocketFields)


def test_big_endian_messages_are_read_one_by_one(tmp_path: Path) -> None:
    messages = [joints(k) for k in range(4)]
    store = ensure_type(JOINTS)
    raws = [bytes(store.serialize_cdr(m, JOINTS, little_endian=k % 2 == 0)) for k, m in enumerate(messages)]
    with bag_of(tmp_path / "bag", JOINTS, raws) as bag:
        (table,) = tables(bag)
        np.testing.assert_equal(numbers(table.rows(SprocketFields), []), expected(SprocketFields, messages))


def test_a_type_without_a_field_is_refused(tmp_path: Path) -> None:
    with bag_of(tmp_path / "bag", IMU, [serialize(make(IMU))]) as bag:
        (table,) = tables(bag)
        with pytest.raises(InputError, match="/topic is a sensor_msgs/msg/Imu without pose"):
            table.rows(PoseFields)


def write(path: Path, count: int = 20) -> Path:
    raws = (serialize(joints(k)) for k in range(count))
    return write_messages(path, (("/sprockets", JOINTS, 1000 + k, raw) for k, raw in enumerate(raws)))


def read(path: Path) -> list[tuple[int, int, tuple[Any, ...]]]:
    """Position, log time and row of each message."""
    messages = []
    with open_bag(path) as bag:
        for table in tables(bag, "/sprockets"):
            rows = table.rows(SprocketFields).tolist()
            messages += zip(table.order.tolist(), table.log_times_ns.tolist(), rows, strict=True)
    return messages


def test_a_recorded_bag_is_read_chunk_by_chunk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Bag, "messages", lambda *_: pytest.fail("one by one"))
    assert len(read(write(tmp_path / "bag"))) == 20


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_bags_of_every_form_make_the_same_rows(
    tmp_path: Path, storage: StoragePlugin, mode: CompressionMode
) -> None:
    messages = [("/sprockets", JOINTS, 1000 + k, serialize(joints(k))) for k in range(20)]
    assert read(write_foreign(tmp_path / "other", messages, storage, mode)) == read(write(tmp_path / "bag"))
