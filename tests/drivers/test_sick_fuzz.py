# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Arbitrary bytes on the line: no exception, bounded memory, every byte counted, no wrong scan."""

import itertools

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.sick_scan import RawScan, parse_scan
from trackslip_drivers.protocols.sick_telegram import (
    FROM_SENSOR,
    MAX_TELEGRAM,
    SILENCE_NS,
    Telegram,
    TelegramFault,
    TelegramParser,
    make_telegram,
)

MS = 1_000_000

words = st.lists(st.integers(0, 0xFFFF), min_size=361, max_size=361)
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


class Receiver:
    """A parser with a simulated clock."""

    def __init__(self) -> None:
        self.tally = Tally()
        self.parser = TelegramParser(FROM_SENSOR, 38_400, 11, self.tally, "scan")
        self.now_ns = 0
        self.used = 0
        self.payloads: list[bytes] = []

    def feed(self, data: bytes) -> None:
        self.now_ns += MS
        for event in self.parser.feed(data, self.now_ns):
            if isinstance(event, Telegram):
                assert event.end_ns <= self.now_ns
                self.payloads.append(event.payload)
                self.used += len(make_telegram(event.payload, FROM_SENSOR))
            else:
                self.used += 1
        assert self.parser.bytes_held < MAX_TELEGRAM

    def wait(self) -> None:
        self.now_ns += SILENCE_NS
        self.feed(b"")

    def garbage(self) -> int:
        return self.tally.total["scan", TelegramFault.GARBAGE_BYTE.value]


@pytest.mark.slow
@given(values=words, status=st.integers(0, 255), unit=st.integers(0, 3), partial=st.integers(0, 3))
def test_raw_scans_survive_a_round_trip(values: list[int], status: int, unit: int, partial: int) -> None:
    scan = RawScan(np.array(values, dtype=np.uint16), status, unit, partial)
    parsed = parse_scan(scan.payload())
    assert isinstance(parsed, RawScan)
    np.testing.assert_array_equal(parsed.values, scan.values)
    assert (parsed.status, parsed.unit, parsed.partial) == (status, unit, partial)


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


def test_a_telegram_may_be_split_anywhere() -> None:
    whole = scan_frame(3)
    for cut in range(len(whole) + 1):
        receiver = Receiver()
        receiver.feed(whole[:cut])
        receiver.feed(whole[cut:])
        assert receiver.payloads == [whole[4:-2]]
        assert not receiver.tally.total


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
