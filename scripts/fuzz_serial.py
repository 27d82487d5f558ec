# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzz targets on serial lines: SICK telegrams, session and device; Watson lines and frames; NMEA."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import TypeVar

import numpy as np
from pyubx2 import GET, UBXMessage, calc_checksum

from fuzz_script import pieces, script
from trackslip_common.config_files import node_defaults
from trackslip_common.parameters import Parameters, from_flat
from trackslip_common.tally import Tally
from trackslip_drivers.nmea_parameters import NmeaParameters
from trackslip_drivers.protocols import nmea_sentences, sick_telegram
from trackslip_drivers.protocols import sick_commands as commands
from trackslip_drivers.protocols.gnss_frames import LONGEST
from trackslip_drivers.protocols.nmea_stream import NmeaStream
from trackslip_drivers.protocols.sick_crc import sick_crc
from trackslip_drivers.protocols.sick_scan import RawScan, Scan, decode_scan
from trackslip_drivers.protocols.sick_session import Phase, SickSession
from trackslip_drivers.protocols.sick_telegram import (
    FROM_SENSOR,
    MAX_PAYLOAD,
    MAX_TELEGRAM,
    SILENCE_NS,
    TO_SENSOR,
    Control,
    Telegram,
    TelegramParser,
    frame,
)
from trackslip_drivers.protocols.watson import Layout, encode_frame, encode_line
from trackslip_drivers.protocols.watson_stream import WatsonStream
from trackslip_drivers.sick_parameters import SickParameters
from trackslip_drivers.watson_parameters import WatsonParameters
from trackslip_sim.devices.sick_device import SickDevice, SickDeviceParameters

Target = tuple[Callable[[bytes], None], list[bytes]]
T = TypeVar("T", bound=Parameters)

MS = 1_000_000
RAW, FRAMED, CUT, HEAD, ACK, SILENCE, SCAN = range(7)  # kinds of pieces; a further one is raw, too

# Most of the time would go into the checksums of the same few telegrams.
sick_telegram.sick_crc = lru_cache(1 << 14)(sick_crc)  # type: ignore[attr-defined]


def defaults(cls: type[T], node: str) -> T:
    """What ``config/`` gives a node."""
    return from_flat(cls, node_defaults(node, f"{node}.yaml"), node)


PLS = defaults(SickParameters, "sick_pls")
LMS = replace(PLS, model="lms", range_max=80.0)
SCANS = [
    frame(RawScan(np.full(361, n, dtype=np.uint16), status=0).payload(), FROM_SENSOR) for n in (250, 251)
]
MODE_OK = frame(b"\xa0\x00\x10", FROM_SENSOR)
POWER_ON = b"\x90PLS101-312\x10"


