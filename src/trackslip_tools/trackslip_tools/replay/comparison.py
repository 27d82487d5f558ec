# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Compares the live estimates of a bag with the replayed ones, in pieces: every number of the same stamp.

Rows of ``odometry`` have x, y, z, the quaternion (or roll, pitch, heading), v_x, v_y, yaw_rate, covariance,
twist_covariance. Rows of ``track_slip`` have left_slip, right_slip, slip_angle, covariance.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray, Rows
from trackslip_common.orientations import headings_of, tilts_of, wrap_angles
from trackslip_common.topics import LOCAL_ODOMETRY, ODOMETRY, TRACK_SLIP
from trackslip_estimation.slip.mounting import quaternion_from_half_angles
from trackslip_tools.replay.comparable import Comparability, ComparablePart
from trackslip_tools.replay.live_order import HORIZON_NS, JournalCounts
from trackslip_tools.replay.series import sort_by_stamp

WAITING_NS = 2 * HORIZON_NS  # wait for a pair: the replay lags the reading by up to a horizon and a batch
TOLERANCE = 1e-9  # largest difference between a live and a replayed number
_ODOMETRY = ("x", "y", "heading", "v_x", "v_y", "yaw_rate", "covariance", "twist_covariance")
_TILT = ("roll", "pitch", "z")
_QUATERNION = ("qx", "qy", "qz", "qw")
_SLIPS = ("left_slip", "right_slip", "slip_angle", "covariance")
_COLUMNS = {ODOMETRY: (*_ODOMETRY, *_TILT), LOCAL_ODOMETRY: _ODOMETRY, TRACK_SLIP: _SLIPS}
_SHAPES = {"covariance": (3, 3), "twist_covariance": (3, 3)}
_MOST_NAMED = 3  # parts named in a line


@dataclass(frozen=True)
class LiveComparison:
    """Result of a comparison of live with replayed estimates."""

    compared: int  # live estimates
    unmatched: int  # messages without a message of the same stamp on the other side
    largest_difference: float
    lost_reports: int  # lines of the live journal that the bag lacks
    lost_inputs: int  # measurements that the journal names and the bag lacks
    comparability: Comparability = field(default_factory=Comparability)  # compared parts, reasons of breaks
    disordered_reports: int = 0  # lines of the live journal out of order, as of several simultaneous runs
    differing: str = ""  # column and message of the largest difference

    @property
    def matches(self) -> bool:
        """Whether both have the same stamps and the same numbers."""
        return self.compared > 0 and self.unmatched == 0 and self.largest_difference <= TOLERANCE

    def __str__(self) -> str:
        if not self.compared and self.comparability.breaks:
            return f"replay = live: not compared: {self.comparability.breaks[0].why}"
        numbers = f"{self.compared} estimates, {self.unmatched} unmatched"
        where = f" in {self.differing}" if self.largest_difference > TOLERANCE else ""
        difference = f"largest difference {self.largest_difference:.1e}{where}"
        return f"replay = live: {'yes' if self.matches else 'NO'} ({numbers}, {difference})"


class _Difference(NamedTuple):
    """Largest difference between numbers of a column, in the unit of the column."""

    size: float
    column: str


