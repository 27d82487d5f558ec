# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Contents of a bag for a report beside the replay: log times of all topics, soil, diagnostics, laser."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from trackslip_bags.input_filters import InputFilters, relative_name
from trackslip_bags.parameters import bag_parameters
from trackslip_bags.reader import Bag
from trackslip_bags.tables import TopicTable, read_tables
from trackslip_common.arrays import FloatArray, IntArray, Rows
from trackslip_common.config_files import load_parameters
from trackslip_common.message_fields import ForceFields, SoilFields
from trackslip_common.message_reading import RecordClass, dtype_of
from trackslip_common.topics import DIAGNOSTICS, FORCES, SOIL, TOPICS, TRUE_SOIL
from trackslip_estimation.box.parameters import DEFAULT_FILES, NODE, BoxNodeParameters
from trackslip_tools.replay.inputs import SPROCKETS, stamp_origin_ns
from trackslip_tools.report.events import Event, LightLog
from trackslip_tools.report.quantities import classes_of
from trackslip_tools.report.state_intervals import StateInterval

SCAN = "scan"
_NUMBERS = {FORCES: ForceFields, SOIL: SoilFields, TRUE_SOIL: SoilFields}
_SCANS = 60  # per bag, evenly spread: enough to show walls and the path of the box
_CELL = 0.04  # m; grid in which one point per cell is drawn
_MOST_RANGES = 5000  # per scan
_MAX_RANGE = 1000.0  # m, largest range
_MOST_TURNS = 100.0  # rad
_MIN_MESSAGES = 5  # fewest messages that give a rate
_GAP_PERIODS, _LEAST_GAP = 5.0, 0.1  # a gap exceeds both this many usual periods and this many s


class Gap(NamedTuple):
    """An interval without messages, s from the bag's first message."""

    start: float
    stop: float


