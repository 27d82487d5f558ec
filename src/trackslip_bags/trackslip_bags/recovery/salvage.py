# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads a damaged MCAP file: every complete chunk up to the truncation.

A killed recorder leaves a truncated file; a bad disk leaves chunks with wrong checksums.
"""

import os
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap.well_known import MessageEncoding

from trackslip_bags.metadata import IDL, LATEST_NS, MAX_TOPICS, ROS2MSG
from trackslip_bags.metadata import Schema as KnownSchema
from trackslip_bags.unpacking import decompress_chunk, decompress_message, is_packed

MAGIC = b"\x89MCAP0\r\n"
_HEAD = 9  # bytes before the content of a record: opcode (1), length (8)
_LAST_OPCODE, _FIRST_PRIVATE = 0x0F, 0x80


class SalvagedTopic(NamedTuple):
    """One channel of a damaged file."""

    topic: str
    type_name: str
    schema: KnownSchema
    qos_yaml: str


class DamagedFile:
    """An MCAP file, read in the order written; records that fail a check are skipped.

    The counts of losses are valid once ``messages`` has ended.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[int, SalvagedTopic] = {}
        self.is_truncated = False
        self.lost_bytes = 0  # after the last complete record
        self.bad_chunks = 0
        self.bad_records = 0  # in complete chunks: of an unknown channel, or with an invalid time
        self.share_read = 0.0  # of the file
        self._schemas: dict[int, Schema] = {}

    @property
    def problem(self) -> str:
        """Short description of the damage; empty without damage."""
        parts = [
            "cut short" if self.is_truncated else "",
            f"{self.bad_chunks} damaged chunks" if self.bad_chunks else "",
            f"{self.bad_records} unusable records" if self.bad_records else "",
        ]
        return ", ".join(filter(None, parts))

    def messages(self) -> Iterator[Message]:
        """Yield every complete message; its channel is in ``topics`` by then.

        Raises:
            OSError: the file cannot be read.
        """
        with self.path.open("rb") as stream:
            self._read_summary(stream)
            for opcode, content in self._records(stream):
                for record in self._parse_records(opcode, content):
                    if isinstance(record, Message):
                        if self._is_usable(record):
                            yield record
                    else:
                        self._add_record(record)

    def _read_summary(self, stream: IO[bytes]) -> None:
        """Read channels from the summary, if the file is complete: its first chunk may be damaged."""
        try:
            summary = make_reader(stream).get_summary()
        except Exception:  # noqa: BLE001 (damaged bytes can raise anything in the parser)
            summary = None
        if summary is not None:
            for record in (*summary.schemas.values(), *summary.channels.values()):
                self._add_record(record)
        stream.seek(0)

    def _records(self, stream: IO[bytes]) -> Iterator[tuple[int, bytes]]:
        """(opcode, content) of each complete record up to the file's end or truncation."""
        size = os.fstat(stream.fileno()).st_size
        end = len(MAGIC)
        self.is_truncated = True
        opcode = 0
        if stream.read(end) != MAGIC:
            self.lost_bytes = size
            return
        while opcode != Opcode.FOOTER:
            head = stream.read(_HEAD)
            opcode, length = head[0] if head else 0, int.from_bytes(head[1:], "little")
            is_known = 0 < opcode <= _LAST_OPCODE or opcode >= _FIRST_PRIVATE
            if len(head) < _HEAD or not is_known or end + _HEAD + length > size:
                self.lost_bytes = size - end
                return
            end += _HEAD + length
            self.share_read = end / size
            yield opcode, stream.read(length)
        self.is_truncated = stream.read(len(MAGIC) + 1) != MAGIC

    def _parse_records(self, opcode: int, content: bytes) -> list[object]:
        """The schemas, channels and messages in a record; none if it fails its checks."""
        stream = ReadDataStream(BytesIO(content))
        try:
            if opcode == Opcode.CHUNK:
                return list(breakup_chunk(decompress_chunk(Chunk.read(stream)), validate_crc=True))
            if opcode == Opcode.MESSAGE:
                return [Message.read(stream, len(content))]
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                return [(Schema if opcode == Opcode.SCHEMA else Channel).read(stream)]
        except Exception:  # noqa: BLE001 (damaged bytes can raise anything in the parser)
            if opcode == Opcode.CHUNK:
                self.bad_chunks += 1
            else:
                self.bad_records += 1
        return []

    def _add_record(self, record: object) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel) and record.message_encoding == MessageEncoding.CDR:
            if record.id not in self.topics and len(self.topics) >= MAX_TOPICS:
                self.bad_records += 1
                return
            try:
                self.topics[record.id] = _topic(record, self._schemas[record.schema_id])
            except (KeyError, UnicodeDecodeError):
                self.bad_records += 1

    def _is_usable(self, message: Message) -> bool:
        is_usable = message.channel_id in self.topics and message.log_time <= LATEST_NS
        if is_usable and is_packed(message.data):
            try:
                message.data = decompress_message(message.data)
            except Exception:  # noqa: BLE001 (damaged bytes can raise anything in the library)
                is_usable = False
        self.bad_records += not is_usable
        return is_usable


def _topic(channel: Channel, schema: Schema) -> SalvagedTopic:
    is_known = schema.encoding in (ROS2MSG, *IDL)
    encoding, data = (schema.encoding, schema.data) if is_known else ("", b"")
    data.decode()
    definition = KnownSchema(encoding, data, channel.metadata.get("topic_type_hash", ""))
    return SalvagedTopic(
        channel.topic, schema.name, definition, channel.metadata.get("offered_qos_profiles", "")
    )
