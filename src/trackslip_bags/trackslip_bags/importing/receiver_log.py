# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of logs of a GNSS receiver, NMEA and UBX, through the driver's own protocol.

A log has no times of arrival. Stamps are the receiver's UTC: times of day, on the date that RMC, ZDA or
NAV-PVT states, or that the mapping gives. A sentence without a time (HDT, THS) is of the previous epoch.
"""

import codecs
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import NamedTuple

import numpy as np

from trackslip_bags.importing.local import LocalFrame
from trackslip_bags.importing.log_kinds import encoding_of_mark
from trackslip_bags.importing.recorded_devices import GnssSection
from trackslip_bags.importing.role_values import values_of
from trackslip_bags.importing.roles import ROLE_OF_TOPIC, ROLES
from trackslip_bags.importing.samples import Samples, SelectedRows, Values
from trackslip_bags.importing.times import LIMIT_NS
from trackslip_common.config_files import load_parameters
from trackslip_common.errors import InputError
from trackslip_common.tally import Tally
from trackslip_drivers.nmea_parameters import NmeaParameters
from trackslip_drivers.protocols import ubx
from trackslip_drivers.protocols.gnss_frames import Frame, FrameSplitter, Kind
from trackslip_drivers.protocols.nmea import Rejection, Sentence, read_sentence, time_of_day_ns
from trackslip_drivers.protocols.nmea_stream import NO_POSITION, POSITIONS, NmeaStream, Sample
from trackslip_drivers.records import CovarianceType, FixSample, HeadingSample, VelocitySample

_NODE, _NETWORK = "nmea_gnss", "log://"  # as over a network: bytes without transmission time
_PIECE = 1 << 16  # bytes
_MIN_SENTENCES = 2  # sentences that identify a log with other bytes before them
_VALID_DATE = 1  # flag of NAV-PVT
_DAY_NS = 86_400_000_000_000
_EPOCH = date(1970, 1, 1)


class _TimedMessage(NamedTuple):
    """One message of the log."""

    content: bytes
    time_ns: int | None  # of day
    day: date | None  # that it states
    is_clock: bool = False  # the date is that of the receiver's own clock, which may not be set


def read_receiver_logs(
    paths: Sequence[Path], section: GnssSection, local: LocalFrame
) -> tuple[list[Samples], list[str]]:
    """Samples of ``fix``, ``gnss_pose``, ``fix_velocity`` and ``heading``, and notes on rejected messages.

    Raises:
        InputError: a log cannot be read, or gives no sample.
    """
    names = ", ".join(path.name for path in paths)
    defaults = load_parameters(NmeaParameters, _NODE, (f"{_NODE}.yaml",))
    stddev = defaults.heading_stddev if section.heading_stddev is None else section.heading_stddev
    tally = Tally()
    p = replace(defaults, serial_port=_NETWORK, heading_stddev=stddev, time_offset=0.0)
    stream = NmeaStream(p, tally, lambda steady_ns: steady_ns)
    messages = [message for path in paths for message in _messages(path)]
    notes: list[str] = []
    samples: list[Sample] = []
    for message, now_ns in _with_epoch_times(messages, section, names, notes):
        samples += stream.feed(message.content, now_ns)
    samples += stream.flush()
    distinct = {(type(one), one.stamp_ns): one for one in reversed(samples)}
    if len(distinct) < len(samples):
        notes.append(f"{names}: {len(samples) - len(distinct)} × an epoch that another log holds, too")
    samples = list(reversed(distinct.values()))
    notes += [f"{names}: {n} × {reason}" for why in tally.by_source().values() for reason, n in why.items()]
    if count := stream.duplicates_of_same_kind:
        notes.append(f"{names}: {count} × another of one kind in an epoch; accepted: one (as often as GGA)")
    kinds = f"kinds that come: {', '.join(stream.all_kinds) or 'none'}"
    if stream.all_kinds and not POSITIONS & set(stream.all_kinds):
        kinds += f"; {NO_POSITION}"
        notes.append(f"{names}: no position; {kinds}")
    if samples and all(message.time_ns is None for message in messages):
        raise InputError(f"{section.where}: {names}: no message states a time ({kinds})")
    fixes = [one for one in samples if isinstance(one, FixSample)]
    directions = [one for one in samples if isinstance(one, HeadingSample)]
    velocities = [one for one in samples if isinstance(one, VelocitySample)]
    all_samples = list(_fix_samples(fixes, section, local, names, notes)) if fixes else []
    if velocities:
        east, north, stddev = np.array([(one.east, one.north, one.stddev) for one in velocities]).T
        columns, variances = {"east": east, "north": north}, dict.fromkeys("xy", stddev**2)
        all_samples.append(_samples("fix_velocity", velocities, columns, variances, section, names))
    if directions:
        yaw, stddev = np.array([(one.yaw, one.stddev) for one in directions]).T
        all_samples.append(_samples("heading", directions, {"yaw": yaw}, {"yaw": stddev**2}, section, names))
    if not all_samples:
        reasons = "; ".join([*notes, kinds] if POSITIONS & set(stream.all_kinds) else notes or [kinds])
        raise InputError(f"{section.where}: {names}: no position and no heading ({reasons})")
    return all_samples, notes


def _messages(path: Path) -> Iterator[_TimedMessage]:
    """Complete messages of a file, and the bytes between them, which the stream counts."""
    splitter = FrameSplitter(0)
    try:
        for piece in _read_pieces(path):
            for frame in splitter.feed(piece, 0):
                yield _timed_message(frame)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    for frame in splitter.feed(b"\n", 0):  # a last line without an end
        yield _timed_message(frame)


def _read_pieces(path: Path) -> Iterator[bytes]:
    """The bytes of a log; of a log in UTF-16, its text as latin-1."""
    with path.open("rb") as file:
        is_wide = encoding_of_mark(file.read(2)) == "utf-16"
        file.seek(0)
        if is_wide:
            for text in codecs.iterdecode(iter(lambda: file.read(_PIECE), b""), "utf-16", "replace"):
                yield text.encode("latin-1", "replace")
        else:
            yield from iter(lambda: file.read(_PIECE), b"")


def has_messages(path: Path) -> bool:
    """Whether the first part of a file holds messages of a receiver, with any bytes before or between them.

    Raises:
        OSError: it cannot be read.
    """
    splitter, sentences = FrameSplitter(0), 0
    for frame in splitter.feed(next(_read_pieces(path), b""), 0):
        if frame.kind is Kind.UBX:
            return True
        sentences += frame.kind is Kind.SENTENCE and isinstance(read_sentence(frame.content), Sentence)
    return sentences >= _MIN_SENTENCES


def _timed_message(frame: Frame) -> _TimedMessage:
    if frame.kind is Kind.SENTENCE:
        sentence = read_sentence(frame.content)
        reading = sentence.reading if isinstance(sentence, Sentence) else None
        time_ns = None if reading is None or isinstance(reading, Rejection) else reading.time_ns
        is_clock = isinstance(sentence, Sentence) and sentence.kind == "ZDA"
        if is_clock:
            time_ns = _zda_time_ns(frame.content)
        day = None if time_ns is None else _day_of(sentence, frame.content)
        return _TimedMessage(frame.content + b"\r\n", time_ns, day, is_clock)
    if frame.kind is Kind.UBX:
        pvt = ubx.decode(frame.content)
        time_ns = None if pvt is None or isinstance(pvt, Rejection) else pvt.time_ns
        day = None
        if isinstance(pvt, ubx.Pvt):
            year, month, day_of_month = int.from_bytes(frame.content[10:12], "little"), *frame.content[12:14]
            day = _date(year, month, day_of_month)
        return _TimedMessage(
            frame.content, time_ns, day, is_clock=day is not None and not frame.content[17] & _VALID_DATE
        )
    return _TimedMessage(frame.content + (b"\n" if frame.kind is Kind.OVERLONG else b""), None, None)


def _zda_time_ns(sentence: bytes) -> int | None:
    try:
        return time_of_day_ns(sentence.split(b",")[1].decode("latin-1"))
    except (IndexError, ValueError):
        return None


def _day_of(sentence: Sentence | Rejection, content: bytes) -> date | None:
    """The date that RMC, ZDA or KSXT states; None where there is none."""
    if not isinstance(sentence, Sentence):
        return None
    fields = content.partition(b"*")[0].decode("latin-1").split(",")
    try:
        if sentence.kind == "RMC" and len(fields[9]) == 6:
            day, month, year = (int(fields[9][k : k + 2]) for k in (0, 2, 4))
            return _date(2000 + year, month, day)
        if sentence.kind == "ZDA":
            return _date(int(fields[4]), int(fields[3]), int(fields[2]))
        if sentence.kind == "KSXT":
            return _date(int(fields[1][:4]), int(fields[1][4:6]), int(fields[1][6:8]))
    except (IndexError, ValueError):
        pass
    return None


def _date(year: int, month: int, day: int) -> date | None:
    try:
        return date(year, month, day) if year >= _EPOCH.year else None
    except ValueError:
        return None


def _with_epoch_times(
    messages: Sequence[_TimedMessage], section: GnssSection, names: str, notes: list[str]
) -> Iterator[tuple[_TimedMessage, int]]:
    """Each message with the time of its epoch, ns; a note where neither messages nor mapping state a date."""
    times, days, epochs = _epochs(messages)
    first_dated = next((k for k, day in enumerate(days) if day is not None), 0)
    if days[first_dated] is None:
        days[first_dated] = section.day or _EPOCH
        if section.day is None:
            notes.append(f"{names}: no date; stamps are of 1970-01-01 (gnss: {{date: …}} in the mapping)")
    day_numbers = [0 if day is None else (day - _EPOCH).days for day in days]
    for k in range(first_dated - 1, -1, -1):
        day_numbers[k] = day_numbers[k + 1] - (times[k] - times[k + 1] > _DAY_NS // 2)
    for k in range(first_dated + 1, len(days)):
        if days[k] is None:
            day_numbers[k] = day_numbers[k - 1] + (times[k - 1] - times[k] > _DAY_NS // 2)
    shift = (section.day - _EPOCH).days - day_numbers[0] if section.day is not None else 0
    for message, k in zip(messages, epochs, strict=True):
        yield message, (day_numbers[k] + shift) * _DAY_NS + times[k]


def _epochs(messages: Sequence[_TimedMessage]) -> tuple[list[int], list[date | None], list[int]]:
    """Time of day, ns, and stated date of each epoch; the epoch of each message.

    Dates of valid positions are used; in a log without any, those of the receiver's own clock (ZDA).
    """
    of_positions = any(message.day is not None and not message.is_clock for message in messages)
    times: list[int | None] = [None]
    days: list[date | None] = [None]
    epochs: list[int] = []
    for message in messages:
        if message.time_ns is not None and times[-1] not in (None, message.time_ns):
            times.append(None)
            days.append(None)
        times[-1] = times[-1] if message.time_ns is None else message.time_ns
        if message.day is not None and not (message.is_clock and of_positions):
            days[-1] = message.day
        epochs.append(len(times) - 1)
    return [time_ns or 0 for time_ns in times], days, epochs


def _samples(
    topic: str,
    readings: Sequence[Sample],
    columns: Values,
    variances: Values,
    section: GnssSection,
    source: str,
) -> Samples:
    """Samples of one topic; (n, …) columns and variances of its readings."""
    role = ROLE_OF_TOPIC[topic]
    stamps_ns = np.array([one.stamp_ns for one in readings], np.int64) + section.offset_ns
    if stamps_ns.min() < 0 or stamps_ns.max() >= LIMIT_NS:
        raise InputError(f"{section.where}: stamps outside 0 … 2^31 s; accepted: another date or time_offset")
    values = values_of(role, columns, variances, stamps_ns)
    return Samples(topic, role, [ROLES[role].frame], stamps_ns, stamps_ns, values, source=source)


def _fix_samples(
    fixes: Sequence[FixSample], section: GnssSection, local: LocalFrame, source: str, notes: list[str]
) -> Iterator[Samples]:
    """Fixes, and the poses of those with an accuracy."""
    latitude, longitude = np.radians([(one.latitude, one.longitude) for one in fixes]).T
    columns = {
        "latitude": latitude,
        "longitude": longitude,
        "altitude": np.array([one.altitude for one in fixes]),
        "covariance": np.array([np.diag(one.variances) for one in fixes]),
        "kind": np.array([float(one.covariance_type) for one in fixes]),
        "status": np.array([float(one.status) for one in fixes]),
    }
    yield _samples("fix", fixes, columns, {}, section, source)
    has_accuracy = np.array([one.covariance_type is not CovarianceType.UNKNOWN for one in fixes])
    if not has_accuracy.all():
        notes.append(
            f"{source}: {sum(~has_accuracy)} × a fix without accuracy, of which no gnss_pose is made;"
            " switch GST on"
        )
    if not has_accuracy.any():
        return
    chosen = SelectedRows(has_accuracy)
    local.reject(chosen, columns, f"{section.where}: {source}")
    columns = local.with_east_north({name: column[chosen.rows] for name, column in columns.items()})
    used = [one for one, is_used in zip(fixes, chosen.rows, strict=True) if is_used]
    poses = _samples("gnss_pose", used, columns, {}, section, source)
    yield replace(poses, left_out=chosen.left_out)
