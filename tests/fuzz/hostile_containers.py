# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bags that are hostile outside of their messages: MCAP records, file names, other files.

``hostile_bags.py`` has hostile metadata.
"""

import os
import struct
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from mcap.writer import CompressionType, IndexType, Writer

from hostile_messages import Family, Line, good, write
from trackslip_bags.writer import own_schema


def damages() -> Family:
    """Truncated files, changed bytes, gaps, appended data."""
    variants: dict[str, Callable[[bytearray], bytes]] = {
        "twice": lambda b: bytes(b + b),
        "head twice": lambda b: bytes(b[: len(b) // 2] + b),
        "tail": lambda b: bytes(b) + bytes(100_000),
        "long record": lambda b: bytes(b[:8]) + b"\x01" + (2**63).to_bytes(8, "little") + bytes(b[17:]),
        "no magic at the end": lambda b: bytes(b[:-8]),
        "reversed": lambda b: bytes(b[::-1]),
    }
    for share in (0.0, 0.001, 0.02, 0.1, 0.3, 0.6, 0.95, 0.97, 0.99, 0.999):
        variants[f"cut at {share:g}"] = partial(_cut, share)
        variants[f"zeros at {share:g}"] = partial(_over, share, bytes(5000))
        variants[f"ones at {share:g}"] = partial(_over, share, b"\xff" * 9)
    for name, variant in variants.items():
        for bare in (False, True):
            yield f"damage={name}{' bare' * bare}", partial(_damaged, variant, bare)


def _damaged(variant: Callable[[bytearray], bytes], bare: bool, folder: Path) -> Path:
    bag = write(good(), folder)
    (file,) = bag.glob("*.mcap")
    file.write_bytes(variant(bytearray(file.read_bytes())))
    return _without_metadata(bag) if bare else bag


def _without_metadata(bag: Path) -> Path:
    (bag / "metadata.yaml").unlink()
    return bag


def _cut(share: float, content: bytearray) -> bytes:
    return bytes(content[: int(share * len(content))])


def _over(share: float, piece: bytes, content: bytearray) -> bytes:
    at = int(share * len(content))
    content[at : at + len(piece)] = piece
    return bytes(content)


def records() -> Family:
    """MCAP files with unusual records."""
    writers: dict[str, Callable[[Writer], None]] = {
        "60000 schemas": lambda w: _many(w, schemas=60_000, channels=1),
        "60000 channels": lambda w: _many(w, schemas=1, channels=60_000),
        "20000 of both": lambda w: _many(w, schemas=20_000, channels=20_000),
        "3000 topics with a message": lambda w: _many(w, schemas=3000, channels=3000, messages=3000),
        "a message on each of 60000": lambda w: _many(w, schemas=1, channels=60_000, messages=60_000),
        "schemas of 100 kB": lambda w: _many(w, schemas=500, channels=500, size=100_000),
        "one schema of 50 MB": lambda w: _many(w, schemas=1, channels=1, size=50_000_000),
        "400000 empty messages": lambda w: _many(w, schemas=1, channels=1, messages=400_000, content=b""),
        "a message of 200 MB": lambda w: _many(
            w, schemas=1, channels=1, messages=1, content=bytes(200_000_000)
        ),
        "ten messages of 60 MB": lambda w: _many(
            w, schemas=1, channels=1, messages=10, content=bytes(60_000_000)
        ),
        "a message of 200 MB of text": lambda w: _text(w, 200_000_000),
        "an array of 10^7 values": _large_array,
        "attachments": _attachments,
        "metadata records": _metadata_records,
        "definition of other fields": lambda w: _defined(w, "int32 x"),
        "definition of no fields": lambda w: _defined(w, ""),
        "definition of garbage": lambda w: _defined(w, "\x1b[2J ]] [["),
        "definition of 10000 fields": lambda w: _defined(
            w, "".join(f"float64 f{k}\n" for k in range(10_000))
        ),
        "definition with deep types": lambda w: _defined(w, _deep(300)),
        "definition with sequences of sequences": lambda w: _defined(w, "string[<=5] x\nwstring y\nchar[] z"),
        "definition in idl": lambda w: _defined(
            w, "module a { module msg { struct B { double x; }; }; };", "ros2idl"
        ),
        "definition in protobuf": lambda w: _defined(w, "x", "protobuf"),
        "definition of nobody": lambda w: _defined(w, "", ""),
    }
    for name, fill in writers.items():
        for packed in (CompressionType.ZSTD, CompressionType.NONE):
            if packed == CompressionType.NONE and "MB" in name:
                continue
            yield f"mcap={name} {packed.name}", partial(_mcap, fill, packed)
    for name, indexes in (
        ("no", IndexType.NONE),
        ("attachment", IndexType.ATTACHMENT),
        ("chunk", IndexType.CHUNK),
    ):
        yield f"mcap={name} index", partial(_mcap, _good, CompressionType.ZSTD, indexes=indexes)
    yield "mcap=no chunks", partial(_mcap, _good, CompressionType.NONE, chunks=False)
    yield "mcap=tiny chunks", partial(_mcap, _good, CompressionType.NONE, size=1)
    yield "mcap=other encoding", partial(_mcap, partial(_good, encoding="ros1"), CompressionType.NONE)
    yield "mcap=no schema", partial(_mcap, partial(_good, no_schema=True), CompressionType.NONE)
    yield "mcap=100000 empty chunks", _empty_chunks
    yield "mcap=200000 schemas bare", _bare_schemas


def _mcap(
    fill: Callable[[Writer], None], packed: CompressionType, folder: Path, *,
    indexes: IndexType = IndexType.ALL, chunks: bool = True, size: int = 1 << 20,
) -> Path:  # fmt: skip
    file = folder / "bag.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, compression=packed, index_types=indexes, use_chunking=chunks, chunk_size=size)
        writer.start("ros2")
        fill(writer)
        writer.finish()  # type: ignore[no-untyped-call]
    return file


def _many(
    writer: Writer,
    *,
    schemas: int,
    channels: int,
    messages: int = 0,
    size: int = 10,
    content: bytes = b"\0\1\0\0\1\0\0\0\0",
) -> None:
    text = b"string data\n" + b"#" * size
    schema_ids = [
        writer.register_schema("std_msgs/msg/String" if k == 0 else f"a/msg/B{k}", "ros2msg", text)
        for k in range(schemas)
    ]
    channel_ids = [writer.register_channel(f"/t{k}", "cdr", schema_ids[k % schemas]) for k in range(channels)]
    for k in range(messages):
        writer.add_message(channel_ids[k % channels], 10**18 + k, content, 10**18 + k)


def _text(writer: Writer, size: int) -> None:
    raw = b"\0\1\0\0" + struct.pack("<I", size + 1) + b"x" * size + b"\0"
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    for topic in ("/vehicle", "/slip_estimator/parameters", "/diagnostics"):
        writer.add_message(writer.register_channel(topic, "cdr", schema), 10**18, raw, 10**18)


def _large_array(writer: Writer) -> None:
    raw = next(line for line in good() if line.topic == "/scan").raw
    channel = writer.register_channel("/scan", "cdr", _own_schema(writer, "sensor_msgs/msg/LaserScan"))
    length = raw.rindex(struct.pack("<I", 0)) if struct.pack("<I", 0) in raw else len(raw)
    for k in range(3):
        writer.add_message(
            channel, 10**18 + k, raw[:length] + struct.pack("<I", 10**7) + bytes(4 * 10**7), 10**18 + k
        )
    _good(writer)


def _own_schema(writer: Writer, type_name: str) -> int:
    """Register the definition of a type of ours."""
    schema: int = writer.register_schema(type_name, "ros2msg", own_schema(type_name).data)
    return schema


def _attachments(writer: Writer) -> None:
    for k in range(2000):
        writer.add_attachment(k, k, f"a{k}", "text/plain", bytes(1000))
    writer.add_attachment(1, 1, "\x1b[2J", "x", bytes(50_000_000))
    _good(writer)


def _metadata_records(writer: Writer) -> None:
    for k in range(20_000):
        writer.add_metadata(f"m{k}", {"a": "b" * 100})
    _good(writer)


def _defined(writer: Writer, text: str, encoding: str = "ros2msg") -> None:
    """Write valid messages whose types have ``text`` as definition."""
    types = sorted({line.type_name for line in good()})
    schemas = {
        name: writer.register_schema(name, encoding, text.replace("a/msg/B", name).encode()) for name in types
    }
    _add_lines(writer, good()[:2000], schemas.__getitem__)


def _add_lines(
    writer: Writer, lines: Sequence[Line], schema_of: Callable[[str], int], encoding: str = "cdr"
) -> None:
    channels: dict[str, int] = {}
    for line in lines:
        if line.topic not in channels:
            schema = schema_of(line.type_name)
            channels[line.topic] = writer.register_channel(line.topic, encoding, schema)
        writer.add_message(channels[line.topic], line.log_ns, line.raw, line.log_ns)


def _deep(depth: int) -> str:
    parts = "".join("=" * 80 + f"\nMSG: a/C{k}\na/C{k + 1} x\n" for k in range(depth))
    return f"a/C0 x\n{parts}" + "=" * 80 + f"\nMSG: a/C{depth}\nfloat64 x\n"


def _good(writer: Writer, encoding: str = "cdr", *, no_schema: bool = False) -> None:
    def schema_of(type_name: str) -> int:
        return 0 if no_schema else _own_schema(writer, type_name)

    _add_lines(writer, good()[:4000], schema_of, encoding)


def _record(opcode: int, content: bytes) -> bytes:
    return bytes([opcode]) + struct.pack("<Q", len(content)) + content


def _strings(*texts: bytes) -> bytes:
    return b"".join(struct.pack("<I", len(text)) + text for text in texts)


_HEAD = b"\x89MCAP0\r\n" + _record(1, _strings(b"ros2", b""))


def _empty_chunks(folder: Path) -> Path:
    file = folder / "bag.mcap"
    chunk = _record(6, struct.pack("<QQQIIQ", 5, 6, 0, 0, 0, 0))
    file.write_bytes(_HEAD + chunk * 100_000)
    return file


def _bare_schemas(folder: Path) -> Path:
    file = folder / "bag.mcap"
    with file.open("wb") as stream:
        stream.write(_HEAD)
        for k in range(200_000):
            number, name = k % 65535, b"std_msgs/msg/String%d" % (k % 60_000)
            schema = struct.pack("<H", number + 1) + _strings(name, b"ros2msg", b"string data")
            channel = struct.pack("<HH", number, number + 1) + _strings(b"/t%d" % k, b"cdr", b"")
            stream.write(_record(3, schema) + _record(4, channel))
    return file


# --- names, and other files


def names() -> Family:
    """Unusual names of directories and files, and foreign entries in the directory of a bag."""
    texts = {
        "not utf8": b"b\xff\xfe",
        "steering": b"\x1b[2J",
        "line": b"a\nb",
        "space": b" ",
        "quote": b"'\"$(ls)",
        "long": b"x" * 240,
        "dots": b"...",
        "wide": "\u2028\U0001f69c".encode(),
        "hidden": b".bag",
        "suffix": b"bag.mcap",
        "yaml": b"metadata.yaml",
        "dash": b"-x",
        "percent": b"%s%n",
        "braces": b"{0}",
        "cp1252": b"M\xe4rz",
    }
    for name, text in texts.items():
        yield f"name={name}", partial(_renamed, text)
        yield f"name of the file={name}", partial(_file_renamed, text)
        yield f"name of a bare file={name}", partial(_bare_file, text)
    beside: dict[str, Callable[[Path], object]] = {
        "loop": lambda bag: _link(bag, "x.mcap", 1),
        "link to nothing": lambda bag: _link(bag, "nothing", 1),
        "folder.mcap": lambda bag: (bag / "x.mcap").mkdir(),
        "pipe": lambda bag: os.mkfifo(bag / "x.mcap"),
        "zeros": lambda bag: (bag / "x.mcap").symlink_to("/dev/zero"),
        "empty file": lambda bag: (bag / "x.mcap").touch(),
        "text": lambda bag: (bag / "x.db3").write_text("x"),
        "2000 links to it": lambda bag: _link(bag, "bag_0.mcap", 2000),
        "packed zeros": lambda bag: (bag / "x.mcap.zstd").write_bytes(_packed_zeros()),
        "folders": lambda bag: (bag / "/".join("d" * 100)).mkdir(parents=True),
    }
    for name, add in beside.items():
        for bare in (False, True):
            yield f"beside={name}{' bare' * bare}", partial(_with_beside, add, bare)
    yield "a folder of folders", lambda folder: folder
    yield "no folder", lambda folder: folder / "nothing"


def _renamed(text: bytes, folder: Path) -> Path:
    return write(good(), folder).rename(folder / os.fsdecode(text))


def _file_renamed(text: bytes, folder: Path) -> Path:
    bag = write(good(), folder)
    (file,) = bag.glob("*.mcap")
    file.rename(bag / os.fsdecode(text[:200] + b".mcap"))
    return _without_metadata(bag)


def _bare_file(text: bytes, folder: Path) -> Path:
    (file,) = write(good(), folder).glob("*.mcap")
    return file.rename(folder / os.fsdecode(text[:200] + b".mcap"))


def _with_beside(add: Callable[[Path], object], bare: bool, folder: Path) -> Path:
    bag = write(good(), folder)
    add(bag)
    return _without_metadata(bag) if bare else bag


def _link(bag: Path, target: str, count: int) -> None:
    for name in ("x.mcap", *(f"y_{k}.mcap" for k in range(count - 1))):
        (bag / name).symlink_to(target)


def _packed_zeros() -> bytes:
    import zstandard

    packer = zstandard.ZstdCompressor().compressobj()
    return b"".join(packer.compress(bytes(1 << 20)) for _ in range(1000)) + packer.flush()


FAMILIES_OF_CONTAINERS: tuple[Callable[[], Family], ...] = (damages, records, names)
