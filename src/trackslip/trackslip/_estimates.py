# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Estimates as arrays, as tables of pandas and polars, and as files."""

import importlib
import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pymap3d
from numpy.typing import NDArray

from trackslip._values import as_text
from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.atomic_files import write_atomically
from trackslip_common.errors import InputError
from trackslip_common.units import NS_PER_S
from trackslip_estimation.gnss.localizer import Datum
from trackslip_estimation.slip.mounting import quaternion_from_half_angles

_AXES = {
    "pose": ("x", "y", "yaw"),
    "twist": ("v_x", "v_y", "yaw_rate"),
    "slips": ("left_slip", "right_slip", "slip_angle"),
    "tilt": ("roll", "pitch", "z"),
    "swing": ("swing", "swing_rate"),
}
_MAX_LATITUDE = 90.0  # deg
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)

_DatumValues = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates in the order of their stamps; n of them.

    ``*_covariance`` are (n, k, k), over the columns of the array after which they are named, in their units.
    """

    stamp_ns: IntArray  #: (n,) ns, of the machine's clock
    pose: FloatArray  #: (n, 3) x, y m and yaw rad of base_link in the map
    pose_covariance: FloatArray
    twist: FloatArray  #: (n, 3) v_x forward, v_y left, m/s, and yaw rate, rad/s, of base_link
    twist_covariance: FloatArray
    slips: FloatArray  #: (n, 3) slip of the left and of the right track, 1, and slip angle, rad
    slips_covariance: FloatArray
    tilt: FloatArray  #: (n, 3) roll, pitch rad (nose down > 0) and height m; nan where unknown
    tilt_covariance: FloatArray
    swing: FloatArray  #: (n, 2) angle and rate of the upper structure, rad, rad/s; nan where unknown
    swing_covariance: FloatArray
    datum: _DatumValues | None = None  #: latitude, longitude deg, altitude m

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def time(self) -> FloatArray:
        """(n,) s since the first estimate."""
        since: IntArray = self.stamp_ns - self.stamp_ns[:1]
        return np.asarray(since * 1e-9, np.float64)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Name → (n,) column: ``t`` s, ``stamp_ns``, each quantity, and its standard deviation ``sd_…``."""
        columns: dict[str, NDArray[Any]] = {"t": self.time, "stamp_ns": self.stamp_ns}
        for group, names in _AXES.items():
            values, covariance = getattr(self, group), getattr(self, f"{group}_covariance")
            for k, name in enumerate(names):
                columns[name], columns[f"sd_{name}"] = values[:, k], np.sqrt(covariance[:, k, k])
        return columns

    def to_pandas(self) -> Any:
        """The columns as a ``pandas.DataFrame``.

        Raises:
            InputError: pandas is not installed.
        """
        return to_pandas(self.columns())

    def to_polars(self) -> pl.DataFrame:
        """The columns as a data frame of polars."""
        return pl.DataFrame(self.columns())

    def save(self, path: Path | str, datum: _DatumValues | None = None) -> Path:
        """Write a file in the format of its extension; an existing file is replaced.

        ``.csv``: all columns. ``.tum``: s, position and quaternion of each pose, for evaluation tools.
        ``.geojson``: the path in degrees, for maps; needs a datum (latitude, longitude deg, altitude m).

        Raises:
            InputError: the extension is another, the file cannot be written, or there is no datum.
        """
        path = Path(as_text("save", path))
        if path.suffix not in _WRITERS:
            raise InputError(f"save: '{path}' has another ending; accepted: {', '.join(_WRITERS)}")
        text = _WRITERS[path.suffix](self, self.datum if datum is None else datum)
        try:
            write_atomically(path, text)
        except OSError as error:
            raise InputError(f"save: '{path}' cannot be written ({error.strerror})") from error
        return path


def to_pandas(columns: Mapping[str, NDArray[Any]]) -> Any:
    """A ``pandas.DataFrame`` of (n,) columns.

    Raises:
        InputError: pandas is not installed.
    """
    try:
        pandas = importlib.import_module("pandas")
    except ImportError as error:
        raise InputError("to_pandas: pandas is not installed; accepted: pip install pandas") from error
    return pandas.DataFrame(dict(columns))


def estimates_of_rows(rows: NDArray[np.void], datum: Datum | None = None) -> Estimates:
    """Estimates from (n,) ESTIMATE in the order of their stamps."""
    tilt, swing = rows["tilt"], rows["swing"]
    return Estimates(
        stamp_ns=rows["stamp_ns"].copy(),
        pose=rows["pose"].copy(),
        pose_covariance=rows["pose_covariance"].copy(),
        twist=rows["twist"].copy(),
        twist_covariance=rows["twist_covariance"].copy(),
        slips=rows["slips"].copy(),
        slips_covariance=rows["slip_covariance"].copy(),
        tilt=_nan_unless(tilt["known"], tilt["tilt"]),
        tilt_covariance=_nan_unless(tilt["known"], tilt["covariance"]),
        swing=_nan_unless(swing["known"], np.column_stack((swing["angle"], swing["rate"]))),
        swing_covariance=_nan_unless(swing["known"], swing["covariance"]),
        datum=None if datum is None else (datum.latitude, datum.longitude, datum.altitude),
    )


def _nan_unless(known: NDArray[Any], values: FloatArray) -> FloatArray:
    """The values where known, else nan."""
    masked: FloatArray = values.copy()
    masked[known == 0] = np.nan
    return masked


def _csv(estimates: Estimates, _: _DatumValues | None) -> str:
    return str(estimates.to_polars().write_csv())


def _tum(estimates: Estimates, _: _DatumValues | None) -> str:
    """Lines ``timestamp tx ty tz qx qy qz qw``; flat ground where the tilt is unknown."""
    roll, pitch, z = np.nan_to_num(estimates.tilt).T
    yaw = estimates.pose[:, 2]
    turn = quaternion_from_half_angles(
        [(np.sin(angle / 2.0), np.cos(angle / 2.0)) for angle in (roll, pitch, yaw)]
    )
    rows = np.column_stack((estimates.pose[:, :2], z, *turn)).tolist()
    stamps = [f"{ns // NS_PER_S}.{ns % NS_PER_S:09d}" for ns in estimates.stamp_ns.tolist()]
    lines = (" ".join((stamp, *map(repr, row))) for stamp, row in zip(stamps, rows, strict=True))
    return "".join(f"{line}\n" for line in lines)


def _geojson(estimates: Estimates, datum: _DatumValues | None) -> str:
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


def _check_datum(datum: _DatumValues) -> None:
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


_WRITERS: Mapping[str, Callable[[Estimates, _DatumValues | None], str]] = {
    ".csv": _csv,
    ".tum": _tum,
    ".geojson": _geojson,
}
