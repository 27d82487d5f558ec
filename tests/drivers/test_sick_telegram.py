# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""SICK telegrams: known byte vectors, the search for telegrams in garbage, and their times."""

from random import Random

import pytest

from trackslip_common.tally import Tally
from trackslip_drivers.protocols import sick_commands as commands
from trackslip_drivers.protocols.sick_crc import sick_crc
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
ACK, NAK = b"\x06", b"\x15"


class Receiver:
    """A parser with its tally, and a shorthand for the counts."""

    def __init__(self, address: int = FROM_SENSOR) -> None:
        self.tally = Tally()
        self.parser = TelegramParser(address, 38_400, 11, self.tally, "scan")

    def feed(self, data: bytes, arrival_ns: int = 0) -> list[bytes | Control]:
        events = self.parser.feed(data, arrival_ns)
        return [event.payload if isinstance(event, Telegram) else event for event in events]

    def counted(self, fault: TelegramFault) -> int:
        return self.tally.total["scan", fault.value]


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


def test_controls_are_received_between_telegrams() -> None:
    receiver = Receiver()
    assert receiver.feed(ACK + OK + NAK + OK + ACK) == [
        Control.ACK,
        b"\xa0\x00\x00",
        Control.NAK,
        b"\xa0\x00\x00",
        Control.ACK,
    ]
    assert not receiver.tally.total


def test_telegrams_of_the_other_direction_are_garbage() -> None:
    receiver = Receiver(TO_SENSOR)
    assert receiver.feed(OK) == []
    assert receiver.counted(TelegramFault.GARBAGE_BYTE) == len(OK)


def test_garbage_costs_no_telegram_and_hides_controls_within() -> None:
    receiver = Receiver()
    assert receiver.feed(b"\xff\x06\x02\x15" + OK + ACK) == [b"\xa0\x00\x00", Control.ACK]
    assert receiver.counted(TelegramFault.GARBAGE_BYTE) == 4


def test_a_silence_ends_garbage() -> None:
    receiver = Receiver()
    assert receiver.feed(b"\xff", 0) == []
    assert receiver.feed(ACK, SILENCE_NS - 1) == []
    assert receiver.feed(ACK, 2 * SILENCE_NS) == [Control.ACK]


@pytest.mark.parametrize("length", [0, MAX_PAYLOAD + 1])
def test_telegram_of_a_bad_length_is_counted_and_skipped(length: int) -> None:
    receiver = Receiver()
    assert receiver.feed(b"\x02\x80" + length.to_bytes(2, "little") + OK) == [b"\xa0\x00\x00"]
    assert receiver.counted(TelegramFault.BAD_LENGTH) == 1


def test_a_corrupt_telegram_is_counted_and_the_next_one_received() -> None:
    receiver = Receiver()
    corrupt = bytearray(OK)
    corrupt[5] ^= 0x10
    assert receiver.feed(bytes(corrupt) + OK) == [b"\xa0\x00\x00"]
    assert receiver.counted(TelegramFault.BAD_CRC) == 1
    assert receiver.counted(TelegramFault.GARBAGE_BYTE) == len(OK)


def test_truncated_telegram_is_dropped_after_a_silence() -> None:
    receiver = Receiver()
    assert receiver.feed(b"\x02\x80\xd6\x02\xb0" + OK, 0) == []
    assert receiver.feed(b"", SILENCE_NS - 1) == []
    assert receiver.feed(b"", SILENCE_NS) == [b"\xa0\x00\x00"]
    assert receiver.counted(TelegramFault.TRUNCATED) == 1
    assert receiver.parser.bytes_held == 0


def test_bytes_of_the_old_baud_rate_are_dropped() -> None:
    receiver = Receiver()
    assert receiver.feed(OK[:4]) == []
    receiver.parser.set_baud(9600)
    assert receiver.feed(OK) == [b"\xa0\x00\x00"]
    assert receiver.counted(TelegramFault.GARBAGE_BYTE) == 4


def only(events: list[Telegram | Control]) -> Telegram:
    (event,) = events
    assert isinstance(event, Telegram)
    return event


def test_start_of_a_telegram_is_its_end_minus_the_transfer_time() -> None:
    telegram = only(Receiver().parser.feed(OK, 50 * MS))
    assert telegram.end_ns == 50 * MS
    assert telegram.start_ns == 50 * MS - round(9 * CHAR_NS)


def test_bytes_behind_a_telegram_put_it_earlier() -> None:
    events = Receiver().parser.feed(OK + OK, 50 * MS)
    first, second = (event for event in events if isinstance(event, Telegram))
    assert second.end_ns == 50 * MS
    assert first.end_ns == pytest.approx(second.start_ns, abs=1)


def test_one_prompt_read_makes_up_for_late_ones() -> None:
    parser = Receiver().parser
    began_ns = 100 * MS
    assert parser.feed(OK[:5], began_ns + round(5 * CHAR_NS)) == []
    telegram = only(parser.feed(OK[5:], began_ns + 60 * MS))
    assert telegram.start_ns == pytest.approx(began_ns, abs=1)
    assert telegram.end_ns == pytest.approx(began_ns + 9 * CHAR_NS, abs=2)


def test_a_read_before_a_telegram_does_not_bound_its_time() -> None:
    parser = Receiver().parser
    assert parser.feed(b"\x02\x80\x09\x00", 0) == []
    telegram = only(parser.feed(OK + b"\xff\xff", 50 * MS))
    assert telegram.end_ns == 50 * MS - round(2 * CHAR_NS)
