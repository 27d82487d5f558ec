# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The emulated receiver with driver protocol and localizer; a hundred faults."""

import random
from dataclasses import replace

import numpy as np
import pytest
from fixtures.driver_defaults import NMEA

from trackslip_common.config_files import node_defaults
from trackslip_common.parameters import from_flat
from trackslip_common.tally import Tally
from trackslip_drivers.protocols.nmea import BITS_PER_CHAR
from trackslip_drivers.protocols.nmea_stream import NmeaStream
from trackslip_drivers.records import FixSample, VelocitySample
from trackslip_estimation.gnss.localizer import AntennaPosition, Fix, GnssLocalizer
from trackslip_estimation.gnss.parameters import GnssLocalizerParameters
from trackslip_sim.devices.line import BaudLine
from trackslip_sim.devices.nmea_device import NmeaDevice
from trackslip_sim.machine.faults import KINDS, Fault, Faults
from trackslip_sim.machine.faulty_line import FaultySerial
from trackslip_sim.machine.gnss_model import GnssModel
from trackslip_sim.machine.placement import Placement
from trackslip_sim.parameters import load_emulator_parameters

S = 1_000_000_000
MS = 1_000_000
GNSS = load_emulator_parameters({"gnss.device.rate": 10.0, "gnss.antenna_x": 0.5}).gnss
ORIGIN = {f"datum_{name}": getattr(GNSS, name) for name in ("latitude", "longitude", "altitude")}
MAP = from_flat(
    GnssLocalizerParameters, node_defaults("gnss_localizer", "gnss_localizer.yaml") | ORIGIN, "gnss_localizer"
)


def pose_at(stamp_ns):
    """Pose on a curve."""
    t = stamp_ns / S
    return Placement(x=0.4 * t, y=3.0 * np.sin(0.1 * t), yaw=0.05 * t)


class Chain:
    """Receiver, line, driver protocol and localizer."""

    def __init__(self, *faults, gnss=GNSS):
        self.faults = Faults(faults, 0)
        self.now_ns = 0
        line = BaudLine(NMEA.serial_baud, BITS_PER_CHAR)
        model = GnssModel(gnss, pose_at, self.faults, 1)
        self.device = NmeaDevice(gnss.device, line, model.measure, 0, 1)
        self.tally = Tally()
        self.stream = NmeaStream(NMEA, self.tally)
        self.localizer = GnssLocalizer(MAP)
        self.velocities = []
        self._bad_line = FaultySerial("gnss", self.faults, 1)
        self._is_off = False

    def run(self, seconds):
        """(stamp s, east error m, north error m, stddev m) of each fix, and the headings."""
        places, headings = [], []
        for _ in range(round(seconds * 500)):
            self.now_ns += 2 * MS
            for sample in self._receive():
                if isinstance(sample, FixSample):
                    places += self._locate(sample)
                elif isinstance(sample, VelocitySample):
                    self.velocities.append(sample)
                else:
                    headings.append(sample)
        return np.array(places).reshape(-1, 4), headings

    def _receive(self):
        if self.faults.active_fault("gnss", "power_cycle", self.now_ns):
            self._is_off = True
            return []
        if self._is_off:
            self._is_off = False
            self.device.power_cycle(self.now_ns)
        data = self._bad_line.transmit(self.device.step(self.now_ns), self.now_ns)
        if self.faults.active_fault("gnss", "unplug", self.now_ns):
            self.stream.reset()
            return []
        return self.stream.feed(data, self.now_ns) if data else []

    def _locate(self, s):
        place, covariance = (s.latitude, s.longitude, s.altitude), np.diag(s.variances[:2])
        errors = int(s.status), covariance, int(s.covariance_type), s.variances[2]
        position = self.localizer.locate(Fix(s.stamp_ns, *place, *errors))
        if not isinstance(position, AntennaPosition):
            return []
        x, y, yaw = pose_at(s.stamp_ns)[:3]
        east, north = position.east - x - 0.5 * np.cos(yaw), position.north - y - 0.5 * np.sin(yaw)
        return [(s.stamp_ns / S, east, north, position.covariance[0, 0] ** 0.5)]


