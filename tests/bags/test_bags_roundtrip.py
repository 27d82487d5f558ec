# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Every project message with any content is read from a bag as it was written, by rosbags too."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

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
        return st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=8)
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


@pytest.mark.parametrize("type_name", PROJECT + STANDARD)
@settings(max_examples=15, deadline=None, derandomize=True)
@given(data=st.data())
def test_round_trip(type_name: str, data: st.DataObject) -> None:
    sent = [
        serialize(message) for message in data.draw(st.lists(messages(type_name), min_size=1, max_size=4))
    ]
    stamps = [i * 300_000_000 for i in range(len(sent))]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        with BagWriter(path) as bag:
            for stamp_ns, raw in zip(stamps, sent, strict=True):
                bag.write("/topic", type_name, raw, stamp_ns)
        with open_bag(path) as opened:
            ours = [(m.log_time_ns, m.raw) for m in opened.messages()]
            decoded = [opened.deserialize(raw, type_name) for _, raw in ours]
        with AnyReader([path]) as reader:
            theirs = [(time_ns, raw) for _, time_ns, raw in reader.messages()]
            again = [
                reader.typestore.serialize_cdr(reader.deserialize(raw, type_name), type_name) for raw in sent
            ]
        with bag.file.open("rb") as stream:
            mcaps = [
                (m.log_time, m.data) for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()
            ]
    assert ours == theirs == mcaps == list(zip(stamps, sent, strict=True))
    assert [serialize(message) for message in decoded] == sent
    assert [bytes(raw) for raw in again] == sent
