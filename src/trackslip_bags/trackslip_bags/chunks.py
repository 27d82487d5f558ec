# SPDX-License-Identifier: Apache-2.0
"""Messages of some topics in log order, a stretch of some seconds at a time, as bytes in one buffer.

Common MCAP files (whole chunks that an index names, and an index of the messages behind each) are read chunk
by chunk: several are unpacked into one buffer, in which the index says where each message is, so that nothing
is done message by message. Memory holds one stretch, and what overlaps the next. Everything else, a damaged
file from the first bad chunk on among them, is read message by message.
"""

from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import IO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, ChunkIndex
from mcap.stream_reader import get_chunk_data_stream
from mcap.summary import Summary
from mcap.well_known import MessageEncoding
from numpy.typing import NDArray

from trackslip_bags.reader import Bag, absolute

IntArray = NDArray[np.int64]
Bytes = NDArray[np.uint8]

STRETCH_NS = 10_000_000_000  # of log time that is read at once
_STRETCH_BYTES = 32_000_000  # or so many, if that is less
_STRETCH_MESSAGES = 5000  # or so many, where they are read one by one
_HEAD = Struct("<BQ")  # of a record: what it is, bytes that follow
_RECORD = (("opcode", "u1"), ("length", "<u8"))
_HEADER = (("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("sent", "<u8"))
_MESSAGE = np.dtype([*_RECORD, *_HEADER])  # of a message, up to its content
_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])  # of a message index
_COMPRESSIONS = ("", "lz4", "zstd")


class Located(NamedTuple):
    """Messages in a buffer, one row each."""

    topics: IntArray  # (n,) their numbers
    log_times_ns: IntArray  # (n,)
    written: IntArray  # (n, 2) rank of the chunk by its place in the files, place in the chunk
    starts: IntArray  # (n,) of the content, in the buffer
    lengths: IntArray  # (n,) of the content, bytes


class Stretch(NamedTuple):
    """All messages logged before ``until_ns`` that no earlier stretch had, in log order."""

    until_ns: int
    buffer: Bytes
    topics: IntArray  # (n,) numbers of the topics, in the order asked for
    log_times_ns: IntArray  # (n,)
    starts: IntArray  # (n,) of the content, in the buffer
    lengths: IntArray  # (n,) of the content, bytes


def read_stretches(
    bag: Bag, topics: Collection[str], start_ns: int | None = None, stop_ns: int | None = None
) -> Iterator[Stretch]:
    """The messages of the topics (names as in the bag), logged from ``start_ns`` on and before ``stop_ns``.

    Those logged at the same time come in the order written.

    Raises:
        InputError: the bag turns out to be damaged inside.
    """
    first = bag.start_ns if start_ns is None else start_ns
    stop = bag.end_ns + 1 if stop_ns is None else stop_ns
    names = {absolute(topic) for topic in topics}
    types = {topic: info.type_name for topic, info in bag.topics.items() if absolute(topic) in names}
    reached_ns = first
    try:
        for stretch in _by_chunk(bag.files, types, first, stop):
            yield stretch
            reached_ns = stretch.until_ns
    except GeneratorExit:
        raise
    except Exception:  # noqa: BLE001 (damaged bytes can raise anything in the parser)
        yield from _one_by_one(bag, types, reached_ns, stop)


def _one_by_one(bag: Bag, types: Mapping[str, str], start_ns: int, stop_ns: int) -> Iterator[Stretch]:
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


class _File(NamedTuple):
    """An open file, and its channels."""

    stream: IO[bytes]
    numbers: dict[int, int]  # channel → number of its topic


class _Part(NamedTuple):
    """One chunk of a file."""

    file: _File
    rank: int  # by place
    chunk: ChunkIndex


