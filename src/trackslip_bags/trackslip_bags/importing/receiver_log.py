# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Logs of a GNSS receiver, NMEA and UBX, through the driver's own protocol.

A log has no times of arrival. Stamps are the receiver's UTC: times of day, on the date that RMC, ZDA or
NAV-PVT states, or that the mapping gives. A sentence without a time (HDT, THS) is of the epoch before it.
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
from trackslip_bags.importing.samples import FloatArray, IntArray, Samples, headings, without_heading
from trackslip_bags.importing.times import LIMIT_NS
from trackslip_common.config_files import load_parameters
from trackslip_common.errors import InputError
from trackslip_common.tally import Tally
from trackslip_drivers.nmea_parameters import NmeaParameters
from trackslip_drivers.protocols import ubx
from trackslip_drivers.protocols.gnss_frames import Frame, FrameCutter, Kind
from trackslip_drivers.protocols.nmea import Rejection, Sentence, read
from trackslip_drivers.protocols.nmea_stream import POSITIONS, NmeaStream, Sample
from trackslip_drivers.records import CovarianceType, FixSample, HeadingSample, VelocitySample

_NODE, _NETWORK = "nmea_gnss", "log://"  # bytes that come in no time, as over a network
_PIECE = 1 << 16  # bytes
_FEWEST = 2  # sentences of a log that begins in another one
_DAY_NS = 86_400_000_000_000
_EPOCH = date(1970, 1, 1)
_PVT = 0x07


class _Timed(NamedTuple):
    """One message of the log."""

    content: bytes
    time_ns: int | None  # of day
    day: date | None  # where it states one


def read_receiver_logs(
    paths: Sequence[Path], given: GnssSection, local: LocalFrame
) -> tuple[list[Samples], list[str]]:
    """``fix``, ``gnss_pose``, ``fix_velocity`` and ``heading``, and notes on what was refused.

    Raises:
        InputError: a log cannot be read, or gives nothing.
    """
    names = ", ".join(path.name for path in paths)
    defaults = load_parameters(NmeaParameters, _NODE, (f"{_NODE}.yaml",))
    stddev = defaults.heading_stddev if given.heading_stddev is None else given.heading_stddev
    tally = Tally()
    p = replace(defaults, serial_port=_NETWORK, heading_stddev=stddev, time_offset=0.0)
    stream = NmeaStream(p, tally, lambda steady_ns: steady_ns)
    messages = [message for path in paths for message in _messages(path)]
    begin_ns, notes = _first_day_ns(messages, given, names)
    samples: list[Sample] = []
    for message, now_ns in _on_one_clock(messages, begin_ns):
        samples += stream.feed(message.content, now_ns)
    samples += stream.flush()
    notes += [f"{names}: {n} × {reason}" for why in tally.by_source().values() for reason, n in why.items()]
    kinds = f"kinds that come: {', '.join(stream.kinds) or 'none'}"
    if stream.kinds and not POSITIONS & set(stream.kinds):
        kinds += "; switch GGA on at the receiver"
    if samples and all(message.time_ns is None for message in messages):
        raise InputError(f"{given.where}: {names}: no message states a time ({kinds})")
    fixes = [one for one in samples if isinstance(one, FixSample)]
    directions = [one for one in samples if isinstance(one, HeadingSample)]
    velocities = [one for one in samples if isinstance(one, VelocitySample)]
    found = [
        *_fixes(fixes, given, local, names),
        *_velocities(velocities, given, names),
        *_headings(directions, given, names),
    ]
    if not found:
        reasons = "; ".join([*notes, kinds])
        raise InputError(f"{given.where}: {names}: no position and no heading ({reasons})")
    return found, notes


def _messages(path: Path) -> Iterator[_Timed]:
    """Whole messages of a file, and its noise, which the stream counts.

    Raises:
        InputError: it cannot be read.
    """
    cutter = FrameCutter(0)
    try:
        for piece in _pieces(path):
            for frame in cutter.feed(piece, 0):
                yield _timed(frame)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    for frame in cutter.feed(b"\n", 0):  # a last line without an end
        yield _timed(frame)


