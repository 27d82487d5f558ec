# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Time series of a topic for scoring, and paths: named columns, by stamp."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray, IntArray, Rows
from trackslip_common.orientations import headings_of
from trackslip_estimation.slip.levers import UNKNOWN_HEADING
from trackslip_tools.replay.growing import GrowingRows

_MOTION = ("v_x", "v_y", "yaw_rate")
_SLIPS = ("left_slip", "right_slip", "slip_angle")
_COVARIANCES = ("covariance", "twist_covariance")


@dataclass(frozen=True, eq=False)
class Series:
    """Rows with the field ``stamp_ns`` in increasing order; of poses also x, y, heading (nan: unknown)."""

    rows: Rows  # (n,)

    @property
    def stamps_ns(self) -> IntArray:
        """(n,) stamps, ns."""
        stamps: IntArray = self.rows["stamp_ns"]
        return stamps

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.rows[name]

    def __len__(self) -> int:
        return len(self.rows)

    def columns(self, *names: str) -> FloatArray:
        """(n, k) array of the named columns."""
        return np.column_stack([self.rows[name] for name in names]).astype(np.float64, copy=False)

    def rows_since(self, start_ns: int) -> "Series":
        """The rows at or after a stamp."""
        return Series(self.rows[np.searchsorted(self.stamps_ns, start_ns) :])


def series_of(**columns: Any) -> Series:
    """A series of columns of equal length, ``stamp_ns`` among them."""
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    rows = np.empty(len(arrays["stamp_ns"]), [(n, a.dtype, a.shape[1:]) for n, a in arrays.items()])
    for name, column in arrays.items():
        rows[name] = column
    return Series(rows)


@dataclass(frozen=True, eq=False)
class Path:
    """Poses over time in the site frame."""

    stamps_ns: IntArray  # (n,) increasing
    poses: FloatArray  # (n, 3) x m, y m, heading rad (continuous)
    covariances: FloatArray | None = None  # (n, 3, 3) of the poses, if the messages of a reference have them

    def poses_at(self, stamps_ns: IntArray) -> FloatArray:
        """(k, 3) poses at other stamps, linear between samples; nan outside the path."""
        origin = self.stamps_ns[0]
        t, requested = (self.stamps_ns - origin) * 1e-9, (stamps_ns - origin) * 1e-9
        columns = [np.interp(requested, t, column, left=np.nan, right=np.nan) for column in self.poses.T]
        return np.stack(columns, axis=-1)


class SeriesCollector:
    """Collects series from tables that come in pieces; ``detailed`` topics keep their covariances.

    ``most``: largest number of rows of each, evenly spread; None: all rows.
    """

    def __init__(self, detailed: frozenset[str] = frozenset(), most: int | None = None) -> None:
        self._detailed, self._most = detailed, most
        self._parts: dict[str, GrowingRows] = {}

    def add(self, topic: str, rows: Rows) -> None:
        """Add rows of a topic, records of a class of ``message_fields``."""
        reduced = reduce_columns(rows, detailed=topic in self._detailed)
        self._parts.setdefault(topic, GrowingRows(reduced.dtype, self._most)).add(reduced)

    def series(self) -> dict[str, Series]:
        """Topic → series by stamp; of several rows with one stamp the last."""
        return {topic: Series(sort_by_stamp(self._parts.pop(topic).rows())) for topic in list(self._parts)}


def sort_by_stamp(rows: Rows) -> Rows:
    """(n,) rows by stamp; of several with one stamp, as before and after a restart, the last."""
    stamps_ns = rows["stamp_ns"]
    if (np.diff(stamps_ns) > 0).all():
        return rows
    _, from_the_end = np.unique(stamps_ns[::-1], return_index=True)
    return rows[::-1][from_the_end]


def reduce_columns(rows: Rows, *, detailed: bool = False) -> Rows:
    """The columns needed for scoring, so that 8 h of 100 Hz fit into memory."""
    names = rows.dtype.names or ()
    if "qx" not in names and "left_slip" not in names:
        return rows
    needed = [name for name in ("stamp_ns", "x", "y", *_MOTION, *_SLIPS) if name in names]
    needed += [name for name in _COVARIANCES if detailed and name in names]
    heading = [("heading", np.float64)] if "qx" in names else []
    reduced = np.empty(len(rows), [(name, rows.dtype[name]) for name in needed] + heading)
    for name in needed:
        reduced[name] = rows[name]
    if heading:
        reduced["heading"] = headings_of(rows)
        reduced["heading"][rows["covariance"][:, 2, 2] > UNKNOWN_HEADING**2] = np.nan
    return reduced
