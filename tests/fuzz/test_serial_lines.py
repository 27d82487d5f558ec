# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Valid messages are found after any bytes on a serial line: SICK scanners, Watson IMUs, NMEA."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fixtures.driver_defaults import LAYOUT, NMEA, PLS
from fixtures.heading_sentences import hdt
from hypothesis import example, given
from hypothesis import strategies as st
from pyubx2 import GET, UBXMessage, calc_checksum

from trackslip_common.tally import Tally
from trackslip_drivers.protocols import nmea_sentences
from trackslip_drivers.protocols import sick_commands as commands
from trackslip_drivers.protocols.gnss_frames import LONGEST_MESSAGE
from trackslip_drivers.protocols.nmea_stream import NmeaStream
from trackslip_drivers.protocols.sick_scan import RawScan, Scan
from trackslip_drivers.protocols.sick_session import Phase, SickSession
from trackslip_drivers.protocols.sick_telegram import (
    FROM_SENSOR,
    MAX_PAYLOAD,
    SILENCE_NS,
    TO_SENSOR,
    Control,
    make_telegram,
)
from trackslip_drivers.protocols.watson import encode_frame, encode_line
from trackslip_drivers.protocols.watson_stream import WatsonStream
from trackslip_sim.devices.sick_device import SickDevice, SickDeviceParameters

Piece = tuple[int, bytes]  # kind and content

MS = 1_000_000
RAW, FRAMED, CUT, HEAD, ACK, SILENCE, SCAN = range(7)  # kinds of pieces; any other is raw

kinds = st.one_of(st.integers(RAW, SCAN), st.just(FRAMED))
contents = st.one_of(st.binary(max_size=24), st.binary(max_size=768))
pieces = st.lists(st.tuples(kinds, contents), max_size=12)


SCANS = [
    make_telegram(RawScan(np.full(361, n, dtype=np.uint16), status=0).payload(), FROM_SENSOR)
    for n in (250, 251)
]
MODE_OK = make_telegram(b"\xa0\x00\x10", FROM_SENSOR)
POWER_ON = b"\x90PLS101-312\x10"


