# SPDX-License-Identifier: Apache-2.0
"""Reads from a bag what the estimator takes, and the order in which it took it live."""

from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.column_cache import read_columns
from trackslip_bags.columns import Columns, IrregularError
from trackslip_bags.input_filters import Arrival, InputFilters, relative
from trackslip_bags.parameters import bag_parameters, read_parameters
from trackslip_bags.reader import Bag, require_topics
from trackslip_common.errors import InputError
from trackslip_common.make import stamp_ns_of
from trackslip_common.topics import TOPICS
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.measurements import (
    FREEZE,
    RELOAD,
    RESET,
    SET_POSE,
    UNFREEZE,
    Command,
    Input,
    Measurement,
    Reload,
)
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, reloadable
from trackslip_tools.replay import columns as by_column
from trackslip_tools.replay.scoring import Series

FloatArray = NDArray[np.float64]

SPROCKETS, REPORTS, ODOMETRY, TRACK_SLIP = "sprockets", "measurement_reports", "odometry", "track_slip"

_COMMANDS = (RESET, FREEZE, UNFREEZE)  # of them the bag has nothing but their line in the journal


class Taken(NamedTuple):
    """One line of the live estimator's journal: which measurement it took next."""

    log_time_ns: int
    sequence: int
    source: str
    stamp_ns: int


class _Reader(NamedTuple):
    """How a source's measurements are read."""

    message: Callable[[Any], Measurement]
    columns: Callable[[Columns], list[Measurement]]


class _Span(NamedTuple):
    """Log times; None for no limit."""

    start_ns: int | None
    stop_ns: int | None


@dataclass
class Inputs:
    """What one replay needs of a bag."""

    origin_ns: int  # log time of the bag's first message
    arrivals: list[Arrival] = field(default_factory=list)  # in log order
    journal: list[Taken] = field(default_factory=list)
    series: dict[str, Series] = field(default_factory=dict)  # by topic
    messages: Counter[str] = field(default_factory=Counter)  # by topic, all that was read


def read_inputs(
    bag: Bag, p: SlipEstimatorParameters, filters: InputFilters, series: tuple[str, ...]
) -> Inputs:
    """Read the estimator's topics, its journal, and the numbers of the topics named in ``series``.

    Raises:
        InputError: the bag lacks the sprockets or is damaged.
    """
    backwards = {after: before for before, after in filters.remap.items()}
    require_topics(bag, [backwards.get(SPROCKETS, SPROCKETS)])
    readers = _readers(p)
    names = {topic: filters.remap.get(relative(topic), relative(topic)) for topic in bag.topics}
    names = {topic: name for topic, name in names.items() if name in readers or name in (REPORTS, *series)}
    _require_types(bag, names, p)
    span = _Span(*(absolute_time(bag, t) for t in (filters.start_s, filters.stop_s)))
    try:
        inputs = _from_columns(bag, names, readers, series, span)
    except IrregularError:
        inputs = _from_messages(bag, names, readers, series, span)
    inputs.arrivals = sorted((*inputs.arrivals, *_reloads(bag, *span)), key=lambda a: a.log_time_ns)
    return inputs


def _from_columns(
    bag: Bag, names: dict[str, str], readers: dict[str, _Reader], series: tuple[str, ...], span: _Span
) -> Inputs:
    """All messages of a topic at once.

    Raises:
        IrregularError: a topic makes no columns.
    """
    inputs = Inputs(bag.start_ns)
    arrivals: list[tuple[int, Arrival]] = []
    for topic, whole in read_columns(bag, names).items():
        name, (order, log_times_ns, columns) = names[topic], whole.between(*span)
        if not len(log_times_ns):
            continue
        times = log_times_ns.tolist()
        inputs.messages[name] += len(times)
        if name in readers:
            given = map(Arrival, times, readers[name].columns(columns))
            arrivals += zip(order.tolist(), given, strict=True)
        stamps_ns = by_column.stamps_ns(columns)
        if name == REPORTS:
            rows = (times, columns["sequence"].tolist(), columns["source"].tolist(), stamps_ns.tolist())
            inputs.journal += map(Taken, *rows)
        if name in series:
            inputs.series[name] = _series(stamps_ns, by_column.numbers(columns))
    inputs.arrivals = [arrival for _, arrival in sorted(arrivals, key=itemgetter(0))]
    return inputs


def _from_messages(
    bag: Bag, names: dict[str, str], readers: dict[str, _Reader], series: tuple[str, ...], span: _Span
) -> Inputs:
    """One message after the other."""
    inputs = Inputs(bag.start_ns)
    collected: dict[str, list[tuple[int, FloatArray]]] = defaultdict(list)
    for message in bag.messages(names, *span):
        name = names[message.topic]
        content = bag.deserialize(message.raw, message.type_name)
        inputs.messages[name] += 1
        if name in readers:
            inputs.arrivals.append(Arrival(message.log_time_ns, readers[name].message(content)))
        if name == REPORTS:
            stamp_ns = stamp_ns_of(content)
            inputs.journal.append(Taken(message.log_time_ns, content.sequence, content.source, stamp_ns))
        if name in series:
            collected[name].append((stamp_ns_of(content), numbers_of(content)))
    for name, rows in collected.items():
        stamps, numbers = zip(*rows, strict=True)
        inputs.series[name] = _series(np.array(stamps, dtype=np.int64), np.array(numbers))
    return inputs