def _by_chunk(
    files: Collection[Path], types: Mapping[str, str], start_ns: int, stop_ns: int
) -> Iterator[Stretch]:
    """The same from common files.

    Raises:
        Exception: a file is of another form, or damaged; what was read until then is whole.
    """
    if not files:
        raise ValueError("no common file")
    with ExitStack() as stack:
        parts: list[_Part] = []
        for path in files:
            stream = stack.enter_context(path.open("rb"))
            summary = make_reader(stream).get_summary()
            parts += _parts(stream, summary, types, len(parts))
        inside = [
            part
            for part in parts
            if part.chunk.message_end_time >= start_ns
            and part.chunk.message_start_time < stop_ns
            and not part.file.numbers.keys().isdisjoint(part.chunk.message_index_offsets)
        ]
        inside.sort(key=lambda part: part.chunk.message_start_time)
        yield from _stretches(inside, start_ns, stop_ns)


def _parts(stream: IO[bytes], summary: Summary | None, types: Mapping[str, str], known: int) -> list[_Part]:
    """The chunks of a file in the order written; ``known`` are those of the files before it."""
    if summary is None or summary.statistics is None:
        raise ValueError("no summary")
    indexes = sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
    if summary.statistics.message_count and not any(index.message_index_offsets for index in indexes):
        raise ValueError("no index of messages")
    file = _File(stream, _numbers(summary, types))
    return [_Part(file, known + k, index) for k, index in enumerate(indexes)]


def _numbers(summary: Summary, types: Mapping[str, str]) -> dict[int, int]:
    """Channel → number of its topic."""
    places = {topic: number for number, topic in enumerate(types)}
    channels = [channel for channel in summary.channels.values() if channel.topic in places]
    for channel in channels:
        known = summary.schemas[channel.schema_id].name == types[channel.topic]
        if not known or channel.message_encoding != MessageEncoding.CDR:
            raise ValueError(f"{channel.topic} of another type")
    return {channel.id: places[channel.topic] for channel in channels}


class _Indexed(NamedTuple):
    """What the index behind a chunk says of one channel."""

    entries: NDArray[np.void]  # (n,) _ENTRY
    channel: int
    topic: int  # its number
    rank: int  # of the chunk
    begin: int  # of the chunk in the buffer
    end: int
    first_ns: int  # log times that the chunk spans
    last_ns: int


def _stretches(parts: list[_Part], start_ns: int, stop_ns: int) -> Iterator[Stretch]:
    """The chunks are in the order of their first message: what comes before the next one's can go."""
    buffer, waiting = np.empty(0, np.uint8), _located([])
    k = 0
    while k < len(parts):
        pieces, size = [buffer], buffer.size
        indexed: list[_Indexed] = []
        limit_ns, most = parts[k].chunk.message_start_time + STRETCH_NS, size + _STRETCH_BYTES
        while k < len(parts) and parts[k].chunk.message_start_time < limit_ns and size < most:
            content = _content(parts[k])
            indexed += _indexed(parts[k], size, size + content.size)
            pieces.append(content)
            size += content.size
            k += 1
        until_ns = min(parts[k].chunk.message_start_time, stop_ns) if k < len(parts) else stop_ns
        whole = np.concatenate(pieces)
        rows = _located([waiting, _messages(whole, indexed)])
        wanted = rows.log_times_ns >= start_ns
        now = _chosen(rows, wanted & (rows.log_times_ns < until_ns))
        ready = _chosen(now, np.lexsort((now.written[:, 1], now.written[:, 0], now.log_times_ns)))
        if until_ns > start_ns:
            yield Stretch(until_ns, whole, ready.topics, ready.log_times_ns, ready.starts, ready.lengths)
        buffer, waiting = _carried(whole, _chosen(rows, wanted & (rows.log_times_ns >= until_ns)))


def _carried(buffer: Bytes, rows: Located) -> tuple[Bytes, Located]:
    """A buffer with these messages alone."""
    ends = np.cumsum(rows.lengths)
    pairs = zip(rows.starts.tolist(), (rows.starts + rows.lengths).tolist(), strict=True)
    pieces = [buffer[start:end] for start, end in pairs]
    joined = np.concatenate(pieces) if pieces else np.empty(0, np.uint8)
    return joined, rows._replace(starts=ends - rows.lengths)


def _located(found: list[Located]) -> Located:
    """All of them as one."""
    none = np.empty(0, np.int64)
    blank = Located(none, none, none.reshape(0, 2), none, none)
    return Located(*(np.concatenate(columns) for columns in zip(blank, *found, strict=True)))


