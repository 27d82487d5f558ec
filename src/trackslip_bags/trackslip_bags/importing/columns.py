# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of a CSV log in a mapping: values with their units, times, standard deviations and covariances."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError, did_you_mean
from trackslip_common.units import NS_PER_S, UNITS, factor_to_si
from trackslip_common.yaml_tree import check_keys, flag, number, positive_number, section, texts

ISO = "iso8601"
MONTH_FIRST, DAY_FIRST = "mm/dd/yyyy", "dd/mm/yyyy"  # as ISO, but for the order of the date
CLOCK = "hh:mm:ss"  # time of day, which begins again at midnight
MINUTES = "mm:ss"  # of the hour, as Excel leaves of the time of day
CLOCKS = (CLOCK, MINUTES)
DEGREES_MINUTES = "ddmm.mmmm"  # of NMEA 0183: 4812.5 is 48° 12.5′
FIRST = "first"  # as an origin: the first value of the column

_DATES = (ISO, MONTH_FIRST, DAY_FIRST)
_OPTIONAL_KEYS = ("scale", "origin", "missing")
_ZONE = re.compile(r"Z|([+-])(\d\d):?(\d\d)")


@dataclass(frozen=True)
class Column:
    """One column, or the mean of several: (value − origin) · factor is SI."""

    names: tuple[str, ...]
    quantity: str  # of its unit; empty for a plain number
    factor: float
    origin: float | str = 0.0  # in the column's own unit, or FIRST
    turn: float = 0.0  # one turn of an angle, in that unit
    missing: tuple[float, ...] = ()  # values that mark missing ones, in the column's own unit
    increments: bool = False  # each row holds the change since the row before
    degrees_minutes: bool = False  # written as DEGREES_MINUTES; its own unit is deg


@dataclass(frozen=True)
class TimeColumn:
    """One or two columns of times, which add up: numbers of a unit, or ISO 8601 (date and time of day)."""

    names: tuple[str, ...]
    units: tuple[str, ...]  # of UNITS["time"], of _DATES or CLOCKS
    zone_ns: int = 0  # east of Greenwich, of ISO times that state no zone

    @property
    def name(self) -> str:
        """All names, for messages."""
        return " + ".join(self.names)

    @property
    def is_iso(self) -> bool:
        """Whether it holds dates."""
        return self.units[0] in _DATES

    @property
    def is_clock(self) -> bool:
        """Whether it holds times of day, or of the hour."""
        return self.units[0] in CLOCKS


@dataclass(frozen=True)
class Spread:
    """Uncertainty of a value: a number, or a column of its own."""

    value: float | Column
    is_stddev: bool  # else a variance, or a covariance of two axes

    def variances(self, count: int, numbers: Mapping[str, FloatArray]) -> FloatArray:
        """(count,) variances, or covariances, SI; ``numbers``: (count,) of the columns of a table."""
        if isinstance(self.value, Column):
            own = [numbers[name] for name in self.value.names]
            values: FloatArray = np.mean(own, axis=0) * self.value.factor
        else:
            values = np.full(count, self.value)
        return values * np.abs(values) if self.is_stddev else values  # -1, of unknown ones, is none


def read_column(where: str, value: Any, quantities: Sequence[str]) -> Column:
    """The column of ``{column: …, unit: …}``, optionally with ``scale``, ``origin``; plain numbers: no unit.

    Raises:
        InputError: a key, unit or value is not accepted.
    """
    tree = section(where, value)
    check_keys(
        where, tree, ("column", "unit") if quantities else ("column",), (*_OPTIONAL_KEYS, "increments")
    )
    degrees_minutes = quantities == ("angle",) and tree["unit"] == DEGREES_MINUTES
    unit = "deg" if degrees_minutes else tree.get("unit")
    quantity, factor = factor_to_si(f"{where}.unit", unit, *quantities) if quantities else ("", 1.0)
    origin = tree.get("origin", 0.0)
    return Column(
        names=texts(f"{where}.column", tree["column"]),
        quantity=quantity,
        factor=factor * _scale(f"{where}.scale", tree.get("scale", 1.0)),
        origin=FIRST if origin == FIRST else number(f"{where}.origin", origin),
        turn=math.tau / factor if quantity == "angle" else 0.0,
        missing=_missing_values(f"{where}.missing", tree.get("missing", [])),
        increments=flag(f"{where}.increments", tree.get("increments", False)),
        degrees_minutes=degrees_minutes,
    )


def _scale(where: str, value: Any) -> float:
    scale = number(where, value)
    if scale == 0.0:
        raise InputError(f"{where}: 0 is out of range; accepted: another number")
    return scale