@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0])
def test_fixes_come_at_their_rate_within_their_error_and_at_their_epochs(rate):
    chain = Chain(gnss=replace(GNSS, device=replace(GNSS.device, rate=rate)))
    places, headings = chain.run(20.0)
    assert len(places) == pytest.approx(20.0 * rate, abs=2)
    assert len(headings) == len(chain.velocities) == pytest.approx(20.0 * rate, abs=2)
    assert np.sqrt(np.mean(places[:, 1:3] ** 2)) == pytest.approx(0.01, rel=0.25)
    epochs = places[places[:, 0] > 1.0, 0]  # after the first reply without delay
    assert np.abs(epochs - np.round(epochs * rate) / rate).max() < 0.001
    errors = [h.yaw - pose_at(h.stamp_ns).yaw for h in headings]
    assert np.std(errors) == pytest.approx(0.0035, rel=0.2)
    assert np.mean(errors) == pytest.approx(0.0, abs=0.001)
    assert chain.device.fixes_emitted == pytest.approx(len(places), abs=1)
    assert not chain.tally.total


def test_receiver_goes_from_fixed_to_float_to_no_fix_and_back():
    chain = Chain(Fault("gnss", "rtk_float", 10.0, 30.0), Fault("gnss", "no_fix", 40.0, 5.0))
    places, headings = chain.run(55.0)
    stamps, errors = places[:, 0], np.hypot(places[:, 1], places[:, 2])
    floating = (stamps > 10.1) & (stamps < 39.9)
    assert set(np.round(places[floating, 3], 6)) == {0.3}
    assert 0.05 < np.sqrt(np.mean(errors[floating] ** 2)) < 1.0
    east = places[floating, 1]
    assert np.corrcoef(east[1:], east[:-1])[0, 1] > 0.9  # a slow drift
    assert not ((stamps > 40.1) & (stamps < 44.9)).any()
    assert errors[stamps > 45.0].max() < 0.06
    assert len([h for h in headings if 10.1 * S < h.stamp_ns < 39.9 * S]) > 290  # independent of corrections
    assert not [h for h in headings if 40.1 * S < h.stamp_ns < 44.9 * S]
    assert chain.tally.by_source()["fix"]["no fix"] == 50


def test_multipath_is_an_unreported_step():
    chain = Chain(Fault("gnss", "multipath", 5.0, 5.0, 2.0))
    places, _ = chain.run(12.0)
    inside = (places[:, 0] >= 5.0) & (places[:, 0] < 10.0)
    assert places[inside, 1].mean() == pytest.approx(2.0, abs=0.02)
    assert np.abs(places[~inside, 1]).max() < 0.05
    assert set(np.round(places[1:, 3], 6)) == {0.01}


def test_receiver_recovers_in_steps_after_a_power_cycle():
    chain = Chain(Fault("gnss", "power_cycle", 3.0, 1.0))
    places, _ = chain.run(25.0)
    after = places[places[:, 0] > 4.0]
    assert after[0, 0] == pytest.approx(9.0, abs=0.2)
    assert [after[after[:, 0] > t][0, 3] for t in (9.5, 13.0, 17.0)] == [1.5, 0.3, 0.01]
    assert chain.tally.by_source()["fix"]["no fix"] == pytest.approx(30, abs=1)


def test_one_antenna_has_no_heading():
    chain = Chain(gnss=replace(GNSS, heading_stddev=0.0))
    places, headings = chain.run(3.0)
    assert len(places) == pytest.approx(30, abs=1)
    assert headings == []


GNSS_KINDS = [*(name for name, kind in KINDS.items() if "gnss" in kind.sensors), "another datum"]
VALUES = {
    **dict.fromkeys(("lost_bytes", "doubled_bytes", "corrupted_bytes"), 0.02),
    "bursts": 0.7,
    "multipath": 1.5,
    "clock_step": 18.0,
}


@pytest.mark.slow
def test_a_hundred_faults_are_survived():
    """Fixes return after unplugging, garbage, a wrong baud rate, a reboot, leap seconds or another datum."""
    chooser, chain = random.Random(7), Chain()
    chain.run(2.0)
    for count in range(100):
        kind = GNSS_KINDS[count % len(GNSS_KINDS)]
        begin, duration = chain.now_ns / S, chooser.uniform(0.2, 2.0)
        if kind == "another datum":  # base station in another frame: a temporary offset of 1.7 m
            chain.faults.add(Fault("gnss", "multipath", begin, duration, 1.7), chain.now_ns)
        else:
            chain.faults.add(Fault("gnss", kind, begin, duration, VALUES.get(kind, 0.0)), chain.now_ns)
        chain.run(duration + (13.0 if kind == "power_cycle" else 1.5))
        places, headings = chain.run(1.0)
        assert len(places) >= 9, kind
        assert len(headings) >= 9, kind
        assert np.abs(places[:, 1:3]).max() < 0.06, kind
