# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live estimates of a bag against the replayed ones, while both come: every number of the same stamp.

Rows of ``odometry`` have x, y, heading (or the quaternion), v_x, v_y, yaw_rate, covariance,
twist_covariance, and for its tilt z; rows of ``track_slip`` have left_slip, right_slip, slip_angle,
covariance. Replayed attitudes are to go through ``carried`` first.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_common.orientations import headings_of, tilts_of
from trackslip_common.topics import LOCAL_ODOMETRY, ODOMETRY, TRACK_SLIP
from trackslip_estimation.slip.mounting import quaternion_by
from trackslip_tools.replay.growing import Rows
from trackslip_tools.replay.live_order import HORIZON_NS, JournalCounts

WAITING_NS = 2 * HORIZON_NS  # for a partner: the replay may be a horizon behind what is read, and a batch
TOLERANCE = 1e-9  # between a live and a replayed number
_ODOMETRY = ("x", "y", "heading", "v_x", "v_y", "yaw_rate", "covariance", "twist_covariance")
_TILT = ("roll", "pitch", "z")
_QUATERNION = ("qx", "qy", "qz", "qw")
_SLIPS = ("left_slip", "right_slip", "slip_angle", "covariance")
TILT = "tilt"  # of odometry, with its height
_COLUMNS = {ODOMETRY: _ODOMETRY, LOCAL_ODOMETRY: _ODOMETRY, TRACK_SLIP: _SLIPS, TILT: _TILT}
_SHAPES = {"covariance": (3, 3), "twist_covariance": (3, 3)}


@dataclass(frozen=True)
class LiveComparison:
    """What a comparison found."""

    compared: int  # live estimates
    unmatched: int  # messages of one side at a stamp that the other does not have
    largest_difference: float
    lost_reports: int  # lines of the live journal that the bag lacks
    lost_inputs: int  # measurements that the journal names and the bag lacks

    @property
    def matches(self) -> bool:
        """Same stamps, same numbers."""
        return self.compared > 0 and self.unmatched == 0 and self.largest_difference <= TOLERANCE

    def __str__(self) -> str:
        verdict = "yes" if self.matches else "NO"
        numbers = f"{self.compared} estimates, {self.unmatched} unmatched"
        return f"replay = live: {verdict} ({numbers}, largest difference {self.largest_difference:.1e})"


class TopicComparison:
    """One topic, by stamp; memory holds what the other side may still bring within ``WAITING_NS``."""

    def __init__(self) -> None:
        self.compared = self._unmatched = 0
        self.largest_difference = 0.0
        self._live: Rows | None = None  # still without partner, as below
        self._replayed: Rows | None = None
        self._first_ns = self._last_ns = 0  # stamps of live rows so far

    def add(self, live: Rows, replayed: Rows) -> None:
        """More of both; of several rows with one stamp the last counts."""
        if len(live):
            first_ns, last_ns = int(live["stamp_ns"].min()), int(live["stamp_ns"].max())
            self._first_ns = min(self._first_ns, first_ns) if self.compared else first_ns
            self._last_ns = max(self._last_ns, last_ns) if self.compared else last_ns
        waiting, theirs = _together(self._live, live), _together(self._replayed, replayed)
        self.compared += len(waiting) - (0 if self._live is None else len(self._live))
        _, mine, others = np.intersect1d(
            waiting["stamp_ns"], theirs["stamp_ns"], assume_unique=True, return_indices=True
        )
        if mine.size:
            largest = _difference(waiting[mine], theirs[others])
            self.largest_difference = max(self.largest_difference, largest)
        oldest_ns = self._last_ns - WAITING_NS
        self._live, late = _divided(np.delete(waiting, mine), oldest_ns)
        self._replayed, unpaired = _divided(np.delete(theirs, others), oldest_ns)
        self._unmatched += len(late) + self._within(unpaired, self._last_ns)

    def unmatched(self, end_ns: int | None) -> int:
        """Rows without partner; live ones after ``end_ns`` do not count, nor replayed ones outside."""
        if self._live is None or self._replayed is None or not self.compared:
            return 0
        inside = np.ones(len(self._live), np.bool_) if end_ns is None else self._live["stamp_ns"] <= end_ns
        last_ns = self._last_ns if end_ns is None else min(self._last_ns, end_ns)
        return self._unmatched + int(inside.sum()) + self._within(self._replayed, last_ns)

    def _within(self, rows: Rows, last_ns: int) -> int:
        stamps_ns = rows["stamp_ns"]
        return int(((stamps_ns >= self._first_ns) & (stamps_ns <= last_ns)).sum())

    def compared_until(self, end_ns: int | None) -> int:
        """Live rows, those after ``end_ns`` left out."""
        if self._live is None or end_ns is None:
            return self.compared
        return self.compared - int((self._live["stamp_ns"] > end_ns).sum())


