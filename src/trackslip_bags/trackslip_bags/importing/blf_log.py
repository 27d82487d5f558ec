# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""BLF by python-can, with a bound on what a container unpacks to: python-can has none."""

import zlib
from collections.abc import Generator, Iterator
from pathlib import Path

import can
from can.io import blf

_LARGEST = 1 << 25  # bytes of a container, unpacked, and of an object; writers use 128 kB


class BlfLog(can.BLFReader):
    """Frames of a log; ``missing`` counts its bytes that are not there, as its header states.

    Raises:
        blf.BLFParseError, struct.error, zlib.error: it is damaged.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.missing = max(self.file_size - path.stat().st_size, 0)

    def __iter__(self) -> Generator[can.Message, None, None]:
        head = blf.OBJ_HEADER_BASE_STRUCT
        while data := self.file.read(head.size):
            signature, _, _, size, kind = head.unpack(data)
            if signature != b"LOBJ" or size < head.size:
                raise blf.BLFParseError("no object where one should begin")
            content = self.file.read(size - head.size)
            self.file.read(size % 4)  # padding
            if kind == blf.LOG_CONTAINER:
                yield from self._parse_container(_unpacked(content))

    def _parse_container(self, data: bytes) -> Iterator[can.Message]:
        if len(self._tail) > _LARGEST:
            raise blf.BLFParseError(f"an object of more than {_LARGEST} bytes")
        yield from super()._parse_container(data)


def _unpacked(container: bytes) -> bytes:
    method, _ = blf.LOG_CONTAINER_STRUCT.unpack_from(container)
    content = container[blf.LOG_CONTAINER_STRUCT.size :]
    if method == blf.NO_COMPRESSION:
        return content
    if method != blf.ZLIB_DEFLATE:
        raise blf.BLFParseError(f"a container packed in a way that is not known ({method})")
    unpacking = zlib.decompressobj()
    data = unpacking.decompress(content, _LARGEST)
    if unpacking.unconsumed_tail:
        raise blf.BLFParseError(f"a container of more than {_LARGEST} bytes")
    return data
