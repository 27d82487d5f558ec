# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""SICK telegrams: known byte vectors, their times, and their search in any bytes: none is lost or wrong."""

import itertools
from random import Random

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from trackslip_common.tally import Tally
from trackslip_drivers.protocols import sick_commands as commands
from trackslip_drivers.protocols.sick_crc import sick_crc
from trackslip_drivers.protocols.sick_scan import RawScan
from trackslip_drivers.protocols.sick_telegram import (
    FROM_SENSOR,
    MAX_PAYLOAD,
    MAX_TELEGRAM,
    SILENCE_NS,
    TO_SENSOR,
    Control,
    Telegram,
    TelegramFault,
    TelegramParser,
    make_telegram,
)

MS = 1_000_000
CHAR_NS = 11e9 / 38_400

TO_SENSOR_VECTORS = [
    ("02 00 02 00 20 24 34 08", commands.STREAM_ALL),
    ("02 00 02 00 20 25 35 08", commands.STOP),
    ("02 00 02 00 20 20 30 08", commands.STREAM_MINIMA),
    ("02 00 02 00 20 40 50 08", commands.set_baud(38400)),
    ("02 00 02 00 20 41 51 08", commands.set_baud(19200)),
    ("02 00 02 00 20 42 52 08", commands.set_baud(9600)),
    ("02 00 02 00 20 48 58 08", commands.set_baud(500000)),
    (
        "02 00 0A 00 20 00 53 49 43 4B 5F 50 4C 53 CC FC",
        commands.installation_mode(commands.PASSWORDS["pls"]),
    ),
    (
        "02 00 0A 00 20 00 53 49 43 4B 5F 4C 4D 53 BE C5",
        commands.installation_mode(commands.PASSWORDS["lms"]),
    ),
    ("02 00 01 00 31 15 12", commands.STATUS),
    ("02 00 01 00 32 16 12", commands.ERRORS),
    ("02 00 01 00 10 34 12", commands.RESET),
    ("02 00 02 00 30 01 31 18", commands.REQUEST_VALUES_LMS),
    ("02 00 03 00 30 05 B4 CE 3D", commands.REQUEST_VALUES_PLS),
]
FROM_SENSOR_VECTORS = [
    ("02 80 03 00 A0 00 00 06 0A", "A0 00 00"),
    ("02 80 03 00 A0 01 00 04 0B", "A0 01 00"),
    ("02 80 0A 00 B0 03 00 64 00 E8 03 87 33 00 7E 0C", "B0 03 00 64 00 E8 03 87 33 00"),
    ("02 80 D6 02 B0 69 01" + " F4 01" * 361 + " 00 D4 59", "B0 69 01" + " F4 01" * 361 + " 00"),
]
VECTORS = [(bytes.fromhex(v), p, TO_SENSOR) for v, p in TO_SENSOR_VECTORS] + [
    (bytes.fromhex(v), bytes.fromhex(p), FROM_SENSOR) for v, p in FROM_SENSOR_VECTORS
]
OK = bytes.fromhex("02 80 03 00 A0 00 00 06 0A")
MODE = OK[4:-2]
ACK, NAK = b"\x06", b"\x15"


class Receiver:
    """A parser whose reads come a millisecond apart unless a test states their times; it counts all bytes."""

    def __init__(self, address: int = FROM_SENSOR) -> None:
        self.tally = Tally()
        self.parser = TelegramParser(address, 38_400, 11, self.tally, "scan")
        self.now_ns = 0
        self.used = 0  # bytes of telegrams and controls
        self.payloads: list[bytes] = []

    def feed(self, data: bytes, arrival_ns: int | None = None) -> list[bytes | Control]:
        self.now_ns = self.now_ns + MS if arrival_ns is None else arrival_ns
        received: list[bytes | Control] = []
        for event in self.parser.feed(data, self.now_ns):
            if isinstance(event, Telegram):
                assert event.end_ns <= self.now_ns
                self.payloads.append(event.payload)
                self.used += len(make_telegram(event.payload, FROM_SENSOR))
            else:
                self.used += 1
            received.append(event.payload if isinstance(event, Telegram) else event)
        assert self.parser.bytes_held < MAX_TELEGRAM
        return received

    def wait(self) -> None:
        self.feed(b"", self.now_ns + SILENCE_NS)

    def counted(self, fault: TelegramFault) -> int:
        return self.tally.total["scan", fault.value]

    def garbage(self) -> int:
        return self.parser.discarded_bytes


