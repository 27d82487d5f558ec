# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Positions of messages in the chunks of an MCAP file, from the checked index after each chunk."""

from collections.abc import Iterator, Mapping
from io import BytesIO
from struct import Struct
from typing import IO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex
from mcap.stream_reader import get_chunk_data_stream
from mcap.summary import Summary
from mcap.well_known import MessageEncoding
from numpy.typing import NDArray

from trackslip_bags.unpacking import decompress_chunk
from trackslip_common.arrays import BoolArray, IntArray

Bytes = NDArray[np.uint8]

_HEAD = Struct("<BQ")  # of a record: opcode, length of the content
_RECORD = (("opcode", "u1"), ("length", "<u8"))
_HEADER = (("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("sent", "<u8"))
_MESSAGE = np.dtype([*_RECORD, *_HEADER])  # of a message, up to its content
_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])  # of a message index


class MessageRows(NamedTuple):
    """Messages in a buffer, one row each."""

    topics: IntArray  # (n,) indices of the topics
    log_times_ns: IntArray  # (n,)
    written: IntArray  # (n, 2) rank of the chunk in the files, offset in the chunk
    starts: IntArray  # (n,) of the content, in the buffer
    lengths: IntArray  # (n,) of the content, bytes


class File(NamedTuple):
    """An open file, and its channels."""

    stream: IO[bytes]
    numbers: dict[int, int]  # channel → index of its topic


class FileChunk(NamedTuple):
    """One chunk of a file."""

    file: File
    rank: int  # order in the files
    chunk: ChunkIndex


class ChannelIndex(NamedTuple):
    """The entries of one channel in the index after a chunk."""

    entries: NDArray[np.void]  # (n,) _ENTRY
    channel: int
    topic: int  # index of the topic
    rank: int  # of the chunk
    begin: int  # of the chunk, in the buffer
    end: int
    first_ns: int  # log times of the chunk
    last_ns: int


def chunks_of(
    stream: IO[bytes], summary: Summary | None, types: Mapping[str, str], first_rank: int
) -> list[FileChunk]:
    """The chunks of a file in the order written; ``first_rank``: number of chunks of the files before it."""
    if summary is None or summary.statistics is None:
        raise ValueError("no summary")
    indexes = sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
    if summary.statistics.message_count and not any(index.message_index_offsets for index in indexes):
        raise ValueError("no index of messages")
    file = File(stream, _numbers(summary, types))
    return [FileChunk(file, first_rank + k, index) for k, index in enumerate(indexes)]


def _numbers(summary: Summary, types: Mapping[str, str]) -> dict[int, int]:
    """Channel → index of its topic."""
    numbers = {topic: number for number, topic in enumerate(types)}
    channels = [channel for channel in summary.channels.values() if channel.topic in numbers]
    for channel in channels:
        is_of_type = summary.schemas[channel.schema_id].name == types[channel.topic]
        if not is_of_type or channel.message_encoding != MessageEncoding.CDR:
            raise ValueError(f"{channel.topic} of another type")
    return {channel.id: numbers[channel.topic] for channel in channels}


def join_rows(parts: list[MessageRows]) -> MessageRows:
    """All rows as one record."""
    empty = np.empty(0, np.int64)
    blank = MessageRows(empty, empty, empty.reshape(0, 2), empty, empty)
    return MessageRows(*(np.concatenate(columns) for columns in zip(blank, *parts, strict=True)))


def select_rows(rows: MessageRows, which: BoolArray | IntArray) -> MessageRows:
    """Some of the rows, by mask or indices."""
    return MessageRows(*(column[which] for column in rows))


def read_chunk(part: FileChunk) -> Bytes:
    """The unpacked records of a chunk; raises if it does not match its index."""
    stream, index = part.file.stream, part.chunk
    stream.seek(index.chunk_start_offset + _HEAD.size)
    chunk = Chunk.read(ReadDataStream(BytesIO(stream.read(index.chunk_length - _HEAD.size))))
    stated = index.compression, index.compressed_size, index.uncompressed_size
    if stated != (chunk.compression, len(chunk.data), chunk.uncompressed_size):
        raise ValueError("a chunk that differs from its index")
    records, size = get_chunk_data_stream(decompress_chunk(chunk), validate_crc=True)
    return np.frombuffer(records.read(size), np.uint8)


def read_indexes(part: FileChunk, begin: int, end: int) -> Iterator[ChannelIndex]:
    """The index of each requested channel; the chunk lies between ``begin`` and ``end`` in the buffer."""
    stream, index = part.file.stream, part.chunk
    stream.seek(index.chunk_start_offset + index.chunk_length)
    data = stream.read(index.message_index_length)
    for channel, topic in part.file.numbers.items():
        if channel in index.message_index_offsets:
            at = index.message_index_offsets[channel] - index.chunk_start_offset - index.chunk_length
            times = index.message_start_time, index.message_end_time
            yield ChannelIndex(_entries(data, at, channel), channel, topic, part.rank, begin, end, *times)


def locate_messages(buffer: Bytes, indexed: list[ChannelIndex]) -> MessageRows:
    """Positions of the messages, each checked against its index."""
    if not indexed:
        return join_rows([])
    counts = [one.entries.size for one in indexed]

    def repeat_field(name: str) -> IntArray:
        return np.repeat(np.array([getattr(one, name) for one in indexed], dtype=np.int64), counts)

    entries = np.concatenate([one.entries for one in indexed])
    log_times_ns, chunk_offsets = entries["log"].astype(np.int64), entries["offset"].astype(np.int64)
    offsets, ends = repeat_field("begin") + chunk_offsets, repeat_field("end")
    if ((chunk_offsets < 0) | (offsets + _MESSAGE.itemsize > ends)).any():
        raise ValueError("an index beyond its chunk")
    heads = buffer[offsets[:, np.newaxis] + np.arange(_MESSAGE.itemsize)].view(_MESSAGE)[:, 0]
    lengths = heads["length"].astype(np.int64) - (_MESSAGE.itemsize - _HEAD.size)
    starts = offsets + _MESSAGE.itemsize
    is_valid = (
        (heads["opcode"] == int(Opcode.MESSAGE))
        & (heads["channel"] == repeat_field("channel"))
        & (heads["log"] == entries["log"])
        & (lengths >= 0)
        & (lengths <= ends - starts)
        & (log_times_ns >= repeat_field("first_ns"))
        & (log_times_ns <= repeat_field("last_ns"))
    )
    if not is_valid.all() or np.unique(offsets).size < offsets.size:
        raise ValueError("an index of messages that are not there")
    return MessageRows(
        repeat_field("topic"),
        log_times_ns,
        np.column_stack((repeat_field("rank"), chunk_offsets)),
        starts,
        lengths,
    )


def _entries(data: bytes, at: int, channel: int) -> NDArray[np.void]:
    """Entries of the message index record that begins ``at``."""
    opcode, length = _HEAD.unpack_from(data, at) if at >= 0 else (0, 0)
    begin = at + _HEAD.size
    stated_channel = int.from_bytes(data[begin : begin + 2], "little")
    size = int.from_bytes(data[begin + 2 : begin + 6], "little")
    is_complete = length == size + 6 and begin + length <= len(data) and size % _ENTRY.itemsize == 0
    if opcode != int(Opcode.MESSAGE_INDEX) or stated_channel != channel or not is_complete:
        raise ValueError("no index of messages")
    return np.frombuffer(data, _ENTRY, size // _ENTRY.itemsize, begin + 6)
