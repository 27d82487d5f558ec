# SPDX-License-Identifier: Apache-2.0
"""Topics read chunk by chunk are what they are message by message: of whole files, cut and spoilt ones."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer

from trackslip_bags import chunks
from trackslip_bags.chunks import by_topic
from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import Bag, open_bag
from trackslip_bags.types import schema_text
from trackslip_common.errors import InputError

TEXT = "std_msgs/msg/String"
TOPICS = ("/a", "/b", "/c")

Found = dict[str, list[tuple[int, int, bytes]]]
"""Topic → place among all, log time, CDR."""


class Recorded(NamedTuple):
    """A file's messages as written, and how."""

    messages: list[tuple[str, int, bytes]]  # topic, log time, CDR
    chunk_size: int
    compression: CompressionType
    index_types: IndexType
    checksums: bool


recordings = st.builds(
    Recorded,
    st.lists(
        st.tuples(
            st.sampled_from(TOPICS),
            st.integers(0, 20),  # ties, and chunks that overlap in time
            st.text("xyz", max_size=30).map(lambda data: serialize(make(TEXT, data=data))),
        ),
        max_size=30,
    ),
    st.integers(1, 600),
    st.sampled_from(CompressionType),
    st.sampled_from((IndexType.ALL, IndexType.ALL, IndexType.CHUNK, IndexType.NONE)),
    st.booleans(),
)
wishes = st.sets(st.sampled_from((*TOPICS, "b", "/none")))


@contextmanager
def written(recorded: Recorded) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag.mcap"
        with path.open("wb") as stream:
            writer = Writer(
                stream,
                chunk_size=recorded.chunk_size,
                compression=recorded.compression,
                index_types=recorded.index_types,
                enable_crcs=recorded.checksums,
            )
            writer.start(profile="ros2", library="test")
            schema = writer.register_schema(TEXT, "ros2msg", schema_text(TEXT).encode())
            channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in TOPICS}
            for topic, time_ns, raw in recorded.messages:
                writer.add_message(channels[topic], time_ns, raw, time_ns)
            writer.finish()  # type: ignore[no-untyped-call]
        yield path


def at_once(bag: Bag, topics: set[str]) -> Found | str:
    try:
        found = by_topic(bag, topics)
    except InputError as error:
        return str(error)
    return {
        topic: list(zip(m.order.tolist(), m.log_times_ns.tolist(), m.raws, strict=True))
        for topic, m in found.items()
    }


def one_by_one(bag: Bag, topics: set[str]) -> Found | str:
    found: Found = {}
    try:
        for place, m in enumerate(bag.messages(topics)):
            found.setdefault(m.topic, []).append((place, m.log_time_ns, m.raw))
    except InputError as error:
        return str(error)
    return found


@settings(max_examples=150, deadline=None, derandomize=True)
@given(recordings, wishes)
def test_whole_files(recorded: Recorded, topics: set[str]) -> None:
    with written(recorded) as path, open_bag(path) as bag:
        found = at_once(bag, topics)
        assert found == one_by_one(bag, topics)
        assert list(found) == list(one_by_one(bag, topics))  # in the same order
        if recorded.index_types is IndexType.ALL and recorded.messages:
            types = dict.fromkeys(TOPICS, TEXT)
            raws = [raw for _, _, raw in sorted(recorded.messages, key=lambda m: m[1])]
            by_chunk = chunks._by_chunk(bag, types)
            assert by_chunk is not None
            assert by_chunk.raws == raws


@settings(max_examples=200, deadline=None, derandomize=True)
@given(recordings, wishes, st.floats(0.0, 1.0), st.integers(0, 255))
def test_cut_and_spoilt_files(recorded: Recorded, topics: set[str], at: float, value: int) -> None:
    """Cut at a place, or with another value there; what is refused is refused in the same words."""
    with written(recorded) as path:
        data = path.read_bytes()
        place = round(at * (len(data) - 1))
        for spoilt in (data[:place], data[:place] + bytes((value,)) + data[place + 1 :]):
            path.write_bytes(spoilt)
            try:
                bag = open_bag(path)
            except InputError:
                continue
            with bag:
                assert at_once(bag, topics) == one_by_one(bag, topics)
