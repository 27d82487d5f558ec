# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""UBX messages alone and together with NMEA sentences: positions, accuracies, headings."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from fixtures.driver_defaults import NMEA
from hypothesis import given
from hypothesis import strategies as st
from pyubx2 import GET, UBXMessage

from trackslip_common.tally import Tally
from trackslip_drivers.protocols import ubx
from trackslip_drivers.protocols.nmea import Rejection
from trackslip_drivers.protocols.nmea_sentences import Position, gga
from trackslip_drivers.protocols.nmea_stream import NmeaStream
from trackslip_drivers.records import CovarianceType, FixSample, FixStatus, HeadingSample, VelocitySample

S = 1_000_000_000
P = replace(NMEA, serial_port="socket://receiver:5017")
TOW = 216_018_000  # ms of the GPS week: 12:00:00 UTC on a Tuesday, with 18 leap seconds
NOON = 43_200 * S


def pvt(tow=TOW, **more):
    defaults = {"fixType": 3, "gnssFixOk": 1, "carrSoln": 2, "lat": 48.1, "lon": 11.6, "height": 520_000}
    fields = defaults | {"hAcc": 14, "vAcc": 20, "validTime": 1} | more
    return UBXMessage("NAV", "NAV-PVT", GET, iTOW=tow, **fields).serialize()


def fine(tow=TOW, **more):
    fields = {"lat": 48.1000001, "lon": 11.6, "height": 520_000, "hAcc": 10.0, "vAcc": 15.0} | more
    return UBXMessage("NAV", "NAV-HPPOSLLH", GET, iTOW=tow, **fields).serialize()


def covariance(tow=TOW, **more):
    fields = {"posCovValid": 1, "posCovNN": 1e-4, "posCovEE": 4e-4, "posCovDD": 9e-4} | more
    return UBXMessage("NAV", "NAV-COV", GET, iTOW=tow, **fields).serialize()


def relative(tow=TOW, **more):
    flags = {"gnssFixOK": 1, "relPosValid": 1, "carrSoln": 2, "isMoving": 1, "relPosHeadingValid": 1}
    fields = flags | {"relPosLength": 100, "relPosHeading": 30.0, "accHeading": 0.2} | more
    return UBXMessage("NAV", "NAV-RELPOSNED", GET, version=1, iTOW=tow, **fields).serialize()


def test_position_and_its_accuracy():
    reading = ubx.decode(pvt())
    assert isinstance(reading, ubx.Pvt)
    assert reading[:5] == pytest.approx((NOON, 48.1, 11.6, 520.0, 4))
    assert reading.stddevs == pytest.approx((0.014, 0.014, 0.02))


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (pvt(gnssFixOk=0), Rejection.NO_FIX),
        (pvt(fixType=0), Rejection.NO_FIX),
        (pvt(fixType=5), Rejection.NO_FIX),
        (pvt(fixType=1), Rejection.DEAD_RECKONING),
        (pvt(invalidLlh=1), Rejection.NO_FIX),
        (pvt(lat=91.0), Rejection.OUT_OF_RANGE),
        (fine(invalidLlh=1), Rejection.NO_FIX),
        (covariance(posCovValid=0), Rejection.NO_FIX),
        (covariance(posCovNN=0.0), Rejection.OUT_OF_RANGE),
        (covariance(posCovNN=math.nan), Rejection.OUT_OF_RANGE),
        (relative(gnssFixOK=0), Rejection.NO_FIX),
        (relative(relPosHeadingValid=0), Rejection.NO_HEADING),
        (relative(isMoving=0), Rejection.NO_PAIR),
        (relative(carrSoln=1), Rejection.NOT_FIXED),
        (UBXMessage("NAV", "NAV-DOP", GET, iTOW=TOW).serialize(), None),
    ],
)
def test_message_is_refused_for_what_it_states(message, expected):
    assert ubx.decode(message) is expected


@pytest.mark.parametrize(
    ("flags", "status", "quality"),
    [
        ({"carrSoln": 2}, FixStatus.RTK, 4),
        ({"carrSoln": 1}, FixStatus.RTK, 5),
        ({"carrSoln": 0, "diffSoln": 1}, FixStatus.DIFFERENTIAL, 2),
        ({"carrSoln": 0}, FixStatus.SINGLE, 1),
    ],
)
def test_solution_decides_the_status(flags, status, quality):
    assert ubx.decode(pvt(**flags)).quality == quality
    _, sample = NmeaStream(P, Tally()).feed(pvt(**flags), S)
    assert sample.status is status


