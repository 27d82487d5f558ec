# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Scans of SICK scanners: units, flags, reserved values, geometry, stamps, and parameters."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fixtures.driver_defaults import LMS, PLS

from trackslip_common.errors import InputError
from trackslip_drivers.protocols.sick_scan import (
    DeviceStatus,
    RawScan,
    Scan,
    ScanFault,
    decode_scan,
    parse_scan,
    ranges_of,
    values_of,
)
from trackslip_drivers.protocols.sick_telegram import Telegram
from trackslip_drivers.sick_parameters import SickParameters

MS = 1_000_000
MINI = bytes.fromhex("B0 03 00 64 00 E8 03 87 33 00")
FULL = bytes.fromhex("B0 69 01" + " F4 01" * 361 + " 00")


def raw(*values: int, unit: int = 0) -> RawScan:
    return RawScan(np.array(values, dtype=np.uint16), status=0, unit=unit)


def decoded(payload: bytes, parameters: SickParameters = PLS) -> Scan:
    scan = decode_scan(Telegram(payload, start_ns=1000 * MS, end_ns=1210 * MS), parameters)
    assert isinstance(scan, Scan)
    return scan


def test_known_scans_encode_and_decode() -> None:
    values = np.random.default_rng(0).integers(0, 0x10000, 361).astype(np.uint16)
    for payload in (MINI, FULL, RawScan(values, status=0x83, unit=2, partial=3).payload()):
        scan = parse_scan(payload)
        assert isinstance(scan, RawScan)
        assert scan.payload() == payload
    np.testing.assert_array_equal(scan.values, values)
    assert (scan.status, scan.unit, scan.partial) == (0x83, 2, 3)


def test_flagged_values_have_no_distance() -> None:
    scan = parse_scan(MINI)
    assert isinstance(scan, RawScan)
    assert scan.distances.tolist() == [100, 1000, 4999]
    assert scan.glare.tolist() == [False, False, True]
    flagged = raw(100 | 0x4000, 100 | 0x8000, 100 | 0xC000)
    np.testing.assert_allclose(ranges_of(flagged, PLS), 1.0)


def test_the_full_scan_is_five_metres_all_round() -> None:
    sample = decoded(FULL).sample
    np.testing.assert_allclose(sample.ranges, 5.0)
    assert sample.angle_min == -math.pi / 2
    assert sample.angle_increment == math.pi / 360
    assert sample.angle_min + 360 * sample.angle_increment == pytest.approx(math.pi / 2)
    assert sample.scan_time == 0.04
    assert (sample.range_min, sample.range_max) == (0.05, 50.0)
    assert decoded(FULL).sample.stamp_ns == 960 * MS
    assert decoded(FULL, replace(PLS, time_offset=0.003)).sample.stamp_ns == 963 * MS


def test_interlaced_scans_start_a_part_of_a_degree_later() -> None:
    scan = RawScan(np.full(180, 200, dtype=np.uint16), status=0, partial=2)
    assert math.degrees(decoded(scan.payload(), LMS).sample.angle_min) == pytest.approx(-89.5)


def test_pls_ranges() -> None:
    ranges = ranges_of(raw(0, 4, 5, 5000, 5001, 8191, 300 | 0x2000), PLS)
    np.testing.assert_allclose(ranges, [-np.inf, -np.inf, 0.05, 50.0, np.inf, np.inf, np.nan])
    assert ranges_of(raw(300 | 0x2000), replace(PLS, glare_is_nan=False)).tolist() == [3.0]
    assert ranges_of(raw(2500), replace(PLS, range_max=20.0)).tolist() == [np.inf]