class LiveComparer:
    """The topics of the slip estimator.

    A recording ends in the middle of things: what it holds beyond its last journal line is left out.
    """

    def __init__(self) -> None:
        self._compared = {what: TopicComparison() for what in _COLUMNS}

    def add(self, what: str, live: Rows, replayed: Rows) -> None:
        """More of a topic, or of ``TILT``, either may be empty."""
        columns = _COLUMNS[what]
        self._compared[what].add(_picked(live, columns), _picked(replayed, columns))

    def result(self, counts: JournalCounts) -> LiveComparison:
        """When all was added; ``counts`` are those of the whole journal."""
        all_of_them = self._compared.values()
        end_ns = counts.last_sprockets_ns
        return LiveComparison(
            max(one.compared_until(end_ns) for one in all_of_them),
            sum(one.unmatched(end_ns) for one in all_of_them),
            max(one.largest_difference for one in all_of_them),
            counts.lost_lines,
            counts.lost_inputs,
        )


def odometry_rows(estimates: Rows, poses: Rows) -> Rows:
    """(n,) rows of odometry that the live node publishes for (n,) of ``ESTIMATE``.

    ``poses`` (n,) has the fields pose and pose_covariance: the same estimates, or those in odom.
    """
    rows = np.zeros(len(estimates), _dtype(_ODOMETRY))
    rows["stamp_ns"], rows["covariance"] = estimates["stamp_ns"], poses["pose_covariance"]
    rows["twist_covariance"] = estimates["twist_covariance"]
    for k, (place, speed) in enumerate((("x", "v_x"), ("y", "v_y"), ("heading", "yaw_rate"))):
        rows[place], rows[speed] = poses["pose"][:, k], estimates["twist"][:, k]
    rows["heading"] = headings_of(carried(estimates, rows["heading"]))
    return rows


def tilt_rows(estimates: Rows) -> Rows:
    """(n,) roll, pitch and height of odometry for (n,) of ``ESTIMATE``."""
    quaternions = carried(estimates, estimates["pose"][:, 2])
    rows = np.zeros(len(estimates), _dtype((*_TILT[2:], *_QUATERNION)))
    rows["stamp_ns"], rows["z"] = estimates["stamp_ns"], estimates["tilt"]["tilt"][:, 2]
    for name in _QUATERNION:
        rows[name] = quaternions[name]
    return rows


def carried(estimates: Rows, headings: NDArray[np.float64]) -> Rows:
    """(n,) quaternions as messages carry the attitude: equal to live ones to the last bit."""
    tilts = estimates["tilt"]["tilt"]
    halves = [(angles / 2.0).tolist() for angles in (tilts[:, 0], tilts[:, 1], headings)]
    columns = [(np.array(list(map(math.sin, h))), np.array(list(map(math.cos, h)))) for h in halves]
    quaternions = np.zeros(len(estimates), [(name, np.float64) for name in _QUATERNION])
    for name, values in zip(_QUATERNION, quaternion_by(columns), strict=True):
        quaternions[name] = values
    return quaternions


def slip_rows(estimates: Rows) -> Rows:
    """(n,) rows of ``track_slip`` that the live node publishes for (n,) of ``ESTIMATE``."""
    rows = np.zeros(len(estimates), _dtype(_SLIPS))
    rows["stamp_ns"], rows["covariance"] = estimates["stamp_ns"], estimates["slip_covariance"]
    for k, name in enumerate(_SLIPS[:3]):
        rows[name] = estimates["slips"][:, k]
    return rows


def _dtype(names: Sequence[str]) -> np.dtype[np.void]:
    fields = [("stamp_ns", np.int64, ())]
    return np.dtype(fields + [(name, np.float64, _SHAPES.get(name, ())) for name in names])


def _picked(rows: Rows, names: Sequence[str]) -> Rows:
    """The columns to compare, by stamp; of several rows with one stamp the last."""
    found = np.zeros(len(rows), _dtype(names))
    known = rows.dtype.names or ()
    for name in ("stamp_ns", *names) if len(rows) else ():
        if name in known:
            found[name] = rows[name]
        elif name == "heading":
            found[name] = headings_of(rows)
        else:
            found[name] = tilts_of(rows)[:, _TILT.index(name)]
    return _unique(found)


def _unique(rows: Rows) -> Rows:
    _, from_the_end = np.unique(rows["stamp_ns"][::-1], return_index=True)
    return rows[::-1][from_the_end]


def _together(known: Rows | None, more: Rows) -> Rows:
    return more if known is None else _unique(np.concatenate((known, more)))


def _divided(rows: Rows, oldest_ns: int) -> tuple[Rows, Rows]:
    """Those that may still find a partner, and the others."""
    young = rows["stamp_ns"] >= oldest_ns
    return rows[young], rows[~young]


def _difference(a: Rows, b: Rows) -> float:
    """The largest of any column; of headings the short way round. Nothing differs from nothing."""
    largest = 0.0
    for name in (a.dtype.names or ())[1:]:
        apart: NDArray[np.float64] = np.abs(a[name] - b[name])
        if name == "heading":
            apart = np.abs(np.angle(np.exp(1j * apart)))
        apart = np.where(np.isnan(a[name]) & np.isnan(b[name]), 0.0, apart)
        largest = max(largest, float(np.nan_to_num(apart, nan=np.inf).max(initial=0.0)))
    return largest
