# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Format of the text of a table: its encoding, the line of names, the delimiter of cells.

Accepted without an entry in the mapping: UTF-8, UTF-16, cp1252; comma, semicolon, tab, pipe or blanks; a
``sep=;`` line; comment lines that begin with ``#``; text before the line of names. A mapping states the rest:

    csv: {names: [t, x, y], delimiter: ";", decimal: comma}     or    csv: {format: tum}
"""

import codecs
import csv
import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from trackslip_bags.importing.log_kinds import encoding_of_mark, utf16_without_mark
from trackslip_common.errors import InputError
from trackslip_common.yaml_tree import check_keys, choice, section, texts

MAX_LINE_LENGTH = 1 << 20  # characters of a line
COMMENT = "#"
BLANKS = " "  # as a delimiter: any number of blanks

_DELIMITERS = ",;\t|"
_DELIMITER_OF_WORD = {"comma": ",", "semicolon": ";", "tab": "\t", "pipe": "|", "blanks": BLANKS}
_DELIMITER_OF_NAME = {
    **_DELIMITER_OF_WORD,
    **{delimiter: delimiter for delimiter in _DELIMITER_OF_WORD.values()},
}
_DECIMALS = ("point", "comma")
_TUM = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")  # of trajectories, blanks between
_FORMATS = ("tum",)
_HEAD = 100  # lines that are searched for names
_PIECE = 1 << 20
_SEPARATOR = re.compile(r'"?sep=(.)"?')


class Dialect(NamedTuple):
    """Format of a table as a mapping states it; empty where it does not."""

    names: tuple[str, ...] = ()
    delimiter: str = ""
    decimal_comma: bool = False


class Head(NamedTuple):
    """Line of the names, and names of the cells."""

    names: list[str]
    delimiter: str
    line: int  # of the names, 1 the first; 0: the mapping has them
    has_rows: bool  # rows follow without a line of units: the names are the mapping's, or in a comment


def read_dialect(where: str, value: Any) -> Dialect:
    """The format of ``csv: …`` in a mapping.

    Raises:
        InputError: a key or value is not accepted.
    """
    tree: Mapping[str, Any] = section(where, value)
    check_keys(where, tree, (), ("names", "delimiter", "decimal", "format"))
    is_tum = "format" in tree and choice(f"{where}.format", tree["format"], _FORMATS) == "tum"
    names = texts(f"{where}.names", tree["names"]) if "names" in tree else _TUM if is_tum else ()
    delimiter = BLANKS if is_tum else ""
    if "delimiter" in tree:
        delimiter = _DELIMITER_OF_NAME[choice(f"{where}.delimiter", tree["delimiter"], _DELIMITER_OF_NAME)]
    decimal = choice(f"{where}.decimal", tree.get("decimal", "point"), _DECIMALS)
    if decimal == "comma" and delimiter == ",":
        raise InputError(f"{where}.decimal: a comma, as the delimiter is; accepted: another delimiter")
    return Dialect(names, delimiter, decimal == "comma")


def encoding_of(path: Path) -> str:
    """Encoding of a file: UTF-16 by its mark or zeros, UTF-8 if the whole file is valid, else cp1252.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        first = file.read(1024).rstrip(b"\0")
        if encoding_of_mark(first) == "utf-16":
            return "utf-16"
        if encoding := utf16_without_mark(first):
            return encoding
        decoder = codecs.getincrementaldecoder("utf-8")()
        try:
            decoder.decode(first)
            while piece := file.read(_PIECE):
                decoder.decode(piece)
        except UnicodeDecodeError:
            return "cp1252"
    return "utf-8-sig"


