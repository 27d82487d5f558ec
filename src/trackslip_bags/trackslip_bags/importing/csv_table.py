# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads columns of a CSV log: comma, semicolon or tab between cells; a line of names; numbers below.

Accepted around that: a byte-order mark, comment lines that begin with ``#``, a line of units below the names,
blank cells (also nan, NA, null). A decimal comma is not.
"""

import csv
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.importing.columns import TimeColumn
from trackslip_bags.importing.times import accepted, time_ns
from trackslip_common.errors import InputError, did_you_mean

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NO_TIME = np.iinfo(np.int64).min

_ENCODING = "utf-8-sig"  # UTF-8, with or without the mark that spreadsheets put first
_DELIMITERS = ",;\t"
_BLANK = frozenset(("", "nan", "na", "n/a", "null", "none", "-nan"))
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+")
_BLOCK = 20_000  # rows
_COMMENT = "#"
_LONGEST = 1 << 20  # characters of a line
_SHOWN = 40  # characters of a bad cell


class Wanted(NamedTuple):
    """What is to be read of a file."""

    numbers: tuple[str, ...]
    times: tuple[TimeColumn, ...]
    texts: tuple[str, ...]


@dataclass
class Table:
    """Columns of one file; arrays of (rows,)."""

    path: Path
    lines: IntArray  # where each row ends in the file
    times: dict[TimeColumn, IntArray]  # ns, NO_TIME where blank
    numbers: dict[str, FloatArray]  # nan where blank
    texts: dict[str, NDArray[Any]]
    notes: list[str] = field(default_factory=list)  # what was left out


def read_table(path: Path, wanted: Wanted) -> Table:
    """The wanted columns of a file.

    Raises:
        InputError: the file cannot be read, lacks a column or has no rows, or a cell in one of these
            columns is not what it should be (names its line and column).
    """
    if not path.is_file():
        raise InputError(f"{path}: no regular file; accepted: a CSV file")
    try:
        with path.open(encoding=_ENCODING, newline="") as stream:
            return _Reader(path, stream, wanted).table()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error


class _Converter(NamedTuple):
    """How the cells of a column become numbers."""

    name: str
    convert: Callable[[str], Any]  # raises ValueError
    kind: Any  # of numpy
    accepted: Callable[[str], str] = lambda _: "a finite number"  # instead of a cell


class _Reader:
    """One pass over a file."""

    def __init__(self, path: Path, stream: Any, wanted: Wanted) -> None:
        self._path, self._wanted, self._notes = path, wanted, list[str]()
        self._stream = stream
        self._names, self._delimiter, self._skipped, self._first = _head(path, stream)
        columns = [*(column.name for column in wanted.times), *wanted.numbers, *wanted.texts]
        self._indices = [self._index(name) for name in columns]
        self._converters: list[_Converter] = [
            *(_Converter(c.name, _time_of(c), np.int64, partial(accepted, column=c)) for c in wanted.times),
            *(_Converter(name, _number, np.float64) for name in wanted.numbers),
            *(_Converter(name, str, object) for name in wanted.texts),
        ]

    def table(self) -> Table:
        """All rows."""
        blocks: list[list[NDArray[Any]]] = [[np.empty(0, column.kind) for column in self._converters]]
        lines = [np.empty(0, np.int64)]
        for numbers, cells in self._blocks():
            lines.append(np.array(numbers, np.int64))
            blocks.append(self._converted(numbers, cells))
        columns = [np.concatenate(parts) for parts in zip(*blocks, strict=True)]
        if not sum(map(len, lines)):
            raise InputError(f"{self._path}: no rows below the header; accepted: a log with at least one")
        first, second = len(self._wanted.times), len(self._wanted.times) + len(self._wanted.numbers)
        return Table(
            self._path,
            np.concatenate(lines),
            dict(zip(self._wanted.times, columns[:first], strict=True)),
            dict(zip(self._wanted.numbers, columns[first:second], strict=True)),
            dict(zip(self._wanted.texts, columns[second:], strict=True)),
            self._notes,
        )

    def _blocks(self) -> Iterator[tuple[list[int], list[list[str]]]]:
        """Line numbers, and the cells of the wanted columns, of some rows at a time."""
        numbers: list[int] = []
        rows: list[list[str]] = []
        for line, row in self._rows():
            if not numbers and not self._first and self._is_units(row):
                self._notes.append(f"{self._path.name}: line {line} is taken for units")
                self._first = True
                continue
            self._first = True
            numbers.append(line)
            rows.append([row[i].strip() for i in self._indices])
            if len(rows) == _BLOCK:
                yield numbers, rows
                numbers, rows = [], []
        if rows:
            yield numbers, rows

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        """Rows as long as the header; a last one that was cut off is left out."""
        reader = csv.reader(self._lines(), delimiter=self._delimiter, strict=True, skipinitialspace=True)
        width, short = len(self._names), None
        try:
            for row in reader:
                line = self._skipped + reader.line_num
                if short is not None:
                    raise self._ragged(*short)
                if not row or (row[0].lstrip().startswith(_COMMENT)):
                    continue
                if len(row) > width and any(row[width:]):
                    raise self._ragged(line, row)
                if len(row) < width:
                    short = line, row
                else:
                    yield line, row
        except csv.Error as error:
            line = self._skipped + reader.line_num
            raise InputError(
                f"{self._path}: line {line}: not a table ({error}); accepted: quotes that close, "
                "cells of less than 128 kB"
            ) from error
        if short is not None:
            self._notes.append(f"{self._path.name}: line {short[0]}, the last, is cut off and left out")

    def _lines(self) -> Iterator[str]:
        while line := self._stream.readline(_LONGEST):
            if len(line) == _LONGEST:
                raise InputError(f"{self._path}: a line of more than 1 MB; accepted: rows, a line each")
            if "\0" in line:
                raise InputError(f"{self._path}: holds zero bytes; accepted: text")
            yield line

    def _is_units(self, row: list[str]) -> bool:
        """Below the names: no cell that is wanted holds a value, and some hold a word."""
        cells = [row[i].strip() for i in self._indices[: len(self._wanted.numbers) + len(self._wanted.times)]]
        for cell, column in zip(cells, self._converters, strict=False):
            if cell.lower() not in _BLANK and _holds(column.convert, cell):
                return False
        return any(cell for cell in cells) and not any(re.search(r"\d,\d", cell) for cell in cells)

    def _converted(self, lines: list[int], rows: list[list[str]]) -> list[NDArray[Any]]:
        """A block's columns as arrays."""
        found = []
        for cells, column in zip(zip(*rows, strict=True), self._converters, strict=True):
            try:
                found.append(np.array(list(map(column.convert, cells)), column.kind))
            except ValueError:
                raise self._bad(lines, cells, column) from None
        return found

    def _bad(self, lines: list[int], cells: Sequence[str], column: _Converter) -> InputError:
        """The first cell that cannot be converted."""
        line, cell = next((n, c) for n, c in zip(lines, cells, strict=True) if not _holds(column.convert, c))
        place = f"{self._path}: line {line}, column '{column.name}'"
        if _DECIMAL_COMMA.fullmatch(cell):
            return InputError(f"{place}: '{cell}' has a decimal comma; accepted: a decimal point")
        shown = cell if len(cell) <= _SHOWN else f"{cell[:_SHOWN]}…"
        return InputError(f"{place}: {shown!r} is not accepted; accepted: {column.accepted(cell)}, or blank")

    def _ragged(self, line: int, row: list[str]) -> InputError:
        has = f"{self._path}: line {line} has {len(row)} cells, the header {len(self._names)}"
        comma = self._delimiter == "," and len(row) > len(self._names)
        return InputError(f"{has}{' (decimal commas?)' if comma else ''}; accepted: as many as the header")

    def _index(self, name: str) -> int:
        if self._names.count(name) > 1:
            raise InputError(f"{self._path}: several columns '{name}'; accepted: one of each name")
        if name not in self._names:
            like = did_you_mean(name, self._names)
            there = ", ".join(self._names) or "none"
            raise InputError(f"{self._path}: no column '{name}'{like}; the columns are: {there}")
        return self._names.index(name)