class TopicComparison:
    """Compares one topic by stamp; keeps rows that may still find a pair, up to ``WAITING_NS`` old."""

    def __init__(self) -> None:
        self.largest = _Difference(0.0, "")
        self._compared = self._unmatched = 0
        self._live: Rows | None = None  # unpaired live rows; below: unpaired replayed rows
        self._replayed: Rows | None = None
        self._newest_ns: int | None = None  # newest stamp of live rows
        self._spans: dict[int, tuple[int, int]] = {}  # part → stamps of its first and last pair
        self._beyond: Counter[int] = Counter()  # part → unpaired replayed rows after its last pair

    def add(self, live: Rows, replayed: Rows, parts: Sequence[ComparablePart] = ()) -> None:
        """Add rows of both; the last of several rows with one stamp counts.

        ``parts``: comparable parts of the bag so far; empty: the whole bag is comparable.
        """
        if len(live):
            newest_ns = int(live["stamp_ns"].max())
            self._newest_ns = newest_ns if self._newest_ns is None else max(self._newest_ns, newest_ns)
        live_rows, replayed_rows = _merge_rows(self._live, live), _merge_rows(self._replayed, replayed)
        _, in_live, in_replayed = np.intersect1d(
            live_rows["stamp_ns"], replayed_rows["stamp_ns"], assume_unique=True, return_indices=True
        )
        is_comparable = replayed_rows["part"][in_replayed] > 0
        self._compare_pairs(live_rows[in_live[is_comparable]], replayed_rows[in_replayed[is_comparable]])
        oldest_ns = (self._newest_ns or 0) - WAITING_NS
        self._live, late_live = _split_by_age(np.delete(live_rows, in_live), oldest_ns)
        self._replayed, late_replayed = _split_by_age(np.delete(replayed_rows, in_replayed), oldest_ns)
        unpaired_live = _count_in_parts(parts, late_live["stamp_ns"])
        self._compared += unpaired_live
        self._unmatched += unpaired_live + self._count_between_pairs(late_replayed)

    def count_compared(self, parts: Sequence[ComparablePart], end_ns: int | None) -> int:
        """Number of live rows in the parts, without those after ``end_ns``."""
        return self._compared + self._count_unpaired_live(parts, end_ns)

    def count_unmatched(self, parts: Sequence[ComparablePart], end_ns: int | None) -> int:
        """Number of unpaired rows: live ones in the parts up to ``end_ns``, replayed ones between pairs."""
        if self._replayed is None:
            return 0
        unpaired = self._count_unpaired_live(parts, end_ns) + self._count_between_pairs(self._replayed)
        return self._unmatched + unpaired

    def _count_unpaired_live(self, parts: Sequence[ComparablePart], end_ns: int | None) -> int:
        stamps_ns = np.empty(0, np.int64) if self._live is None else self._live["stamp_ns"]
        return _count_in_parts(parts, stamps_ns[stamps_ns <= end_ns] if end_ns is not None else stamps_ns)

    def _compare_pairs(self, live: Rows, replayed: Rows) -> None:
        """Compare rows of the same stamps."""
        if not len(live):
            return
        self._compared += len(live)
        self.largest = max(self.largest, _largest_difference(live, replayed))
        for part in np.unique(replayed["part"]).tolist():
            stamps_ns = replayed["stamp_ns"][replayed["part"] == part]
            first_ns, last_ns = int(stamps_ns.min()), int(stamps_ns.max())
            known = self._spans.get(part, (first_ns, last_ns))
            self._spans[part] = min(known[0], first_ns), max(known[1], last_ns)
            self._unmatched += self._beyond.pop(part, 0)

    def _count_between_pairs(self, rows: Rows) -> int:
        """Number of unpaired replayed rows between pairs; counts those after the last pair in ``_beyond``."""
        count = 0
        for part, (first_ns, last_ns) in self._spans.items():
            stamps_ns = rows["stamp_ns"][rows["part"] == part]
            count += int(((stamps_ns >= first_ns) & (stamps_ns <= last_ns)).sum())
            self._beyond[part] += int((stamps_ns > last_ns).sum())
        return count


class LiveComparer:
    """Compares all topics of the slip estimator.

    Estimates after the last sprocket line of the journal are left out: the end of a recording is incomplete.
    """

    def __init__(self) -> None:
        self._compared = {topic: TopicComparison() for topic in _COLUMNS}

    def add(
        self,
        topic: str,
        live: Rows,
        replayed: Rows,
        numbers: IntArray | None = None,
        parts: Sequence[ComparablePart] = (),
    ) -> None:
        """Add rows of a topic; either side may be empty.

        Args:
            topic: its name.
            live: rows of the topic.
            replayed: (n,) rows of the topic.
            numbers: (n,) parts of the replayed rows, 0 for none; None: all in the first part.
            parts: as ``TopicComparison.add``.
        """
        columns = _COLUMNS[topic]
        numbers = np.ones(len(replayed), np.int64) if numbers is None else numbers
        replayed = _select_columns(replayed, columns, numbers)
        self._compared[topic].add(_select_columns(live, columns), replayed, parts)

    def result(self, counts: JournalCounts) -> LiveComparison:
        """Result over all topics; ``counts`` are those of the whole journal."""
        topics = self._compared.values()
        parts, end_ns = counts.parts, counts.last_sprockets_ns
        largest, name = max((topic.largest, name) for name, topic in self._compared.items())
        return LiveComparison(
            max(topic.count_compared(parts, end_ns) for topic in topics),
            sum(topic.count_unmatched(parts, end_ns) for topic in topics),
            largest.size,
            counts.lost_lines,
            counts.lost_inputs,
            counts.comparable,
            counts.disordered_lines,
            f"{largest.column} of {name}" if largest.size else "",
        )


def _count_in_parts(parts: Sequence[ComparablePart], stamps_ns: IntArray) -> int:
    """Number of stamps that lie in any of the parts; of all stamps without parts."""
    if not parts:
        return len(stamps_ns)
    return int(np.any([part.contains(stamps_ns) for part in parts], axis=0).sum())


