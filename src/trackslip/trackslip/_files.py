# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Estimates as text: CSV, TUM trajectories, GeoJSON."""

import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pymap3d

from trackslip_common.atomic_files import write_atomically
from trackslip_common.errors import InputError

if TYPE_CHECKING:
    from trackslip._estimates import Estimates

Datum = tuple[float, float, float]

_MAX_LATITUDE = 90.0  # deg
_SECOND_NS = 1_000_000_000
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def write(path: Path, estimates: "Estimates", datum: Datum | None) -> None:
    """Write the estimates, complete or not at all.

    Raises:
        InputError: the file cannot be written, or the format needs a datum.
    """
    text = _WRITERS[path.suffix](estimates, datum)
    try:
        write_atomically(path, text)
    except OSError as error:
        raise InputError(f"save: '{path}' cannot be written ({error.strerror})") from error


def _csv(estimates: "Estimates", _: Datum | None) -> str:
    return str(estimates.to_polars().write_csv())


def _tum(estimates: "Estimates", _: Datum | None) -> str:
    """Lines ``timestamp tx ty tz qx qy qz qw``; flat ground where the tilt is unknown."""
    roll, pitch, z = np.nan_to_num(estimates.tilt).T
    yaw = estimates.pose[:, 2]
    (cr, cp, cy), (sr, sp, sy) = (
        [function(angle / 2.0) for angle in (roll, pitch, yaw)] for function in (np.cos, np.sin)
    )
    turn = (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
    rows = np.column_stack((estimates.pose[:, :2], z, *turn)).tolist()
    stamps = [f"{ns // _SECOND_NS}.{ns % _SECOND_NS:09d}" for ns in estimates.stamp_ns.tolist()]
    lines = (" ".join((stamp, *map(repr, row))) for stamp, row in zip(stamps, rows, strict=True))
    return "".join(f"{line}\n" for line in lines)


def _geojson(estimates: "Estimates", datum: Datum | None) -> str:
    """A line of RFC 7946 with the time of each position."""
    if datum is None:
        accepted = "datum=(latitude, longitude, altitude) of the map's origin"
        raise InputError(f"save: GeoJSON is in degrees, and the map's datum is unknown; accepted: {accepted}")
    _check_datum(datum)
    east, north, up = estimates.pose[:, 0], estimates.pose[:, 1], np.nan_to_num(estimates.tilt[:, 2])
    latitude, longitude, _ = pymap3d.enu2geodetic(east, north, up, *datum)
    places = np.column_stack((np.round(longitude, 9), np.round(latitude, 9))).tolist()
    times = [_EPOCH + timedelta(microseconds=ns // 1000) for ns in estimates.stamp_ns.tolist()]
    feature = {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": places},
        "properties": {"coordTimes": [time.isoformat() for time in times]},
    }
    return json.dumps({"type": "FeatureCollection", "features": [feature]}) + "\n"


def _check_datum(datum: Datum) -> None:
    """Raise InputError for a datum outside of the Earth's ranges."""
    with suppress(TypeError, ValueError):
        latitude, longitude, altitude = map(float, datum)
        if (
            abs(latitude) <= _MAX_LATITUDE
            and abs(longitude) <= 2.0 * _MAX_LATITUDE
            and math.isfinite(altitude)
        ):
            return
    accepted = "datum=(latitude, longitude, altitude), deg, deg, m"
    raise InputError(f"save: {datum!r} is no datum; accepted: {accepted}")


_WRITERS: Mapping[str, Callable[["Estimates", Datum | None], str]] = {
    ".csv": _csv,
    ".tum": _tum,
    ".geojson": _geojson,
}
SUFFIXES = tuple(_WRITERS)
