# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A serial line delivers whole characters at its rate, in order, each once."""

import random

from trackslip_sim.devices.line import BaudLine

CHAR_NS = 1_000_000  # at 11 kBd and 11 bits a character


def line() -> BaudLine:
    return BaudLine(11_000, 11)


def test_character_arrives_with_its_last_bit() -> None:
    wire = line()
    wire.send(b"ab", 5_000_000)
    assert wire.read(5_000_000 + CHAR_NS - 1) == b""
    assert wire.read(5_000_000 + CHAR_NS) == b"a"
    assert wire.read(5_000_000 + CHAR_NS) == b""
    assert wire.busy_until_ns == 5_000_000 + 2 * CHAR_NS
    assert wire.read(wire.busy_until_ns) == b"b"


def test_bytes_wait_for_those_before_them() -> None:
    wire = line()
    wire.send(b"abc", 0)
    wire.send(b"d", CHAR_NS)
    assert wire.read(3 * CHAR_NS) == b"abc"
    assert wire.read(4 * CHAR_NS) == b"d"


def test_idle_line_does_not_accumulate_capacity() -> None:
    wire = line()
    wire.send(b"a", 0)
    wire.send(b"b", 10 * CHAR_NS)
    assert wire.read(10 * CHAR_NS) == b"a"
    assert wire.read(11 * CHAR_NS) == b"b"


def test_new_rate_applies_to_bytes_sent_after_it() -> None:
    wire = line()
    wire.send(b"a", 0)
    wire.baud = 22_000
    wire.send(b"bc", 0)
    assert wire.read(CHAR_NS) == b"a"
    assert wire.read(CHAR_NS + CHAR_NS // 2) == b"b"
    assert wire.busy_until_ns == 2 * CHAR_NS


def test_empty_send_keeps_the_line_free() -> None:
    wire = line()
    wire.send(b"", 7)
    assert wire.busy_until_ns == 0
    assert wire.read(7) == b""


def test_odd_rates_lose_and_repeat_nothing() -> None:
    rng = random.Random(1)
    wire = BaudLine(38_400, 11)
    sent, received, now_ns = bytearray(), bytearray(), 0
    for _ in range(500):
        data = rng.randbytes(rng.randrange(20))
        wire.send(data, now_ns)
        sent += data
        now_ns += rng.randrange(10_000_000)
        received += wire.read(now_ns)
    received += wire.read(wire.busy_until_ns)
    assert received == sent
