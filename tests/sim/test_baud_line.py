# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A serial line delivers whole characters at its rate, in order, each once."""

from collections.abc import Callable

from hypothesis import given
from hypothesis import strategies as st

from trackslip_sim.devices.line import NEVER_NS, BaudLine

BITS, TICK_NS = 11, 2_000_000
RATES = st.sampled_from((9600, 38_400, 500_000))


@given(st.lists(st.tuples(st.integers(0, 10_000_000), RATES, st.binary(max_size=20)), max_size=8))
def test_each_character_arrives_once_with_its_last_bit(sent: list[tuple[int, int, bytes]]) -> None:
    """After the characters before it, at the rate of its sending; an idle line accumulates no capacity."""
    line, now_ns, free_ns = BaudLine(9600, BITS), 0, 0
    arrivals: list[tuple[int, int]] = []
    received = b""
    for silence_ns, baud, data in sent:
        now_ns += silence_ns
        line.baud = baud
        received += line.read(now_ns)
        assert received == bytes(byte for at_ns, byte in arrivals if at_ns <= now_ns)
        line.send(data, now_ns)
        begin_ns = max(now_ns, free_ns)
        for count, byte in enumerate(data, 1):
            free_ns = begin_ns - (-count * BITS * 10**9 // baud)
            arrivals.append((free_ns, byte))
        assert line.busy_until_ns == free_ns
    for at_ns, byte in arrivals[len(received) :]:
        assert line.read(at_ns - 1) == b""
        assert line.read(at_ns) == bytes((byte,))


@given(count=st.integers(1, 800), baud=st.sampled_from((9600, 38_400)), start_ns=st.integers(0, TICK_NS - 1))
def test_two_reads_bound_the_start_as_well_as_all_reads(count: int, baud: int, start_ns: int) -> None:
    def bounds(next_read_ns: Callable[[BaudLine, int], int]) -> tuple[list[int], int]:
        """Bounds of the start, ns, from each read, and the time of the last read."""
        line, now_ns, got = BaudLine(baud, 10), 0, 0
        line.send(bytes(count), start_ns)
        found = []
        while got < count:
            now_ns = next_read_ns(line, now_ns) if now_ns else TICK_NS
            got += len(line.read(now_ns))
            if got:
                found.append(now_ns - got * 10_000_000_000 // baud)
        assert line.next_read_ns(now_ns, TICK_NS) == NEVER_NS
        return found, now_ns

    few, end_ns = bounds(lambda line, now_ns: line.next_read_ns(now_ns, TICK_NS))
    every, last_ns = bounds(lambda _, now_ns: now_ns + TICK_NS)
    assert (min(few), end_ns) == (min(every), last_ns)
    assert len(few) <= 3
