# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Decodes scans of SICK scanners: ``B0 | count LE16 | count values LE16 | status``.

    count   bits 0-8 number of values, 11-12 start of an interlaced scan in quarters of a degree,
            14-15 unit (LMS: 0 cm, 1 mm, 2 or 3 dm; the PLS measures in cm whatever the field is)
    value   bits 0-12 distance, 13 glare, 14 warning field, 15 safety field
    status  bits 0-2 severity, 5 restart, 6 implausible, 7 pollution (documented for the LMS)

The first value is the ray at -90 degrees (LMS with a field of 100 degrees: at -50); the others follow
counter-clockwise. A scanner that hangs upside down sends them clockwise; they are reversed here.
"""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_common.units import NS_PER_S
from trackslip_drivers.protocols.sick_commands import ReplyCode, Severity
from trackslip_drivers.protocols.sick_telegram import Telegram
from trackslip_drivers.records import ScanSample
from trackslip_drivers.sick_parameters import SickParameters

UintArray = NDArray[np.uint16]

_DEGREE = math.pi / 180
_SCAN_FIELDS = {  # values: (degrees seen, steps a degree); an interlaced scan has one value less
    361: (180, 2),
    360: (180, 2),
    181: (180, 1),
    180: (180, 1),
    401: (100, 4),
    400: (100, 4),
    201: (100, 2),
    200: (100, 2),
    101: (100, 1),
    100: (100, 1),
}

_COUNT_MASK = 0x01FF
_PARTIAL_SHIFT, _UNIT_SHIFT, _TWO_BITS = 11, 14, 0x3
_DISTANCE_MASK = 0x1FFF
_GLARE = 0x2000
_LMS_UNITS = (0.01, 0.001, 0.1, 0.1)  # m
_PLS_UNIT = 0.01  # m

# The LMS reserves its highest distances for rays without a distance; all but one mean 'invalid'.
_LMS_FIRST_RESERVED = 8183
_LMS_BEYOND_RANGE = 8183
_LMS_DAZZLED = 8190
_PLS_BEYOND_RANGE = 8191  # written by our encoder; any value above the PLS' range is valid

_SEVERITY_MASK, _RESTART, _IMPLAUSIBLE, _POLLUTION = 0x07, 0x20, 0x40, 0x80


class ScanFault(Enum):
    """Reason for the rejection of a complete scan telegram."""

    BAD_STRUCTURE = "scan with the wrong length"
    UNKNOWN_COUNT = "scan with an unknown number of rays"
    NOT_STREAMING = "scan before streaming was asked for"


@dataclass(frozen=True)
class DeviceStatus:
    """The status byte, decoded."""

    severity: int  # see ``sick_commands.Severity``
    restart: bool
    implausible: bool
    pollution: bool

    @property
    def severity_text(self) -> str:
        """The severity in words."""
        is_known = self.severity in set(Severity)
        return Severity(self.severity).name.lower() if is_known else f"severity {self.severity}"

    @staticmethod
    def from_byte(byte: int) -> "DeviceStatus":
        """Decode a status byte."""
        return DeviceStatus(
            byte & _SEVERITY_MASK, bool(byte & _RESTART), bool(byte & _IMPLAUSIBLE), bool(byte & _POLLUTION)
        )


@dataclass(frozen=True, eq=False)
class RawScan:
    """Content of a scan telegram, numbers as sent."""

    values: UintArray  # (n,) with their flags
    status: int
    unit: int = 0
    partial: int = 0

    @property
    def distances(self) -> UintArray:
        """(n,) in the scanner's unit, without flags."""
        return self.values & np.uint16(_DISTANCE_MASK)

    @property
    def glare(self) -> BoolArray:
        """(n,) whether a ray was dazzled."""
        return np.bitwise_and(self.values, np.uint16(_GLARE)).astype(np.bool_)

    def payload(self) -> bytes:
        """The telegram's payload."""
        count = len(self.values) | self.partial << _PARTIAL_SHIFT | self.unit << _UNIT_SHIFT
        head = bytes((ReplyCode.SCAN,)) + count.to_bytes(2, "little")
        return head + self.values.astype("<u2").tobytes() + bytes((self.status,))


