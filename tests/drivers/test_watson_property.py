# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Watson units: round trips, any split of the stream, lost characters."""

from itertools import pairwise

import pytest
from fixtures.driver_defaults import LAYOUT
from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.watson import (
    Reading,
    decode_frame,
    decode_line,
    encode_frame,
    encode_line,
)
from trackslip_drivers.protocols.watson_stream import WatsonStream

VALUES = st.fixed_dictionaries(
    {channel.name: st.floats(-channel.full_scale, channel.full_scale) for channel in LAYOUT.channels}
)
LABEL = st.sampled_from("IRGTirgt")
seeded = settings(derandomize=True, max_examples=200, deadline=None)


def cut(data, places):
    edges = [0, *sorted(min(place, len(data)) for place in places), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


@seeded
@given(LABEL, VALUES)
def test_line_round_trip(label, values):
    reading = decode_line(encode_line(label, values, LAYOUT)[:-1], LAYOUT)
    assert isinstance(reading, Reading)
    for channel in LAYOUT.channels:
        error = abs(reading.values[channel.name] - values[channel.name])
        assert error <= 0.5000001 * 10.0**-channel.decimals
    assert reading.over_range >= label.islower()


@seeded
@given(VALUES)
def test_frame_round_trip(values):
    reading = decode_frame(encode_frame(values, LAYOUT)[:-1], LAYOUT)
    assert isinstance(reading, Reading)
    for channel in LAYOUT.channels:
        error = abs(reading.values[channel.name] - values[channel.name])
        assert error <= 1.000001 * channel.full_scale / 8192


READ_INTERVAL_NS = 100_000_000  # between reads of the port


@seeded
@given(
    st.lists(st.tuples(st.booleans(), VALUES), max_size=8),
    st.lists(st.integers(0, 600), max_size=20),
)
def test_cutting_of_the_stream_changes_nothing(lines, places):
    data = b"".join(
        encode_frame(values, LAYOUT) if binary else encode_line("R", values, LAYOUT)
        for binary, values in lines
    )
    whole = WatsonStream(LAYOUT, 9600, 0, Tally()).feed(data, 10**15)
    parser = WatsonStream(LAYOUT, 9600, 0, Tally())
    left, last_read_ns = len(data), 10**15 - len(data) * 10**10 // 9600
    pieces = []
    for piece in cut(data, places):
        left -= len(piece)
        arrival_ns = 10**15 - left * 10**10 // 9600
        for empty_ns in range(last_read_ns, arrival_ns, READ_INTERVAL_NS):
            parser.feed(b"", empty_ns)
        pieces, last_read_ns = pieces + parser.feed(piece, arrival_ns), arrival_ns
    assert len(pieces) == len(lines)
    for piece, sample in zip(pieces, whole, strict=True):
        assert piece.stamp_ns == pytest.approx(sample.stamp_ns, abs=3)
        assert (piece.acceleration, piece.magnetic_field) == (sample.acceleration, sample.magnetic_field)
    assert not parser.tally.total


@seeded
@given(VALUES, st.integers(0, LAYOUT.line_length - 2), st.integers(1, 20))
def test_line_with_lost_characters_is_never_decoded(values, start, count):
    """Only a loss that keeps every field's width could be decoded, and such a loss also removes a space."""
    line = encode_line("R", values, LAYOUT)[:-1]
    damaged = line[:start] + line[start + count :]
    assert not isinstance(decode_line(damaged, LAYOUT), Reading)