@pytest.mark.parametrize(("wire", "payload", "address"), VECTORS)
def test_known_telegrams_encode_and_decode(wire: bytes, payload: bytes, address: int) -> None:
    receiver = Receiver(address)
    assert make_telegram(payload, address) == wire
    assert receiver.feed(wire) == [payload]
    assert not receiver.tally.total


@pytest.mark.parametrize("payload", [b"", bytes(MAX_PAYLOAD + 1)])
def test_payloads_of_no_telegram_are_refused(payload: bytes) -> None:
    with pytest.raises(ValueError, match="payload of"):
        make_telegram(payload, TO_SENSOR)


def test_the_checksum_is_that_of_the_manuals_register() -> None:
    random = Random(4)
    for count in (1, 2, 3, 7, 8, 9, 728, MAX_TELEGRAM - 2):
        data = random.randbytes(count)
        crc = previous = 0
        for byte in data:
            crc = (crc << 1 & 0xFFFF) ^ (0x8005 if crc & 0x8000 else 0) ^ byte ^ previous << 8
            previous = byte
        assert sick_crc(data) == crc


@pytest.mark.parametrize(
    ("data", "received", "counts"),
    [
        (ACK + OK + NAK + OK + ACK, [Control.ACK, MODE, Control.NAK, MODE, Control.ACK], {}),
        (b"\xff\x06\x02\x15" + OK + ACK, [MODE, Control.ACK], {"bytes between telegrams": 1}),
        (b"\x02\x80\0\0" + OK, [MODE], {"bad length": 1}),
        (
            b"\x02\x80" + (MAX_PAYLOAD + 1).to_bytes(2, "little") + OK,
            [MODE],
            {"bad length": 1},
        ),
        (OK[:5] + b"\x10" + OK[6:] + OK, [MODE], {"bad CRC": 1}),
        (make_telegram(b"\x20\x25", TO_SENSOR), [], {"bytes between telegrams": 1}),
    ],
    ids=["controls", "controls in garbage", "length 0", "long", "corrupt", "other direction"],
)
def test_a_fault_is_counted_once_whatever_its_bytes_and_costs_no_telegram(
    data: bytes, received: list[bytes | Control], counts: dict[str, int]
) -> None:
    receiver = Receiver()
    assert receiver.feed(data) == received
    assert receiver.tally.by_source().get("scan", {}) == counts


def test_a_silence_ends_garbage() -> None:
    receiver = Receiver()
    assert receiver.feed(b"\xff", 0) == []
    assert receiver.feed(ACK, SILENCE_NS - 1) == []
    assert receiver.feed(ACK, 2 * SILENCE_NS) == [Control.ACK]


def test_truncated_telegram_is_dropped_after_a_silence() -> None:
    receiver = Receiver()
    assert receiver.feed(b"\x02\x80\xd6\x02\xb0" + OK, 0) == []
    assert receiver.feed(b"", SILENCE_NS - 1) == []
    assert receiver.feed(b"", SILENCE_NS) == [MODE]
    assert receiver.counted(TelegramFault.TRUNCATED) == 1
    assert receiver.parser.bytes_held == 0


def test_bytes_of_the_old_baud_rate_are_dropped() -> None:
    receiver = Receiver()
    assert receiver.feed(OK[:4]) == []
    receiver.parser.set_baud(9600)
    assert receiver.feed(OK[4:] + OK) == [MODE]
    assert receiver.garbage() == len(OK)