@dataclass(frozen=True, eq=False)
class Scan:
    """A decoded scan with the scanner's status."""

    sample: ScanSample
    status: DeviceStatus


def parse_scan(payload: bytes) -> RawScan | ScanFault:
    """Decode a B0 payload."""
    if len(payload) < 4 or payload[0] != ReplyCode.SCAN:
        return ScanFault.BAD_STRUCTURE
    word = int.from_bytes(payload[1:3], "little")
    count = word & _COUNT_MASK
    if len(payload) != 4 + 2 * count:
        return ScanFault.BAD_STRUCTURE
    values = np.frombuffer(payload, dtype="<u2", count=count, offset=3).astype(np.uint16)
    return RawScan(values, payload[-1], word >> _UNIT_SHIFT & _TWO_BITS, word >> _PARTIAL_SHIFT & _TWO_BITS)


def ranges_of(raw: RawScan, parameters: SickParameters) -> FloatArray:
    """(n,) m; +inf no return, -inf too close, nan invalid (REP-117)."""
    is_lms = parameters.model == "lms"
    ranges = raw.distances.astype(np.float64) * (_LMS_UNITS[raw.unit] if is_lms else _PLS_UNIT)
    ranges[ranges < parameters.range_min] = -np.inf
    ranges[ranges > parameters.range_max] = np.inf
    if is_lms:
        ranges[raw.distances >= _LMS_FIRST_RESERVED] = np.nan
        ranges[raw.distances == _LMS_BEYOND_RANGE] = np.inf
    if parameters.glare_is_nan:
        ranges[raw.glare] = np.nan
    return ranges


def values_of(ranges: FloatArray, parameters: SickParameters) -> UintArray:
    """The values that a scanner measuring in cm sends for these ranges (m); inverse of ``ranges_of``."""
    is_lms = parameters.model == "lms"
    beyond = _LMS_BEYOND_RANGE if is_lms else _PLS_BEYOND_RANGE
    invalid = _LMS_DAZZLED if is_lms else _GLARE
    distances = np.clip(np.rint(ranges / _PLS_UNIT), 0, beyond)
    return np.where(np.isnan(ranges), invalid, distances).astype(np.uint16)


def decode_scan(telegram: Telegram, parameters: SickParameters) -> Scan | ScanFault:
    """The scan in a telegram, stamped with the time of its first ray.

    The scanner sends a scan when the mirror has completed its turn. The turn begins one scan time before the
    telegram.
    """
    raw = parse_scan(telegram.payload)
    if isinstance(raw, ScanFault):
        return raw
    if len(raw.values) not in _SCAN_FIELDS:
        return ScanFault.UNKNOWN_COUNT
    field, steps = _SCAN_FIELDS[len(raw.values)]
    increment = _DEGREE / steps
    sample = ScanSample(
        stamp_ns=telegram.start_ns + round((parameters.time_offset - parameters.scan_time) * NS_PER_S),
        angle_min=(raw.partial / 4 - field / 2) * _DEGREE,
        angle_increment=increment,
        time_increment=parameters.scan_time * increment / (2 * math.pi),
        scan_time=parameters.scan_time,
        range_min=parameters.range_min,
        range_max=parameters.range_max,
        ranges=ranges_of(raw, parameters),
    )
    return Scan(_reverse_scan(sample) if parameters.clockwise else sample, DeviceStatus.from_byte(raw.status))


def _reverse_scan(sample: ScanSample) -> ScanSample:
    """The scan in reverse order: its last ray is the first counter-clockwise."""
    steps = len(sample.ranges) - 1
    return sample._replace(
        stamp_ns=sample.stamp_ns + round(steps * sample.time_increment * NS_PER_S),
        angle_min=-sample.angle_min - steps * sample.angle_increment,
        time_increment=-sample.time_increment,
        ranges=sample.ranges[::-1],
    )
