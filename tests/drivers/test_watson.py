# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Watson units: lines and frames of the manuals byte by byte, framing, stamps, rejections, round trips."""

import math
from itertools import pairwise

import pytest
from fixtures.driver_defaults import LAYOUT
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.errors import InputError
from trackslip_common.tally import Tally
from trackslip_common.units import GRAVITY
from trackslip_drivers.protocols.watson import (
    Layout,
    Reading,
    Rejection,
    decode_frame,
    decode_line,
    encode_frame,
    encode_line,
    from_sample,
    to_sample,
)
from trackslip_drivers.protocols.watson_stream import FIELD, IMU, WatsonStream

SIX = ["XA", "YA", "ZA", "XR", "YR", "ZR"]
SIX_FORMATS = ["+0.00"] * 3 + ["+000.0"] * 3
AHRS_VALUES = {"BK": 2.5, "EL": -5.0, "HG": 273.4, "XA": 1.02, "YA": 0.15, "ZA": -1.57}
AHRS_VALUES |= {"XR": -0.4, "YR": 1.2, "ZR": 10.4, "VS": 1.4}
AHRS = Layout(
    [*AHRS_VALUES],
    ["+000.0", "+00.0", "000.0", "+0.00", "+0.00", "+0.00", "+00.0", "+00.0", "+00.0", "+000.0"],
    [180, 180, 360, 10, 10, 10, 200, 200, 200, 800],
)
AHRS_LINE = b"I +002.5 -05.0 273.4 +1.02 +0.15 -1.57 -00.4 +01.2 +10.4 +001.4 "
DMS = Layout(
    ["TM", "BK", "EL", "HG", *SIX[:3], "FA", "LA", "VA", *SIX[3:], "HR", "VS", "LT", "LN", "AL"],
    [
        *("000000.0", "+000.0", "+00.0", "000.0"),
        *["+0.00"] * 6,
        *["+00.0"] * 4,
        *("000.0", "+00.00000", "+000.00000", "00000"),
    ],
    [240000, 180, 180, 360, 10, 10, 10, 10, 10, 10, 200, 200, 200, 200, 400, 90, 180, 32768],
)
DMS_LINE = (
    b"I 000000.0 +001.0 +00.2 000.0 +0.00 -0.02 -0.99 -0.00 +0.00 -0.99 +00.0 -00.0 +00.0 -00.0 "
    b"****.* +**.***** +***.***** *****"
)
BAUD = 9600
CHAR_NS = 10 * 1_000_000_000 / BAUD


def stream(offset_ns=0):
    return WatsonStream(LAYOUT, BAUD, offset_ns, Tally())


def test_line_of_the_manual():
    reading = decode_line(AHRS_LINE, AHRS)
    assert isinstance(reading, Reading)
    assert reading.values == AHRS_VALUES
    assert not reading.over_range
    assert encode_line("I", AHRS_VALUES, AHRS) == AHRS_LINE.rstrip() + b"\r"


def test_real_line_with_invalid_fields():
    reading = decode_line(DMS_LINE, DMS)
    assert isinstance(reading, Reading)
    assert not {"VS", "LT", "LN", "AL"} & reading.values.keys()
    assert reading.values["ZA"] == -0.99
    sample = to_sample(reading, 4)
    assert not isinstance(sample, Rejection)
    assert sample.stamp_ns == 4
    assert sample.acceleration == pytest.approx((0.0, 0.02 * GRAVITY, 0.99 * GRAVITY))
    assert sample.magnetic_field is None


@pytest.mark.parametrize(
    ("frame", "full_scale", "values"),
    [
        ("85AA FE9C F080 8399 FB99 91CC 0D", 180.0, (15.0, -5.0, -45.0, 10.0, -15.0, 55.0)),
        ("8080 FE9A F9EE 8399 FB99 91CC 0D", 10.0, (0.0, -0.28, -0.96, 10.0, -15.0, 55.0)),
    ],
    ids=["manual", "level"],
)
def test_binary_frames(frame, full_scale, values):
    layout, sent = Layout(SIX, SIX_FORMATS, [full_scale] * 3 + [200.0] * 3), bytes.fromhex(frame)
    reading = decode_frame(sent[:-1], layout)
    assert isinstance(reading, Reading)
    assert reading.values == pytest.approx(dict(zip(SIX, values, strict=True)), abs=200.0 / 8192)
    assert encode_frame(reading.values, layout) == sent
    sample = to_sample(reading, 0)
    assert not isinstance(sample, Rejection)
    x, y, z = (GRAVITY * value for value in values[:3])
    assert sample.acceleration == pytest.approx((x, -y, -z), abs=0.025 * GRAVITY)
    assert sample.angular_velocity[2] == pytest.approx(math.radians(-55.0), abs=0.001)


