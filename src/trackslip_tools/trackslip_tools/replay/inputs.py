# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads the estimator's inputs from a bag, in the order in which it processed them live.

    stream = InputStream(bag, p, filters, tables=("truth/odometry",))
    for batch in stream:                      # some seconds of the bag, in bounded memory
        batch.rows                            # (n,) ARRIVAL in live order, filters applied: see arrivals
        batch.tables["truth/odometry"].rows   # (m,) named columns of message_fields, in log order
    stream.counts, stream.messages, stream.duration_s     # known by then

``to_measurements`` makes the estimator's own records of the rows.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from trackslip_bags.chunks import Span, exchanged_parts
from trackslip_bags.input_filters import InputFilters
from trackslip_bags.manual_poses import input_names
from trackslip_bags.parameters import (
    PARAMETERS_TOPIC,
    bag_parameters,
    mounting_names,
    read_learned,
    read_parameters,
)
from trackslip_bags.reader import Bag, require_one_type, require_topics
from trackslip_bags.tables import Stretch, TopicTable, read_tables
from trackslip_common.arrays import BoolArray, IntArray, Rows
from trackslip_common.errors import InputError
from trackslip_common.make import stamp_ns_of
from trackslip_common.message_fields import ABSENT, RECORDS, FrameFields, ReportFields, SwingFields
from trackslip_common.message_reading import frame_number
from trackslip_common.parameters import reloadable_names
from trackslip_common.tally import Tally
from trackslip_common.topics import FIX_VELOCITY, ODOMETRY, TOPICS, TRACK_SLIP, TRUE_SWING
from trackslip_estimation.slip.measurements import (
    FORGET,
    FREEZE,
    RELOAD,
    RESET,
    SET_POSE,
    UNFREEZE,
    Reload,
)
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import ODOMETRY as ODOMETRY_KIND
from trackslip_estimation.slip.sources import HEADING_MESSAGES, Rejection
from trackslip_tools.replay.arrivals import (
    ARRIVAL,
    IS_RELOAD,
    POSE_READER,
    SLIP_READER,
    SPROCKET_READER,
    SourceReader,
    reader_of,
)
from trackslip_tools.replay.comparable import LINE
from trackslip_tools.replay.filtering import ArrivalFilter, Withholding
from trackslip_tools.replay.live_order import JournalCounts, LiveOrder

SPROCKETS, REPORTS = "sprockets", "measurement_reports"

_OTHER_CLOCK_NS = 60_000_000_000  # between stamps and log times of one clock, at most
_FIRST_MESSAGES = 9  # of the sprockets: a single stamp may be stray
_ADJACENT_NS = 500_000_000  # between two spans: a slow topic has no message at their border
_COMMANDS = (RESET, FORGET, FREEZE, UNFREEZE)  # the bag holds only their lines in the journal


class LoggedMessages(NamedTuple):
    """Messages of a topic, in log order."""

    log_times_ns: IntArray  # (n,)
    rows: Rows  # (n,) records of the class that ``message_fields`` has for the type
    table: TopicTable  # for fields that the rows lack


class Batch(NamedTuple):
    """Inputs from some seconds of a bag."""

    rows: Rows  # (n,) ARRIVAL in live order
    tables: dict[str, LoggedMessages]  # requested topic → messages; never later than rows of the same time


