# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads messages of some topics in log order, a stretch of some seconds at a time, as bytes in one buffer.

Common MCAP files have a chunk index, and an index of messages after each chunk. Several of their chunks are
unpacked into one buffer, and the index gives the position of each message, without a loop over messages.
Memory holds one stretch and its overlap with the next. Other files are read message by message, as is a
damaged file from its first bad chunk on.
"""

from collections import deque
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.reader import make_reader

from trackslip_bags.mcap_index import (
    Bytes,
    ChannelIndex,
    FileChunk,
    MessageRows,
    chunks_of,
    join_rows,
    locate_messages,
    read_chunk,
    read_indexes,
    select_rows,
)
from trackslip_bags.metadata import LATEST_NS
from trackslip_bags.reader import Bag, require_one_type
from trackslip_common.arrays import IntArray
from trackslip_common.errors import InputError

STRETCH_NS = 10_000_000_000  # log time read at once
_STRETCH_BYTES = 32_000_000  # upper limit of a stretch
_STRETCH_MESSAGES = 5000  # upper limit of a stretch read message by message


class Span(NamedTuple):
    """A span of log times."""

    begin_ns: int
    end_ns: int


class Stretch(NamedTuple):
    """All messages logged before ``until_ns`` and not in an earlier stretch, in log order."""

    until_ns: int
    buffer: Bytes
    topics: IntArray  # (n,) indices of the topics among those requested, in the bag's order
    log_times_ns: IntArray  # (n,)
    starts: IntArray  # (n,) of the contents, in the buffer
    lengths: IntArray  # (n,) of the contents, bytes
    passed_twice: Span | None = None  # the longest, as the clock was set back; None: the order is unknown


def read_stretches(
    bag: Bag, topics: Collection[str], start_ns: int | None = None, stop_ns: int | None = None
) -> Iterator[Stretch]:
    """Yield the messages of the topics, logged from ``start_ns`` on and before ``stop_ns``.

    Messages of equal log time are in the order written.

    Raises:
        InputError: the bag is damaged inside.
    """
    first = bag.start_ns if start_ns is None else start_ns
    stop = bag.end_ns + 1 if stop_ns is None else stop_ns
    if bag.end_ns > LATEST_NS:
        fault = "messages are logged after 2262, beyond what is read"
        raise InputError(f"bag '{bag.path}': {fault}; trackslip recover leaves them out")
    types = {topic: bag.topics[topic].type_name for topic in bag.matching_topics(topics)}
    require_one_type(bag, types)
    reached_ns = first
    try:
        for stretch in _stretches_by_chunk(bag.files, types, first, stop):
            yield stretch
            reached_ns = stretch.until_ns
    except Exception:  # noqa: BLE001 (damaged bytes can raise anything in the parser)
        yield from _stretches_by_message(bag, types, reached_ns, stop)


def exchanged_parts(bag: Bag) -> Span | None:
    """Log times between two parts of a bag of which the second was recorded first, as its clock was set back.

    None: there are no such parts, or the order written is unknown.
    """
    try:
        with ExitStack() as stack:
            streams = [stack.enter_context(path.open("rb")) for path in bag.files]
            summaries = [make_reader(stream).get_summary() for stream in streams]
            parts = [part for one in summaries for part in chunks_of(streams[0], one, {}, 0)]
    except Exception:  # noqa: BLE001 (damaged bytes can raise anything in the parser)
        return None
    begins = np.array([part.chunk.message_start_time for part in parts], np.int64)
    ends = np.array([part.chunk.message_end_time for part in parts], np.int64)
    for k in range(1, len(parts)):
        if ends[k:].max() < begins[:k].min():
            return Span(int(ends[k:].max()), int(begins[:k].min()))
    return None


def _stretches_by_message(
    bag: Bag, types: Mapping[str, str], start_ns: int, stop_ns: int
) -> Iterator[Stretch]:
    numbers = {topic: number for number, topic in enumerate(types)}
    topics: list[int] = []
    times: list[int] = []
    raws: list[bytes] = []

    def stretch(until_ns: int) -> Stretch:
        lengths = np.array([len(raw) for raw in raws], dtype=np.int64)
        starts = np.cumsum(lengths) - lengths
        buffer = np.frombuffer(b"".join(raws), np.uint8)
        columns = [np.array(column, dtype=np.int64) for column in (topics, times)]
        return Stretch(until_ns, buffer, columns[0], columns[1], starts, lengths)

    for message in bag.messages(types, start_ns, stop_ns):
        if len(raws) >= _STRETCH_MESSAGES and message.log_time_ns > times[-1]:
            yield stretch(message.log_time_ns)
            topics, times, raws = [], [], []
        topics.append(numbers[message.topic])
        times.append(message.log_time_ns)
        raws.append(message.raw)
    yield stretch(stop_ns)


def _stretches_by_chunk(
    files: Collection[Path], types: Mapping[str, str], start_ns: int, stop_ns: int
) -> Iterator[Stretch]:
    """The stretches of common MCAP files, chunk by chunk."""
    if not files:
        raise ValueError("no common file")
    with ExitStack() as stack:
        parts: list[FileChunk] = []
        for path in files:
            stream = stack.enter_context(path.open("rb"))
            parts += chunks_of(stream, make_reader(stream).get_summary(), types, len(parts))
        parts = [
            part
            for part in parts
            if part.chunk.message_end_time >= start_ns
            and part.chunk.message_start_time < stop_ns
            and not part.file.numbers.keys().isdisjoint(part.chunk.message_index_offsets)
        ]
        waiting = deque(sorted(parts, key=lambda part: part.chunk.message_start_time))
        parts.clear()
        yield from _merge_chunks(waiting, start_ns, stop_ns)


def _merge_chunks(parts: deque[FileChunk], start_ns: int, stop_ns: int) -> Iterator[Stretch]:
    """Yield stretches from chunks in the order of their first message.

    Messages before the first message of the next chunk are complete.
    """
    buffer, waiting = np.empty(0, np.uint8), join_rows([])
    while parts:
        pieces, size = [buffer], buffer.size
        indexed: list[ChannelIndex] = []
        limit_ns, max_size = parts[0].chunk.message_start_time + STRETCH_NS, size + _STRETCH_BYTES
        while parts and parts[0].chunk.message_start_time < limit_ns and size < max_size:
            part = parts.popleft()
            content = read_chunk(part)
            indexed += read_indexes(part, size, size + content.size)
            pieces.append(content)
            size += content.size
        until_ns = min(parts[0].chunk.message_start_time, stop_ns) if parts else stop_ns
        joined = np.concatenate(pieces)
        rows = join_rows([waiting, locate_messages(joined, indexed)])
        since_start = rows.log_times_ns >= start_ns
        due = select_rows(rows, since_start & (rows.log_times_ns < until_ns))
        ordered = select_rows(due, np.lexsort((due.written[:, 1], due.written[:, 0], due.log_times_ns)))
        if until_ns > start_ns:
            columns = ordered.topics, ordered.log_times_ns, ordered.starts, ordered.lengths
            yield Stretch(until_ns, joined, *columns, _passed_twice(due))
        buffer, waiting = _copy_messages(
            joined, select_rows(rows, since_start & (rows.log_times_ns >= until_ns))
        )


def _passed_twice(rows: MessageRows) -> Span | None:
    """Log times of the longest step back of one topic in the order written."""
    order = np.lexsort((rows.written[:, 1], rows.written[:, 0], rows.topics))
    topics, times = rows.topics[order], rows.log_times_ns[order]
    steps = np.where(np.diff(topics) == 0, np.diff(times), 0)
    if steps.min(initial=0) == 0:
        return None
    k = int(steps.argmin())
    return Span(int(times[k + 1]), int(times[k]))


def _copy_messages(buffer: Bytes, rows: MessageRows) -> tuple[Bytes, MessageRows]:
    """A buffer with only these messages, and their rows."""
    ends = np.cumsum(rows.lengths)
    pairs = zip(rows.starts.tolist(), (rows.starts + rows.lengths).tolist(), strict=True)
    pieces = [buffer[start:end] for start, end in pairs]
    copied = np.concatenate(pieces) if pieces else np.empty(0, np.uint8)
    return copied, rows._replace(starts=ends - rows.lengths)
