# SPDX-License-Identifier: Apache-2.0
"""Reads columns of a CSV log: comma-separated, names in the first line, numbers below."""

import csv
import math
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trackslip_common.errors import InputError

FloatArray = NDArray[np.float64]

_ENCODING = "utf-8-sig"  # UTF-8, with or without the mark that spreadsheets put first


def read_columns(path: Path, names: Sequence[str]) -> dict[str, FloatArray]:
    """The named columns, each (rows,), all finite.

    Raises:
        InputError: the file cannot be read, lacks a column or has no rows, or a cell in one of these
            columns is not a finite number (names its line and column).
    """
    try:
        indices = _indices(path, names)
        table = _load(path, indices)
        if table is None or not np.isfinite(table).all():
            raise _bad_cell(path, names, indices)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error
    if not len(table):
        raise InputError(f"{path}: no rows below the header; accepted: a CSV log with at least one")
    return {name: table[:, i] for i, name in enumerate(names)}


def _indices(path: Path, names: Sequence[str]) -> list[int]:
    """Where the named columns are."""
    with path.open(encoding=_ENCODING, newline="") as stream:
        header = [name.strip() for name in next(csv.reader(stream), [])]
    missing = [name for name in names if name not in header]
    if missing:
        raise InputError(
            f"{path}: no column {', '.join(missing)}; the columns are: {', '.join(header) or 'none'}"
        )
    return [header.index(name) for name in names]


def _load(path: Path, indices: list[int]) -> FloatArray | None:
    """The columns, (rows, columns); None where a cell is no number."""
    with path.open(encoding=_ENCODING) as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of an empty table, which the caller reports
        try:
            return np.loadtxt(
                stream, delimiter=",", skiprows=1, usecols=indices, ndmin=2, comments=None, quotechar='"'
            )
        except UnicodeDecodeError:
            raise
        except ValueError:
            return None


def _bad_cell(path: Path, names: Sequence[str], indices: list[int]) -> InputError:
    """The first cell that is no finite number, looked for only once it is known to be there."""
    with path.open(encoding=_ENCODING, newline="") as stream:
        rows = csv.reader(stream)
        next(rows)
        for row in filter(None, rows):
            for name, index in zip(names, indices, strict=True):
                cell = row[index] if index < len(row) else ""
                if not _is_number(cell):
                    place = f"{path}: line {rows.line_num}, column '{name}'"
                    return InputError(f"{place}: '{cell}' is not accepted; accepted: a finite number")
    return InputError(f"{path}: not a table of numbers; accepted: comma-separated, names in the first line")


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False
