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
from rosbags.interfaces import Nodetype

from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import open_bag
from trackslip_bags.types import ensure_type, field_parts
from trackslip_bags.writer import BagWriter

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


def fields(description: Any) -> st.SearchStrategy[Any]:
    kind, detail = field_parts(description)
    if kind == Nodetype.NAME:
        return messages(str(detail))
    if kind == Nodetype.BASE:
        return scalars(str(detail[0]))
    item, size = detail
    low, high = (size, size) if kind == Nodetype.ARRAY else (0, 4)
    return st.lists(fields(item), min_size=low, max_size=high)


def messages(type_name: str) -> st.SearchStrategy[Any]:
    described = ensure_type(type_name).fielddefs[type_name][1]
    strategies = {name: fields(description) for name, description in described}
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
