# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The sections ``can`` and ``gnss`` of a mapping: logs of a bus and of a receiver, read as drivers do.

can: {dbc: machine.dbc, roles: machine_roles.yaml, file: "*.asc", channel: can0, start: 0.0, time_offset: 0.0}
gnss: {file: "*.nmea", date: 2026-11-25, time_offset: 0.0, heading_stddev: 0.0035}
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from trackslip_common.config_files import config_file
from trackslip_common.errors import InputError
from trackslip_common.yaml_tree import check_keys, nanoseconds, number, section, text

_ANY = "*"


@dataclass(frozen=True)
class CanSection:
    """Settings to read a log of a CAN bus."""

    where: str
    dbc: Path
    roles: Path
    file: str  # pattern of the files' names
    channel: str | None  # None: all
    offset_ns: int  # added to every time


@dataclass(frozen=True)
class GnssSection:
    """Settings to read a log of a GNSS receiver."""

    where: str
    file: str  # pattern of the files' names
    day: date | None  # None: as the log states it
    offset_ns: int
    heading_stddev: float | None  # rad; None: that of the driver


def read_can(mapping: Path, value: Any) -> CanSection:
    """The section ``can: …`` of a mapping.

    Raises:
        InputError: a key or value is not accepted, or a file is not there.
    """
    where = f"{mapping}: can"
    tree = section(where, value)
    check_keys(where, tree, ("dbc", "roles"), ("file", "channel", "start", "time_offset"))
    return CanSection(
        where,
        _file(mapping, f"{where}.dbc", tree["dbc"]),
        _file(mapping, f"{where}.roles", tree["roles"]),
        text(f"{where}.file", tree.get("file", _ANY)),
        str(tree["channel"]) if "channel" in tree else None,
        _offset_ns(where, tree),
    )


def read_gnss(mapping: Path, value: Any) -> GnssSection:
    """The section ``gnss: …`` of a mapping.

    Raises:
        InputError: a key or value is not accepted.
    """
    where = f"{mapping}: gnss"
    tree = section(where, {} if value is None else value)
    check_keys(where, tree, (), ("file", "date", "time_offset", "heading_stddev"))
    day = tree.get("date")
    if day is not None and type(day) is not date:
        raise InputError(f"{where}.date: {day!r} is not accepted; accepted: as 2026-11-25")
    stddev = tree.get("heading_stddev")
    if stddev is not None and number(f"{where}.heading_stddev", stddev) < 0.0:
        raise InputError(f"{where}.heading_stddev: {stddev} is out of range; accepted: 0 rad or more")
    file = text(f"{where}.file", tree.get("file", _ANY))
    return GnssSection(where, file, day, _offset_ns(where, tree), None if stddev is None else float(stddev))


def _offset_ns(where: str, tree: Mapping[str, Any]) -> int:
    return sum(nanoseconds(f"{where}.{key}", tree.get(key, 0.0)) for key in ("start", "time_offset"))


def _file(mapping: Path, where: str, value: Any) -> Path:
    """A file beside the mapping, or where the drivers find it."""
    name = text(where, value)
    beside = mapping.parent / name
    if beside.is_file():
        return beside
    try:
        return config_file(name)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