def _head(path: Path, stream: Any) -> tuple[list[str], str, int, bool]:
    """Names, delimiter, lines up to and with the names, whether rows follow at once (names in a comment)."""
    comment, skipped = "", 0
    while True:
        position = stream.tell()
        line = stream.readline(_LONGEST)
        if not line:
            break
        if line.strip() and not line.lstrip().startswith(_COMMENT):
            if comment and _is_row(line):
                stream.seek(position)
                return *_split(path, comment), skipped, True
            return *_split(path, line), skipped + 1, False
        comment, skipped = (line.strip().lstrip(_COMMENT) if line.strip() else comment), skipped + 1
    return *_split(path, comment), skipped, True


def _split(path: Path, line: str) -> tuple[list[str], str]:
    """Names and the delimiter between them: the one of which there are most."""
    delimiter = max(_DELIMITERS, key=line.count)
    try:
        names = next(csv.reader([line], delimiter=delimiter, strict=True, skipinitialspace=True), [])
    except csv.Error as error:
        raise InputError(
            f"{path}: line of names: not a table ({error}); accepted: quotes that close"
        ) from error
    return [name.strip() for name in names], delimiter


def _is_row(line: str) -> bool:
    """Whether a line begins with a number."""
    return bool(re.match(r"\s*\"?[+-]?\d", line))


def _number(cell: str) -> float:
    """A finite number; nan of a blank cell.

    Raises:
        ValueError: it is neither.
    """
    if cell.lower() in _BLANK:
        return math.nan
    value = float(cell)
    if not math.isfinite(value) or "_" in cell:
        raise ValueError(cell)
    return value


def _time_of(column: TimeColumn) -> Callable[[str], int]:
    return lambda cell: NO_TIME if cell.lower() in _BLANK else time_ns(cell, column)


def _holds(convert: Callable[[str], Any], cell: str) -> bool:
    try:
        convert(cell)
    except ValueError:
        return False
    return True