def _pieces(path: Path) -> Iterator[bytes]:
    """The bytes of a log; those that stand for its text, where that is in UTF-16."""
    with path.open("rb") as file:
        is_wide = encoding_of_mark(file.read(2)) == "utf-16"
        file.seek(0)
        if is_wide:
            for text in codecs.iterdecode(iter(lambda: file.read(_PIECE), b""), "utf-16", "replace"):
                yield text.encode("latin-1", "replace")
        else:
            yield from iter(lambda: file.read(_PIECE), b"")


def holds_messages(path: Path) -> bool:
    """Whether the begin of a file holds messages of a receiver, whatever is before them and between them.

    Raises:
        OSError: it cannot be read.
    """
    cutter, sentences = FrameCutter(0), 0
    for frame in cutter.feed(next(_pieces(path), b""), 0):
        if frame.kind is Kind.UBX:
            return True
        sentences += frame.kind is Kind.SENTENCE and isinstance(read(frame.content), Sentence)
    return sentences >= _FEWEST


def _timed(frame: Frame) -> _Timed:
    if frame.kind is Kind.SENTENCE:
        found = read(frame.content)
        time_ns = None
        if isinstance(found, Sentence) and found.reading is not None:
            time_ns = None if isinstance(found.reading, Rejection) else found.reading.time_ns
        return _Timed(frame.content + b"\r\n", time_ns, _day_of(frame.content))
    if frame.kind is Kind.UBX:
        reading = ubx.decode(frame.content)
        time_ns = None if reading is None or isinstance(reading, Rejection) else reading.time_ns
        day = None
        if ubx.kind_of(frame.content) == "NAV-PVT" and len(frame.content) > 20:
            year, month, day_of_month = int.from_bytes(frame.content[10:12], "little"), *frame.content[12:14]
            day = _date(year, month, day_of_month)
        return _Timed(frame.content, time_ns, day)
    ends_line = frame.kind in (Kind.TEXT, Kind.OVERLONG)
    return _Timed(frame.content + (b"\n" if ends_line else b""), None, None)


def _day_of(sentence: bytes) -> date | None:
    """That RMC or ZDA states."""
    fields = sentence.partition(b"*")[0].decode("latin-1").split(",")
    kind = fields[0][3:]
    try:
        if kind == "RMC" and len(fields[9]) == 6:
            day, month, year = (int(fields[9][k : k + 2]) for k in (0, 2, 4))
            return _date(2000 + year, month, day)
        if kind == "ZDA":
            return _date(int(fields[4]), int(fields[3]), int(fields[2]))
    except (IndexError, ValueError):
        pass
    return None


def _date(year: int, month: int, day: int) -> date | None:
    try:
        return date(year, month, day) if year >= _EPOCH.year else None
    except ValueError:
        return None


def _first_day_ns(messages: Sequence[_Timed], given: GnssSection, names: str) -> tuple[int, list[str]]:
    """Midnight before the first message, ns, and a note where nobody states a date."""
    stated = [(k, message.day) for k, message in enumerate(messages) if message.day is not None]
    if given.day is not None or not stated:
        day, notes = given.day or _EPOCH, []
        if given.day is None:
            notes = [f"{names}: no date; stamps are of 1970-01-01 (gnss: {{date: …}} in the mapping)"]
        return (day - _EPOCH).days * _DAY_NS, notes
    k, day = stated[0]
    passed = sum(1 for _ in _midnights([m.time_ns for m in messages[: k + 1]]))
    return ((day - _EPOCH).days - passed) * _DAY_NS, []


def _midnights(times_ns: Sequence[int | None]) -> Iterator[int]:
    """Where a day ends."""
    before: int | None = None
    for k, time_ns in enumerate(times_ns):
        if time_ns is None:
            continue
        if before is not None and before - time_ns > _DAY_NS // 2:
            yield k
        before = time_ns