def in_live_order(arrivals: list[Arrival], journal: list[Taken]) -> Iterator[Input]:
    """The order in which the live estimator took its measurements.

    Its journal tells it exactly, what a user asked meanwhile included. A source that the journal does not
    know (another bag's, a remapped one) is merged in by log time; without a journal, log time orders all.
    """
    journaled = {taken.source for taken in journal}
    shelf: dict[tuple[str, int], deque[Input]] = defaultdict(deque)
    others: deque[Arrival] = deque()
    for arrival in arrivals:
        m = arrival.measurement
        if m.source in journaled:
            shelf[m.source, m.stamp_ns].append(m)
        else:
            others.append(arrival)
    for taken in journal:
        while others and others[0].log_time_ns <= taken.log_time_ns:
            yield others.popleft().measurement
        if taken.source in _COMMANDS:
            yield Command(taken.source, taken.stamp_ns)
        waiting = shelf[taken.source, taken.stamp_ns]
        if waiting:
            yield waiting.popleft()
    yield from (arrival.measurement for arrival in others)


def missing_inputs(arrivals: list[Arrival], journal: list[Taken]) -> int:
    """How many measurements the journal names that the bag lacks."""
    there = Counter((arrival.measurement.source, arrival.measurement.stamp_ns) for arrival in arrivals)
    named = Counter((taken.source, taken.stamp_ns) for taken in journal if taken.source not in _COMMANDS)
    return sum((named - there).values())


def journal_gaps(journal: list[Taken]) -> int:
    """How many lines of the journal the bag lacks, those before its first line included."""
    lost = 0
    expected = 0
    for taken in journal:
        lost += max(taken.sequence - expected, 0)
        expected = taken.sequence + 1
    return lost


def numbers_of(message: Any) -> FloatArray:
    """The numbers to compare or to score of an odometry, pose or slip message.

    Pose: x, y, heading. Odometry: also v_x, v_y, yaw rate, then both covariances. Slip: left, right,
    angle, then the covariance.
    """
    if hasattr(message, "left_slip"):
        slips = (message.left_slip, message.right_slip, message.slip_angle)
        return np.concatenate((slips, message.covariance))
    pose = conversions.planar_pose(message.pose.pose)
    if not hasattr(message, "twist"):
        return pose
    twist = message.twist.twist
    velocity = (twist.linear.x, twist.linear.y, twist.angular.z)
    return np.concatenate((pose, velocity, message.pose.covariance, message.twist.covariance))


def _readers(p: SlipEstimatorParameters) -> dict[str, _Reader]:
    def of(
        source: str, message: Callable[..., Measurement], columns: Callable[..., Any], *told: float
    ) -> None:
        def from_message(content: Any) -> Measurement:
            return message(content, source, *told)

        def from_columns(content: Columns) -> list[Measurement]:
            found: list[Measurement] = columns(content, source, *told)
            return found

        readers[source] = _Reader(from_message, from_columns)

    readers: dict[str, _Reader] = {}
    of(SPROCKETS, conversions.sprockets, by_column.sprockets)
    for source in filter(None, p.yaw_rate_sources):
        of(source, conversions.yaw_rate, by_column.yaw_rates, p.yaw_rate_stddev**2)
    for source in (SET_POSE, *filter(None, p.pose_sources)):
        of(source, conversions.pose_fix, by_column.pose_fixes)
    for source in filter(None, p.slip_sources):
        of(source, conversions.slip_fix, by_column.slip_fixes)
    return readers


def _reloads(bag: Bag, start_ns: int | None, stop_ns: int | None) -> Iterator[Arrival]:
    """What was changed of the parameters while the estimator ran, as the bag's later messages tell it."""
    before = bag_parameters(bag)
    for message in bag.messages([RELOAD], start_ns, stop_ns):
        now = read_parameters(bag, message)
        changed = {name: now[name] for name in reloadable() & now.keys() if now[name] != before.get(name)}
        if changed:
            yield Arrival(message.log_time_ns, Reload(changed))
        before = now


def _require_types(bag: Bag, names: dict[str, str], p: SlipEstimatorParameters) -> None:
    """What is read must be of the type that its reader knows."""
    expected = dict.fromkeys(p.yaw_rate_sources, "imu/data_raw")
    expected |= dict.fromkeys(("reference_pose", *p.pose_sources), "box_pose")
    expected |= dict.fromkeys(p.slip_sources, TRACK_SLIP)
    for topic, name in names.items():
        known, found = TOPICS.get(expected.get(name, name)), bag.topics[topic].type_name
        if known is not None and found != known.type_name:
            raise InputError(f"bag '{bag.path}': {topic} is a {found}; accepted: {known.type_name}")


def _series(stamps_ns: NDArray[np.int64], numbers: FloatArray) -> Series:
    """Rows in the order of their stamps; of several with the same stamp the last."""
    stamps, from_the_end = np.unique(stamps_ns[::-1], return_index=True)
    return Series(stamps, numbers[::-1][from_the_end])


def absolute_time(bag: Bag, seconds: float) -> int | None:
    """Log time of a time from the bag's first message; None for no limit."""
    return bag.start_ns + round(seconds * 1e9) if np.isfinite(seconds) else None
