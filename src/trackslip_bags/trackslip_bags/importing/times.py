# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Exact times of a CSV log: text → ns."""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime, timezone
from decimal import Decimal

import numpy as np

from trackslip_bags.importing.columns import (
    CLOCK,
    DAY_FIRST,
    ISO,
    MINUTES,
    MONTH_FIRST,
    TimeColumn,
    zone_offset_ns,
)
from trackslip_common.arrays import FloatArray
from trackslip_common.units import NS_PER_S, UNITS

_SCALES = {unit: Decimal(round(seconds * NS_PER_S)) for unit, seconds in UNITS["time"].items()}  # ns
_FRACTION = r"(?:(?:[.,]|:(?=\d{3}))(\d{1,9})\d*)?"
_ISO = re.compile(
    rf"(\d{{4}})[-/]?(\d\d)[-/]?(\d\d)[T ](\d\d|\d(?=:)):?(\d\d)(?::?(\d\d){_FRACTION})? ?"
    r"([AP]M)? ?(Z|UTC|GMT|[+-]\d\d:?\d\d)?",
    re.IGNORECASE,
)
_DOTTED = re.compile(r"(\d\d?)\.(\d\d?)\.(\d{4})(?=[ T])")
_SLASHED = re.compile(r"(\d\d?)/(\d\d?)/(\d{4})(?=[ T])")
_CLOCK = re.compile(rf"(\d\d?)(:?)([0-5]\d)\2([0-5]\d|60){_FRACTION}")
_MINUTES = re.compile(r"\d\d:\d\d[.,]\d+")
_NAMED_MONTH = re.compile(r"(\d\d?)[- ]([a-z]{3})[a-z]*[- ](\d{4})(?=[ T])", re.IGNORECASE)
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_DATE_ORDER: dict[str, Callable[[re.Match[str]], str]] = {
    MONTH_FIRST: lambda date: f"{date[3]}-{date[1]:0>2}-{date[2]:0>2}",
    DAY_FIRST: lambda date: f"{date[3]}-{date[2]:0>2}-{date[1]:0>2}",
}
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_LEAST_ROWS, _LONGEST_PERIOD = 10, 10.0  # rows, and s between them, that show times without colons
_PLAUSIBLE_NS = range(10**18, 2**31 * 10**9)  # ns of plausible dates, from 2001 on
_MAX_NS = Decimal(2) ** 62  # ns: no clock shows more, and int64 holds it

LIMIT_NS = 2**31 * 10**9  # seconds of a ROS stamp are 32 bit, with sign


def accepted_text(cell: str, column: TimeColumn) -> str:
    """Text of what a column accepts instead of ``cell``, with another unit if the cell fits it."""
    if column.is_iso:
        example = "as 2026-11-20T14:30:00.25+01:00"
        return f"{example} (or unit: {MONTH_FIRST} or {DAY_FIRST})" if _SLASHED.match(cell) else example
    if column.is_clock:
        return f"as {'14:' if column.units == (CLOCK,) else ''}30:00.25"
    return f"a number of {' + '.join(column.units)}{_other_unit(cell)}"


def time_ns(cells: Sequence[str], column: TimeColumn) -> int:
    """Time in ns since the column's own zero, of ISO times since 1970; one cell for each of its columns.

    Raises:
        ValueError: the cells hold no such time.
    """
    if column.is_iso:
        return _iso_ns(" ".join(cells), column)
    if column.is_clock:
        return _clock_ns(cells[0] if column.units == (CLOCK,) else f"0:{cells[0]}")
    return sum(_number_ns(cell, unit) for cell, unit in zip(cells, column.units, strict=True))


def time_text(value_ns: int, column: TimeColumn) -> str:
    """A time in the form of a column, to the last digit: ``1791000000.25 s``, ``2026-11-20T13:30:00.25Z``."""
    seconds, nanoseconds = divmod(value_ns, 10**9)
    fraction = f".{nanoseconds:09d}".rstrip("0").rstrip(".")
    if column.is_iso:
        return f"{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%dT%H:%M:%S}{fraction}Z"
    return f"{seconds}{fraction} s"


def _number_ns(cell: str, unit: str) -> int:
    try:
        value = Decimal(cell) * _SCALES[unit]
    except ArithmeticError as error:
        raise ValueError(cell) from error
    if not value.is_finite() or abs(value) > _MAX_NS:
        raise ValueError(cell)
    return int(value.to_integral_value())