def ends_in_zeros(path: Path) -> bool:
    """Whether a file ends in two zero bytes, as after a loss of the recorder's power.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        file.seek(-min(path.stat().st_size, 2), 2)
        return file.read() == b"\0\0"


def lines_of(path: Path, stream: Any) -> Iterator[str]:
    """Lines of an open file, without their ends, and without zero bytes behind the last.

    Raises:
        InputError: one is longer than any row, or holds zero bytes.
    """
    while line := stream.readline(MAX_LINE_LENGTH):
        text = line.rstrip("\r\n").rstrip("\0")
        if len(text) == MAX_LINE_LENGTH:
            raise InputError(f"{path}: a line of more than 1 MB; accepted: rows, a line each")
        if "\0" in text:
            raise InputError(f"{path}: holds zero bytes; accepted: text")
        if text or line[0] != "\0":
            yield text


def find_head(path: Path, lines: list[str], dialect: Dialect, requested: Collection[str]) -> Head:
    """The head of a table: the first line that has all requested names.

    If no line has them, the first line that is no comment, or the comment above rows.

    Raises:
        InputError: there are only values, and the mapping has no names.
    """
    match = _SEPARATOR.fullmatch(lines[0].strip()) if lines else None
    stated = dialect.delimiter or (match[1] if match else "")
    first = 1 if match else 0
    if dialect.names:
        rows = [line for line in lines[first:] if line.strip() and not line.lstrip().startswith(COMMENT)]
        guess = _guess_delimiter(rows[0] if rows else "", dialect.decimal_comma)
        return Head(list(dialect.names), stated or guess, first, True)
    for k, line in enumerate(lines[first:_HEAD], first + 1):
        is_comment = line.lstrip().startswith(COMMENT)
        delimiter = stated or _guess_delimiter(line, dialect.decimal_comma)
        names = split_cells(line.lstrip().lstrip(COMMENT), delimiter)
        if requested and set(requested) <= set(names):
            return Head(names, delimiter, k, is_comment)
    return _likely_head(path, lines, first, stated)


def split_cells(line: str, delimiter: str) -> list[str]:
    """The cells of one line.

    Raises:
        csv.Error: quotes do not close.
    """
    if delimiter == BLANKS:
        return line.split()
    cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    return [cell.strip() for cell in cells]


def _likely_head(path: Path, lines: list[str], first: int, stated: str) -> Head:
    comment = ""
    at = first
    for k, line in enumerate(lines[first:], first + 1):
        if not line.strip():
            continue
        if line.lstrip().startswith(COMMENT):
            comment, at = line.strip().lstrip(COMMENT), k
            continue
        if not _is_row(line):
            delimiter = stated or _guess_delimiter(line)
            return _head_as_wide_as_rows(lines, stated) or Head(
                split_cells(line, delimiter), delimiter, k, False
            )
        if comment:
            break
        raise InputError(
            f"{path}: line {k} holds values, and no line has names; accepted: a line of names, or "
            "csv: {names: [a, b, …]} in the mapping"
        )
    delimiter = stated or _guess_delimiter(comment)
    return Head(split_cells(comment, delimiter), delimiter, at, True)


def _head_as_wide_as_rows(lines: list[str], stated: str) -> Head | None:
    """The first line without numbers that has as many cells as the rows, else one less; or None."""
    at = next((k for k, line in enumerate(lines) if _is_row(line)), 0)
    delimiter = stated or _guess_delimiter(lines[at])
    width = len(split_cells(lines[at], delimiter))
    texts_above = ((k, line) for k, line in enumerate(lines[:at], 1) if not line.lstrip().startswith(COMMENT))
    heads = [Head(split_cells(line, delimiter), delimiter, k, False) for k, line in texts_above]
    heads = [head for head in heads if not any(re.fullmatch(r"[+-]?[\d.]+", name) for name in head.names)]
    return next((head for less in (0, 1) for head in heads if len(head.names) == width - less), None)


def _guess_delimiter(line: str, decimal_comma: bool = False) -> str:
    """The most frequent delimiter of a line; without any, blanks between words, or else a comma."""
    delimiter = max(_DELIMITERS.replace(",", "") if decimal_comma else _DELIMITERS, key=line.count)
    return delimiter if delimiter in line else BLANKS if len(line.split()) > 1 else ","


def _is_row(line: str) -> bool:
    """Whether a line begins with a number."""
    return bool(re.match(r"\s*\"?[+-]?\d", line))
