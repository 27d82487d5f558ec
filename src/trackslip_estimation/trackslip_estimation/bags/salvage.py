# SPDX-License-Identifier: Apache-2.0
"""What can be read of an MCAP file whose recorder was killed: everything up to its last whole chunk."""

from collections.abc import Iterator
from pathlib import Path
from typing import IO, NamedTuple

from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.well_known import MessageEncoding
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

_FORMATS = {
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
    "omgidl": MessageDefinitionFormat.IDL,
}


class SalvagedTopic(NamedTuple):
    """One channel of a damaged file."""

    topic: str
    type_name: str
    definition: MessageDefinition


class Salvage(NamedTuple):
    """What a damaged file still holds; messages are (log time in ns, channel, CDR bytes) in log order.

    They are held in memory: a recording is split long before that matters. ``problem`` is empty where the
    file turned out to be whole.
    """

    topics: dict[int, SalvagedTopic]
    messages: list[tuple[int, int, bytes]]
    problem: str


def salvage(path: Path) -> Salvage:
    """Read a damaged file as far as it goes.

    Raises:
        OSError: it cannot be opened.
    """
    schemas: dict[int, Schema] = {}
    topics: dict[int, SalvagedTopic] = {}
    messages: list[tuple[int, int, bytes]] = []
    problem = ""
    with path.open("rb") as stream:
        try:
            for record in _records(stream):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel) and record.message_encoding == MessageEncoding.CDR:
                    topics[record.id] = _topic(record, schemas)
                elif isinstance(record, Message) and record.channel_id in topics:
                    messages.append((record.log_time, record.channel_id, record.data))
        except Exception as error:  # noqa: BLE001 (damaged bytes can raise anything in the parser)
            place = stream.tell()
            problem = (
                f"unreadable at byte {place} ({type(error).__name__})" if stream.read(1) else "cut short"
            )
    messages.sort(key=lambda message: message[0])
    return Salvage(topics, messages, problem)


def _records(stream: IO[bytes]) -> Iterator[object]:
    """The records of a file, those of a chunk only where the whole chunk passes its checks."""
    for record in StreamReader(stream, emit_chunks=True).records:
        if isinstance(record, Chunk):
            yield from breakup_chunk(record, validate_crc=True)
        else:
            yield record


def _topic(channel: Channel, schemas: dict[int, Schema]) -> SalvagedTopic:
    schema = schemas[channel.schema_id]
    kind = _FORMATS.get(schema.encoding, MessageDefinitionFormat.NONE)
    text = schema.data.decode() if kind != MessageDefinitionFormat.NONE else ""
    return SalvagedTopic(channel.topic, schema.name, MessageDefinition(kind, text))
