# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Exact times of a CSV log: text → ns."""

import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime, timezone
from decimal import Decimal

from trackslip_bags.importing.columns import CLOCK, ISO, TimeColumn, zone_offset_ns
from trackslip_common.units import NS_PER_S, UNITS

_SCALES = {unit: Decimal(round(seconds * NS_PER_S)) for unit, seconds in UNITS["time"].items()}  # ns
_ISO = re.compile(
    r"(\d{4})[-/]?(\d\d)[-/]?(\d\d)[T ](\d\d):?(\d\d)(?::?(\d\d)(?:[.,](\d{1,9})\d*)?)? ?"
    r"(Z|UTC|GMT|[+-]\d\d:?\d\d)?"
)
_DAY_FIRST = re.compile(r"(\d\d?)\.(\d\d?)\.(\d{4})(?=[ T])")
_CLOCK = re.compile(r"(\d\d?):([0-5]\d):([0-5]\d|60)(?:[.,](\d{1,9})\d*)?")
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_PLAUSIBLE_NS = range(10**18, 2**31 * 10**9)  # ns of plausible dates, from 2001 on
_MAX_NS = Decimal(2) ** 62  # ns: no clock shows more, and int64 holds it

LIMIT_NS = 2**31 * 10**9  # seconds of a ROS stamp are 32 bit, with sign


def accepted_text(cell: str, column: TimeColumn) -> str:
    """Text of what a column accepts instead of ``cell``, with another unit if the cell fits it."""
    if column.is_iso:
        return "as 2026-11-20T14:30:00.25+01:00"
    if column.is_clock:
        return "as 14:30:00.25"
    return f"a number of {' + '.join(column.units)}{_other_unit(cell)}"


def time_ns(cells: Sequence[str], column: TimeColumn) -> int:
    """Time in ns since the column's own zero, of ISO times since 1970; one cell for each of its columns.

    Raises:
        ValueError: the cells hold no such time.
    """
    if column.is_iso:
        return _iso_ns(" ".join(cells), column.zone_ns)
    if column.is_clock:
        return _clock_ns(cells[0])
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


def _iso_ns(cell: str, default_zone_ns: int) -> int:
    match = _date_of(cell)
    if match is None:
        raise ValueError(cell)
    *parts, fraction, zone = match.groups()
    since_epoch = datetime(*(int(part or 0) for part in parts), tzinfo=timezone.utc) - _EPOCH  # type: ignore[arg-type, misc]
    zone_ns = default_zone_ns if zone is None else zone_offset_ns(zone) or 0  # 0 for UTC, GMT
    nanoseconds = int((fraction or "0").ljust(9, "0"))
    stamp_ns = (since_epoch.days * 86400 + since_epoch.seconds) * NS_PER_S + nanoseconds - zone_ns
    if abs(stamp_ns) > _MAX_NS:
        raise ValueError(cell)
    return stamp_ns


def _clock_ns(cell: str) -> int:
    match = _CLOCK.fullmatch(cell)
    if match is None:
        raise ValueError(cell)
    hours, minutes, seconds = (int(part) for part in match.groups()[:3])
    return (3600 * hours + 60 * minutes + seconds) * 10**9 + int((match[4] or "0").ljust(9, "0"))


def _date_of(cell: str) -> re.Match[str] | None:
    """Parts of a date and time of day, also of the form 20.11.2026 14:30; None of other texts."""
    return _ISO.fullmatch(cell) or _ISO.fullmatch(
        _DAY_FIRST.sub(lambda day: f"{day[3]}-{day[2]:0>2}-{day[1]:0>2}", cell)
    )


def unit_hint(value_ns: int, column: TimeColumn) -> str:
    """A hint for a time beyond the range of stamps: the unit that makes it a plausible date."""
    if column.is_iso or column.is_clock or len(column.units) > 1:
        return ""
    return _other_unit(str(Decimal(value_ns) / _SCALES[column.units[0]]))


def likely_unit(cell: str) -> str:
    """The unit in which a cell is a plausible date or time of day; empty where there is none."""
    if _date_of(cell):
        return ISO
    if _CLOCK.fullmatch(cell):
        return CLOCK
    for unit in ("s", "ms", "us", "ns"):
        with suppress(ValueError):
            if _number_ns(cell, unit) in _PLAUSIBLE_NS:
                return unit
    return ""


def _other_unit(cell: str) -> str:
    unit = likely_unit(cell)
    return f" (is its unit {unit}?)" if unit else ""
