# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Converts another robot's log (CSV files, a bag, recorded devices) to a bag, by a file of ``mapping``.

The log time of a message is its time of arrival: that of the bag, or of a column ``received``, or else its
stamp. Replay thus passes it to the estimator no earlier than the robot received it. Motion is planar.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from trackslip_bags.importing.bag_log import is_bag, read_bag_log
from trackslip_bags.importing.can_log import read_can_logs
from trackslip_bags.importing.csv_log import read_csv_logs
from trackslip_bags.importing.local import LocalFrame
from trackslip_bags.importing.log_kinds import LogKind, kind_of
from trackslip_bags.importing.mapping import LogMapping
from trackslip_bags.importing.mapping_topics import BagTopic, CsvTopic
from trackslip_bags.importing.receiver_log import has_messages, read_receiver_logs
from trackslip_bags.importing.recorded_devices import CanSection, GnssSection
from trackslip_bags.importing.roles import ROLES
from trackslip_bags.importing.samples import Samples
from trackslip_bags.messages import make, serialize
from trackslip_bags.parameters import PARAMETERS_TOPIC, PARAMETERS_TYPE
from trackslip_bags.reader import absolute_name
from trackslip_bags.writer import BagWriter
from trackslip_common.config_files import parameters_text
from trackslip_common.errors import InputError
from trackslip_common.vehicle_files import TOPIC as VEHICLE
from trackslip_common.vehicle_files import vehicle_text
from trackslip_estimation.gnss.localizer import Datum
from trackslip_estimation.setup_check.count_angle import angle_of_count
from trackslip_estimation.slip.parameters import NODE as SLIP_NODE

_CSV_SUFFIXES = (".csv", ".txt", ".tsv", ".dat")
_FileKinds = Mapping[Path, tuple[LogKind, str]]
_MAX_NAMED = 3  # files in an error
_DEVICE_SUFFIXES = (".log", ".asc", ".blf", ".trc", ".mf4", ".nmea", ".ubx", ".bin", ".gps")
_OTHER_CLOCK_S = 10.0
_MIN_READINGS = 100  # readings of speeds, enough to show counts
_BEFORE_ZERO = "moved to before 0 s by time_offset"


@dataclass(frozen=True)
class Lateness:
    """Delay of the log times of a topic's messages after their stamps, s."""

    median: float
    longest: float

    @property
    def is_other_clock(self) -> bool:
        """Whether stamps and log times are from two clocks."""
        return abs(self.median) > _OTHER_CLOCK_S


@dataclass(frozen=True)
class Imported:
    """Result of an import."""

    counts: dict[str, int]  # messages in the bag, by topic
    left_out: dict[str, dict[str, int]]  # by topic and reason
    lateness: dict[str, Lateness]  # by topic, if log times differ from stamps
    datum: Datum | None  # of local positions made of latitude and longitude
    notes: list[str]


def import_log(logs: Sequence[Path], mapping: LogMapping, output: Path) -> Imported:
    """Write the bag; rows that give no message are left out and counted.

    Raises:
        InputError: the log cannot be read or does not fit the mapping, or the bag exists already.
    """
    local = LocalFrame(mapping.datum)
    samples, notes = _read_logs(logs, mapping, local)
    samples = [_without_negative_stamps(one) for one in samples]
    if not any(len(one.stamps_ns) for one in samples):
        raise InputError(f"{logs[0]}: no message has a stamp of 0 s or later; accepted: another time_offset")
    samples = [one for one in samples if len(one.stamps_ns)]
    with BagWriter(output) as bag:
        begin_ns = min(int(one.log_times_ns.min()) for one in samples)
        for topic, text in _first_messages(mapping, samples):
            data = serialize(make(PARAMETERS_TYPE, data=text))
            bag.write(absolute_name(topic), PARAMETERS_TYPE, data, begin_ns)
        for log_time_ns, one, row in _in_log_order(samples):
            type_name = ROLES[one.role].type_name
            bag.write(absolute_name(one.topic), type_name, serialize(one.message(row)), log_time_ns)
    left_out = {absolute_name(one.topic): dict(one.left_out) for one in samples if one.left_out}
    late = {absolute_name(one.topic): lateness for one in samples if (lateness := _lateness(one)) is not None}
    return Imported(bag.counts, left_out, late, local.datum if local.is_used else None, notes)


