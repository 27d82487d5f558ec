# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reading topics chunk by chunk equals reading message by message: whole, truncated and damaged files."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple
from unittest import mock

from fixtures.made_bags import TEXT, text
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer

from trackslip_bags import chunks
from trackslip_bags.chunks import read_stretches
from trackslip_bags.reader import Bag, open_bag
from trackslip_bags.types import known_schema
from trackslip_common.errors import InputError

TOPICS = ("/a", "/b", "/c")

Messages = list[tuple[str, int, bytes]]
"""Topic, log time, CDR."""


class Recorded(NamedTuple):
    """Messages of a file, and how they are written."""

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
            st.integers(0, 20),  # equal times, and chunks that overlap in time
            st.text("xyz", max_size=30).map(text),
        ),
        max_size=30,
    ),
    st.integers(1, 600),
    st.sampled_from(CompressionType),
    st.sampled_from((IndexType.ALL, IndexType.ALL, IndexType.CHUNK, IndexType.NONE)),
    st.booleans(),
)
topic_sets = st.sets(st.sampled_from((*TOPICS, "b", "/none")))


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
            schema = writer.register_schema(TEXT, "ros2msg", known_schema(TEXT).data)
            channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in TOPICS}
            for topic, time_ns, raw in recorded.messages:
                writer.add_message(channels[topic], time_ns, raw, time_ns)
            writer.finish()
        yield path


def at_once(bag: Bag, topics: set[str], *span: int) -> Messages | str:
    """The messages of all stretches, in log order, or the error."""
    requested = [topic for topic in bag.topics if topic in {f"/{t.removeprefix('/')}" for t in topics}]
    messages: Messages = []
    try:
        for stretch in read_stretches(bag, topics, *span):
            content = stretch.buffer.tobytes()
            ends = (stretch.starts + stretch.lengths).tolist()
            assert (stretch.log_times_ns < stretch.until_ns).all()
            columns = (stretch.topics, stretch.log_times_ns, stretch.starts)
            for topic, time_ns, start, end in zip(*(c.tolist() for c in columns), ends, strict=True):
                messages.append((requested[topic], time_ns, content[start:end]))
    except InputError as error:
        return str(error)
    return messages


def one_by_one(bag: Bag, topics: set[str], *span: int) -> Messages | str:
    try:
        return [(m.topic, m.log_time_ns, m.raw) for m in bag.messages(topics, *span)]
    except InputError as error:
        return str(error)


@contextmanager
def stretches_of(ns: int) -> Iterator[None]:
    """Make stretches ``ns`` long, so that a file has several."""
    with mock.patch.object(chunks, "STRETCH_NS", ns):
        yield


spans = st.one_of(st.just(()), st.tuples(st.integers(0, 20), st.integers(0, 20)))


@settings(max_examples=100)
@given(recordings, topic_sets, spans, st.integers(1, 30))
def test_whole_files_and_parts_of_them(
    recorded: Recorded, topics: set[str], span: tuple[int, ...], stretch_ns: int
) -> None:
    with written(recorded) as path, open_bag(path) as bag, stretches_of(stretch_ns):
        assert at_once(bag, topics, *span) == one_by_one(bag, topics, *span)
        if recorded.index_types is IndexType.ALL and recorded.messages:
            types = dict.fromkeys(TOPICS, TEXT)
            by_chunk = chunks._stretches_by_chunk(bag.files, types, bag.start_ns, bag.end_ns + 1)
            assert sum(len(stretch.topics) for stretch in by_chunk) == len(recorded.messages)


@settings(max_examples=80)
@given(recordings, topic_sets, st.floats(0.0, 1.0), st.integers(0, 255))
def test_cut_and_damaged_files(recorded: Recorded, topics: set[str], at: float, value: int) -> None:
    """Files are truncated at a place or have another value there; both ways give the same error."""
    with written(recorded) as path, stretches_of(5):
        data = path.read_bytes()
        place = round(at * (len(data) - 1))
        for damaged in (data[:place], data[:place] + bytes((value,)) + data[place + 1 :]):
            path.write_bytes(damaged)
            try:
                bag = open_bag(path)
            except InputError:
                continue
            with bag:
                assert at_once(bag, topics) == one_by_one(bag, topics)
