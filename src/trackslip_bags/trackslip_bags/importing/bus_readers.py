# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Extended readers of python-can.

ASC: times relative to the event before, dates in any language. BLF: a limit on the unpacked container.
"""

import re
import zlib
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TextIO, cast

import can
from can.io import blf

_RELATIVE = re.compile(r"\s*base\s.*timestamps\s+relative", re.IGNORECASE)
_DATE = re.compile(r"\s*(?:date|(?P<block>begin\s+triggerblock))\s+\S+\s+(?P<date>.+)", re.IGNORECASE)
_TIME = re.compile(r"\s*(\d+\.\d+)(?=\s)")
_MAX_SIZE = 1 << 25  # bytes of an unpacked container, and of an object; writers use 128 kB


def open_asc(text: TextIO, notes: list[str], name: str) -> can.ASCReader:
    """Frames of a log, at absolute times; ``notes`` gets an entry for an unreadable date."""
    log = can.ASCReader(text, relative_timestamp=False)
    log.file = cast(TextIO, _AbsoluteLines(text, notes, name))
    return log


class _AbsoluteLines:
    """Lines with each time counted from the start of its block."""

    def __init__(self, text: TextIO, notes: list[str], name: str) -> None:
        self._text, self._notes, self._name = text, notes, name
        self._lines = self._absolute_lines()
        self.close = text.close

    def __iter__(self) -> Iterator[str]:
        return self._lines

    def _absolute_lines(self) -> Iterator[str]:
        is_relative, now = False, 0.0
        for line in self._text:
            is_relative |= _RELATIVE.match(line) is not None
            if match := _DATE.match(line):
                now = 0.0 if match["block"] else now
                if not self._is_date(match["date"].strip()):
                    continue
            elif is_relative and (match := _TIME.match(line)):
                now += float(match[1])
                line = f"{now:.6f}{line[match.end() :]}"
            yield line

    def _is_date(self, date: str) -> bool:
        try:
            can.ASCReader._datetime_to_timestamp(date)
        except ValueError:
            note = f"{self._name}: date '{date}' cannot be read; times count from 0 s (can.start)"
            if note not in self._notes:
                self._notes.append(note)
            return False
        return True


class BlfLog(can.BLFReader):
    """Frames of a log; ``missing``: number of bytes that the file lacks, by its header.

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
                yield from self._parse_container(_decompress(content))

    def _parse_container(self, data: bytes) -> Iterator[can.Message]:
        if len(self._tail) > _MAX_SIZE:
            raise blf.BLFParseError(f"an object of more than {_MAX_SIZE} bytes")
        yield from super()._parse_container(data)


def _decompress(container: bytes) -> bytes:
    method, _ = blf.LOG_CONTAINER_STRUCT.unpack_from(container)
    content = container[blf.LOG_CONTAINER_STRUCT.size :]
    if method == blf.NO_COMPRESSION:
        return content
    if method != blf.ZLIB_DEFLATE:
        raise blf.BLFParseError(f"a container packed in a way that is not known ({method})")
    unpacking = zlib.decompressobj()
    data = unpacking.decompress(content, _MAX_SIZE)
    if unpacking.unconsumed_tail:
        raise blf.BLFParseError(f"a container of more than {_MAX_SIZE} bytes")
    return data