def test_velocity_has_the_epoch_of_the_fix_and_an_impossible_one_is_refused():
    stream = NmeaStream(P, Tally())
    velocity, fix = stream.feed(pvt(velE=1500, velN=-200, sAcc=40), S)
    assert velocity == VelocitySample(fix.stamp_ns, *map(pytest.approx, (1.5, -0.2, 0.04)))
    (fix,) = stream.feed(pvt(TOW + 1000, velE=150_000, sAcc=40), 2 * S)
    assert isinstance(fix, FixSample)
    assert stream.tally.by_source()["fix_velocity"] == {"out of range": 1}


def epochs(*encoders, count=20):
    """Samples from ``count`` epochs of these messages at 10 Hz."""
    stream, samples = NmeaStream(P, Tally()), []
    for k in range(count):
        burst = b"".join(encode(TOW + 100 * k) for encode in encoders)
        samples += stream.feed(burst, 5 * S + k * S // 10)
    samples += stream.flush()
    assert not stream.tally.total
    return tuple([s for s in samples if isinstance(s, kind)] for kind in (FixSample, HeadingSample))


def of_gga(tow):
    return gga(Position(NOON + (tow - TOW) * 1_000_000, 48.1, 11.6, 520.0, 4))


@pytest.mark.parametrize("encoders", [(pvt,), (pvt, of_gga), (of_gga, pvt), (of_gga, pvt, fine), (pvt, fine)])
def test_one_fix_an_epoch(encoders):
    fixes, _ = epochs(*encoders)
    assert len(fixes) == 20
    steps = [b.stamp_ns - a.stamp_ns for a, b in itertools.pairwise(fixes)]
    assert steps == [S // 10] * 19
    assert {fix.covariance_type for fix in fixes[1:]} == {CovarianceType.DIAGONAL_KNOWN}


@pytest.mark.parametrize("encoders", [(pvt, fine, covariance), (pvt, covariance, fine)])
def test_the_finest_position_and_the_covariance_are_used(encoders):
    fixes, _ = epochs(*encoders)
    assert [fix.latitude for fix in fixes[2:]] == pytest.approx([48.1000001] * 18, abs=1e-10)
    np.testing.assert_allclose([fix.variances for fix in fixes[2:]], [(4e-4, 1e-4, 9e-4)] * 18, rtol=1e-6)


def test_repeated_position_of_one_time_is_no_measurement():
    parser = NmeaStream(P, Tally())
    for k in range(30):
        parser.feed(pvt() + fine(), S + k * S // 10)
    assert parser.feed(pvt() + fine(), 4 * S + S // 10) + parser.flush() == []
    assert len(parser.feed(pvt(tow=TOW + 100) + fine(tow=TOW + 100), 4 * S + S // 5)) == 2


@pytest.mark.parametrize("damage", ["changed", "cut", "long"])
def test_damaged_messages_are_counted(damage):
    parser, samples = NmeaStream(P, Tally()), []
    for k in range(20):
        whole = pvt(tow=TOW + 100 * k)
        changed = {
            "changed": whole[:20] + b"\x99" + whole[21:],
            "cut": whole[:60],
            "long": whole[:4] + b"\xff\xff",
        }
        samples += parser.feed(changed[damage] if k % 5 == 2 else whole, S + k * S // 10)
    samples += parser.flush()
    assert len([sample for sample in samples if isinstance(sample, FixSample)]) == 16
    assert parser.tally.by_source() == {"fix": {"wrong checksum": 4}}


def test_an_accuracy_of_zero_is_unknown():
    velocity, fix = NmeaStream(P, Tally()).feed(pvt(hAcc=0, vAcc=0, sAcc=0), S)
    assert velocity.stddev == P.velocity_stddev
    assert (fix.covariance_type, fix.variances) == (CovarianceType.UNKNOWN, (0.0, 0.0, 0.0))


@given(st.sampled_from([0x07, 0x14, 0x36, 0x3C]), st.binary(max_size=120))
def test_any_payload_raises_no_exception(name, payload):
    ubx.decode(b"\xb5\x62\x01" + bytes((name,)) + len(payload).to_bytes(2, "little") + payload + b"\0\0")
