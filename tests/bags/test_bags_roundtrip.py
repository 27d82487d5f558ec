# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Every project message with any content is read from a bag as it was written, by rosbags too."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import open_bag
from trackslip_bags.types import ensure_type, fields_by, is_message
from trackslip_bags.writer import BagWriter
from trackslip_common.layout import ANY_LENGTH, Field

MSG_FOLDER = Path(__file__).parents[2] / "src" / "trackslip_msgs" / "msg"
PROJECT = sorted(f"trackslip_msgs/msg/{path.stem}" for path in MSG_FOLDER.glob("*.msg"))
STANDARD = ["sensor_msgs/msg/JointState", "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"]


def scalars(name: str) -> st.SearchStrategy[Any]:
    if name == "string":
        return st.text("az \n\x1bä€\U0001f69c", max_size=8)  # of one to four bytes
    if name == "bool":
        return st.booleans()
    if name.startswith("float"):
        return st.floats(width=int(name[5:]), allow_nan=False)
    info = np.iinfo(name)
    return st.integers(int(info.min), int(info.max))


def values(field: Field) -> st.SearchStrategy[Any]:
    item = messages(field.type) if is_message(field.type) else scalars(field.type)
    if field.length is None:
        return item
    low, high = (0, 4) if field.length == ANY_LENGTH else (field.length, field.length)
    return st.lists(item, min_size=low, max_size=high)


def messages(type_name: str) -> st.SearchStrategy[Any]:
    fields = fields_by(ensure_type(type_name))(type_name)
    strategies = {field.name: values(field) for field in fields}
    return st.fixed_dictionaries(strategies).map(lambda values: make(type_name, **values))


contents = st.sampled_from(PROJECT + STANDARD).flatmap(messages)


@settings(max_examples=30)
@given(st.lists(contents, min_size=1, max_size=8))
def test_round_trip(sent: list[Any]) -> None:
    """Each topic has one type."""
    raws = [(f"/{message.__msgtype__}", message.__msgtype__, serialize(message)) for message in sent]
    written = [(topic, i * 300_000_000, raw) for i, (topic, _, raw) in enumerate(raws)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        with BagWriter(path) as bag:
            for i, (topic, type_name, raw) in enumerate(raws):
                bag.write(topic, type_name, raw, i * 300_000_000)
        with open_bag(path) as opened:
            ours = [(m.topic, m.log_time_ns, m.raw) for m in opened.messages()]
            decoded = [opened.deserialize(raw, type_name) for _, type_name, raw in raws]
        with Reader(path) as reader:
            theirs = [(c.topic, time_ns, bytes(raw)) for c, time_ns, raw in reader.messages()]
        with bag.file.open("rb") as stream:
            read = make_reader(stream, validate_crcs=True).iter_messages()
            mcaps = [(channel.topic, m.log_time, m.data) for _, channel, m in read]
    assert ours == theirs == mcaps == written
    assert [serialize(message) for message in decoded] == [raw for _, _, raw in raws]
