# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""NMEA sentences: exact examples, each reason for rejection, encoder against decoder, arbitrary bytes."""

import math

import pytest
from fixtures.heading_sentences import hdt
from hypothesis import given
from hypothesis import strategies as st

from trackslip_drivers.protocols import nmea_sentences
from trackslip_drivers.protocols.nmea import (
    Gga,
    Gst,
    Heading,
    Reading,
    Rejection,
    Rmc,
    Sentence,
    Velocity,
    heading_of_yaw,
    read_sentence,
    yaw_of_heading,
)
from trackslip_drivers.protocols.nmea_sentences import Position, sentence
from trackslip_drivers.records import FixStatus

S = 1_000_000_000
EPOCH = 36930 * S + S // 5
GGA = "GNGGA,101530.20,3352.1234567,S,15112.7654321,E,{},18,0.6,41.20,M,22.10,M,1.0,0021"


def line(content: str) -> bytes:
    return sentence(content)[:-1]  # without the final LF


def decode(raw: bytes) -> Reading | Rejection | None:
    """The reading of a line, or the reason why it has none."""
    read = read_sentence(raw)
    return read.reading if isinstance(read, Sentence) else read


def test_position_is_south_and_east_above_the_ellipsoid():
    reading = gga_of(GGA.format(4))
    assert reading.latitude == pytest.approx(-(33 + 52.1234567 / 60), abs=1e-10)
    assert reading.longitude == pytest.approx(151 + 12.7654321 / 60, abs=1e-10)
    assert (reading.altitude, reading.hdop, reading.quality) == (pytest.approx(63.3), 0.6, 4)
    assert reading.time_ns == ((10 * 60 + 15) * 60 + 30) * S + S // 5


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
    reading = decode(line(GGA.format(quality)))
    assert (reading.status if isinstance(reading, Gga) else reading) is expected


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("GPGST,101530.20,0.1,0.02,0.01,34.5,0.011,0.012,0.02", Gst(EPOCH, 0.012, 0.011, 0.02)),
        ("GPGST,101530.20,,,,,-0.1,0.1,", Rejection.OUT_OF_RANGE),
        ("GNRMC,101530.20,A,3352.1,S,15112.7,E,,,201126,,,R,V", Rmc(36930 * S + S // 5)),
        (
            "GNRMC,101530.20,A,3352.1,S,15112.7,E,5.0,,201126,,,R,V",
            Rmc(36930 * S + S // 5, Rejection.NO_VELOCITY),
        ),
        ("GNVTG,,T,,M,1.0,N,1.852,K,A", Rejection.NO_VELOCITY),
        ("GNVTG,30.0,T,,M,1.0,N,1.852,K,N", Rejection.WARNING),
        ("GNVTG,30.0,T,,M,1.0,N,1.852,K,E", Rejection.DEAD_RECKONING),
        ("GNVTG,361.0,T,,M,1.0,N,1.852,K,A", Rejection.OUT_OF_RANGE),
        ("GNVTG,30.0,T,,M,1.0,N,-1.852,K,A", Rejection.OUT_OF_RANGE),
        ("GNVTG,30.0,M,,M,1.0,N,1.852,K,A", Rejection.MALFORMED),
        ("GNRMC,101530.20,V,,,,,,,201126,,,N,V", Rejection.WARNING),
        ("GNRMC,101530.20,A,3352.1,S,15112.7,E,0.0,,201126,,,N,V", Rejection.WARNING),
        ("GNHDT,90.0,T", Heading(None, 0.0, 0.0, True)),
        ("GNHDT,90.0,M", Rejection.NOT_TRUE_NORTH),
        ("GNHDT,,T", Rejection.NO_HEADING),
        ("GNHDT,361.0,T", Rejection.OUT_OF_RANGE),
        ("GNHDT,nan,T", Rejection.OUT_OF_RANGE),
        ("GNTHS,0.0,A", Heading(None, math.pi / 2, 0.0)),
        ("GNTHS,0.0,E", Rejection.DEAD_RECKONING),
        ("GNTHS,0.0,S", Rejection.NOT_MEASURED),
        ("GNTHS,0.0,", Rejection.NO_HEADING),
        ("GNTHS,,V", Rejection.NO_HEADING),
        (
            "PASHR,101530.000,90.00,T,-0.30,+0.31,+0.01,0.029,0.029,0.180,4,1",
            Heading(36930 * S, 0.0, math.radians(0.18)),
        ),
        ("PASHR,,90.00,T,,,,,,0.180,4,1", Heading(None, 0.0, math.radians(0.18))),
        ("PASHR,101530.00,90.00,T,,,,,,0.000,4,1", Heading(36930 * S, 0.0, 0.0)),
        ("PASHR,101530.00,0.00,T,,,,,,0.200,0,0", Rejection.NO_FIX),
        ("PASHR,,0.00,T,,,,,,0.200,0,0", Rejection.NO_FIX),
        ("PTNL,AVR,101530.20,+90.0000,Yaw,+0.01,Tilt,,,60.191,3,2.5,6", Heading(EPOCH, 0.0, 0.0)),
        ("PTNL,AVR,101530.20,-90.0000,Yaw,+0.01,Tilt,,,60.191,3,2.5,6", Heading(EPOCH, math.pi, 0.0)),
        ("PTNL,AVR,101530.20,+90.0000,Yaw,+0.01,Tilt,,,60.191,2,2.5,6", Rejection.NOT_FIXED),
        ("PTNL,AVR,101530.20,+90.0000,Yaw,+0.01,Tilt,,,60.191,0,2.5,6", Rejection.NO_FIX),
        ("PTNL,GGK,101530.20,082006,4838.1,N,00217.9,E,3,7,2.4,EHT85.96,M", None),
        (
            "PSSN,HRP,101530.00,081118,90.000,,-0.300,0.180,,0.400,21,2,12.000,E",
            Heading(36930 * S, 0.0, math.radians(0.18)),
        ),
        ("PSSN,HRP,101530.00,081118,90.000,,-0.300,0.180,,0.400,21,1,12.000,E", Rejection.NOT_FIXED),
        ("PSSN,HRP,101530.00,081118,,,,,,,,0,12.000,E", Rejection.NO_HEADING),
        ("PSAT,HPR,101530.00,90.00,0.4,-1.2,N", Heading(36930 * S, 0.0, 0.0)),
        ("PSAT,HPR,101530.00,90.00,0.4,-1.2,G", Rejection.DEAD_RECKONING),
        ("PSAT,HPR,101530.00,,,,", Rejection.NO_HEADING),
        (
            "KSXT,20261125101530.00,116.2,40.0,68.3830,90.00,-67.03,190.28,0.022,,1,3,46,28,,,,-0.1,-0.1,-0.1,,",
            Heading(36930 * S, 0.0, 0.0),
        ),
        (
            "KSXT,20261125101530.00,116.2,40.0,68.3830,90.00,-67.03,190.28,0.022,,1,2,46,28,,,,-0.1,-0.1,-0.1,,",
            Rejection.NOT_FIXED,
        ),
        ("KSXT,20261125101530.00,,,,,,,,,0,0,,,,,,,,,,", Rejection.NO_HEADING),
        ("PASHR,POS,0,12,101530.00", None),
        ("GPGSV,3,1,11,03,03,111,00", None),
        ("GNGGA", Rejection.MALFORMED),
        ("GNGGA,101530.20,,,,,4,18,0.6,41.20,M,22.10,M,,", Rejection.MALFORMED),
        ("GNGGA,101530.20,9000.01,S,15112.76,E,4,18,0.6,41.2,M,22.1,M,,", Rejection.OUT_OF_RANGE),
        ("GNGGA,101530.20,3352.12,S,18000.01,E,4,18,0.6,41.2,M,22.1,M,,", Rejection.OUT_OF_RANGE),
        ("GNGGA,101530.20,3352.12,S,15175.76,E,4,18,0.6,41.2,M,22.1,M,,", Rejection.OUT_OF_RANGE),
        ("GNGGA,101530.20,-3352.12,S,15112.76,E,4,18,0.6,41.2,M,22.1,M,,", Rejection.MALFORMED),
        ("GNGGA,101530.20,3352.12,E,15112.76,E,4,18,0.6,41.2,M,22.1,M,,", Rejection.MALFORMED),
        ("GNGGA,101530.20,3352.12,S,15112.76,E,4,18,0.6,141.2,F,22.1,M,,", Rejection.NOT_METRES),
        ("GNGGA,101530.20,3352.12,S,15112.76,E,4,18,0.6,41.2,M,72.1,f,,", Rejection.NOT_METRES),
        ("GNGGA,101530.20,3352.12,S,15112.76,E,4,18,0.6,4.1e9,M,22.1,M,,", Rejection.OUT_OF_RANGE),
        ("GNGGA,106130.20,3352.12,S,15112.76,E,4,18,0.6,41.2,M,22.1,M,,", Rejection.MALFORMED),
        ("GNGGA,241530.20,3352.12,S,15112.76,E,4,18,0.6,41.2,M,22.1,M,,", Rejection.MALFORMED),
    ],
)
def test_sentence(content, expected):
    reading = decode(line(content))
    if isinstance(expected, tuple):
        assert type(reading) is type(expected)
        assert reading == pytest.approx(expected)
    else:
        assert reading is expected


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
def test_damaged_sentence_is_rejected(raw, expected):
    assert decode(raw) is expected


def gga_of(content):
    reading = decode(line(content))
    assert isinstance(reading, Gga)
    return reading


@pytest.mark.parametrize(
    ("latitude", "longitude", "expected"),
    [
        ("4506.0000000,N", "401.3380000,E", (45.1, 4 + 1.338 / 60)),
        ("6.5,S", "1.5,W", (-6.5 / 60, -1.5 / 60)),
        ("4506,N", "00401,E", (45.1, 4 + 1 / 60)),
        ("9000.000,N", "18000.000,W", (90.0, -180.0)),
        ("0.0,N", "59.999999999,E", (0.0, 59.999999999 / 60)),
    ],
)
def test_angles_are_read_without_leading_zeros(latitude, longitude, expected):
    reading = gga_of(f"GPGGA,101530.20,{latitude},{longitude},4,18,0.6,41.20,M,22.10,M,1.0,0021")
    assert (reading.latitude, reading.longitude) == pytest.approx(expected, abs=1e-12)


NINE_THIRTY = ((9 * 60 + 30) * 60 + 15) * S + S // 5


@pytest.mark.parametrize(
    ("time", "time_ns"),
    [("93015.20", NINE_THIRTY), ("093015.200000000", NINE_THIRTY), ("", None), ("235960.00", None)],
)
def test_time_of_day_may_lack_leading_zeros_and_is_unknown_in_a_leap_second(time, time_ns):
    assert gga_of(GGA.format(4).replace("101530.20", time)).time_ns == time_ns


@pytest.mark.parametrize("fields", ["0.000,0.000,0.000", ",,"])
def test_accuracy_of_zero_is_unknown(fields):
    reading = decode(line(f"GPGST,101530.20,,,,,{fields}"))
    assert isinstance(reading, Gst)
    assert math.isnan(reading.north)


def test_altitude_is_unknown_without_the_geoid():
    assert math.isnan(gga_of(GGA.format(1).replace("22.10", "")).altitude)


GNS = "GNGNS,101530.20,3352.1234567,S,15112.7654321,E,{},18,0.6,41.20,22.10,1.0,0021{}"


@pytest.mark.parametrize(
    ("modes", "status", "expected"),
    [
        ("RR", ",S", FixStatus.RTK),
        ("NF", "", FixStatus.RTK),
        ("AD", ",V", FixStatus.DIFFERENTIAL),
        ("ANN", ",C", FixStatus.SINGLE),
        ("", "", Rejection.NO_FIX),
        ("E", "", Rejection.DEAD_RECKONING),
        ("S", "", Rejection.NOT_MEASURED),
        ("RR", ",U", Rejection.WARNING),
        ("?", "", Rejection.MALFORMED),
    ],
)
def test_gns_is_a_position_of_the_best_mode(modes, status, expected):
    reading = decode(line(GNS.format(modes, status)))
    assert (reading.status if isinstance(reading, Gga) else reading) is expected
    if isinstance(reading, Gga):
        assert reading[:4] == gga_of(GGA.format(4))[:4]


@given(
    st.floats(-89.9, 89.9),
    st.floats(-179.9, 179.9),
    st.floats(-400, 9000),
    st.integers(0, 8_639_999),
    st.floats(0.001, 50.0),
    st.floats(0.0, 359.9),
)
def test_encoded_sentences_decode_to_their_values(
    latitude, longitude, altitude, centiseconds, stddev, heading
):
    time_ns = centiseconds * 10_000_000
    at = Position(time_ns, latitude, longitude, altitude, 5, 0.9, stddev, 2 * stddev, heading, 0.2)
    position = decode(nmea_sentences.gga(at)[:-1])
    assert isinstance(position, Gga)
    assert position[:4] == pytest.approx((time_ns, latitude, longitude, altitude), abs=2e-4)
    assert position[1:3] == pytest.approx((latitude, longitude), abs=1e-9)
    noise = decode(nmea_sentences.gst(at)[:-1])
    assert isinstance(noise, Gst)
    assert noise[1:] == pytest.approx((stddev, stddev, 2 * stddev), abs=1e-4)
    assert decode(nmea_sentences.rmc(at)[:-1]) == Rmc(time_ns)
    moving = decode(nmea_sentences.rmc(at._replace(speed=stddev, course=heading))[:-1])
    assert isinstance(moving, Rmc)
    assert isinstance(moving.velocity, Velocity)
    east, north = stddev * math.sin(math.radians(heading)), stddev * math.cos(math.radians(heading))
    assert moving.velocity[1:3] == pytest.approx((east, north), abs=5e-4 + 1e-4 * stddev)
    for encode, expected in ((hdt, 0.0), (nmea_sentences.pashr, math.radians(0.2))):
        reading = decode(encode(at)[:-1])
        assert isinstance(reading, Heading)
        assert math.sin(reading.yaw - yaw_of_heading(heading)) == pytest.approx(0.0, abs=1e-5)
        assert reading.stddev == pytest.approx(expected)


@pytest.mark.parametrize(
    "content",
    ["GNVTG,90.0,T,,M,1.944,N,3.6,K,D", "GPVTG,90.0,T,,M,1.9438445,N,,K", "GNRMC,,A,,,,,1.9438445,90.0,,,,A"],
)
def test_speed_and_course_are_a_velocity(content):
    reading = decode(line(content))
    velocity = reading.velocity if isinstance(reading, Rmc) else reading
    assert isinstance(velocity, Velocity)
    assert velocity[1:] == pytest.approx((1.0, 0.0, 0.0, 0.0), abs=1e-6)


def test_slow_antenna_without_a_course_has_zero_velocity():
    assert decode(line("GNVTG,,T,,M,0.1,N,0.18,K,A")) == Velocity(None, 0.0, 0.0, 0.0, pytest.approx(0.05))


@given(st.floats(-math.pi, math.pi))
def test_heading_and_yaw_are_each_other_s_inverse(yaw):
    assert math.cos(yaw_of_heading(heading_of_yaw(yaw)) - yaw) == pytest.approx(1.0)
    assert -math.pi < yaw_of_heading(heading_of_yaw(yaw)) <= math.pi
