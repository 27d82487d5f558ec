# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""NMEA sentences: exact ones, each reason to refuse one, both halves against each other, any bytes."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_drivers.protocols import nmea_sentences
from trackslip_drivers.protocols.nmea import (
    Gga,
    Gst,
    Heading,
    Rejection,
    Rmc,
    decode,
    heading_of_yaw,
    yaw_of_heading,
)
from trackslip_drivers.protocols.nmea_sentences import Position, sentence
from trackslip_drivers.records import FixStatus

S = 1_000_000_000
GGA = "GNGGA,101530.20,3352.1234567,S,15112.7654321,E,{},18,0.6,41.20,M,22.10,M,1.0,0021"


def line(content: str) -> bytes:
    return sentence(content)[:-1]  # without the LF that ends it


def test_position_is_south_and_east_above_the_ellipsoid():
    found = decode(line(GGA.format(4)))
    assert isinstance(found, Gga)
    assert found.latitude == pytest.approx(-(33 + 52.1234567 / 60), abs=1e-10)
    assert found.longitude == pytest.approx(151 + 12.7654321 / 60, abs=1e-10)
    assert (found.altitude, found.hdop, found.quality) == (pytest.approx(63.3), 0.6, 4)
    assert found.time_ns == ((10 * 60 + 15) * 60 + 30) * S + S // 5


@pytest.mark.parametrize(
    ("quality", "expected"),
    [
        (0, Rejection.NO_FIX),
        (1, FixStatus.SINGLE),
        (2, FixStatus.DIFFERENTIAL),
        (4, FixStatus.RTK),
        (5, FixStatus.RTK),
        (6, Rejection.DEAD_RECKONING),
        (7, Rejection.NOT_MEASURED),
        (8, Rejection.NOT_MEASURED),
        ("", Rejection.NO_FIX),
        ("x", Rejection.MALFORMED),
    ],
)
def test_quality_decides_what_a_position_is(quality, expected):
    found = decode(line(GGA.format(quality)))
    assert (found.status if isinstance(found, Gga) else found) is expected


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("GPGST,101530.20,0.1,0.02,0.01,34.5,0.011,0.012,0.02", Gst(36930 * S + S // 5, 0.012, 0.011, 0.02)),
        ("GPGST,101530.20,,,,,0.0,0.0,", Rejection.OUT_OF_RANGE),
        ("GPGST,101530.20,,,,,,,", Rejection.OUT_OF_RANGE),
        ("GNRMC,101530.20,A,3352.1,S,15112.7,E,0.0,,201126,,,R,V", Rmc(36930 * S + S // 5)),
        ("GNRMC,101530.20,V,,,,,,,201126,,,N,V", Rejection.WARNING),
        ("GNHDT,90.0,T", Heading(None, 0.0, 0.0)),
        ("GNHDT,270.0,T", Heading(None, math.pi, 0.0)),
        ("GNHDT,90.0,M", Rejection.NOT_TRUE_NORTH),
        ("GNHDT,,T", Rejection.NO_HEADING),
        ("GNHDT,361.0,T", Rejection.OUT_OF_RANGE),
        ("GNHDT,nan,T", Rejection.OUT_OF_RANGE),
        ("GNTHS,0.0,A", Heading(None, math.pi / 2, 0.0)),
        ("GNTHS,0.0,E", Rejection.NOT_MEASURED),
        ("GNTHS,,V", Rejection.NO_HEADING),
        (
            "PASHR,101530.000,90.00,T,-0.30,+0.31,+0.01,0.029,0.029,0.180,4,1",
            Heading(36930 * S, 0.0, math.radians(0.18)),
        ),
        ("PASHR,,90.00,T,,,,,,0.180,4,1", Rejection.MALFORMED),
        ("PASHR,POS,0,12,101530.00", None),
        ("GPGSV,3,1,11,03,03,111,00", None),
        ("GNGGA", Rejection.MALFORMED),
        ("GNGGA,101530.20,,,,,4,18,0.6,41.20,M,22.10,M,,", Rejection.MALFORMED),
        ("GNGGA,101530.20,9952.12,S,15112.76,E,4,18,0.6,41.2,M,22.1,M,,", Rejection.OUT_OF_RANGE),
    ],
)
def test_sentence(content, expected):
    found = decode(line(content))
    if isinstance(expected, tuple):
        assert type(found) is type(expected)
        assert found == pytest.approx(expected)
    else:
        assert found is expected


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        (b"", Rejection.NOT_NMEA),
        (b"\xb5\x62\x01\x07\x5c", Rejection.NOT_NMEA),
        (line(GGA.format(4)).partition(b"*")[0], Rejection.NO_CHECKSUM),
        (line(GGA.format(4)).replace(b"3352", b"3353"), Rejection.CHECKSUM),
        (line(GGA.format(4))[:-3], Rejection.CHECKSUM),
        (b"$G\xff", Rejection.NOT_NMEA),
    ],
)
def test_damage_is_found(raw, expected):
    assert decode(raw) is expected


