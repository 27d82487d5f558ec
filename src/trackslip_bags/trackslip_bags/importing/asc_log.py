# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""ASC by python-can, with what it leaves to its user: times since the event before, dates of any language."""

import re
from collections.abc import Iterator
from typing import TextIO, cast

import can

_RELATIVE = re.compile(r"\s*base\s.*timestamps\s+relative", re.IGNORECASE)
_DATE = re.compile(r"\s*(?:date|(?P<block>begin\s+triggerblock))\s+\S+\s+(?P<date>.+)", re.IGNORECASE)
_TIME = re.compile(r"\s*(\d+\.\d+)(?=\s)")


def open_asc(text: TextIO, notes: list[str], name: str) -> can.ASCReader:
    """Frames of a log, at absolute times; notes get a date that cannot be read."""
    log = can.ASCReader(text, relative_timestamp=False)
    log.file = cast(TextIO, _Lines(text, notes, name))
    return log


class _Lines:
    """Lines in which each time counts from the begin of its block."""

    def __init__(self, text: TextIO, notes: list[str], name: str) -> None:
        self._text, self._notes, self._name = text, notes, name
        self._lines = self._absolute()
        self.close = text.close

    def __iter__(self) -> Iterator[str]:
        return self._lines

    def _absolute(self) -> Iterator[str]:
        is_relative, now = False, 0.0
        for line in self._text:
            is_relative |= _RELATIVE.match(line) is not None
            if found := _DATE.match(line):
                now = 0.0 if found["block"] else now
                if not self._is_date(found["date"].strip()):
                    continue
            elif is_relative and (found := _TIME.match(line)):
                now += float(found[1])
                line = f"{now:.6f}{line[found.end() :]}"
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