def odometry_rows(estimates: Rows, poses: Rows) -> Rows:
    """(n,) rows of odometry that the live node publishes for (n,) of ``ESTIMATE``, equal to the last bit.

    ``poses`` (n,) has the fields pose and pose_covariance: the same estimates, or those in odom.
    """
    x, y, headings = poses["pose"].T
    roll, pitch, z = estimates["tilt"]["tilt"].T
    halves = [(angles / 2.0).tolist() for angles in (roll, pitch, headings)]
    columns = [(np.array(list(map(math.sin, h))), np.array(list(map(math.cos, h)))) for h in halves]
    rows = np.zeros(len(estimates), _dtype(("x", "y", "z", *_QUATERNION, *_ODOMETRY[3:])))
    rows["stamp_ns"], rows["covariance"] = estimates["stamp_ns"], poses["pose_covariance"]
    rows["twist_covariance"] = estimates["twist_covariance"]
    names = ("x", "y", "z", *_QUATERNION, *_ODOMETRY[3:6])
    values = (x, y, z, *quaternion_from_half_angles(columns), *estimates["twist"].T)
    for name, column in zip(names, values, strict=True):
        rows[name] = column
    return rows


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


def _select_columns(rows: Rows, names: Sequence[str], numbers: IntArray | None = None) -> Rows:
    """The columns to compare and the part ``numbers``, by stamp; of several rows with one stamp the last."""
    dtype = _dtype(names)
    if numbers is not None:
        dtype = np.dtype([*dtype.descr, ("part", np.int64)])
    columns = np.zeros(len(rows), dtype)
    if numbers is not None:
        columns["part"] = numbers
    available = rows.dtype.names or ()
    for name in ("stamp_ns", *names) if len(rows) else ():
        if name in available:
            columns[name] = rows[name]
        elif name == "heading":
            columns[name] = headings_of(rows)
        else:
            columns[name] = tilts_of(rows)[:, _TILT.index(name)]
    return sort_by_stamp(columns)


def _merge_rows(known: Rows | None, more: Rows) -> Rows:
    return more if known is None else sort_by_stamp(np.concatenate((known, more)))


def _split_by_age(rows: Rows, oldest_ns: int) -> tuple[Rows, Rows]:
    """The rows that may still find a pair, and the others."""
    young = rows["stamp_ns"] >= oldest_ns
    return rows[young], rows[~young]


def _largest_difference(a: Rows, b: Rows) -> _Difference:
    """The largest difference of any column, headings wrapped; nan and nan differ by 0."""
    largest = _Difference(0.0, "")
    for name in (a.dtype.names or ())[1:]:
        difference: FloatArray = np.abs(a[name] - b[name])
        if name == "heading":
            difference = np.abs(wrap_angles(difference))
        difference = np.where(np.isnan(a[name]) & np.isnan(b[name]), 0.0, difference)
        size = float(np.nan_to_num(difference, nan=np.inf).max(initial=0.0))
        largest = max(largest, _Difference(size, name))
    return largest


def compared_parts(live: LiveComparison, start_ns: int) -> dict[str, Any]:
    """The compared parts for JSON, in s from the bag's first message at ``start_ns``, as in ``--start``."""

    def seconds(log_time_ns: int) -> float:
        return (log_time_ns - start_ns) * 1e-9

    comparability = live.comparability
    return {
        "estimates": live.compared,
        "parts": [
            {"start": seconds(p.begin_log_ns), "stop": seconds(p.end_log_ns)} for p in comparability.parts
        ],
        "breaks": [{"time": seconds(gap.log_time_ns), "reason": gap.why} for gap in comparability.breaks],
    }


def partial_comparison_lines(live: LiveComparison, start_ns: int) -> list[str]:
    """A line for the terminal if the replay was only compared in part."""
    comparability = live.comparability
    if not comparability.breaks or not comparability.parts:
        return []
    parts = [
        f"from {(p.begin_log_ns - start_ns) * 1e-9:.2f} to {(p.end_log_ns - start_ns) * 1e-9:.2f} s"
        for p in comparability.parts[:_MOST_NAMED]
    ]
    more = len(comparability.parts) - len(parts)
    parts += [f"and {more} more parts"] if more else []
    first = comparability.breaks[0]
    others = len(comparability.breaks) - 1
    further = f" ({others} more such places)" if others else ""
    at_s = (first.log_time_ns - start_ns) * 1e-9
    return [f"  compared {', '.join(parts)}; not from {at_s:.2f} s, where {first.why}{further}"]
