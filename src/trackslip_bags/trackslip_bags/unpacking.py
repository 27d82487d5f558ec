# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Decompresses parts of bags, with limits: the stated size, and sizes that recorders write."""

import bz2
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import IO

import lz4.frame
import zstandard
from mcap.records import Chunk
from rosbags.rosbag2 import storage_mcap

MAX_SIZE = 128_000_000  # bytes of a chunk; recorders write 1 to 10 MB, reading takes seven times that
_RATIO = 200  # limit of a file's compression ratio; recordings reach some 20
_PIECE = 1 << 20  # bytes decompressed at once


def _stored(data: bytes, _: int) -> bytes:
    return data


def _zstd(data: bytes, max_size: int) -> bytes:
    content: bytes = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True).read(max_size)
    return content


def _lz4(data: bytes, max_size: int) -> bytes:
    content: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=max_size)
    return content


def _bz2(data: bytes, max_size: int) -> bytes:
    return bz2.BZ2Decompressor().decompress(data, max_length=max_size)


_KINDS: Mapping[str, Callable[[bytes, int], bytes]] = MappingProxyType(
    {"": _stored, "lz4": _lz4, "zstd": _zstd}
)


def decompress(data: bytes, size: int, compression: str) -> bytes:
    """The decompressed content of a chunk with the stated ``size``, bytes.

    Raises:
        ValueError: the stated size is too large or wrong, or the compression is unknown.
    """
    if size > MAX_SIZE:
        raise ValueError(f"a chunk of {size / 1e6:.0f} MB; accepted: up to {MAX_SIZE / 1e6:.0f} MB")
    if compression not in _KINDS:
        raise ValueError(f"a chunk of compression '{compression}'; accepted: lz4, zstd or none")
    content = _KINDS[compression](data, size + 1)
    if len(content) != size:
        raise ValueError("a chunk that unpacks to another size than it states")
    return content


def decompress_chunk(chunk: Chunk) -> Chunk:
    """A chunk with decompressed records.

    Raises:
        ValueError: as ``decompress``.
    """
    data = decompress(chunk.data, chunk.uncompressed_size, chunk.compression)
    return replace(chunk, compression="", data=data)


def is_packed(data: bytes) -> bool:
    """Whether a message is compressed by itself (zstd); CDR never begins with this header."""
    return data.startswith(zstandard.FRAME_HEADER)


def decompress_message(data: bytes) -> bytes:
    """A message, decompressed if it was compressed by itself.

    Raises:
        ValueError: it decompresses to more than ``MAX_SIZE``.
    """
    return _decompress_limited("message", _zstd, data) if is_packed(data) else data


def _decompress_limited(what: str, unpack: Callable[[bytes, int], bytes], data: bytes) -> bytes:
    content = unpack(data, MAX_SIZE + 1)
    if len(content) > MAX_SIZE:
        raise ValueError(f"a {what} that unpacks to more than {MAX_SIZE / 1e6:.0f} MB")
    return content


def decompress_file(path: Path, output: IO[bytes] | None = None) -> None:
    """Decompress a file that was compressed as a whole (``.zstd``); without ``output`` only check its size.

    Raises:
        ValueError: the size exceeds ``MAX_SIZE`` and ``_RATIO`` times the file's size.
    """
    packed = path.stat().st_size
    limit, size = max(MAX_SIZE, _RATIO * packed), 0
    with path.open("rb") as file:
        stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        while piece := stream.read(_PIECE):
            size += len(piece)
            if output is not None:
                output.write(piece)
            if size > limit:
                raise ValueError(f"{path.name}: {packed} bytes that unpack to more than {limit / 1e6:.0f} MB")


def limit_rosbags() -> None:
    """Make rosbags, which has no limit, decompress chunks by ``decompress``."""
    for kind in _KINDS:
        storage_mcap.DECOMPRESSORS[kind] = partial(decompress, compression=kind)


def ros1_decompressors() -> dict[str, Callable[[bytes], bytes]]:
    """Compression → function that decompresses a chunk of a ROS 1 bag; ``ValueError`` beyond ``MAX_SIZE``."""
    return {
        kind: partial(_decompress_limited, "chunk", unpack) for kind, unpack in (("bz2", _bz2), ("lz4", _lz4))
    }
