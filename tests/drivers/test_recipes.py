# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The receivers of docs/hardware.md on synthetic recordings: each epoch gives one fix and one heading."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fixtures.driver_defaults import NMEA
from fixtures.heading_sentences import hdt
from pyubx2 import GET, UBXMessage

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.nmea_sentences import Position, gga, gst, pashr, rmc, sentence
from trackslip_drivers.protocols.nmea_stream import NmeaStream
from trackslip_drivers.records import FixSample, HeadingSample

S = 1_000_000_000
EPOCHS, RATE = 30, 10
NOON, LEAP_MS = 43_200 * S, 18_000
COMPASS = 60.0  # °
YAW = math.radians(90.0 - COMPASS)


def at(k):
    return Position(NOON + k * S // RATE, 48.1, 11.6 + 1e-6 * k, 520.0, 4, 0.6, 0.01, 0.02, COMPASS, 0.2)


def time_of(k):
    return gga(at(k)).split(b",")[1].decode()


def f9p_pair(k):
    tow = (NOON + k * S // RATE) // 1_000_000 + LEAP_MS
    fields = {"fixType": 3, "gnssFixOk": 1, "carrSoln": 2, "lat": 48.1, "lon": 11.6 + 1e-6 * k, "hAcc": 10}
    flags = {"gnssFixOK": 1, "relPosValid": 1, "carrSoln": 2, "isMoving": 1, "relPosHeadingValid": 1}
    pair = {"relPosHeading": COMPASS, "accHeading": 0.2, **flags}
    messages = (
        UBXMessage("NAV", "NAV-PVT", GET, iTOW=tow, height=520_000, vAcc=20, **fields),
        UBXMessage("NAV", "NAV-RELPOSNED", GET, version=1, iTOW=tow, **pair),
        UBXMessage("RXM", "RXM-RTCM", GET, version=2),
    )
    return b"".join(message.serialize() for message in messages) + gga(at(k))


def septentrio(k):
    sbf = b"$@" + bytes(range(1, 120)) * 3
    hrp = sentence(f"PSSN,HRP,{time_of(k)},251126,{COMPASS:.3f},,-0.3,0.200,,0.4,21,2,,")
    return sbf + gga(at(k)) + gst(at(k)) + hrp


def trimble(k):
    yaw = sentence(f"PTNL,AVR,{time_of(k)},+{COMPASS:.4f},Yaw,+0.01,Tilt,,,1.20,3,2.5,6")
    return gga(at(k)) + gst(at(k)) + yaw


def hemisphere(k):
    return gga(at(k)) + gst(at(k)) + sentence(f"PSAT,HPR,{time_of(k)},{COMPASS:.2f},0.4,-1.2,N")


def unicore(k):
    fields = f"48.1,11.6,520.0,{COMPASS:.2f},-0.1,0,0,,3,3,30,28,0,0,0,0,0,0,,"
    return gga(at(k)) + gst(at(k)) + sentence(f"KSXT,20261125{time_of(k)},{fields}")


def inertial(k):
    return rmc(at(k)) + gga(at(k)) + gst(at(k)) + hdt(at(k)) + pashr(at(k))


def played(recipe, **parameters):
    stream, samples = NmeaStream(replace(NMEA, serial_port="socket://device:1", **parameters), Tally()), []
    for k in range(EPOCHS):
        samples += stream.feed(recipe(k), 5 * S + k * S // RATE)
    samples += stream.flush()
    assert not stream.tally.total
    return tuple([s for s in samples if isinstance(s, kind)] for kind in (FixSample, HeadingSample))


@pytest.mark.parametrize("recipe", [f9p_pair, septentrio, trimble, hemisphere, unicore, inertial])
def test_receivers_with_two_antennas(recipe):
    fixes, headings = played(recipe)
    assert len(fixes) == len(headings) == EPOCHS
    assert np.diff([fix.stamp_ns for fix in fixes]) == pytest.approx(S / RATE, abs=1_000_000)
    assert [one.stamp_ns for one in headings[1:]] == [fix.stamp_ns for fix in fixes[1:]]
    assert [one.yaw for one in headings] == pytest.approx([YAW] * EPOCHS, abs=1e-6)
    assert [fix.variances[0] for fix in fixes[2:]] == pytest.approx([1e-4] * (EPOCHS - 2))


def test_total_station_variance_is_from_its_range_error():
    range_errors = replace(NMEA.range_errors, rtk_fixed=0.005)
    fixes, _ = played(lambda k: gga(at(k)), range_errors=range_errors, latency=0.2)
    assert len(fixes) == EPOCHS
    assert fixes[-1].variances[0] == pytest.approx((0.6 * 0.005) ** 2 / 2.0)