def _chosen(rows: Located, which: NDArray[np.bool_] | IntArray) -> Located:
    return Located(*(column[which] for column in rows))


def _content(part: _Part) -> Bytes:
    """The records of a chunk that passes its checks."""
    stream, index = part.file.stream, part.chunk
    stream.seek(index.chunk_start_offset + _HEAD.size)
    chunk = Chunk.read(ReadDataStream(BytesIO(stream.read(index.chunk_length - _HEAD.size))))
    stated = index.compression, index.compressed_size, index.uncompressed_size
    if stated != (chunk.compression, len(chunk.data), chunk.uncompressed_size):
        raise ValueError("a chunk other than its index says")
    if chunk.compression not in _COMPRESSIONS:
        raise ValueError("a chunk of another compression")
    records, size = get_chunk_data_stream(chunk, validate_crc=True)
    if size != index.uncompressed_size:
        raise ValueError("a chunk of another size")
    return np.frombuffer(records.read(size), np.uint8)


def _indexed(part: _Part, begin: int, end: int) -> Iterator[_Indexed]:
    """Of each wanted channel; the chunk lies between ``begin`` and ``end`` in the buffer."""
    stream, index = part.file.stream, part.chunk
    stream.seek(index.chunk_start_offset + index.chunk_length)
    data = stream.read(index.message_index_length)
    for channel, topic in part.file.numbers.items():
        if channel in index.message_index_offsets:
            at = index.message_index_offsets[channel] - index.chunk_start_offset - index.chunk_length
            times = index.message_start_time, index.message_end_time
            yield _Indexed(_entries(data, at, channel), channel, topic, part.rank, begin, end, *times)


def _messages(buffer: Bytes, indexed: list[_Indexed]) -> Located:
    """Where the messages are, each checked against its index."""
    if not indexed:
        return _located([])
    counts = [one.entries.size for one in indexed]

    def of_each(name: str) -> IntArray:
        return np.repeat(np.array([getattr(one, name) for one in indexed], dtype=np.int64), counts)

    entries = np.concatenate([one.entries for one in indexed])
    log_times_ns, at = entries["log"].astype(np.int64), entries["offset"].astype(np.int64)
    offsets, ends = of_each("begin") + at, of_each("end")
    if ((at < 0) | (offsets + _MESSAGE.itemsize > ends)).any():
        raise ValueError("an index beyond its chunk")
    heads = buffer[offsets[:, np.newaxis] + np.arange(_MESSAGE.itemsize)].view(_MESSAGE)[:, 0]
    lengths = heads["length"].astype(np.int64) - (_MESSAGE.itemsize - _HEAD.size)
    starts = offsets + _MESSAGE.itemsize
    sound = (
        (heads["opcode"] == int(Opcode.MESSAGE))
        & (heads["channel"] == of_each("channel"))
        & (heads["log"] == entries["log"])
        & (lengths >= 0)
        & (lengths <= ends - starts)
        & (log_times_ns >= of_each("first_ns"))
        & (log_times_ns <= of_each("last_ns"))
    )
    if not sound.all() or np.unique(offsets).size < offsets.size:
        raise ValueError("an index of messages that are not there")
    return Located(of_each("topic"), log_times_ns, np.column_stack((of_each("rank"), at)), starts, lengths)


def _entries(data: bytes, at: int, channel: int) -> NDArray[np.void]:
    """Of a message index record that begins ``at``."""
    opcode, length = _HEAD.unpack_from(data, at) if at >= 0 else (0, 0)
    begin = at + _HEAD.size
    named = int.from_bytes(data[begin : begin + 2], "little")
    size = int.from_bytes(data[begin + 2 : begin + 6], "little")
    whole = length == size + 6 and begin + length <= len(data) and size % _ENTRY.itemsize == 0
    if opcode != int(Opcode.MESSAGE_INDEX) or named != channel or not whole:
        raise ValueError("no index of messages")
    return np.frombuffer(data, _ENTRY, size // _ENTRY.itemsize, begin + 6)
