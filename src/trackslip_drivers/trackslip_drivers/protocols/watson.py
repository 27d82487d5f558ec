# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Serial output of Watson inertial units: decoding and encoding of decimal lines and binary frames.

A decimal line is a label letter and one field per channel, ended by CR alone:

    R +0.012 -0.003 -1.001 +000.04 -000.11 +012.30 +0213 -0041 -0466<CR>

    I inertial, R reference (gyros and accelerometers without closed-loop bias correction). A lower-case label
    means that the unit found its error over range. A field of asterisks is invalid. A text banner precedes
    the first line.

A binary frame is two bytes with bit 7 set per channel, most significant first, 7 bits each, ended by CR:
14 bits in two's complement, value = raw/8192 × full scale. No byte of a line has bit 7 and every byte of a
frame has, so the bytes show the format. Neither format has a checksum; the fixed width of the fields detects
lost characters. A changed digit or sign is not detected: of 12000 lines with 1 % of all bytes changed at
random, 52 % were unharmed, 47.6 % were rejected, and 0.7 % were accepted wrong (0.1 % of bytes: 0.1 % of
lines). A frame has even fewer checks than a line.

Axes of the unit are forward, right, down (specific force: level z reads −1 g); records are forward, left, up.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

from trackslip_common.errors import InputError
from trackslip_common.units import GRAVITY
from trackslip_drivers.records import ImuSample, Vector

TESLA_PER_MILLIGAUSS = 1e-7
BITS_PER_CHAR = 10  # 8N1
TERMINATOR = b"\r"

COMMAND_MODE = b"  "  # opens the commands below, for the first seconds after power-on only
REFERENCE = b"R"  # never send N after it: that stores a north offset for good
DECIMAL = b"_"
BINARY = b"^"
REINITIALISE = b"!"

_ACCELERATION = ("XA", "YA", "ZA")
_RATE = ("XR", "YR", "ZR")
_FIELD = ("XM", "YM", "ZM")
_ANGLES = ("BK", "EL", "HG", "XI", "YI")
_OTHER = ("TM", "FA", "LA", "VA", "HR", "U1", "U2", "U3", "U4", "VS", "TP", "LT", "LN", "AL")
_LABELS = "IRGT"
_BIT_7 = 0x80  # marks a binary frame's bytes
_HALF_RANGE = 8192  # of a 14-bit word
_FLU_FROM_FRD = (1.0, -1.0, -1.0)


class Rejection(Enum):
    """Reason for the rejection of a line, a frame or a part of it."""

    OVERLONG = "no line end"
    GARBLED = "bytes of both formats"
    TEXT = "text, no data"  # banner, column heads
    WRONG_COUNT = "wrong number of fields"
    MALFORMED = "malformed field"
    INVALID = "marked invalid by the unit"


@dataclass(frozen=True)
class Channel:
    """One quantity that the unit sends.

    Raises:
        InputError: the name is not one of the unit's, or the format is not of the form ``+00.0``.
    """

    name: str
    format: str  # the field at zero, with every digit
    full_scale: float  # in the unit's own unit

    def __post_init__(self) -> None:
        """Reject names and formats that cannot be parsed."""
        names = _ACCELERATION + _RATE + _FIELD + _ANGLES + _OTHER
        if self.name not in names:
            raise InputError(f"channels: '{self.name}' is unknown; accepted: {', '.join(names)}")
        if not re.fullmatch(r"\+?0+(\.0+)?", self.format):
            raise InputError(f"formats: '{self.format}' is not a field of zeros such as +00.0 or 000.0")

    @cached_property
    def decimals(self) -> int:
        """Digits behind the point."""
        return len(self.format.partition(".")[2])

    @cached_property
    def max_value(self) -> float:
        """Largest magnitude of a field: full scale, or all digits 9 if that is less."""
        return min(self.full_scale, float(re.sub("0", "9", self.format)))

    def format_value(self, value: float) -> str:
        """The value as the unit prints it, clamped to the field."""
        largest = self.max_value
        return format(min(max(value, -largest), largest), self._format_spec)

    @cached_property
    def _format_spec(self) -> str:
        """Format specification of the field."""
        sign = "+" if self.format.startswith("+") else ""
        return f"{sign}0{len(self.format)}.{self.decimals}f"

    def matches(self, field: str) -> bool:
        """Whether the field has a digit wherever the format has one, and nothing else."""
        return self._pattern.fullmatch(field) is not None

    @cached_property
    def _pattern(self) -> re.Pattern[str]:
        digits = re.sub("0", r"\\d", re.escape(self.format))
        return re.compile(digits.replace(r"\+", "[+-]"), re.ASCII)