def on_line(kind: int, content: bytes, address: int) -> tuple[bytes, int]:
    """The bytes of a piece, and the duration of their transfer, ns."""
    payload = scan_payload(content) if kind == SCAN else content or b"\0"
    whole = make_telegram(payload[:MAX_PAYLOAD], address) if kind in (FRAMED, CUT, SCAN) else content
    forms = {
        CUT: whole[: len(whole) // 2],
        HEAD: bytes((0x02, address)) + content,
        ACK: bytes((Control.ACK.value,)),
        SILENCE: b"",
    }
    return forms.get(kind, whole), SILENCE_NS if kind == SILENCE else 2 * MS


def scan_payload(content: bytes) -> bytes:
    """A scan with the number of values in the first two bytes, padded with the last byte."""
    head, values = content[:2].ljust(2, b"\0"), content[2:] or b"\0"
    size = 2 * (int.from_bytes(head, "little") & 0x1FF)
    return b"\xb0" + head + values.ljust(size, values[-1:])[:size] + values[-1:]


SCAN_OF_ZEROS = RawScan(np.zeros(10, dtype=np.uint16), status=0).payload()
CONVERSATIONS: list[list[Piece]] = [  # possible output of a scanner
    [(ACK, b""), (FRAMED, b"\xa0\x00\x10"), (RAW, b"\x06\x15\xff"), (SILENCE, b"")],
    [(SCAN, count.to_bytes(2, "little") + b"\xf7\x1f\x80") for count in (180, 4457, 16745)],
    [(FRAMED, POWER_ON), (FRAMED, b"\x91\x10"), (FRAMED, b"\x92\x10"), (FRAMED, b"\xb1abc\x10")],
    [
        *((HEAD, b"\x2c\x03\xb0"), (SCAN, b"\x69\x01\x00\x21\x80"), (CUT, SCAN_OF_ZEROS)),
        *((FRAMED, b"\xb2\x01\x05\x03\x02\x10"), (SILENCE, b"")),
    ],
]


@given(pieces)
@example(CONVERSATIONS[0])
@example(CONVERSATIONS[1])
@example(CONVERSATIONS[2])
@example(CONVERSATIONS[3])
def test_session_streams_again_after_any_bytes(conversation: list[Piece]) -> None:
    session = SickSession(replace(PLS, serial_baud=9600), Tally())
    now_ns = start_streaming(session, 0)
    for kind, content in conversation:
        sent, duration_ns = on_line(kind, content, FROM_SENSOR)
        now_ns += duration_ns * (10 if kind == SILENCE else 1)
        session.receive(sent, now_ns)
        session.step(now_ns)
    now_ns = start_streaming(session, now_ns) + SILENCE_NS
    session.receive(b"", now_ns)  # false starts are tested with the telegram parser
    scans = [scan for n in (1, 2) for scan in session.receive(SCANS[n - 1], now_ns + 40 * MS * n)]
    assert any(abs(s.sample.ranges[0] - 2.51) < 1e-9 for s in scans)
    assert all(isinstance(scan, Scan) for scan in scans)


def start_streaming(session: SickSession, now_ns: int) -> int:
    """Answer all commands as a scanner that accepts them; return the time at which it streams."""
    for _ in range(100_000):
        if session.phase is Phase.STREAMING:
            return now_ns
        now_ns += 100 * MS  # far above the answer times: time-outs pass quickly
        command = session.step(now_ns).write
        session.receive(bytes((Control.ACK.value,)) + MODE_OK if command else b"", now_ns)
    raise AssertionError(f"still {session.phase.value}")


@given(pieces)
@example([(FRAMED, commands.STREAM_ALL), (FRAMED, commands.STREAM_MINIMA), (FRAMED, commands.RESET)])
@example(
    [(FRAMED, commands.installation_mode(commands.PASSWORDS["pls"])), (FRAMED, commands.set_baud(500_000))]
)
@example([(FRAMED, commands.STATUS), (FRAMED, commands.ERRORS), (FRAMED, commands.STOP)])
def test_emulated_scanner_answers_after_any_command(conversation: list[Piece]) -> None:
    ranges = np.full(361, 2.5)
    start = SickDeviceParameters(boot_delay=0.0, power_on_baud=9600)
    device = SickDevice(PLS, start, lambda _: ranges, 0)
    now_ns = 500 * MS  # power-on is reported
    for kind, content in conversation:
        sent, duration_ns = on_line(kind, content, TO_SENSOR)
        now_ns += duration_ns
        device.receive(sent, now_ns, None)
        device.step(now_ns)
    for _ in range(2):  # silence: drop what was begun, process what follows
        now_ns += 2_000 * MS
        device.receive(b"", now_ns, None)
        device.step(now_ns)
    device.receive(make_telegram(commands.STOP, TO_SENSOR), now_ns, None)
    assert MODE_OK[:6] in device.step(now_ns + 2_000 * MS)


LINES = [encode_line("R", {"ZA": -1.0, "ZR": rate}, LAYOUT) for rate in (1.0, 2.0)]
BINARY = [encode_frame({"ZA": -1.0, "ZR": rate}, LAYOUT) for rate in (50.0, 100.0)]
parts = st.lists(
    st.one_of(st.binary(max_size=40), st.sampled_from([*LINES, *BINARY, LINES[0][:9], b"*****\r"]))
)


@pytest.mark.parametrize("good", [LINES, BINARY], ids=["lines", "binary"])
@given(sent=parts.map(b"".join), cut=st.integers(1, 256))
@example(sent=b"WATSON INDUSTRIES, INC.\r" + LINES[0] + LINES[0].replace(b"+0000", b"*****"), cut=8)
@example(sent=BINARY[0][:-1] + BINARY[1], cut=256)
def test_second_message_of_the_imu_after_any_bytes_is_found(good: list[bytes], sent: bytes, cut: int) -> None:
    """``cut``: bytes per read."""
    last = WatsonStream(LAYOUT, 9600, 0, Tally()).feed(good[1], 0)[0].angular_velocity
    stream = WatsonStream(LAYOUT, 9600, 0, Tally())
    for at in range(0, len(sent), cut):
        for sample in stream.feed(sent[at : at + cut], at * MS):
            assert np.isfinite((*sample.acceleration, *sample.angular_velocity)).all(), sample
        assert stream.bytes_held <= stream.limit
    samples = [sample for message in good for sample in stream.feed(message, 0)]
    assert any(sample.angular_velocity == last for sample in samples)


AT = nmea_sentences.Position(1_200_000_000, -33.9, 151.2, 60.0, 4, 0.6, 0.01, 0.02, 123.0, 0.1)
_ENCODERS: tuple[Callable[[nmea_sentences.Position], bytes], ...] = (
    *(nmea_sentences.gga, nmea_sentences.gst, nmea_sentences.rmc, hdt, nmea_sentences.pashr),
)
SENTENCES = [encode(AT) for encode in _ENCODERS]
AFTER = AT._replace(time_ns=90_000_000_000)  # an epoch of no input
LATER = nmea_sentences.gga(AFTER) + nmea_sentences.gst(AFTER)
BODIES = [message[1:].partition(b"*")[0] for message in SENTENCES] + [
    b"GNGNS,101530.20,3352.1,S,15112.7,E,RR,18,0.6,41.20,22.10,1.0,0021,V",
    b"GNVTG,12.0,T,,M,1.0,N,1.852,K,R",
    b"GNTHS,12.5,A",
    b"PTNL,AVR,181059.6,149.4,Yaw,0.1,Tilt,,,60.2,3,2.5,6",
    b"PSAT,HPR,1200.0,90.0,0,0,N",
    b"PSSN,HRP,142800.00,251126,8.3,,1.2,0.1,,0.2,12,2,3,E",
    b"KSXT,20261125102155.00,116.3,40.1,59.3,12.5,0.1,2.0,0.5,,3,3,22,22,,,,-0.1,0.0,0.2,1,12,",
]
ODD_FIELDS = [
    *b" -0 1e9 nan inf - . 0x10 1_0 4806.0 60.0 99 235960.00 240000 +1".split(b" "),
    b"9" * 40,
    b" 1",
]
fields = st.one_of(
    st.binary(max_size=12),
    st.sampled_from(sorted({field for body in BODIES for field in body.split(b",")}) + ODD_FIELDS),
)


def with_field(body: bytes, at: int, field: bytes) -> bytes:
    """A sentence with one field replaced."""
    parts = body.split(b",")
    parts[at % len(parts)] = field
    return b",".join(parts)


bodies = st.one_of(
    st.sampled_from(BODIES),
    st.builds(with_field, st.sampled_from(BODIES), st.integers(0, 23), fields),
    st.lists(fields, max_size=16).map(b",".join),
    st.binary(max_size=160),
)


@given(st.lists(bodies, max_size=8))
@example([b"GNTHS,12.5,A", b"GNHDT,,T", b"PASHR,POS,1"])
def test_good_fix_after_any_sentences_is_found(sent: list[bytes]) -> None:
    """Sentences with a valid checksum, or unchanged bytes."""
    stream, now_ns = NmeaStream(NMEA, Tally()), 0
    for content in sent:
        now_ns += 40 * MS
        is_text = content.isascii() and b"\n" not in content
        whole = nmea_sentences.sentence(content.decode("ascii")) if is_text else content + b"\n"
        for sample in stream.feed(whole, now_ns):
            assert np.isfinite(sample[1]), sample
        assert stream.bytes_held <= LONGEST_MESSAGE
        stream.flush()
    stream.feed(b"\n", now_ns)
    samples = stream.feed(LATER, now_ns + 1000 * MS)
    assert any(abs(sample[1] + 33.9) < 1e-6 for sample in samples)


_HEADING = {"gnssFixOK": 1, "relPosValid": 1, "carrSoln": 2, "isMoving": 1, "relPosHeadingValid": 1}
_FIX = {"fixType": 3, "gnssFixOk": 1, "carrSoln": 2, "lat": 48.1, "lon": 11.6, "hAcc": 14, "vAcc": 20}
UBX_MESSAGES = (
    UBXMessage("NAV", "NAV-PVT", GET, iTOW=20_000, **_FIX),
    UBXMessage("NAV", "NAV-HPPOSLLH", GET, iTOW=20_000, lat=48.1, lon=11.6, hAcc=10.0, vAcc=15.0),
    UBXMessage("NAV", "NAV-COV", GET, iTOW=20_000, posCovValid=1, posCovNN=1e-4, posCovEE=1e-4),
    UBXMessage("NAV", "NAV-RELPOSNED", GET, version=1, iTOW=20_000, relPosHeading=30.0, **_HEADING),
)
PAYLOADS = [message.payload for message in UBX_MESSAGES]
NAMES = (b"\x01\x07", b"\x01\x14", b"\x01\x36", b"\x01\x3c", b"\x02\x15")


def with_byte(name: int, at: int, byte: int) -> Piece:
    """A message with one byte of its payload replaced."""
    payload = bytearray(PAYLOADS[name])
    payload[at % len(payload)] = byte
    return name, bytes(payload)


of_names = st.integers(0, len(PAYLOADS) - 1)
edges = st.sampled_from((0, 1, 0x7F, 0x80, 0xFF))
changed = st.builds(with_byte, of_names, st.integers(0, 99), st.one_of(edges, st.integers(0, 255)))
contents_of_ubx = st.one_of(st.sampled_from(PAYLOADS), st.binary(max_size=120))
ubx = st.lists(st.one_of(changed, st.tuples(st.integers(0, len(NAMES)), contents_of_ubx)), max_size=8)


@given(ubx)
@example(list(enumerate(PAYLOADS)))
def test_good_fix_after_any_binary_messages_is_found(sent: list[Piece]) -> None:
    """Messages with a valid checksum, or unchanged bytes."""
    stream, now_ns = NmeaStream(NMEA, Tally()), 0
    for kind, content in sent:
        now_ns += 40 * MS
        whole = ubx_frame(NAMES[kind] + content) if kind < len(NAMES) else content
        for sample in stream.feed(whole, now_ns):
            assert np.isfinite(sample[1]), sample
        assert stream.bytes_held <= LONGEST_MESSAGE
    samples = stream.feed(LATER, now_ns + 5000 * MS) + stream.flush()
    assert any(abs(sample[1] + 33.9) < 1e-6 for sample in samples)


def ubx_frame(content: bytes) -> bytes:
    """A UBX frame of class, id and payload."""
    body = content[:2] + (len(content) - 2).to_bytes(2, "little") + content[2:]
    return b"".join((b"\xb5\x62", body, calc_checksum(body)))