@pytest.mark.parametrize(("unit", "metres"), [(0, 6.0), (1, 0.6), (2, 60.0), (3, 60.0)])
def test_the_unit_and_the_reserved_distances_count_on_an_lms_only(unit: int, metres: float) -> None:
    assert ranges_of(raw(600, unit=unit), PLS)[0] == pytest.approx(6.0)
    assert ranges_of(raw(600, unit=unit), LMS)[0] == pytest.approx(metres)
    ranges = ranges_of(raw(8191, 8190, 8189, 8187, 8186, 8183, unit=unit), LMS)
    np.testing.assert_equal(ranges, [np.nan] * 5 + [np.inf])
    assert ranges_of(raw(8182, unit=1), LMS)[0] == pytest.approx(8.182)


@pytest.mark.parametrize(
    ("byte", "status"),
    [
        (0x00, DeviceStatus(0, False, False, False)),
        (0x83, DeviceStatus(3, False, False, True)),
        (0x60, DeviceStatus(0, True, True, False)),
    ],
)
def test_the_status_byte(byte: int, status: DeviceStatus) -> None:
    assert decoded(FULL[:-1] + bytes((byte,))).status == status
    texts = [DeviceStatus.from_byte(severity).severity_text for severity in (0, 4, 6)]
    assert texts == ["none", "fatal", "severity 6"]


@pytest.mark.parametrize(("field", "steps"), [(100, 1), (100, 2), (100, 4), (180, 1), (180, 2)])
def test_field_of_view_is_decoded(field: int, steps: int) -> None:
    """An interlaced scan has one value less."""
    for count in (field * steps, field * steps + 1):
        sample = decoded(raw(*[700] * count).payload(), LMS).sample
        assert sample.angle_min == pytest.approx(math.radians(-field / 2.0))
        assert sample.angle_increment == pytest.approx(math.radians(1.0 / steps))
        assert sample.time_increment == pytest.approx(40e-3 / 360 / steps)
        assert len(sample.ranges) == count


def test_scan_of_a_scanner_upside_down_is_not_mirrored() -> None:
    """Its first ray is at +90° of its frame; the last ray measured is the first one counter-clockwise."""
    hanging = replace(PLS, clockwise=True)
    scan = raw(*range(100, 461))
    upright, turned = decoded(scan.payload()).sample, decoded(scan.payload(), hanging).sample
    np.testing.assert_array_equal(turned.ranges, upright.ranges[::-1])
    assert turned.angle_increment == upright.angle_increment
    assert turned.angle_min == pytest.approx(upright.angle_min)
    times = [s.stamp_ns + s.time_increment * 1e9 * np.arange(361) for s in (upright, turned)]
    np.testing.assert_allclose(times[1], times[0][::-1], atol=1.0)


@pytest.mark.parametrize(
    ("payload", "fault"),
    [
        (b"\xb0\x00", ScanFault.BAD_STRUCTURE),
        (b"\xb1" + FULL[1:], ScanFault.BAD_STRUCTURE),
        (FULL[:-2], ScanFault.BAD_STRUCTURE),
        (FULL + b"\x00", ScanFault.BAD_STRUCTURE),
        (MINI, ScanFault.UNKNOWN_COUNT),
    ],
)
def test_other_scans_are_refused(payload: bytes, fault: ScanFault) -> None:
    assert decode_scan(Telegram(payload, 0, 0), PLS) is fault


@pytest.mark.parametrize("parameters", [PLS, LMS])
def test_nan_and_infinite_ranges_survive_a_round_trip(parameters: SickParameters) -> None:
    ranges = np.full(361, 12.34)
    ranges[:3] = [np.nan, np.inf, -np.inf]
    scan = RawScan(values_of(ranges, parameters), status=0)
    np.testing.assert_allclose(decoded(scan.payload(), parameters).sample.ranges, ranges)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"serial_baud": 115200}, "115200 is not one of 9600, 19200, 38400, 500000"),
        ({"range_min": 50.0}, "below range_max = 50 m"),
        ({"parity": "M"}, "one of N, E, O"),
        ({"model": "tim"}, "one of pls, lms"),
    ],
)
def test_bad_parameters_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(PLS, **change)


def test_bits_per_character() -> None:
    assert (PLS.bits_per_char, LMS.bits_per_char) == (11, 10)