class Layout:
    """The channels in the order sent.

    Raises:
        InputError: the lists differ in length, a channel comes twice, or one that a sample needs is missing.
    """

    def __init__(self, names: Sequence[str], formats: Sequence[str], full_scales: Sequence[float]) -> None:
        if not len(names) == len(formats) == len(full_scales):
            raise InputError(
                f"channels, formats, full_scales: {len(names)}, {len(formats)}, {len(full_scales)} items; "
                "accepted: as many of each"
            )
        if len(set(names)) < len(names):
            raise InputError(f"channels: {', '.join(names)} has one twice; accepted: each once")
        missing = [name for name in _ACCELERATION + _RATE if name not in names]
        if missing:
            raise InputError(f"channels: {', '.join(missing)} missing; all of XA YA ZA XR YR ZR are needed")
        self.channels = tuple(map(Channel, names, formats, full_scales))
        self.has_field = all(name in names for name in _FIELD)

    @property
    def line_length(self) -> int:
        """Characters in a decimal line, CR included."""
        return len(encode_line("I", {}, self))


@dataclass(frozen=True)
class Reading:
    """One decoded line or frame in the unit's own axes and units; invalid channels are absent."""

    values: Mapping[str, float]
    over_range: bool


def encode_line(label: str, values: Mapping[str, float], layout: Layout) -> bytes:
    """A decimal line; missing channels are zero, values beyond their field are clamped."""
    fields = [channel.format_value(values.get(channel.name, 0.0)) for channel in layout.channels]
    return " ".join([label, *fields]).encode("ascii") + TERMINATOR


def encode_frame(values: Mapping[str, float], layout: Layout) -> bytes:
    """A binary frame; missing channels are zero, values beyond full scale are clamped."""
    frame = bytearray()
    for channel in layout.channels:
        raw = round(values.get(channel.name, 0.0) / channel.full_scale * _HALF_RANGE)
        word = min(max(raw, -_HALF_RANGE), _HALF_RANGE - 1) & 0x3FFF
        frame += bytes((0x80 | word >> 7, 0x80 | word & 0x7F))
    return bytes(frame) + TERMINATOR


def decode_line(line: bytes, layout: Layout) -> Reading | Rejection:
    """Decode one line without its CR."""
    label, *fields = b" ".join(line.split()).decode("latin-1").split(" ")
    if len(label) != 1 or label.upper() not in _LABELS:
        return Rejection.TEXT
    if len(fields) != len(layout.channels):
        return Rejection.WRONG_COUNT
    values: dict[str, float] = {}
    over_range = label.islower()
    for channel, field in zip(layout.channels, fields, strict=True):
        if "*" in field:
            continue
        if not channel.matches(field):
            return Rejection.MALFORMED
        value = float(field)
        over_range |= abs(value) >= channel.max_value
        values[channel.name] = value
    return Reading(values, over_range)


def decode_frame(frame: bytes, layout: Layout) -> Reading | Rejection:
    """Decode one binary frame without its CR."""
    if len(frame) != 2 * len(layout.channels):
        return Rejection.WRONG_COUNT
    values: dict[str, float] = {}
    over_range = False
    for channel, high, low in zip(layout.channels, frame[::2], frame[1::2], strict=True):
        word = (high & 0x7F) << 7 | (low & 0x7F)
        raw = word - 2 * _HALF_RANGE if word >= _HALF_RANGE else word
        over_range |= raw in (-_HALF_RANGE, _HALF_RANGE - 1)
        values[channel.name] = raw / _HALF_RANGE * channel.full_scale
    return Reading(values, over_range)


def count_mismatch(line: bytes, layout: Layout) -> str:
    """Text with the length of a line or frame, and the expected length."""
    if line and line[0] < _BIT_7:
        return f"{len(line.split()) - 1} fields, {len(layout.channels)} expected"
    return f"frame of {len(line)} bytes, {2 * len(layout.channels)} expected"


def to_sample(reading: Reading, stamp_ns: int) -> ImuSample | Rejection:
    """The sample in SI units and FLU axes; an invalid magnetometer removes the field only."""
    acceleration = _vector(reading.values, _ACCELERATION, GRAVITY)
    angular_velocity = _vector(reading.values, _RATE, math.pi / 180.0)
    if acceleration is None or angular_velocity is None:
        return Rejection.INVALID
    field = _vector(reading.values, _FIELD, TESLA_PER_MILLIGAUSS)
    return ImuSample(stamp_ns, acceleration, angular_velocity, field, reading.over_range)


def from_sample(sample: ImuSample) -> dict[str, float]:
    """The inverse of ``to_sample``: channel values as the unit would have measured them."""
    values: dict[str, float] = {}
    for names, vector, scale in (
        (_ACCELERATION, sample.acceleration, GRAVITY),
        (_RATE, sample.angular_velocity, math.pi / 180.0),
        (_FIELD, sample.magnetic_field or (0.0, 0.0, 0.0), TESLA_PER_MILLIGAUSS),
    ):
        for name, sign, value in zip(names, _FLU_FROM_FRD, vector, strict=True):
            values[name] = sign * value / scale
    return values


def _vector(values: Mapping[str, float], names: tuple[str, str, str], scale: float) -> Vector | None:
    """Three channels in FLU and SI, None if any is absent."""
    if any(name not in values for name in names):
        return None
    x, y, z = (sign * scale * values[name] for sign, name in zip(_FLU_FROM_FRD, names, strict=True))
    return x, y, z