@dataclass(frozen=True, eq=False)
class Timing:
    """Log times of the messages of one topic."""

    times: FloatArray  # (n,) s from the bag's first message

    @property
    def period(self) -> float:
        """The median interval between messages, s; nan with fewer than two messages."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else float("nan")

    @property
    def rate(self) -> float:
        """Mean message rate, Hz; nan with fewer than two messages."""
        span = float(np.ptp(self.times)) if len(self.times) else 0.0
        return (len(self.times) - 1) / span if span > 0.0 else float("nan")

    @property
    def is_regular(self) -> bool:
        """Whether the message rate is steady, so that lost messages can be detected."""
        if len(self.times) < _MIN_MESSAGES:
            return False
        early, late = np.percentile(np.diff(self.times), (25.0, 75.0))
        return bool(self.period / 2.0 < early and late < 2.0 * self.period)

    @property
    def lost_share(self) -> float:
        """Share of lost messages, by the usual period; nan of an irregular topic."""
        return max(0.0, 1.0 - self.rate * self.period) if self.is_regular else float("nan")

    @property
    def gaps(self) -> list[Gap]:
        """Gaps in the messages of a regular topic."""
        if not self.is_regular:
            return []
        limit = max(_GAP_PERIODS * self.period, _LEAST_GAP)
        longer = np.flatnonzero(np.diff(self.times) > limit)
        return [Gap(float(self.times[i]), float(self.times[i + 1])) for i in longer]

    @property
    def longest_interval(self) -> float:
        """The longest interval between messages, s; nan with fewer than two messages."""
        return float(np.max(np.diff(self.times))) if len(self.times) > 1 else float("nan")


@dataclass(frozen=True, eq=False)
class Numbers:
    """Messages of one topic as columns."""

    times: FloatArray  # (n,) s from the bag's first message, by stamp
    rows: Rows  # (n,) records of the message's fields
    classes: dict[str, FloatArray]  # soil → (n,) its probability, nan where not compared
    reason: str  # final reason why the soil cannot be identified; empty if it can, and for forces

    def classes_at(self, k: int) -> dict[str, float]:
        """Soil → probability in message ``k``, of the soils that were compared."""
        return {name: float(p[k]) for name, p in self.classes.items() if np.isfinite(p[k])}


def make_numbers(
    rows: Rows, start_ns: int, classes: Sequence[Mapping[str, float]] = (), reason: str = ""
) -> Numbers:
    """Columns of (n,) records; ``start_ns``: origin of times; ``classes``: soil → probability of each."""
    names = sorted({name for of_record in classes for name in of_record})
    columns = {name: np.array([of_record.get(name, np.nan) for of_record in classes]) for name in names}
    return Numbers((rows["stamp_ns"] - start_ns) * 1e-9, rows, columns, reason)


class _NumbersCollector:
    """Collects ``Numbers`` from the tables of a bag; ``start_ns``: origin of times."""

    def __init__(self, kind: RecordClass, start_ns: int) -> None:
        self._kind, self._start_ns = kind, start_ns
        self._parts = [np.empty(0, dtype_of(kind))]
        self._classes: list[dict[str, float]] = []
        self._reason = ""

    def __len__(self) -> int:
        return sum(map(len, self._parts))

    def add(self, table: TopicTable) -> None:
        """Add the messages of a table."""
        self._parts.append(table.rows(self._kind))
        for message in map(table.message, range(len(table)) if self._kind is SoilFields else ()):
            self._classes.append(classes_of(message))
            self._reason = message.reason

    def numbers(self) -> Numbers:
        """The columns of all added messages."""
        return make_numbers(np.concatenate(self._parts), self._start_ns, self._classes, self._reason)


@dataclass(frozen=True, eq=False)
class Recording:
    """One bag or a part of it; times are s from ``zero_ns``."""

    path: str
    start_ns: int  # log time of the bag's first message
    stamp_origin_ns: int  # time of the stamps then
    zero_ns: int  # stamp at the origin of times: ``stamp_origin_ns``, or the start of driving
    start_s: float  # start of the reported part
    stop_s: float
    damage: str
    parameters: dict[str, Any]  # dotted name → value in the bag
    timings: dict[str, Timing]  # topic → log times
    numbers: dict[str, Numbers]  # topic → forces or soil in the bag
    laser: FloatArray | None  # (2,) position, m in odom
    points: FloatArray  # (n, 2) scanned points, m in odom
    lights: dict[str, list[StateInterval]] = field(default_factory=dict)  # name → states on /diagnostics
    events: list[Event] = field(default_factory=list)  # changes of the diagnostics, ms

    def seconds(self, stamps_ns: IntArray) -> FloatArray:
        """Stamps as times in plots, s."""
        return _seconds(stamps_ns, self.zero_ns)

    def with_origin(self, zero_ns: int) -> "Recording":
        """The same recording with another origin of times."""
        by_s = (self.zero_ns - zero_ns) * 1e-9
        return replace(
            self,
            zero_ns=zero_ns,
            start_s=self.start_s + by_s,
            stop_s=self.stop_s + by_s,
            timings={name: Timing(timing.times + by_s) for name, timing in self.timings.items()},
            numbers={name: replace(own, times=own.times + by_s) for name, own in self.numbers.items()},
            lights={name: [interval.shift(by_s) for interval in own] for name, own in self.lights.items()},
            events=[event._replace(time_ms=event.time_ms + 1e3 * by_s) for event in self.events],
        )


def read_recording(bag: Bag, filters: InputFilters, namespace: str = "") -> Recording:
    """Read a bag once; topics by the estimator's names, diagnostics of the nodes in the namespace.

    Raises:
        InputError: the bag is damaged.
    """
    names = {topic: filters.remap.get(relative_name(topic), relative_name(topic)) for topic in bag.topics}
    start_s, stop_s = max(filters.start_s, 0.0), min(filters.stop_s, bag.duration_s)
    logged: dict[str, list[IntArray]] = {name: [] for name in names.values()}
    original_names = {after: before for before, after in filters.remap.items()}
    origin_ns = stamp_origin_ns(bag, original_names.get(SPROCKETS, SPROCKETS))
    numbers = {name: _NumbersCollector(kind, origin_ns) for name, kind in _NUMBERS.items()}
    scans = _Scans(sum(info.count for topic, info in bag.topics.items() if names[topic] == SCAN))
    lights = LightLog(namespace)
    window = (bag.start_ns + round(start_s * 1e9), bag.start_ns + round(stop_s * 1e9) + 1)
    for stretch in read_tables(bag, bag.topics, *window):
        for topic, table in stretch.items():
            name = names[topic]
            logged[name].append(table.log_times_ns)
            if name in numbers:
                numbers[name].add(table)
            elif name == SCAN and table.type_name == TOPICS[SCAN].type_name:
                scans.add(table)
            elif name == DIAGNOSTICS and table.type_name == TOPICS[DIAGNOSTICS].type_name:
                for k, now_s in enumerate(_seconds(table.log_times_ns, bag.start_ns).tolist()):
                    lights.add(table.message(k), now_s)
    none = [np.empty(0, np.int64)]
    times = {name: np.concatenate(none + logged.pop(name)) for name in sorted(logged)}
    laser, points = scans.view()
    return Recording(
        path=str(bag.path),
        start_ns=bag.start_ns,
        stamp_origin_ns=origin_ns,
        zero_ns=origin_ns,
        start_s=start_s,
        stop_s=stop_s,
        damage=bag.damage,
        parameters=bag_parameters(bag),
        timings={name: Timing(_seconds(log_times, bag.start_ns)) for name, log_times in times.items()},
        numbers={name: collector.numbers() for name, collector in numbers.items() if len(collector)},
        laser=laser,
        points=points,
        lights=lights.intervals(stop_s),
        events=lights.events,
    )


class _Scans:
    """Points of some scans, evenly spread over ``count``, placed by the site parameters in ``config/``."""

    def __init__(self, count: int) -> None:
        self._stride = -(-count // _SCANS) or 1
        self._seen = 0
        self._site: BoxNodeParameters | None = None
        self._clouds: list[FloatArray] = []  # (n, 2) m from the laser

    def add(self, table: TopicTable) -> None:
        """Add a table of scans."""
        if self._site is None:
            self._site = load_parameters(BoxNodeParameters, NODE, DEFAULT_FILES)
        first = (-self._seen - 1) % self._stride
        for k in range(first, len(table), self._stride):
            self._clouds.append(_scan_points(table.message(k), self._site.laser_yaw))
        self._seen += len(table)

    def view(self) -> tuple[FloatArray | None, FloatArray]:
        """Position of the laser, and (n, 2) scanned points, m in odom; None without a scan."""
        if self._site is None or not self._clouds:
            return None, np.empty((0, 2))
        laser, points = np.array((self._site.laser_x, self._site.laser_y)), np.concatenate(self._clouds)
        _, first = np.unique(np.round(points / _CELL), axis=0, return_index=True)
        return laser, laser + points[np.sort(first)]


def _scan_points(scan: Any, laser_yaw: float) -> FloatArray:
    """(n, 2) valid points of one scan in the axes of odom, m from the laser."""
    ranges = np.asarray(scan.ranges[:_MOST_RANGES], dtype=np.float64)
    with np.errstate(invalid="ignore"):
        angles = laser_yaw + scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    is_valid = (ranges > scan.range_min) & (ranges < min(scan.range_max, _MAX_RANGE))
    is_valid &= np.abs(angles) < _MOST_TURNS
    angles, ranges = angles[is_valid], ranges[is_valid]
    return np.asarray(ranges[:, np.newaxis] * np.stack((np.cos(angles), np.sin(angles)), axis=-1))


def _seconds(stamps_ns: Sequence[int] | IntArray, start_ns: int) -> FloatArray:
    return np.asarray((np.asarray(stamps_ns, dtype=np.int64) - start_ns) * 1e-9, dtype=np.float64)