def test_samples_and_values_are_inverse():
    line = b"R +0.012 -0.003 -1.001 +000.04 -000.11 +012.30 +0213 -0041 -0466"
    reading = decode_line(line, LAYOUT)
    assert isinstance(reading, Reading)
    sample = to_sample(reading, 0)
    assert not isinstance(sample, Rejection)
    assert sample.magnetic_field == pytest.approx((213e-7, 41e-7, 466e-7))
    assert from_sample(sample) == pytest.approx(reading.values)


def test_configured_line_fits_the_rate():
    assert LAYOUT.line_length == 65
    assert LAYOUT.line_length * CHAR_NS < 1e9 / 11.85


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"WATSON INDUSTRIES, INC.", Rejection.TEXT),
        (b"+0.012 -0.003 -1.001", Rejection.TEXT),
        (b"\x1c", Rejection.TEXT),
        (b"R +0.012 -0.003", Rejection.WRONG_COUNT),
        (b"R +0.012 -0.003 -1.001 +000.04 -000.11 +12.30 +0213 -0041 -0466", Rejection.MALFORMED),
        (b"R +0.012 -0.003 -1.001 +000.04 -000.11 +012.3 +0213 -0041 -0466", Rejection.MALFORMED),
        (b"R +0.012 -0.003 -1.001 +000.04 -000.11 +0x2.30 +0213 -0041 -0466", Rejection.MALFORMED),
        (b"R +0.012 -0.003 -1.001 +000.04 -000.11 +***.** +0213 -0041 -0466", Rejection.INVALID),
        (b"R \x80\x80", Rejection.GARBLED),
        (b"\x80\x80\x80", Rejection.WRONG_COUNT),
        pytest.param(b"x" * 5000, Rejection.OVERLONG, id="overlong"),
    ],
)
def test_rejections_are_counted_and_pass(line, reason):
    good = encode_line("R", {"ZA": -1.0}, LAYOUT)
    parser, data = stream(), good + line + b"\r" + good
    samples = parser.feed(data[:1000], 0)
    assert parser.bytes_held <= parser.limit
    assert len(samples + parser.feed(data[1000:], 0)) == 2
    assert parser.tally.total == {(IMU, reason.value): max(1, len(line) // parser.limit)}


@pytest.mark.parametrize(
    ("line", "text"),
    [(b"R +0.012 -0.003", "2 fields, 9 expected"), (b"\x80\x80\x80", "frame of 3 bytes, 18 expected")],
)
def test_the_number_of_fields_is_reported(line, text):
    parser = stream()
    parser.feed(line + b"\r", 10**9)
    (key,) = parser.tally.total
    assert parser.tally.detail_or_reason(key) == text


def test_invalid_magnetometer_drops_only_the_magnetic_field():
    parser = stream()
    (sample,) = parser.feed(b"R +0.012 -0.003 -1.001 +000.04 -000.11 +012.30 +0213 -*** -0466\r", 0)
    assert sample.magnetic_field is None
    assert parser.tally.total == {(FIELD, "marked invalid by the unit"): 1}


@pytest.mark.parametrize(
    ("label", "rate", "over_range"),
    [("R", 199.99, False), ("R", 1e9, True), ("R", -200.0, True), ("r", 0.0, True), ("i", 0.0, True)],
)
def test_over_range(label, rate, over_range):
    """Values beyond full scale are limited."""
    (sample,) = stream().feed(encode_line(label, {"ZR": rate}, LAYOUT), 0)
    assert sample.over_range is over_range
    (limited,) = stream().feed(encode_frame({"ZR": math.copysign(1e9, rate)}, LAYOUT), 0)
    assert limited.over_range
    assert limited.angular_velocity[2] == pytest.approx(math.copysign(math.radians(200.0), -rate), rel=2e-4)


def test_line_ends_of_every_kind():
    good = encode_line("R", {}, LAYOUT)
    parser = stream()
    assert len(parser.feed(b"\n" + good + b"\n" + good + b"\r\r" + good, 0)) == 3
    assert not parser.tally.total


def test_stamp_is_the_start_of_transmission():
    line = encode_line("R", {}, LAYOUT)
    arrival_ns, offset_ns = 50_000_000_000, -3_000_000
    later = b"R +0.0"  # the same read returned the beginning of the next line
    (sample,) = stream(offset_ns).feed(line + later, arrival_ns)
    expected = arrival_ns + offset_ns - (len(line) + len(later)) * CHAR_NS
    assert sample.stamp_ns == pytest.approx(expected, abs=2)


@pytest.mark.parametrize("rate", [5.9, 7.9, 10.0, 11.85, 14.2, 20.0])
def test_stamps_are_exact_at_any_rate_of_lines(rate):
    line, parser = encode_line("R", {}, LAYOUT), stream()
    sent_ns = [50_000_000_000 + round(k * 1e9 / rate) for k in range(50)]
    arrivals = [(line, begun_ns + round(len(line) * CHAR_NS)) for begun_ns in sent_ns]
    stamps = [sample.stamp_ns for arrival in arrivals for sample in parser.feed(*arrival)]
    assert stamps == pytest.approx(sent_ns, abs=2)


@pytest.mark.parametrize("before", [b"", b"\n", b"  "])
def test_stamp_is_exact_after_one_prompt_read(before):
    """The other reads are late; the previous line ends 15 ms before this one begins."""
    line, parser, began_ns = encode_line("R", {}, LAYOUT), stream(), 50_000_000_000
    parser.feed(before, began_ns - 15_000_000)
    late, begin = {10: 9_000_000, 40: 100_000, len(line) - 1: 30_000_000, len(line): 40_000_000}, 0
    for end, late_ns in late.items():
        samples = parser.feed(line[begin:end], began_ns + round(end * CHAR_NS) + late_ns)
        begin = end
    assert samples[0].stamp_ns == pytest.approx(began_ns + 100_000, abs=2)


def test_reset_forgets_half_a_line():
    parser = stream()
    line = encode_line("R", {}, LAYOUT)
    parser.feed(line[:20], 0)
    parser.reset()
    assert len(parser.feed(line, 0)) == 1
    assert not parser.tally.total


@pytest.mark.parametrize(
    ("names", "formats", "message"),
    [
        (SIX[:5], SIX_FORMATS[:5], "ZR missing"),
        ([*SIX, "QQ"], [*SIX_FORMATS, "+0"], "'QQ' is unknown"),
        ([*SIX, "XA"], [*SIX_FORMATS, "+0"], "one twice"),
        ([*SIX, "HG"], SIX_FORMATS, "7, 6, 7 items"),
        (SIX, ["+0.00"] * 5 + ["%5.1f"], "'%5.1f' is not a field of zeros"),
    ],
)
def test_bad_channel_lists(names, formats, message):
    with pytest.raises(InputError, match=message):
        Layout(names, formats, [1.0] * len(names))


VALUES = st.fixed_dictionaries(
    {channel.name: st.floats(-channel.full_scale, channel.full_scale) for channel in LAYOUT.channels}
)

LABEL = st.sampled_from("IRGTirgt")


def cut(data, places):
    edges = [0, *sorted(min(place, len(data)) for place in places), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


@given(LABEL, VALUES)
def test_lines_and_frames_survive_a_round_trip(label, values):
    line = decode_line(encode_line(label, values, LAYOUT)[:-1], LAYOUT)
    frame = decode_frame(encode_frame(values, LAYOUT)[:-1], LAYOUT)
    assert isinstance(line, Reading)
    assert isinstance(frame, Reading)
    for channel in LAYOUT.channels:
        value, step = values[channel.name], channel.full_scale / 8192
        assert line.values[channel.name] == pytest.approx(value, abs=0.5000001 * 10.0**-channel.decimals)
        assert frame.values[channel.name] == pytest.approx(value, abs=1.000001 * step)
    assert line.over_range >= label.islower()


READ_INTERVAL_NS = 100_000_000  # between reads of the port


@given(
    st.lists(st.tuples(st.booleans(), VALUES), max_size=8),
    st.lists(st.integers(0, 600), max_size=20),
)
def test_cutting_of_the_stream_changes_nothing(lines, places):
    data = b"".join(
        encode_frame(values, LAYOUT) if binary else encode_line("R", values, LAYOUT)
        for binary, values in lines
    )
    whole = stream().feed(data, 10**15)
    parser = stream()
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


@given(VALUES, st.integers(0, LAYOUT.line_length - 2), st.integers(1, 20))
def test_line_with_lost_characters_is_never_decoded(values, start, count):
    """Only a loss that keeps every field's width could be decoded, and such a loss also removes a space."""
    line = encode_line("R", values, LAYOUT)[:-1]
    damaged = line[:start] + line[start + count :]
    assert not isinstance(decode_line(damaged, LAYOUT), Reading)
