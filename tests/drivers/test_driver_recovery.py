# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Drivers' protocols against emulated devices in simulated time: stamps, corrupted bytes, recovery."""

import numpy as np
import pytest
from fixtures.driver_defaults import LAYOUT
from fixtures.excavator_bus import FRAMES, PARAMETERS

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.excavator_can import ExcavatorCan
from trackslip_drivers.protocols.watson_stream import IMU, WatsonStream
from trackslip_drivers.records import HydraulicsSample, ImuSample, SprocketSample
from trackslip_drivers.stamping import StampEvent
from trackslip_sim.devices.can_device import CanDevice
from trackslip_sim.devices.line import BaudLine
from trackslip_sim.devices.watson_device import WatsonDevice
from trackslip_sim.machine.faulty_line import corrupt_bytes

MS, S = 1_000_000, 1_000_000_000


def sprockets(stamp_ns):
    t = stamp_ns * 1e-9
    return SprocketSample(stamp_ns, t, -0.5 * t, 1.0, -0.5)


def inertia(stamp_ns):
    t = stamp_ns * 1e-9
    return ImuSample(stamp_ns, (np.sin(t), 0.3, 9.8), (0.1, 0.2, np.cos(t)), (2e-5, 1e-5, -5e-5), False)


GATHER = 5.0  # ms from the first byte to the read of a serial port


def reads(seed, seconds, gather=0.0):
    """Times when a host's reads return, ns: 1 ms apart, with a stall of up to 40 ms about once a second."""
    random, now = np.random.default_rng(seed), 0
    while now < seconds * S:
        stall = random.uniform(5.0, 40.0) if random.random() < 1e-3 else 0.0
        now += round((gather + 0.2 + random.exponential(1.0) + stall) * MS)
        yield now


def p99(stamps, device):
    """99th percentile of the distance from each stamp to the nearest true stamp, ms."""
    true = np.sort(np.array(device.stamps))
    after = np.clip(np.searchsorted(true, stamps), 1, len(true) - 1)
    errors = np.minimum(np.abs(true[after] - stamps), np.abs(true[after - 1] - stamps))
    assert len(stamps) > 100
    return np.percentile(errors, 99) / MS


def test_stamps_of_frames():
    device = CanDevice(FRAMES, sprockets, lambda stamp_ns: HydraulicsSample(stamp_ns, *[0.0] * 5), 0)
    driver, stamps, arrivals = ExcavatorCan(PARAMETERS, FRAMES, Tally()), [], []
    for now in reads(1, 15):
        for name, data in device.step(now):
            for sample in driver.receive(name, data, now):
                if isinstance(sample, SprocketSample):
                    stamps.append(sample.stamp_ns)
                    arrivals.append(now)
    assert p99(np.array(stamps), device) < 1.0
    assert p99(np.array(arrivals), device) > 2.0  # unfiltered arrival times are worse


def test_stamps_of_the_inertial_unit():
    device = WatsonDevice(LAYOUT, BaudLine(9600, 10), inertia, True, 0)
    stream, stamps = WatsonStream(LAYOUT, 9600, 0, Tally()), []
    for now in reads(2, 40, GATHER):
        data = device.step(now)
        stamps += [sample.stamp_ns for sample in stream.feed(data, now)] if data else []
    assert p99(np.array(stamps), device) < 5.0


def test_stamps_after_a_host_stall_are_right_within_10_ms():
    device = WatsonDevice(LAYOUT, BaudLine(9600, 10), inertia, True, 0)
    stream, samples = WatsonStream(LAYOUT, 9600, 0, Tally()), []
    before, after = 20 * S, 25 * S
    prompt, late = range(0, before, 6 * MS), range(after, 2 * after, 6 * MS)
    for now in (*prompt, *late):
        samples += stream.feed(device.step(now), now)
    stamps, true = np.array([sample.stamp_ns for sample in samples]), np.array(device.stamps)
    assert stream.tally.total[IMU, StampEvent.DELAYED.value] == pytest.approx(5 * 11.85, abs=3)  # lines
    assert (stamps > after).sum() > 200
    assert np.abs(stamps[:, np.newaxis] - true).min(axis=1).max() < 10 * MS
    assert [sample.angular_velocity[2] for sample in samples] == pytest.approx(
        np.cos(stamps * 1e-9), abs=0.02
    )


def test_corrupt_lines_without_checksum_pass_in_under_3_percent():
    """Without a checksum a digit that becomes another digit is undetectable. See ``watson``."""
    random = np.random.default_rng(7)
    device = WatsonDevice(LAYOUT, BaudLine(9600, 10), inertia, True, 0)
    stream, clean = (WatsonStream(LAYOUT, 9600, 0, Tally()) for _ in range(2))
    right = wrong = now = 0
    while device.lines_emitted < 1000:
        now += 84 * MS
        data = device.step(now)
        true = [sample._replace(stamp_ns=0) for sample in clean.feed(data, now)]
        for sample in stream.feed(corrupt_bytes(data, 0.01, random), now):
            is_unchanged = sample._replace(stamp_ns=0) in true
            right, wrong = right + is_unchanged, wrong + (not is_unchanged)
    assert right / 1000 == pytest.approx(0.99**65, abs=0.04)
    assert wrong / 1000 < 0.03
    assert device.lines_emitted - right - wrong > 400