def _read_logs(
    logs: Sequence[Path], mapping: LogMapping, local: LocalFrame
) -> tuple[list[Samples], list[str]]:
    """Samples and notes of a bag or CSV files, depending on the topics of the mapping, and of its devices."""
    missing = [path for path in logs if not path.exists()]
    if missing:
        raise InputError(f"log '{missing[0]}' not found; accepted: logs or their directory, or a bag")
    bags = [path for path in logs if is_bag(path)]
    files = [file for path in logs if path not in bags for file in _log_files(path)]
    samples, notes = [], []
    for part, part_notes in _read_parts(bags, files, mapping, local):
        samples += part
        notes += part_notes
    return samples, notes


def _read_parts(
    bags: Sequence[Path], files: Sequence[Path], mapping: LogMapping, local: LocalFrame
) -> Iterator[tuple[list[Samples], list[str]]]:
    """Samples and notes of each kind of log; each log must be read by some part of the mapping."""
    topics = list(mapping.topics.values())
    of_bag = [topic for topic in topics if isinstance(topic, BagTopic)]
    of_csv = [topic for topic in topics if isinstance(topic, CsvTopic)]
    kinds = {file: _kind_of_file(file, None if of_csv else mapping.gnss) for file in files}
    of_can = _files_of(kinds, LogKind.CAN, mapping.can, "a CAN bus (candump, ASC, BLF, TRC, MF4)")
    of_gnss = _files_of(kinds, LogKind.GNSS, mapping.gnss, "a GNSS receiver (NMEA, UBX)")
    rest = [file for file in files if file not in of_can and file not in of_gnss]
    if of_bag:
        if rest or not bags:
            raise InputError(
                f"{(rest or files)[0]}: no bag, and {mapping.path} has topics of one (from); accepted: a bag"
            )
        yield read_bag_log(bags, of_bag, local)
    elif bags:
        raise InputError(f"{bags[0]}: a bag, and {mapping.path} names columns; accepted: topics with 'from'")
    if mapping.can is not None:
        yield read_can_logs(of_can, mapping.can, mapping.vehicle)
    if mapping.gnss is not None:
        yield read_receiver_logs(of_gnss, mapping.gnss, local)
    if of_csv:
        yield read_csv_logs(rest, of_csv, mapping.start_ns, local)
    elif rest and not of_bag:
        raise InputError(f"{rest[0]}: a {kinds[rest[0]][1]}, {_unread_reason(mapping, kinds[rest[0]][0])}")


def _unread_reason(mapping: LogMapping, kind: LogKind) -> str:
    """The reason why no part of the mapping reads a file of a kind, and accepted alternatives."""
    section = {LogKind.CAN: mapping.can, LogKind.GNSS: mapping.gnss}.get(kind)
    if section is not None:
        return f"left out by {section.where}.file '{section.file}'; accepted: a pattern of its name"
    if kind is LogKind.TABLE:
        return f"and {mapping.path} names no columns; accepted: topics of columns"
    if kind is LogKind.OTHER:
        return f"which no part of {mapping.path} reads; accepted: logs that docs/import.md lists"
    return f"and {mapping.path} has no '{kind.value}'; accepted: that section (docs/import.md)"