def _iso_ns(cell: str, column: TimeColumn) -> int:
    match = _date_of(cell, column.units[0])
    if match is None:
        raise ValueError(cell)
    *date, hour, minute, second, fraction, half, zone = match.groups()
    if half is not None:
        if not 1 <= int(hour) <= 12:
            raise ValueError(cell)
        hour = int(hour) % 12 + (12 if half.upper() == "PM" else 0)
    numbers = (int(part or 0) for part in (*date, hour, minute, second))
    since_epoch = datetime(*numbers, tzinfo=timezone.utc) - _EPOCH  # type: ignore[arg-type, misc]
    zone_ns = column.zone_ns if zone is None else zone_offset_ns(zone) or 0  # 0 for UTC, GMT
    nanoseconds = int((fraction or "0").ljust(9, "0"))
    stamp_ns = (since_epoch.days * 86400 + since_epoch.seconds) * NS_PER_S + nanoseconds - zone_ns
    if abs(stamp_ns) > _MAX_NS:
        raise ValueError(cell)
    return stamp_ns


def _clock_ns(cell: str) -> int:
    whole, point, rest = cell.partition(".")
    match = _CLOCK.fullmatch(f"{whole.zfill(6)}{point}{rest}" if whole.isdecimal() else cell)
    if match is None:
        raise ValueError(cell)
    hours, _, minutes, seconds, fraction = match.groups()
    since_midnight = 3600 * int(hours) + 60 * int(minutes) + int(seconds)
    return since_midnight * 10**9 + int((fraction or "0").ljust(9, "0"))


def is_clock_without_colons(numbers: FloatArray) -> bool:
    """Whether (n,) numbers are times of day as 143000.25: minutes pass, and none has a second 60 to 99."""
    if len(numbers) < _LEAST_ROWS or np.median(np.diff(numbers)) > _LONGEST_PERIOD:
        return False
    minutes, seconds = np.divmod(numbers, 100.0)
    is_time = (seconds < 60.0) & (minutes % 100.0 < 60.0) & (minutes >= 0.0) & (minutes < 2400.0)
    return bool(is_time.all() and np.ptp(minutes) > 0.0)


def _date_of(cell: str, unit: str = ISO) -> re.Match[str] | None:
    """Parts of a date and time of day, also as 20.11.2026 14:30 or 20-Nov-2026 14:30; None of other texts.

    Of dates with slashes that begin with the day or month, ``unit`` states which.
    """
    cell = _NAMED_MONTH.sub(_with_month_number, _DOTTED.sub(_DATE_ORDER[DAY_FIRST], cell))
    return _ISO.fullmatch(cell if unit == ISO else _SLASHED.sub(_DATE_ORDER[unit], cell))


def _with_month_number(date: re.Match[str]) -> str:
    """A date with the name of a month, in digits; as it is if no month has that name."""
    name = date[2].lower()
    return f"{date[3]}-{_MONTHS.index(name) + 1:02}-{date[1]:0>2}" if name in _MONTHS else date[0]


def date_unit(cells: Sequence[str]) -> str:
    """The unit of dates: of those with slashes the only one that suits all; ISO where both do, or none."""
    fitting = [unit for unit in (MONTH_FIRST, DAY_FIRST) if all(_is_date(cell, unit) for cell in cells)]
    return fitting[0] if len(fitting) == 1 else ISO


def _is_date(cell: str, unit: str) -> bool:
    with suppress(ValueError):
        _iso_ns(cell, TimeColumn(("",), (unit,)))
        return bool(_SLASHED.match(cell))
    return False


def unit_hint(value_ns: int, column: TimeColumn) -> str:
    """A hint for a time beyond the range of stamps: the unit that makes it a plausible date."""
    if column.is_iso or column.is_clock or len(column.units) > 1:
        return ""
    return _other_unit(str(Decimal(value_ns) / _SCALES[column.units[0]]))


def likely_unit(cell: str) -> str:
    """The unit in which a cell is a plausible date or time of day; empty where there is none."""
    if _date_of(cell):
        return ISO
    if ":" in cell and _CLOCK.fullmatch(cell):
        return CLOCK
    if _MINUTES.fullmatch(cell):
        return MINUTES
    for unit in ("s", "ms", "us", "ns"):
        with suppress(ValueError):
            if _number_ns(cell, unit) in _PLAUSIBLE_NS:
                return unit
    return ""


def _other_unit(cell: str) -> str:
    unit = likely_unit(cell)
    return f" (is its unit {unit}?)" if unit else ""