class InputStream:
    """The inputs of one bag; iteration reads the bag once.

    ``tables`` names further topics to read. Topics have their names after the filters' remapping.

    Raises:
        InputError: the bag lacks the sprockets, or a topic has an unsupported type; during iteration: the bag
            is damaged.
    """

    def __init__(
        self, bag: Bag, p: SlipEstimatorParameters, filters: InputFilters, tables: Collection[str] = ()
    ) -> None:
        original_names = {after: before for before, after in filters.remap.items()}
        require_topics(bag, [original_names.get(SPROCKETS, SPROCKETS)])
        self._bag, self._filters, self._tables = bag, filters, tables
        self.stamp_origin_ns = stamp_origin_ns(bag, original_names.get(SPROCKETS, SPROCKETS))
        self._reloadable = reloadable_names(p)
        names = {topic: filters.remap.get(name, name) for topic, name in input_names(bag).items()}
        self._readers = _source_readers(
            p, {name: bag.topics[topic].type_name for topic, name in names.items()}
        )
        self.sources = (*self._readers, RELOAD, *_COMMANDS)
        requested = {*self._readers, REPORTS, RELOAD, *tables}
        self._names = {topic: name for topic, name in names.items() if name in requested}
        _require_types(bag, self._names, p, tables)
        self._span = tuple(log_time_at(bag, t) for t in (filters.start_s, filters.stop_s))
        self.reloads: list[Reload] = []
        self.starts: list[Start] = []
        self.messages: Counter[str] = Counter()  # topic → number of messages read
        self.counts = JournalCounts()
        self.rejected, self._frames = Tally(), p.frames_of_sources()
        self.withholding = Withholding(filters, bag.start_ns)
        self._first_ns, self._last_ns = np.iinfo(np.int64).max, 0
        self.exchanged_parts = exchanged_parts(bag)
        self.passed_twice: Span | None = None  # the longest so far
        self.longest_pause: Span | None = None  # of the sprockets, by log time
        self._sprockets_until_ns: int | None = None

    @property
    def topics(self) -> frozenset[str]:
        """Names of the topics that are read and that the bag has."""
        return frozenset(self._names.values())

    @property
    def start_ns(self) -> int:
        """Log time of the bag's first message."""
        return self._bag.start_ns

    @property
    def duration_s(self) -> float:
        """Time between the first and last measurements read so far, s, by log time: stamps may be stray."""
        return max(self._last_ns - self._first_ns, 0) * 1e-9

    def __iter__(self) -> Iterator[Batch]:
        filtering = ArrivalFilter(self._filters, self.sources, self.withholding)
        commands = [self.sources.index(name) for name in _COMMANDS]
        parameters = _ParameterChanges(self._bag, self._reloadable, self.reloads, self.starts)
        sprockets = self.sources.index(SPROCKETS)
        order = LiveOrder(self.sources, self._journaled_sources(), commands, sprockets, parameters.unknown)
        self.counts = order.counts
        for stretch in read_tables(self._bag, self._names, *self._span):
            self._extend_passed_twice(stretch.passed_twice)
            rows, lines = self._read_arrivals(stretch, parameters), self._journal_lines(stretch)
            ready = order.push(filtering(rows), lines, stretch.until_ns)
            yield Batch(ready, self._requested_tables(stretch))
        rest = order.finish()
        if len(rest):
            yield Batch(rest, {})

    def first_message(self, name: str) -> Any:
        """The first message of an input, None without; raises ``InputError`` as iteration does."""
        topics = [topic for topic, input_name in self._names.items() if input_name == name]
        first = next(self._bag.messages(topics, *self._span), None)
        return None if first is None else self._bag.deserialize(first.raw, first.type_name)

    def _journaled_sources(self) -> set[int]:
        """Sources with lines in the journal; the journal is read until all sources of the bag are found."""
        counts = {name: self._bag.topics[topic].count for topic, name in self._names.items()}
        missing = {name for name in self._readers if counts.get(name, 0)}
        missing |= {RELOAD} if counts.get(RELOAD, 0) > 1 else set()  # the first message changes nothing
        journaled: set[int] = set()
        reports = [topic for topic in self._names if self._names[topic] == REPORTS]
        for stretch in read_tables(self._bag, reports, *self._span) if reports else ():
            sources = {int(source) for source in self._journal_lines(stretch)["source"]}
            journaled |= sources
            missing -= {self.sources[source] for source in sources if source >= 0}
            if not missing:
                break
        return journaled

    def _journal_lines(self, stretch: Stretch) -> Rows:
        """(n,) LINE of the journal; source −1 for topics that are no inputs."""
        parts = [np.empty(0, LINE)]
        for topic, table in stretch.items():
            if self._names[topic] == REPORTS:
                rows = table.rows(ReportFields)
                numbers = [self.sources.index(t) if t in self.sources else -1 for t in table.texts]
                lines = np.empty(len(rows), LINE)
                lines["log_time_ns"], lines["sequence"] = table.log_times_ns, rows["sequence"]
                lines["source"], lines["stamp_ns"] = np.array(numbers)[rows["source"]], rows["stamp_ns"]
                lines["outcome"] = rows["outcome"]
                parts.append(lines)
        return np.concatenate(parts)

    def _read_arrivals(self, stretch: Stretch, parameters: "_ParameterChanges") -> Rows:
        """(n,) ARRIVAL in log order; changes of parameters come after inputs of the same log time."""
        parts, orders = [np.empty(0, ARRIVAL)], [np.empty(0, np.int64)]
        changes = [np.empty(0, ARRIVAL)]
        for topic, table in stretch.items():
            name = self._names[topic]
            if name == RELOAD:
                changes.append(parameters.rows(table, self.sources.index(RELOAD)))
                continue
            self.messages[name] += len(table)
            reader = self._readers.get(name)
            if reader is not None:
                read = table.rows(reader.fields)
                rows = reader.rows(read)
                if reader.kind == ODOMETRY_KIND:
                    rows["frame"] = _frame_numbers(table)
                rows["source"], rows["log_time_ns"] = self.sources.index(name), table.log_times_ns
                is_usable = self._has_required_frame(name, table)
                is_usable &= self._has_measurement(name, reader, read, is_usable)
                self._extend_duration(table.log_times_ns)
                if name == SPROCKETS:
                    self._extend_longest_pause(table.log_times_ns)
                parts.append(rows[is_usable])
                orders.append(table.order[is_usable])
        rows = np.concatenate(parts)[np.argsort(np.concatenate(orders), kind="stable")]
        rows = np.concatenate((rows, *changes))
        return rows[np.argsort(rows["log_time_ns"], kind="stable")]

    def _has_required_frame(self, name: str, table: TopicTable) -> BoolArray:
        """(n,) whether each message has the frame_id required of its source, as the live node checks."""
        required = self._frames.get(name)
        if required is None:
            return np.ones(len(table), np.bool_)
        numbers = table.rows(FrameFields)["frame"]
        has_frame = np.array([text == required for text in table.texts])[numbers]
        self.rejected.add(name, Rejection.OTHER_FRAME, int((~has_frame).sum()))
        return np.asarray(has_frame)

    def _has_measurement(
        self, name: str, reader: SourceReader, read: Rows, is_usable: BoolArray
    ) -> BoolArray:
        """(n,) whether each message contains the measured quantity, as the live node checks."""
        if reader.absent is None:
            return is_usable
        field_, reason = reader.absent
        lacks = is_usable & (read[field_] == ABSENT)
        self.rejected.add(name, reason, int(lacks.sum()))
        return np.asarray(~lacks)

    def _extend_passed_twice(self, span: Span | None) -> None:
        """Keep the longest span; those of two stretches that touch are one."""
        longest = self.passed_twice
        if span is None:
            return
        if longest is not None and span.begin_ns - longest.end_ns < _ADJACENT_NS:
            span = Span(min(longest.begin_ns, span.begin_ns), max(longest.end_ns, span.end_ns))
        if longest is None or span.end_ns - span.begin_ns > longest.end_ns - longest.begin_ns:
            self.passed_twice = span

    def _extend_longest_pause(self, log_times_ns: IntArray) -> None:
        if not len(log_times_ns):
            return
        before_ns, self._sprockets_until_ns = self._sprockets_until_ns, int(log_times_ns[-1])
        times = np.insert(log_times_ns, 0, log_times_ns[0] if before_ns is None else before_ns)
        k, longest = int(np.diff(times).argmax()), self.longest_pause
        if longest is None or times[k + 1] - times[k] > longest.end_ns - longest.begin_ns:
            self.longest_pause = Span(int(times[k]), int(times[k + 1]))

    def _extend_duration(self, log_times_ns: IntArray) -> None:
        if len(log_times_ns):
            self._first_ns = min(self._first_ns, int(log_times_ns.min()))
            self._last_ns = max(self._last_ns, int(log_times_ns.max()))

    def _requested_tables(self, stretch: Stretch) -> dict[str, LoggedMessages]:
        return {
            self._names[topic]: LoggedMessages(
                table.log_times_ns,
                table.rows(SwingFields if self._names[topic] == TRUE_SWING else RECORDS[table.type_name]),
                table,
            )
            for topic, table in stretch.items()
            if self._names[topic] in self._tables
        }


