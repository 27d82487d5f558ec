# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The begin of a message on a serial line, from the reads of its bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_drivers.protocols.timed_bytes import TimedBytes

MS = 1_000_000
READS = st.lists(
    st.tuples(st.integers(1, 40), st.integers(0, 50 * MS)), min_size=1, max_size=6
)  # size, lateness


@given(READS, st.sampled_from([9600, 38400, 0]))
def test_begin_of_a_byte_is_bounded_by_the_least_late_read_from_it_on(reads, baud):
    """A read before the byte does not bound it; one with bytes behind it does."""
    received, ends, sent = TimedBytes(11, baud), [], 0
    for size, late_ns in reads:
        sent += size
        ends.append((sent, late_ns))
        received.append(bytes(size), received.transfer_ns(sent) + late_ns)
        received.append(b"", received.transfer_ns(sent) + 60 * MS)  # an empty read shows nothing
    for index in range(sent):
        late_ns = min(late for end, late in ends if end > index)
        assert received.begun_ns() == pytest.approx(received.transfer_ns(index) + late_ns, abs=2)
        assert received.ended_ns(1) <= received.latest_ns - received.transfer_ns(sent - index - 1)
        received.discard(1)
    assert (len(received.data), received._reads) == (0, [])