def _missing_values(where: str, value: Any) -> tuple[float, ...]:
    """A number, or a list of them."""
    return tuple(number(where, one) for one in (value if isinstance(value, list) else [value]))


def read_time(where: str, value: Any) -> TimeColumn:
    """One column or two that hold the time.

    ``{column: t, unit: ms}``, ``{column: t, unit: hh:mm:ss}``,
    ``{column: t, unit: iso8601, zone: "+02:00"}``, or of two columns
    ``{column: [secs, nsecs], unit: [s, ns]}``, ``{column: [date, time], unit: iso8601}``.

    Raises:
        InputError: a key, unit or value is not accepted.
    """
    tree = section(where, value)
    is_iso = tree.get("unit") in _DATES
    check_keys(where, tree, ("column", "unit"), ("zone",) if is_iso else ())
    names, zone = texts(f"{where}.column", tree["column"]), tree.get("zone", "Z")
    accepted = (*UNITS["time"], *_DATES, *CLOCKS)
    units = tuple(map(str, tree["unit"])) if isinstance(tree["unit"], list) else (str(tree["unit"]),)
    for unit in units:
        if unit not in accepted:
            like = did_you_mean(unit, accepted)
            raise InputError(f"{where}.unit: '{unit}' is unknown{like}; accepted: {', '.join(accepted)}")
    if (
        len(names) > 2
        or (not is_iso and len(units) != len(names))
        or (len(units) > 1 and {*_DATES, *CLOCKS} & set(units))
    ):
        raise InputError(
            f"{where}: {len(names)} columns and {len(units)} units; accepted: one of each, "
            "as column: [secs, nsecs], unit: [s, ns], or two columns of unit iso8601"
        )
    offset_ns = zone_offset_ns(str(zone))
    if offset_ns is None:
        raise InputError(f'{where}.zone: {zone!r} is not accepted; accepted: Z, or as "+02:00"')
    return TimeColumn(names, units, offset_ns)


def zone_offset_ns(zone: str) -> int | None:
    """Offset of ``Z`` or ``+02:00``, ns east of Greenwich; None for anything else."""
    match = _ZONE.fullmatch(zone)
    if match is None:
        return None
    sign, hours, minutes = match.groups()
    seconds = 0 if sign is None else (int(hours) * 60 + int(minutes)) * 60
    return (-seconds if sign == "-" else seconds) * NS_PER_S


def read_spreads(where: str, tree: Mapping[str, Any], axes: Mapping[str, str]) -> dict[str, Spread]:
    """Spreads by axis or pair of axes, of ``stddev: {x: …}`` and ``covariance: {x: …, xy: …}`` of a topic.

    Raises:
        InputError: a key, unit or value is not accepted, or an axis is stated twice.
    """
    spreads: dict[str, Spread] = {}
    stddevs = section(f"{where}.stddev", tree.get("stddev", {}))
    check_keys(f"{where}.stddev", stddevs, (), axes)
    for axis, value in stddevs.items():
        spreads[axis] = Spread(_read_stddev(f"{where}.stddev.{axis}", value, axes[axis]), is_stddev=True)
    pairs = {**axes, **({"xy": axes["x"]} if "x" in axes else {})}
    covariances = section(f"{where}.covariance", tree.get("covariance", {}))
    check_keys(f"{where}.covariance", covariances, (), pairs)
    for axis, value in covariances.items():
        if axis in spreads:
            raise InputError(f"{where}.covariance.{axis}: stddev has it too; accepted: one of the two")
        spreads[axis] = Spread(
            _read_variance(f"{where}.covariance.{axis}", value, pairs[axis]), is_stddev=False
        )
    return spreads


def _read_stddev(where: str, value: Any, quantity: str) -> float | Column:
    """A number, SI, or a column."""
    return (
        read_column(where, value, (quantity,))
        if isinstance(value, Mapping)
        else positive_number(where, value)
    )


def _read_variance(where: str, value: Any, quantity: str) -> float | Column:
    """A number, SI, or a column in the square of a unit: ``m^2``, ``m²`` or ``(rad/s)^2``."""
    if not isinstance(value, Mapping):
        return number(where, value)
    unit = str(value.get("unit"))
    squares: dict[str, float] = {}
    for known, factor in UNITS[quantity].items():
        inside = f"({known})" if "/" in known or "^" in known else known
        squares |= {f"{inside}^2": factor * factor, f"{inside}²": factor * factor}
    check_keys(where, value, ("column", "unit"), ())
    if unit not in squares:
        like = did_you_mean(unit, squares)
        accepted = ", ".join(name for name in squares if name.endswith("^2"))
        raise InputError(f"{where}.unit: '{unit}' is unknown{like}; accepted: {accepted}")
    return Column(texts(f"{where}.column", value["column"]), quantity, squares[unit])