def _kind_of_file(file: Path, gnss: GnssSection | None) -> tuple[LogKind, str]:
    """Kind of a file, and its description; one for ``gnss`` may begin anywhere in a receiver's stream."""
    try:
        kind, description = kind_of(file)
        is_open = (
            gnss is not None and kind in (LogKind.TABLE, LogKind.OTHER) and fnmatch(file.name, gnss.file)
        )
        if is_open and has_messages(file):
            return LogKind.GNSS, "log of a GNSS receiver"
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror})") from error
    return kind, description


def _files_of(
    kinds: _FileKinds, kind: LogKind, section: CanSection | GnssSection | None, device: str
) -> list[Path]:
    """Files of a kind whose names the section accepts; none without a section, else one or more."""
    if section is None:
        return []
    files = [file for file, (own, _) in kinds.items() if own is kind and fnmatch(file.name, section.file)]
    if not files:
        there = "; ".join(f"{file.name}: a {words}" for file, (_, words) in list(kinds.items())[:_MAX_NAMED])
        raise InputError(
            f"{section.where}: no log of {device} named '{section.file}' among the logs "
            f"({there or 'none given'}); accepted: one or more"
        )
    return files


def _log_files(path: Path) -> list[Path]:
    """A file, or those in a directory that may be logs."""
    if not path.is_dir():
        return [path]
    endings = (*_CSV_SUFFIXES, *_DEVICE_SUFFIXES)
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in endings and file.is_file())
    if not files:
        raise InputError(
            f"{path}: neither a bag nor holds logs; accepted: a bag, or files *{', *'.join(endings)}"
        )
    return files


def _first_messages(mapping: LogMapping, samples: Sequence[Samples]) -> Iterator[tuple[str, str]]:
    """The first messages of a bag: its vehicle, and parameters of the estimator."""
    resolution = encoder_resolution(samples)
    positions = [one.values["position"] for one in samples if one.role == "sprockets"]
    has_only_speeds = any(len(one) >= _MIN_READINGS and not np.isfinite(one).any() for one in positions)
    estimated = {"encoder_resolution": resolution} if resolution or has_only_speeds else {}
    if mapping.vehicle is not None:
        yield VEHICLE, vehicle_text(mapping.vehicle)
    if parameters := {**estimated, **mapping.parameters}:
        yield PARAMETERS_TOPIC, parameters_text(parameters, SLIP_NODE)


def encoder_resolution(samples: Sequence[Samples]) -> float:
    """Angle of one count of the sprockets, rad; 0 without sprockets, and without counts."""
    sprockets = [one for one in samples if one.role == "sprockets" and len(one.stamps_ns)]
    if not sprockets:
        return 0.0
    t = (sprockets[0].stamps_ns - sprockets[0].stamps_ns[0]) * 1e-9
    return angle_of_count(t, sprockets[0].values["velocity"], sprockets[0].values["position"])


def _without_negative_stamps(one: Samples) -> Samples:
    """Samples without stamps before 0, which no bag can hold."""
    good = one.stamps_ns >= 0
    if good.all():
        return one
    left_out = one.left_out + Counter({_BEFORE_ZERO: int((~good).sum())})
    return replace(one.select(np.flatnonzero(good)), left_out=left_out)


def _in_log_order(samples: Sequence[Samples]) -> Iterator[tuple[int, Samples, int]]:
    """Log time, topic and row of each message; of the same time in the order of mapping and log."""
    numbers = np.concatenate([np.full(len(one.stamps_ns), k) for k, one in enumerate(samples)])
    rows = np.concatenate([np.arange(len(one.stamps_ns)) for one in samples])
    times = np.concatenate([one.log_times_ns for one in samples])
    order = np.argsort(times, kind="stable")
    for log_time_ns, number, row in zip(
        times[order].tolist(), numbers[order].tolist(), rows[order].tolist(), strict=True
    ):
        yield log_time_ns, samples[number], row


def _lateness(one: Samples) -> Lateness | None:
    late = (one.log_times_ns - one.stamps_ns) * 1e-9
    if not late.any():
        return None
    return Lateness(float(np.median(late)), float(late.max()))