def on_line(kind: int, content: bytes, address: int) -> tuple[bytes, int]:
    """The bytes of a piece, and how long they are in coming, ns."""
    payload = scan_payload(content) if kind == SCAN else content or b"\0"
    whole = frame(payload[:MAX_PAYLOAD], address) if kind in (FRAMED, CUT, SCAN) else content
    forms = {
        CUT: whole[: len(whole) // 2],
        HEAD: bytes((0x02, address)) + content,
        ACK: bytes((Control.ACK.value,)),
        SILENCE: b"",
    }
    return forms.get(kind, whole), SILENCE_NS if kind == SILENCE else 2 * MS


def scan_payload(content: bytes) -> bytes:
    """A scan of as many values as the first two bytes say, the last byte filling what is missing."""
    head, values = content[:2].ljust(2, b"\0"), content[2:] or b"\0"
    size = 2 * (int.from_bytes(head, "little") & 0x1FF)
    return b"\xb0" + head + values.ljust(size, values[-1:])[:size] + values[-1:]


def sick_telegrams() -> Target:
    """The parser alone, and the scans that it finds."""

    def one_input(data: bytes) -> None:
        parser = TelegramParser(FROM_SENSOR, 500_000, 11, Tally(), "scan")
        now_ns = 0
        for kind, content in pieces(data):
            said, lasts_ns = on_line(kind, content, FROM_SENSOR)
            now_ns += lasts_ns
            for event in parser.feed(said, now_ns):
                if isinstance(event, Telegram):
                    decode_scan(event, PLS)
                    decode_scan(event, LMS)
            assert parser.bytes_held < MAX_TELEGRAM, f"{parser.bytes_held} bytes held"
        heard = [parser.feed(scan, now_ns + 40 * MS * (n + 1)) for n, scan in enumerate(SCANS)]
        payloads = [event.payload for events in heard for event in events if isinstance(event, Telegram)]
        # One false start in 33000 passes the checksum, with the scans that follow it as its content.
        forged = any(scan[:8] in payload for scan in SCANS for payload in payloads)
        assert forged or SCANS[1][4:-2] in payloads, "second scan after garbage not found"

    return one_input, conversations()


def sick_session() -> Target:
    """The talk: whatever was said, a scanner that answers as it should is streaming again soon."""

    def one_input(data: bytes) -> None:
        session = SickSession(replace(PLS, serial_baud=9600), Tally())
        now_ns = start_streaming(session, 0)
        for kind, content in pieces(data):
            said, lasts_ns = on_line(kind, content, FROM_SENSOR)
            now_ns += lasts_ns * (10 if kind == SILENCE else 1)
            session.receive(said, now_ns)
            session.step(now_ns)
        now_ns = start_streaming(session, now_ns) + SILENCE_NS
        session.receive(b"", now_ns)  # false starts are the telegram parser's affair
        scans = [scan for n in (1, 2) for scan in session.receive(SCANS[n - 1], now_ns + 40 * MS * n)]
        assert any(abs(s.sample.ranges[0] - 2.51) < 1e-9 for s in scans), "second scan not found"
        assert all(isinstance(scan, Scan) for scan in scans)

    return one_input, conversations()


def start_streaming(session: SickSession, now_ns: int) -> int:
    """Be the scanner that answers everything with yes; gives the time at which it streams."""
    for _ in range(100_000):
        if session.phase is Phase.STREAMING:
            return now_ns
        now_ns += 100 * MS  # far longer than its answers take: time-outs pass quickly
        asked = session.step(now_ns).write
        session.receive(bytes((Control.ACK.value,)) + MODE_OK if asked else b"", now_ns)
    raise AssertionError(f"still {session.phase.value}")


def sick_device() -> Target:
    """The emulated scanner, in the host's hands: it boots and answers after whatever it was told."""
    start = SickDeviceParameters(boot_delay=0.0, power_on_baud=9600)
    ranges = np.full(361, 2.5)

    def one_input(data: bytes) -> None:
        device = SickDevice(PLS, start, lambda _: ranges, 0)
        now_ns = 500 * MS  # power-on is said
        for kind, content in pieces(data):
            said, lasts_ns = on_line(kind, content, TO_SENSOR)
            now_ns += lasts_ns
            device.receive(said, now_ns, None)
            device.step(now_ns)
        for _ in range(2):  # silence: what was begun is given up, what that lays bare is done
            now_ns += 2_000 * MS
            device.receive(b"", now_ns, None)
            device.step(now_ns)
        device.receive(frame(commands.STOP, TO_SENSOR), now_ns, None)
        answer = device.step(now_ns + 2_000 * MS)
        assert MODE_OK[:6] in answer, "no answer to stop"

    asked = [commands.STREAM_ALL, commands.REQUEST_VALUES_PLS, commands.STREAM_MINIMA, commands.RESET]
    changed = [commands.installation_mode(commands.PASSWORDS["pls"]), commands.set_baud(500_000)]
    rest = [commands.STATUS, commands.ERRORS, commands.STOP]
    return one_input, [script(*((FRAMED, c) for c in wanted)) for wanted in (asked, changed, rest)]


def conversations() -> list[bytes]:
    """What a scanner may say."""
    scan = RawScan(np.zeros(10, dtype=np.uint16), status=0).payload()
    return [
        script((ACK, b""), (FRAMED, b"\xa0\x00\x10"), (RAW, b"\x06\x15\xff"), (SILENCE, b"")),
        script(*((SCAN, count.to_bytes(2, "little") + b"\xf7\x1f\x80") for count in (180, 4457, 16745))),
        script((FRAMED, POWER_ON), (FRAMED, b"\x91\x10"), (FRAMED, b"\x92\x10"), (FRAMED, b"\xb1abc\x10")),
        script(
            (HEAD, b"\x2c\x03\xb0"),
            (SCAN, b"\x69\x01\x00\x21\x80"),
            (CUT, scan),
            (FRAMED, b"\xb2\x01\x05\x03\x02\x10"),
            (SILENCE, b""),
        ),
    ]


def watson_lines() -> Target:
    """Decimal lines, as the unit comes up."""
    values = [{"ZA": -1.0, "ZR": rate} for rate in (1.0, 2.0)]
    return watson([encode_line("R", v, watson_layout()) for v in values])


def watson_frames() -> Target:
    """Binary frames."""
    values = [{"ZA": -1.0, "ZR": rate} for rate in (50.0, 100.0)]
    return watson([encode_frame(v, watson_layout()) for v in values])


def watson_layout() -> Layout:
    p = defaults(WatsonParameters, "watson_imu")
    return Layout(p.channels, p.formats, p.full_scales)


def watson(good: list[bytes]) -> Target:
    """The stream, then two good messages that must be told apart from what came before."""
    layout = watson_layout()
    last = WatsonStream(layout, 9600, 0, Tally()).feed(good[1], 0)[0].angular_velocity

    def one_input(data: bytes) -> None:
        stream = WatsonStream(layout, 9600, 0, Tally())
        cut = data[0] + 1 if data else 1  # as reads may come
        for at in range(1, len(data), cut):
            for sample in stream.feed(data[at : at + cut], at * MS):
                assert np.isfinite((*sample.acceleration, *sample.angular_velocity)).all(), sample
            assert stream.bytes_held <= stream.limit, f"{stream.bytes_held} bytes held"
        samples = [sample for message in good for sample in stream.feed(message, 0)]
        assert any(sample.angular_velocity == last for sample in samples), "second message not found"

    asterisks = good[0].replace(b"+0000", b"*****")
    joined = b"WATSON INDUSTRIES, INC.\r" + b"".join(good) + asterisks
    return one_input, [b"\x07" + joined, b"\xff" + good[0][:-1] + good[1], b"\x00i" + good[0][1:]]


def nmea() -> Target:
    """A receiver's sentences, whole with a right checksum, or as they come; then a good fix must be found."""
    p = defaults(NmeaParameters, "nmea_gnss")
    at = nmea_sentences.Position(1_200_000_000, -33.9, 151.2, 60.0, 4, 0.6, 0.01, 0.02, 123.0, 0.1)
    encoders = (nmea_sentences.gga, nmea_sentences.gst, nmea_sentences.rmc, nmea_sentences.hdt)
    good = [encode(at) for encode in (*encoders, nmea_sentences.pashr)]
    after = at._replace(time_ns=90_000_000_000)  # of an epoch that no input has
    later = nmea_sentences.gga(after) + nmea_sentences.gst(after)

    def one_input(data: bytes) -> None:
        stream = NmeaStream(p, Tally())
        now_ns = 0
        for content in data.split(b"\n"):
            now_ns += 40 * MS
            text = content.decode("latin-1")
            whole = nmea_sentences.sentence(text) if content.isascii() else content + b"\n"
            for sample in stream.feed(whole, now_ns):
                assert np.isfinite(sample[1]), sample
            assert stream.bytes_held <= LONGEST, f"{stream.bytes_held} bytes held"
            stream.flush()
        stream.feed(b"\n", now_ns)
        samples = stream.feed(later, now_ns + 1000 * MS)
        assert any(abs(sample[1] + 33.9) < 1e-6 for sample in samples), "good fix not found"

    bodies = [message[1:].partition(b"*")[0] for message in good]
    return one_input, [b"\n".join(bodies), good[0] + good[1], b"GNTHS,12.5,A\nGNHDT,,T\nPASHR,POS,1"]


def ubx() -> Target:
    """UBX messages with a right checksum, or as they come; then a good fix must be found."""
    p = defaults(NmeaParameters, "nmea_gnss")
    at = nmea_sentences.Position(90_000_000_000, -33.9, 151.2, 60.0, 4, 0.6, 0.01, 0.02, 123.0, 0.1)
    good = nmea_sentences.gga(at) + nmea_sentences.gst(at)
    names = (b"\x01\x07", b"\x01\x14", b"\x01\x36", b"\x01\x3c", b"\x02\x15")

    def one_input(data: bytes) -> None:
        stream = NmeaStream(p, Tally())
        now_ns = 0
        for kind, content in pieces(data):
            now_ns += 40 * MS
            whole = ubx_frame(names[kind] + content) if kind < len(names) else content
            for sample in stream.feed(whole, now_ns):
                assert np.isfinite(sample[1]), sample
            assert stream.bytes_held <= LONGEST, f"{stream.bytes_held} bytes held"
        samples = stream.feed(good, now_ns + 5000 * MS) + stream.flush()
        assert any(abs(sample[1] + 33.9) < 1e-6 for sample in samples), "good fix not found"

    fields = {"fixType": 3, "gnssFixOk": 1, "carrSoln": 2, "lat": 48.1, "lon": 11.6, "hAcc": 14, "vAcc": 20}
    heading = {"gnssFixOK": 1, "relPosValid": 1, "carrSoln": 2, "isMoving": 1, "relPosHeadingValid": 1}
    messages = (
        UBXMessage("NAV", "NAV-PVT", GET, iTOW=20_000, **fields),
        UBXMessage("NAV", "NAV-HPPOSLLH", GET, iTOW=20_000, lat=48.1, lon=11.6, hAcc=10.0, vAcc=15.0),
        UBXMessage("NAV", "NAV-COV", GET, iTOW=20_000, posCovValid=1, posCovNN=1e-4, posCovEE=1e-4),
        UBXMessage("NAV", "NAV-RELPOSNED", GET, version=1, iTOW=20_000, relPosHeading=30.0, **heading),
    )
    seeds = [script((k, message.payload)) for k, message in enumerate(messages)]
    return one_input, [*seeds, b"".join(seeds)]


def ubx_frame(content: bytes) -> bytes:
    """Class, id and payload with what stands around them."""
    body = content[:2] + (len(content) - 2).to_bytes(2, "little") + content[2:]
    return b"".join((b"\xb5\x62", body, calc_checksum(body)))


_ALL = (sick_telegrams, sick_session, sick_device, watson_lines, watson_frames)
TARGETS = {target.__name__: target for target in _ALL} | {"nmea_sentences": nmea, "ubx_messages": ubx}