def test_what_comes_before_a_sentence_does_not_matter():
    assert isinstance(decode(b"\xb5\x62\x01\x07$GNGGA,1015" + line(GGA.format(4))), Gga)


def test_time_is_unknown_where_it_is_empty_and_in_a_leap_second():
    for told in ("", "235960.00"):
        found = decode(line(GGA.format(4).replace("101530.20", told)))
        assert isinstance(found, Gga)
        assert found.time_ns is None


def test_altitude_is_unknown_without_the_geoid():
    found = decode(line(GGA.format(1).replace("22.10", "")))
    assert isinstance(found, Gga)
    assert math.isnan(found.altitude)


@given(
    st.floats(-89.9, 89.9),
    st.floats(-179.9, 179.9),
    st.floats(-400, 9000),
    st.integers(0, 8_639_999),
    st.floats(0.001, 50.0),
    st.floats(0.0, 359.9),
)
def test_what_is_sent_is_what_is_read(latitude, longitude, altitude, centiseconds, stddev, heading):
    time_ns = centiseconds * 10_000_000
    at = Position(time_ns, latitude, longitude, altitude, 5, 0.9, stddev, 2 * stddev, heading, 0.2)
    position = decode(nmea_sentences.gga(at)[:-1])
    assert isinstance(position, Gga)
    assert position[:4] == pytest.approx((time_ns, latitude, longitude, altitude), abs=2e-4)
    assert position[1:3] == pytest.approx((latitude, longitude), abs=1e-9)
    assert decode(nmea_sentences.gst(at)[:-1])[1:] == pytest.approx((stddev, stddev, 2 * stddev), abs=1e-4)
    assert decode(nmea_sentences.rmc(at)[:-1]) == Rmc(time_ns)
    for encode, expected in ((nmea_sentences.hdt, 0.0), (nmea_sentences.pashr, math.radians(0.2))):
        found = decode(encode(at)[:-1])
        assert isinstance(found, Heading)
        assert math.sin(found.yaw - yaw_of_heading(heading)) == pytest.approx(0.0, abs=1e-5)
        assert found.stddev == pytest.approx(expected)


@given(st.floats(-math.pi, math.pi))
def test_heading_and_yaw_are_each_other_s_inverse(yaw):
    assert math.cos(yaw_of_heading(heading_of_yaw(yaw)) - yaw) == pytest.approx(1.0)
    assert -math.pi < yaw_of_heading(heading_of_yaw(yaw)) <= math.pi


@given(st.binary(max_size=200), st.sampled_from(["GGA", "GST", "RMC", "HDT", "THS"]), st.text(max_size=80))
def test_any_bytes_and_any_fields_are_survived(noise, kind, fields):
    decode(noise)
    content = f"GN{kind},{fields}".encode("ascii", "ignore").decode()
    decode(line(content))
    decode(line("PASHR," + content))