def test_start_of_a_telegram_is_its_end_minus_the_transfer_time() -> None:
    """Bytes behind it put it earlier; a read before it does not bound it."""
    parser = Receiver().parser
    assert parser.feed(b"\x02\x80\x09\x00", 0) == []
    (telegram,) = parser.feed(OK + b"\xff\xff", 50 * MS)
    assert isinstance(telegram, Telegram)
    assert telegram.end_ns == 50 * MS - round(2 * CHAR_NS)
    assert telegram.start_ns == 50 * MS - round(11 * CHAR_NS)


def test_noise_that_goes_on_is_counted_again() -> None:
    receiver = Receiver()
    for _ in range(10):
        receiver.feed(b"\xff" * MAX_TELEGRAM)
    assert 5 <= receiver.counted(TelegramFault.GARBAGE) <= 10


# Noise that often resembles the start of a telegram.
noise = st.lists(
    st.one_of(
        st.binary(max_size=40),
        st.sampled_from([b"\x02", b"\x02\x80", b"\x02\x80\xd6\x02\xb0\x69\x01", b"\x06", b"\x15"]),
        st.integers(0, 0xFFFF).map(lambda n: b"\x02\x80" + n.to_bytes(2, "little")),
    ),
    max_size=60,
).map(b"".join)


def scan_frame(seed: int) -> bytes:
    values = np.random.default_rng(seed).integers(0, 0x10000, 361).astype(np.uint16)
    return make_telegram(RawScan(values, status=0).payload(), FROM_SENSOR)


@given(data=noise, cuts=st.lists(st.integers(0, 400), max_size=20))
def test_every_byte_of_noise_is_counted(data: bytes, cuts: list[int]) -> None:
    receiver = Receiver()
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    for start, end in itertools.pairwise(edges):
        receiver.feed(data[start:end])
        assert receiver.used + receiver.garbage() + receiver.parser.bytes_held == end
    receiver.wait()
    assert receiver.parser.bytes_held == 0
    assert receiver.used + receiver.garbage() == len(data)


@given(before=noise, seed=st.integers(0, 1000))
def test_every_scan_after_noise_is_received(before: bytes, seed: int) -> None:
    receiver = Receiver()
    scans = [scan_frame(seed + i) for i in range(3)]
    receiver.feed(before)
    for scan in scans:
        receiver.feed(scan)
    # A false start delays less than two scans and loses none.
    assert receiver.payloads[:1] == [scans[0][4:-2]]
    receiver.wait()
    assert receiver.payloads == [scan[4:-2] for scan in scans]


def assert_only_following_scans_are_received(damaged: bytes, seed: int) -> None:
    receiver, following = Receiver(), [scan_frame(seed + 1), scan_frame(seed + 2)]
    for scan in (damaged, *following):
        receiver.feed(scan)
    receiver.wait()
    assert receiver.payloads == [scan[4:-2] for scan in following]
    assert receiver.used + receiver.garbage() == len(b"".join((damaged, *following)))


@given(position=st.integers(0, 731), flip=st.integers(1, 255), seed=st.integers(0, 1000))
@example(position=0, flip=4, seed=0)  # STX becomes an ACK, which is no garbage
def test_scan_with_a_changed_byte_is_rejected(position: int, flip: int, seed: int) -> None:
    changed = bytearray(scan_frame(seed))
    changed[position] ^= flip
    assert_only_following_scans_are_received(bytes(changed), seed)


@given(position=st.integers(0, 731), lost=st.integers(1, 100), seed=st.integers(0, 1000))
def test_scan_with_lost_bytes_is_rejected(position: int, lost: int, seed: int) -> None:
    whole = scan_frame(seed)
    assert_only_following_scans_are_received(whole[:position] + whole[position + lost :], seed)
