# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads columns of a CSV log by polars: a line of names (``csv_text``), rows below it.

Also accepted: a line of units below the names, blank cells (also nan, NA, null), a truncated last row.
"""

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from trackslip_bags.importing.columns import TimeColumn
from trackslip_bags.importing.csv_text import (
    BLANKS,
    COMMENT,
    Dialect,
    Head,
    encoding_of,
    ends_in_zeros,
    find_head,
    lines_of,
    split_cells,
)
from trackslip_bags.importing.log_kinds import require_table
from trackslip_bags.importing.times import accepted_text, time_ns
from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.errors import InputError, did_you_mean

NO_TIME = np.iinfo(np.int64).min

_BLANK = (
    *("", "-", "--", "---", "?", "na", "n/a", "n.a.", "#n/a", "nil", "null", "(null)", "none", "undefined"),
    *("nan", "-nan", "nat", "<na>", "1.#qnan", "-1.#ind", "#value!", "#div/0!", "#num!"),
)
_HAS_MARKS = "[°ºNSEW]"
_MARKED = re.compile(  # degrees, minutes and seconds, with signs or a hemisphere
    r"([NSEW]?) ?([+-]?)(\d+(?:\.\d+)?) ?[°º]? ?"
    r"(?:([0-5]?\d(?:\.\d+)?) ?['′’]? ?)?(?:([0-5]?\d(?:\.\d+)?) ?(?:[\"″”]|''|’’)? ?)?([NSEW]?)"
)
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+")
_BLOCK = 20_000  # rows
_HEAD = 200  # lines
_MAX_SHOWN = 40  # characters of a bad cell


class Requested(NamedTuple):
    """Columns to read from a file."""

    numbers: tuple[str, ...]
    times: tuple[TimeColumn, ...]
    texts: tuple[str, ...]
    dialect: Dialect = Dialect()
    places: frozenset[str] = frozenset()  # of the numbers, latitudes and longitudes

    @property
    def names(self) -> list[str]:
        """Names of all columns."""
        return [*(name for time in self.times for name in time.names), *self.numbers, *self.texts]


@dataclass
class Table:
    """Columns of one file; arrays of (rows,)."""

    path: Path
    lines: IntArray  # line of each row in the file
    times: dict[TimeColumn, IntArray]  # ns, NO_TIME where blank
    numbers: dict[str, FloatArray]  # nan where blank
    texts: dict[str, NDArray[Any]]
    notes: list[str] = field(default_factory=list)  # for the user
    parts: tuple[tuple[Path, int], ...] = ()  # files of a log in parts, and the first row of each

    def place(self, row: int) -> str:
        """File and line of a row, for messages."""
        path = next((path for path, first in reversed(self.parts) if first <= row), self.path)
        return f"{path}: line {self.lines[row]}"


def joined(tables: Sequence[Table]) -> Table:
    """One table of the parts of a log, in their order."""
    if len(tables) == 1:
        return tables[0]
    firsts = np.cumsum([0, *(len(table.lines) for table in tables)]).tolist()
    first = tables[0]
    return Table(
        Path(f"{first.path} to {tables[-1].path.name}"),
        np.concatenate([table.lines for table in tables]),
        {name: np.concatenate([table.times[name] for table in tables]) for name in first.times},
        {name: np.concatenate([table.numbers[name] for table in tables]) for name in first.numbers},
        {name: np.concatenate([table.texts[name] for table in tables]) for name in first.texts},
        [note for table in tables for note in table.notes],
        tuple((table.path, row) for table, row in zip(tables, firsts, strict=False)),
    )


def read_table(path: Path, requested: Requested) -> Table:
    """The requested columns of a file.

    Raises:
        InputError: the file cannot be read, is of another kind, lacks a column or has no rows, or a cell in
            one of these columns is not what it should be (names its line and column).
    """
    if not path.is_file():
        raise InputError(f"{path}: no regular file; accepted: a CSV file")
    try:
        require_table(path)
        encoding = encoding_of(path)
        with path.open(encoding=encoding, newline=None) as stream:
            reader = _Reader(path, lines_of(path, stream), requested)
            if encoding == "cp1252":
                reader.notes.append(f"{path.name}: not UTF-8; read as cp1252")
            if ends_in_zeros(path):
                reader.notes.append(f"{path.name}: ends in zero bytes, as after a loss of power")
            return reader.table()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error
    except csv.Error as error:
        raise InputError(f"{path}: not a table ({error}); accepted: quotes that close") from error


class _Block(NamedTuple):
    """Some rows: their lines in the file, and their cells by name."""

    lines: list[int]
    cells: pl.DataFrame


class _Reader:
    """Reads a file in one pass."""

    def __init__(self, path: Path, lines: Iterator[str], requested: Requested) -> None:
        self.notes: list[str] = []
        self._path, self._requested = path, requested
        first = list(islice(lines, _HEAD))
        self._head: Head = find_head(path, first, requested.dialect, requested.names)
        self._delimiter = "\t" if self._head.delimiter == BLANKS else self._head.delimiter  # of ``_rows``
        self._numbered = enumerate(chain(first[self._head.line :], lines), self._head.line + 1)
        self._short: tuple[int, str] | None = None
        for name in requested.names:
            self._require(name)

    def table(self) -> Table:
        """The table of all rows."""
        requested = self._requested
        lines: list[IntArray] = []
        times: dict[TimeColumn, list[IntArray]] = {column: [] for column in requested.times}
        numbers: dict[str, list[FloatArray]] = {name: [] for name in requested.numbers}
        texts: dict[str, list[NDArray[Any]]] = {name: [] for name in requested.texts}
        for block in self._blocks():
            lines.append(np.array(block.lines, np.int64))
            for column, times_ns in times.items():
                times_ns.append(self._times(block, column))
            for name, values in numbers.items():
                values.append(self._numbers(block, name))
            for name, parts in texts.items():
                parts.append(block.cells[name].to_numpy().astype(object))
        if not sum(map(len, lines)):
            raise InputError(f"{self._path}: no rows below the header; accepted: a log with at least one")
        if self._short is not None:
            self.notes.append(f"{self._path.name}: line {self._short[0]}, the last, is cut off and left out")
        return Table(
            self._path,
            np.concatenate(lines),
            {column: np.concatenate(parts) for column, parts in times.items()},
            {name: np.concatenate(parts) for name, parts in numbers.items()},
            {name: np.concatenate(parts) for name, parts in texts.items()},
            self.notes,
        )

    def _blocks(self) -> Iterator[_Block]:
        is_first = not self._head.has_rows
        while rows := list(islice(self._rows(), _BLOCK)):
            while is_first and rows and self._is_units(rows[0][1]):
                self.notes.append(f"{self._path.name}: line {rows[0][0]} is taken for units")
                rows = rows[1:]
            is_first = False
            if block := self._parsed(rows):
                yield block

    def _rows(self) -> Iterator[tuple[int, str]]:
        """(line, text) of each row."""
        for line, text in self._numbered:
            if text.strip() and not text.lstrip().startswith(COMMENT):
                yield line, "\t".join(text.split()) if self._head.delimiter == BLANKS else text

    def _parsed(self, rows: list[tuple[int, str]]) -> _Block | None:
        """The cells of rows, as many as names in each; a truncated last row is left out."""
        delimiter = self._delimiter
        width = len(self._head.names)
        counts = pl.Series([text for _, text in rows]).str.count_matches(delimiter, literal=True) + 1
        if rows and self._short is not None:
            raise self._row_error(*self._short)
        short = (counts < width).arg_true().to_list()
        if short and short[0] < len(rows) - 1:
            raise self._row_error(*rows[short[0]])
        for k in (counts > width).arg_true().to_list():
            behind = split_cells(rows[k][1], delimiter)[width:]
            if any(behind):
                raise self._row_error(*rows[k])
            text = rows[k][1]
            rows[k] = rows[k][0], re.sub(rf"(?:{re.escape(delimiter)}\s*){{{len(behind)}}}$", "", text)
        if short:
            self._short = rows[-1]
            rows = rows[:-1]
        if not rows:
            return None
        lines = [line for line, _ in rows]
        try:
            cells = pl.read_csv(
                BytesIO("\n".join(text for _, text in rows).encode()),
                has_header=False,
                separator=delimiter,
                schema={f"{k}": pl.String for k in range(width)},
                truncate_ragged_lines=True,
            )
        except pl.exceptions.PolarsError as error:
            raise self._table_error(lines, " ".join(str(error).split(".")[0].split())) from error
        if cells.height != len(lines):
            raise self._table_error(lines, "a quote does not close")
        places = {name: self._head.names.index(name) for name in dict.fromkeys(self._requested.names)}
        columns = [
            pl.col(f"{k}").fill_null("").str.strip_chars().str.strip_chars('"').str.strip_chars().alias(name)
            for name, k in places.items()
        ]
        return _Block(lines, cells.select(columns))

    def _numbers(self, block: _Block, name: str) -> FloatArray:
        """(rows,) finite numbers; nan for blank cells."""
        cells = block.cells[name]
        is_blank = cells.str.to_lowercase().is_in(_BLANK)
        plain = cells.str.strip_prefix("+")
        plain = plain.str.replace(",", ".", literal=True) if self._requested.dialect.decimal_comma else plain
        if name in self._requested.places and plain.str.contains(_HAS_MARKS).any():
            plain = pl.Series([_without_marks(cell) for cell in plain.to_list()])
        values = plain.cast(pl.Float64, strict=False)
        bad = (~is_blank & ~values.is_finite().fill_null(value=False)).arg_true()
        if len(bad):
            raise self._cell_error(block.lines[bad[0]], name, cells[bad[0]], "a finite number")
        numbers: FloatArray = values.to_numpy().astype(np.float64)
        return np.where(is_blank.to_numpy(), np.nan, numbers)

    def _times(self, block: _Block, column: TimeColumn) -> IntArray:
        """(rows,) ns, exactly; NO_TIME for blank cells."""
        times_ns = np.empty(len(block.lines), np.int64)
        parts = [block.cells[name].to_list() for name in column.names]
        for k, cells in enumerate(zip(*parts, strict=True)):
            try:
                is_blank = cells[0].lower() in _BLANK
                times_ns[k] = NO_TIME if is_blank else time_ns(self._with_decimal_points(cells), column)
            except ValueError:
                names, cell = " + ".join(column.names), " ".join(cells)
                raise self._cell_error(block.lines[k], names, cell, accepted_text(cell, column)) from None
        return times_ns

    def _with_decimal_points(self, cells: Sequence[str]) -> Sequence[str]:
        return [cell.replace(",", ".") for cell in cells] if self._requested.dialect.decimal_comma else cells

    def _is_units(self, text: str) -> bool:
        """Whether a line below the names holds units: requested cells hold no values, and some hold words."""
        try:
            row = split_cells(text, self._delimiter)
        except csv.Error:
            return False
        if len(row) < len(self._head.names):
            return False
        at = {name: row[self._head.names.index(name)] for name in self._requested.names}
        for column in self._requested.times:
            cells = [at[name] for name in column.names]
            if cells[0].lower() not in _BLANK and _is_convertible(lambda c: time_ns(c, column), cells):  # noqa: B023
                return False
        cells = [at[name] for name in self._requested.numbers]
        if any(cell.lower() not in _BLANK and _is_convertible(float, cell) for cell in cells):
            return False
        cells_of_text = [*cells, *(at[name] for column in self._requested.times for name in column.names)]
        return any(cells_of_text) and not any(re.search(r"\d,\d", cell) for cell in cells_of_text)

    def _cell_error(self, line: int, name: str, cell: str, instead: str) -> InputError:
        """Error for a cell that cannot be converted."""
        place = f"{self._path}: line {line}, column '{name}'"
        if DECIMAL_COMMA.fullmatch(cell):
            remedy = "a decimal point, or csv: {decimal: comma} in the mapping"
            return InputError(f"{place}: '{cell}' has a decimal comma; accepted: {remedy}")
        shown = cell if len(cell) <= _MAX_SHOWN else f"{cell[:_MAX_SHOWN]}…"
        return InputError(f"{place}: {shown!r} is not accepted; accepted: {instead}, or blank")

    def _row_error(self, line: int, text: str) -> InputError:
        names = self._head.names
        count = len(split_cells(text, self._delimiter))
        has = f"{self._path}: line {line} has {count} cells, the header {len(names)}"
        comma = self._head.delimiter == "," and count > len(names)
        return InputError(f"{has}{' (decimal commas?)' if comma else ''}; accepted: as many as the header")

    def _table_error(self, lines: Sequence[int], reason: str) -> InputError:
        where = f"{self._path}: lines {lines[0]} to {lines[-1]}"
        return InputError(f"{where}: not a table ({reason}); accepted: quotes that close, in their line")

    def _require(self, name: str) -> None:
        names = self._head.names
        if names.count(name) > 1:
            raise InputError(f"{self._path}: several columns '{name}'; accepted: one of each name")
        if name not in names:
            like = did_you_mean(name, names)
            there = ", ".join(names) or "none"
            raise InputError(f"{self._path}: no column '{name}'{like}; the columns are: {there}")


def _without_marks(cell: str) -> str:
    """Degrees of a cell as 48°06'03.5"N, N 48° 06.058' or 11.6003 W, as a number; other cells as they are."""
    match = _MARKED.fullmatch(cell)
    if match is None or not re.search(_HAS_MARKS, cell):
        return cell
    before, sign, degrees, minutes, seconds, behind = match.groups()
    value = float(degrees) + float(minutes or 0.0) / 60.0 + float(seconds or 0.0) / 3600.0
    is_negative = (sign == "-") != ((before or behind) in ("S", "W"))
    return repr(-value if is_negative else value)


def _is_convertible(convert: Callable[[Any], Any], cell: Any) -> bool:
    try:
        convert(cell)
    except ValueError:
        return False
    return True
