# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""From a receiver's bytes to positions and headings: variances and stamps."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fixtures.driver_defaults import NMEA
from fixtures.heading_sentences import hdt
from hypothesis import given
from hypothesis import strategies as st
from pyrtcm import calc_crc24q
from pyubx2 import calc_checksum

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.nmea_sentences import Position, gga, gst, pashr, rmc, sentence
from trackslip_drivers.protocols.nmea_stream import NmeaStream
from trackslip_drivers.records import CovarianceType, FixSample, HeadingSample, VelocitySample

S = 1_000_000_000
MS = 1_000_000
DAY = 86_400 * S
P = replace(NMEA, serial_port="socket://receiver:5017", latency=0.02)


def at(time_ns, quality=4, stddev=0.01, heading=120.0):
    return Position(time_ns, -33.9, 151.2, 60.0, quality, 0.6, stddev, 0.02, heading, 0.2)


def stream(p=P, utc=None):
    return NmeaStream(p, Tally(), utc)


def received(parser, epochs, encoders, late=lambda k: 20 * MS, first=0):
    """Samples of a receiver whose clock shows ``epochs[k]`` at host time 5 s + k · 0.1 s."""
    samples = []
    for k, time_ns in enumerate(epochs, first):
        burst = b"".join(encode(at(time_ns)) for encode in encoders)
        samples += parser.feed(burst, 5 * S + k * S // 10 + late(k))
    return samples + parser.flush()


def errors_ms(samples):
    """Errors of the stamps against the true epochs, ms."""
    stamps = [s.stamp_ns for s in samples if isinstance(s, FixSample)]
    return [(stamp - 5 * S - k * S // 10) / MS for k, stamp in enumerate(stamps)]


EPOCHS = [3600 * S + k * S // 10 for k in range(50)]


@pytest.mark.parametrize("encoders", [(gga, gst), (gst, gga), (rmc, gga, gst), (gst, rmc, gga)])
def test_variances_are_those_of_the_gst_of_the_same_epoch(encoders):
    parser = stream()
    samples = received(parser, EPOCHS[:1], encoders)  # before the parser has found that a GST follows
    for k in range(1, 10):
        burst = b"".join(encode(at(EPOCHS[k], stddev=0.01 * k)) for encode in encoders)
        samples += parser.feed(burst, 5 * S + k * S // 10)
    assert [s.variances[0] for s in samples[1:]] == pytest.approx([(0.01 * k) ** 2 for k in range(1, 10)])
    assert {s.covariance_type for s in samples[1:]} == {CovarianceType.DIAGONAL_KNOWN}
    assert not parser.tally.total


def test_variances_are_by_hdop_where_there_is_no_gst():
    (sample,) = stream().feed(gga(at(0, quality=1)), S)
    variance = (0.6 * P.range_errors.single) ** 2 / 2
    assert sample.variances == pytest.approx((variance, variance, 4 * variance))
    assert sample.covariance_type is CovarianceType.APPROXIMATED
    (fixed,) = stream().feed(gga(at(0, quality=4)), S)
    assert fixed.variances[0] == pytest.approx((0.6 * P.range_errors.rtk_fixed) ** 2 / 2)
    without_hdop = gga(at(0)).replace(b",0.6,", b",,").partition(b"*")[0][1:].decode()
    (unknown,) = stream().feed(sentence(without_hdop), S)
    assert (unknown.covariance_type, unknown.variances) == (CovarianceType.UNKNOWN, (0.0, 0.0, 0.0))


def test_gst_of_another_quality_or_of_zeros_is_not_used():
    parser = stream()
    received(parser, EPOCHS[:5], (gga, gst))
    zeros = Position(EPOCHS[5], -33.9, 151.2, 60.0, 4, 0.6)
    samples = parser.feed(gga(at(EPOCHS[5], quality=5)), 6 * S) + parser.flush()
    samples += stream().feed(gga(zeros) + gst(zeros), 7 * S)
    assert {s.covariance_type for s in samples} == {CovarianceType.APPROXIMATED}
    assert not parser.tally.total


def test_gst_once_a_second_applies_to_all_fixes_of_that_second():
    parser, samples = stream(), []
    for k, time_ns in enumerate(EPOCHS):
        burst = gga(at(time_ns)) + (gst(at(time_ns)) if k % 10 == 0 else b"")
        samples += parser.feed(burst, 5 * S + k * S // 10)
    assert len(samples) >= len(EPOCHS) - 1
    assert {s.covariance_type for s in samples[2:]} == {CovarianceType.DIAGONAL_KNOWN}


def ths(position):
    return sentence(f"GNTHS,{position.heading:.2f},A")


def gpgga(position):
    return sentence(gga(position)[1:].partition(b"*")[0].decode().replace("GNGGA", "GPGGA"))


@pytest.mark.parametrize(
    ("encoders", "stddev"),
    [
        ((hdt, gga, ths), P.heading_stddev),
        ((gga, hdt, pashr), math.radians(0.2)),
        ((hdt, ths, pashr, gga), math.radians(0.2)),
        ((gpgga, gga), None),
        ((gga, gpgga, gst), None),
        ((gga, gga), None),
    ],
)
def test_heading_or_position_in_two_sentences_is_used_once(encoders, stddev):
    """A heading with the accuracy that one of them states."""
    parser = stream()
    samples = received(parser, EPOCHS, encoders)
    fixes, headings = ([s for s in samples if isinstance(s, kind)] for kind in (FixSample, HeadingSample))
    for measured in (fixes, headings) if headings else (fixes,):
        assert len(measured) == len(EPOCHS)
        assert np.diff([s.stamp_ns for s in measured[1:]]) == pytest.approx(S / 10, abs=MS)
    assert [s.stddev for s in headings[1:]] == pytest.approx([stddev] * len(headings[1:]))
    assert parser.duplicates > 0
    assert not parser.tally.total


@pytest.mark.parametrize("at", [1, 25])
def test_change_of_talker_loses_no_fix(at):
    parser = stream()
    fixes = received(parser, EPOCHS[:at], (gpgga,)) + received(parser, EPOCHS[at:], (gga,), first=at)
    assert len(fixes) == len(EPOCHS)
    assert parser.duplicates == 0


def test_another_heading_is_used_when_the_first_ceases():
    parser = stream()
    received(parser, EPOCHS, (gga, pashr, hdt))
    later = [EPOCHS[-1] + k * S // 10 for k in range(1, 100)]
    headings = [s for s in received(parser, later, (gga, hdt), first=50) if isinstance(s, HeadingSample)]
    assert 60 <= len(headings) < 80


def test_no_heading_is_used_while_the_receiver_has_no_fix():
    parser = stream()
    booting = [Position(EPOCHS[0], quality=0, heading=0.0, heading_stddev=0.2)] * 3
    for encode in (hdt, pashr):
        for position in booting:
            assert parser.feed(gga(position) + encode(position), 5 * S) + parser.flush() == []
    assert parser.tally.by_source()["heading"] == {"no fix": 6}


@pytest.mark.parametrize("size", [20, 600, 4500])
@pytest.mark.parametrize("form", ["ubx", "rtcm", "cut ubx", "random", "zeros", "dollars"])
def test_binary_bursts_lose_no_sentence(size, form):
    """The bursts have no line end between binary and sentences."""
    random, parser, samples = np.random.default_rng(size), stream(), []
    for k, time_ns in enumerate(EPOCHS[:10]):
        payload = random.integers(0, 256, size, np.uint8).tobytes()
        rtcm = b"\xd3" + min(size, 1023).to_bytes(2, "big") + payload[:1023]
        burst = {
            "ubx": ubx(b"\x02\x15", payload),
            "rtcm": rtcm + calc_crc24q(rtcm).to_bytes(3, "big"),
            "cut ubx": ubx(b"\x02\x15", payload)[: size // 2],
            "random": payload,
            "zeros": bytes(size),
            "dollars": b"\xaa$G" * (size // 3),
        }[form]
        samples += parser.feed(burst + gga(at(time_ns)), 5 * S + k * S // 2) + parser.flush()
    assert len([s for s in samples if isinstance(s, FixSample)]) == 10
    whole = form in ("rtcm", "zeros") or (form == "ubx" and size <= 4096)
    assert not (whole and parser.tally.total)


@pytest.mark.parametrize(
    "other",
    [
        b"#BESTPOSA,COM1,0,58.5,FINESTEERING,2200,1.0,02000020,cdba,16809;SOL_COMPUTED,NARROW_INT*0a1b2c3d\r\n",
        b"\r\n<OK\r\n[COM1]",
        b"$R: setNMEAOutput, Stream1, COM1\r\n",
        b"$command,gpgga 0.1,response: OK*00\r\n",
        b"$@\x12\x34\xa7\x0f\x10\x00\nab\n$ab\n\x00\n",
    ],
)
def test_text_and_binary_data_of_other_protocols_are_no_damaged_sentences(other):
    parser = stream()
    samples = [s for k, t in enumerate(EPOCHS) for s in parser.feed(other + gga(at(t)), S + k * S // 10)]
    assert len(samples) == len(EPOCHS)
    assert parser.bytes_between_sentences > 0
    assert not parser.tally.total


def test_silence_ends_an_incomplete_binary_message():
    """Its header states more bytes than follow."""
    parser = stream()
    assert parser.feed(b"\xb5\x62\x01\x07\x00\x0f", S) == []
    (sample,) = parser.feed(gga(at(EPOCHS[0])), 2 * S)
    assert isinstance(sample, FixSample)


def ubx(name, payload):
    body = name + len(payload).to_bytes(2, "little") + payload
    return b"\xb5\x62" + body + calc_checksum(body)


VTG = sentence("GNVTG,90.0,T,,M,1.944,N,3.600,K,R")


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_velocity_comes_once_an_epoch_at_the_stamp_of_its_fix(order):
    parser, samples = stream(), []
    for k, time_ns in enumerate(EPOCHS):
        both = rmc(at(time_ns)._replace(speed=1.0, course=90.0)), VTG
        samples += parser.feed(gga(at(time_ns)) + both[order[0]] + both[order[1]], 5 * S + k * S // 10)
    fixes, velocities = ([s for s in samples if isinstance(s, kind)] for kind in (FixSample, VelocitySample))
    assert [s.stamp_ns for s in velocities] == [s.stamp_ns for s in fixes]
    assert velocities[0][1:] == pytest.approx((1.0, 0.0, P.velocity_stddev), abs=1e-3)
    assert parser.duplicates == len(EPOCHS)


def test_stamp_is_the_epoch_whatever_the_delay():
    random = np.random.default_rng(1)
    delays = 20 * MS + random.exponential(15 * MS, 500).astype(int)
    delays[0] = 20 * MS
    epochs = [7 * S + k * S // 10 for k in range(500)]
    errors = errors_ms(received(stream(), epochs, (gga, gst), lambda k: int(delays[k])))
    assert len(errors) == 500
    assert max(map(abs, errors)) < 1.0


@pytest.mark.parametrize(("start", "step"), [(3600, -18), (3600, 1), (3600, 3600), (86398, 0)])
def test_leap_seconds_learned_late_and_the_end_of_a_day_move_no_stamp(start, step):
    epochs = [(start * S + k * S // 10 + (k >= 25) * step * S) % DAY for k in range(50)]
    assert max(map(abs, errors_ms(received(stream(), epochs, (gga, gst))))) < 0.1


def test_leap_second_at_one_fix_a_second():
    parser, samples = stream(), []
    for k in range(20):
        time_ns = (k if k < 10 else k - 1) * S
        samples += parser.feed(gga(at(time_ns)) + gst(at(time_ns)), (k + 5) * S + 20 * MS)
    samples += parser.flush()
    assert [s.stamp_ns for s in samples] == [(k + 5) * S for k in range(20)]


@pytest.mark.parametrize("rate", [1, 5, 10])
@pytest.mark.parametrize("encoders", [(gga, gst), (gga, rmc, pashr), (pashr,)])
def test_repeated_readings_of_one_time_are_no_measurements(rate, encoders):
    parser, burst = stream(), b"".join(encode(at(3600 * S)) for encode in encoders)
    for k in range(3 * rate):
        parser.feed(burst, 5 * S + k * S // rate)
    assert [s for k in range(rate) for s in parser.feed(burst, 8 * S + k * S // rate)] == []
    assert parser.tally.by_source()["receiver's clock"]["time of fixes does not advance"] >= rate
    assert len(received(parser, EPOCHS[1:], encoders, late=lambda _: 10 * S)) >= len(EPOCHS) - 2


def test_readings_of_a_receiver_that_cuts_its_times_to_whole_seconds_are_counted_as_rejected():
    parser = stream()
    fixes = received(parser, [time_ns // S * S for time_ns in EPOCHS], (gga, gst))
    counts = parser.tally.by_source()["fix"]
    assert counts == {"several readings of one time": len(EPOCHS) - len(fixes)}
    assert len(fixes) < len(EPOCHS) / 2


def test_fixes_without_a_time_are_stamped_at_arrival_and_empty_reads_move_no_stamp():
    parser = stream()
    parser.feed(b"", 0)
    assert errors_ms(received(parser, [None] * 5, (gga,))) == pytest.approx([0.0] * 5)


def test_backlog_keeps_its_times():
    """The line delays all bytes for up to 1.2 s; the stamps are the measurement times."""
    late = {k: (52 - k) * S // 10 for k in range(40, 52)}
    epochs = [7 * S + k * S // 10 for k in range(100)]
    errors = errors_ms(received(stream(), epochs, (gga, gst), lambda k: late.get(k, 20 * MS)))
    assert len(errors) == 100
    assert max(map(abs, errors)) < 1.0


def test_slower_line_is_accepted_after_a_while():
    epochs = [7 * S + k * S // 10 for k in range(500)]
    errors = errors_ms(received(stream(), epochs, (gga, gst), lambda k: (20 if k < 100 else 45) * MS))
    assert errors[99] == pytest.approx(0.0, abs=0.1)
    assert errors[-1] == pytest.approx(25.0, abs=5.0)


def test_host_on_utc_stamps_by_the_receiver_time():
    parser = stream(utc=lambda steady_ns: steady_ns - 5 * S + 3600 * S)
    samples = received(parser, EPOCHS, (gga, gst), lambda k: (20 + 30 * (k % 3)) * MS)
    assert errors_ms(samples) == pytest.approx([0.0] * 50, abs=1e-3)
    assert not parser.tally.total
    wrong = stream(utc=lambda steady_ns: steady_ns + 1000 * S)
    assert errors_ms(received(wrong, EPOCHS, (gga, gst))) == pytest.approx([0.0] * 50, abs=0.1)
    assert wrong.tally.by_source() == {"receiver's clock": {"not the host's UTC: latency assumed": 100}}


def test_transfer_over_a_slow_line_is_not_latency():
    parser, burst = stream(replace(P, serial_port="/dev/ttyS0", serial_baud=9600)), gga(at(S)) + gst(at(S))
    begun_ns = 7 * S
    samples = parser.feed(burst, begun_ns + len(burst) * 10 * S // 9600)
    assert samples[0].stamp_ns == pytest.approx(begun_ns - 20 * MS, abs=MS)


def test_rejections_are_counted_and_other_sentences_are_named():
    parser = stream()
    parser.feed(b"$GPGSV,3,1*4B\r\n" + gga(at(0, quality=6)) + b"noise\r\n" + b"x" * 2000 + b"\n" + VTG, S)
    parser.feed(gga(at(0))[:40] + gga(at(0)), S)
    assert parser.tally.by_source()["fix"] == {"dead reckoning": 1, "no line end": 2}
    assert (parser.unused_sentences, parser.bytes_between_sentences) == (1, len("noise\r"))
    assert parser.kinds == ["GGA", "GSV", "VTG"]


def test_kinds_of_sentences_are_forgotten_when_none_arrives_any_more():
    parser = stream()
    parser.feed(rmc(at(0)), S)
    assert parser.kinds == ["RMC"]
    for k in range(2, 20):  # the receiver has fallen back to another rate
        parser.feed(b"\x00\xf8\x80" * 300, k * S)
    assert (parser.kinds, parser.all_kinds) == ([], ["RMC"])


@given(st.integers(1, 40))
def test_cuts_between_reads_change_nothing(size):
    whole = b"".join(encode(at(t)) for t in EPOCHS[:3] for encode in (gga, gst, rmc, pashr))
    parser, other = stream(), stream()
    cut = [s for k in range(0, len(whole), size) for s in parser.feed(whole[k : k + size], S)]
    assert cut == other.feed(whole, S)