def _on_one_clock(messages: Sequence[_Timed], begin_ns: int) -> Iterator[tuple[_Timed, int]]:
    """Each message, and when its epoch was, ns."""
    midnights = set(_midnights([message.time_ns for message in messages]))
    first = next((message.time_ns for message in messages if message.time_ns is not None), 0)
    now_ns, day_ns = begin_ns + first, begin_ns
    for k, message in enumerate(messages):
        if k in midnights:
            day_ns += _DAY_NS
        if message.time_ns is not None:
            now_ns = day_ns + message.time_ns
        yield message, now_ns


def _stamps(found: Sequence[Sample], given: GnssSection) -> IntArray:
    stamps_ns = np.array([one.stamp_ns for one in found], np.int64) + given.offset_ns
    if stamps_ns.min() < 0 or stamps_ns.max() >= LIMIT_NS:
        raise InputError(f"{given.where}: stamps outside 0 … 2^31 s; accepted: another date or time_offset")
    return stamps_ns


def _fixes(
    found: Sequence[FixSample], given: GnssSection, local: LocalFrame, source: str
) -> Iterator[Samples]:
    if not found:
        return
    stamps_ns = _stamps(found, given)
    place = np.array([(math.radians(f.latitude), math.radians(f.longitude), f.altitude) for f in found])
    variances = np.array([f.variances for f in found])
    covariance = np.zeros((len(found), 3, 3))
    covariance[:, range(3), range(3)] = variances
    values = {
        "place": place,
        "covariance": covariance,
        "kind": np.array([float(f.covariance_type) for f in found]),
        "status": np.array([float(f.status) for f in found]),
    }
    yield Samples("fix", "fix", [ROLES["fix"].frame], stamps_ns, stamps_ns, values, source=source)
    known = np.array([f.covariance_type is not CovarianceType.UNKNOWN for f in found])
    if not known.any():
        return
    pose, left_out = known, {}
    for reason, refused in local.refusals(place[known], f"{given.where}: {source}"):
        rows = np.flatnonzero(known)[refused]
        left_out[reason] = len(rows)
        pose = pose & ~np.isin(np.arange(len(found)), rows)
    east_north: FloatArray = local.east_north(place[pose])
    planar = np.column_stack((east_north, np.full(len(east_north), np.nan)))
    of_pose = without_heading(planar, covariance[pose].copy())
    times = stamps_ns[pose], stamps_ns[pose]
    poses = Samples("gnss_pose", "pose", [ROLES["pose"].frame], *times, of_pose, source=source)
    poses.left_out.update({reason: n for reason, n in left_out.items() if n})
    yield poses


def _velocities(found: Sequence[VelocitySample], given: GnssSection, source: str) -> Iterator[Samples]:
    if not found:
        return
    stamps_ns = _stamps(found, given)
    variances = np.array([(one.stddev**2, one.stddev**2) for one in found])
    values = {"velocity": np.array([(one.east, one.north) for one in found]), "variances": variances}
    frame = [ROLES["velocity"].frame]
    yield Samples("fix_velocity", "velocity", frame, stamps_ns, stamps_ns, values, source=source)


def _headings(found: Sequence[HeadingSample], given: GnssSection, source: str) -> Iterator[Samples]:
    if not found:
        return
    stamps_ns = _stamps(found, given)
    yaw, stddev = np.array([(one.yaw, one.stddev) for one in found]).T
    level = np.zeros(len(yaw))
    turn = np.column_stack((level, level, np.sin(yaw / 2.0), np.cos(yaw / 2.0)))
    covariance = np.zeros((len(yaw), 3, 3))
    covariance[:, 2, 2] = stddev**2
    values = headings(turn, covariance)
    frame = [ROLES["heading"].frame]
    yield Samples("heading", "heading", frame, stamps_ns, stamps_ns, values, source=source)
