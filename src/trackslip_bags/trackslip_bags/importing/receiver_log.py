# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of logs of a GNSS receiver, NMEA and UBX, through the driver's own protocol.

A log has no times of arrival. Stamps are the receiver's UTC: times of day, on the date that RMC, ZDA or
NAV-PVT states, or that the mapping gives. A sentence without a time (HDT, THS) is of the previous epoch.
"""

import codecs
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import NamedTuple

import numpy as np

from trackslip_bags.importing.local import LocalFrame
from trackslip_bags.importing.log_kinds import encoding_of_mark
from trackslip_bags.importing.recorded_devices import GnssSection
from trackslip_bags.importing.roles import ROLES
from trackslip_bags.importing.samples import (
    Samples,
    SelectedRows,
    heading_values,
    level_quaternions,
    without_heading,
)
from trackslip_bags.importing.times import LIMIT_NS
from trackslip_common.arrays import FloatArray, IntArray
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
    kinds = f"kinds that come: {', '.join(stream.kinds) or 'none'}"
    if stream.kinds and not POSITIONS & set(stream.kinds):
        kinds += f"; {NO_POSITION}"
        notes.append(f"{names}: no position; {kinds}")
    if samples and all(message.time_ns is None for message in messages):
        raise InputError(f"{section.where}: {names}: no message states a time ({kinds})")
    fixes = [one for one in samples if isinstance(one, FixSample)]
    directions = [one for one in samples if isinstance(one, HeadingSample)]
    velocities = [one for one in samples if isinstance(one, VelocitySample)]
    all_samples = [
        *_fix_samples(fixes, section, local, names, notes),
        *_velocity_samples(velocities, section, names),
        *_heading_samples(directions, section, names),
    ]
    if not all_samples:
        reasons = "; ".join([*notes, kinds] if POSITIONS & set(stream.kinds) else notes or [kinds])
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
    ends_line = frame.kind in (Kind.TEXT, Kind.OVERLONG)
    return _TimedMessage(frame.content + (b"\n" if ends_line else b""), None, None)


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


def _stamps(samples: Sequence[Sample], section: GnssSection) -> IntArray:
    stamps_ns = np.array([one.stamp_ns for one in samples], np.int64) + section.offset_ns
    if stamps_ns.min() < 0 or stamps_ns.max() >= LIMIT_NS:
        raise InputError(f"{section.where}: stamps outside 0 … 2^31 s; accepted: another date or time_offset")
    return stamps_ns


def _fix_samples(
    fixes: Sequence[FixSample], section: GnssSection, local: LocalFrame, source: str, notes: list[str]
) -> Iterator[Samples]:
    if not fixes:
        return
    stamps_ns = _stamps(fixes, section)
    place = np.array([(math.radians(f.latitude), math.radians(f.longitude), f.altitude) for f in fixes])
    variances = np.array([f.variances for f in fixes])
    covariance = np.zeros((len(fixes), 3, 3))
    covariance[:, range(3), range(3)] = variances
    values = {
        "place": place,
        "covariance": covariance,
        "kind": np.array([float(f.covariance_type) for f in fixes]),
        "status": np.array([float(f.status) for f in fixes]),
    }
    yield Samples("fix", "fix", [ROLES["fix"].frame], stamps_ns, stamps_ns, values, source=source)
    has_accuracy = np.array([f.covariance_type is not CovarianceType.UNKNOWN for f in fixes])
    if not has_accuracy.all():
        notes.append(
            f"{source}: {sum(~has_accuracy)} × a fix without accuracy, of which no gnss_pose is made;"
            " switch GST on"
        )
    if not has_accuracy.any():
        return
    chosen = SelectedRows(has_accuracy)
    for reason, rejected in local.rejections(place, has_accuracy, f"{section.where}: {source}"):
        chosen.reject(rejected, reason)
    is_used = chosen.rows
    east_north: FloatArray = local.east_north(place[is_used])
    planar = np.column_stack((east_north, np.full(len(east_north), np.nan)))
    pose_values = without_heading(planar, covariance[is_used].copy())
    times = stamps_ns[is_used], stamps_ns[is_used]
    yield Samples("gnss_pose", "pose", [ROLES["pose"].frame], *times, pose_values, chosen.left_out, source)


def _velocity_samples(
    velocities: Sequence[VelocitySample], section: GnssSection, source: str
) -> Iterator[Samples]:
    if not velocities:
        return
    stamps_ns = _stamps(velocities, section)
    variances = np.array([(one.stddev**2, one.stddev**2) for one in velocities])
    values = {"velocity": np.array([(one.east, one.north) for one in velocities]), "variances": variances}
    frame = [ROLES["velocity"].frame]
    yield Samples("fix_velocity", "velocity", frame, stamps_ns, stamps_ns, values, source=source)


def _heading_samples(
    headings: Sequence[HeadingSample], section: GnssSection, source: str
) -> Iterator[Samples]:
    if not headings:
        return
    stamps_ns = _stamps(headings, section)
    yaw, stddev = np.array([(one.yaw, one.stddev) for one in headings]).T
    covariance = np.zeros((len(yaw), 3, 3))
    covariance[:, 2, 2] = stddev**2
    values = heading_values(level_quaternions(yaw), covariance)
    frame = [ROLES["heading"].frame]
    yield Samples("heading", "heading", frame, stamps_ns, stamps_ns, values, source=source)