class Start(NamedTuple):
    """Initial values of a run of the estimator, from the message of its parameters."""

    changed: dict[str, Any]  # reloadable parameters that differ from those at the bag's start
    learned: Any  # learned before, for ``learned.from_tree``; None: nothing


class _ParameterChanges:
    """Later messages of the estimator's parameters: changes at run time, or restarts."""

    def __init__(self, bag: Bag, names: Collection[str], reloads: list[Reload], starts: list[Start]) -> None:
        """``names``: names of the parameters that may change at run time."""
        self._bag, self._names, self._reloads, self._starts = bag, frozenset(names), reloads, starts
        self._first: dict[str, Any] | None = None
        self._before: dict[str, Any] = {}
        messages = bag.messages([PARAMETERS_TOPIC])
        self._first_ns = next((message.log_time_ns for message in messages), 0)
        self.unknown: list[str] = []  # of each start, why it cannot be repeated; empty if it can

    def rows(self, table: TopicTable, source: int) -> Rows:
        """(n,) ARRIVAL of the messages; appends changes to the reloads, initial values to the starts."""
        rows = np.zeros(len(table), ARRIVAL)
        rows["kind"], rows["source"], rows["log_time_ns"] = IS_RELOAD, source, table.log_times_ns
        if self._first is None:
            self._first = self._before = bag_parameters(self._bag)
        for k in range(len(table)):
            message = table.message(k)
            now = read_parameters(self._bag, message)
            changed, rows["reload"][k] = self._changed_parameters(now, self._before), -1
            if changed:
                rows["reload"][k] = len(self._reloads)
                self._reloads.append(Reload(changed))
            rows["start"][k] = len(self._starts)
            self._starts.append(
                Start(self._changed_parameters(now, self._first), read_learned(self._bag, message))
            )
            different = [name for name in now if now[name] != self._first.get(name, now[name])]
            different = sorted(set(different) - self._names - set(mounting_names(self._first)))
            self.unknown.append(
                f"the estimator was started again with other {', '.join(different)}" if different else ""
            )
            self._before = now
        return rows[rows["log_time_ns"] > self._first_ns]

    def _changed_parameters(self, now: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
        return {n: now[n] for n in self._names & now.keys() if now[n] != before.get(n)}


def stamp_origin_ns(bag: Bag, sprockets: str = SPROCKETS) -> int:
    """The stamps' time at the bag's first message: its log time, unless stamps are of another clock.

    Simulated time begins at 0, while the recorder goes by the computer's clock.
    """
    topic = next((topic for topic, name in input_names(bag).items() if name == sprockets), None)
    messages = islice(bag.messages([topic]) if topic is not None else (), _FIRST_MESSAGES)
    contents = ((m.log_time_ns, bag.deserialize(m.raw, m.type_name)) for m in messages)
    offsets_ns = [stamp_ns_of(m) - log_time_ns for log_time_ns, m in contents if hasattr(m, "header")]
    offset_ns = sorted(offsets_ns)[len(offsets_ns) // 2] if offsets_ns else 0
    return bag.start_ns + (offset_ns if abs(offset_ns) > _OTHER_CLOCK_NS else 0)


def _source_readers(p: SlipEstimatorParameters, types: Mapping[str, str]) -> dict[str, SourceReader]:
    """Source → reader; ``types``: topic → type of its messages in the bag."""
    readers = {SPROCKETS: SPROCKET_READER}
    for sources in (p.gyros(), p.compasses(), p.swing_encoders(), p.odometries(), p.velocities()):
        readers |= {topic: reader_of(source, types.get(topic, "")) for topic, source in sources.items()}
    readers |= dict.fromkeys((SET_POSE, *filter(None, p.pose_sources)), POSE_READER)
    return readers | dict.fromkeys(filter(None, p.slip_sources), SLIP_READER)


def _frame_numbers(table: TopicTable) -> IntArray:
    """(n,) the number of each message's frame_id, as in the live node."""
    numbers = table.rows(FrameFields)["frame"]
    number_of_text: IntArray = np.array([frame_number(text) for text in table.texts], np.int64)
    return np.asarray(number_of_text[numbers])


def _require_types(
    bag: Bag, names: dict[str, str], p: SlipEstimatorParameters, tables: Collection[str]
) -> None:
    """Raise InputError for a topic whose type its reader does not support."""
    expected = dict.fromkeys(p.yaw_rate_sources, "imu/data_raw")
    expected |= dict.fromkeys(("reference_pose", *p.pose_sources), "box_pose")
    expected |= dict.fromkeys(p.slip_sources, TRACK_SLIP)
    expected |= dict.fromkeys(p.swing_encoders(), TRUE_SWING)
    expected |= dict.fromkeys(p.odometry_sources, ODOMETRY)
    expected |= dict.fromkeys(p.velocity_sources, FIX_VELOCITY)
    require_one_type(bag, names)
    for topic, name in names.items():
        topic_spec, type_name = TOPICS.get(expected.get(name, name)), bag.topics[topic].type_name
        accepted = [topic_spec.type_name] if topic_spec is not None else sorted(RECORDS)
        if name in p.compasses():
            accepted = sorted(HEADING_MESSAGES.values())
        if type_name not in accepted and (topic_spec is not None or name in tables):
            raise InputError(f"bag '{bag.path}': {topic} is a {type_name}; accepted: {' or '.join(accepted)}")


def log_time_at(bag: Bag, seconds: float) -> int | None:
    """Log time of a time from the bag's first message, ns; None for no limit."""
    return bag.start_ns + round(seconds * 1e9) if np.isfinite(seconds) else None
