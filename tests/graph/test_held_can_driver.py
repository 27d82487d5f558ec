# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Frames that wait for a stalled driver keep their arrival times, or are dropped."""

import itertools
import math
import time

import pytest
from fixtures.excavator_bus import CYCLE_NS, FRAMES
from fixtures.own_node import started
from fixtures.patience import wait_for
from fixtures.plugged_devices import MULTICAST

from trackslip_drivers.nodes.can_driver import CanDriverNode
from trackslip_drivers.records import HydraulicsSample, SprocketSample
from trackslip_drivers.stamping import StampEvent
from trackslip_drivers.transports.can_bus import CanBus
from trackslip_sim.devices.can_device import CanDevice

MS = 1_000_000
SPEED = 2.0  # rad/s
HELD_CYCLES, ALL_CYCLES = (100, 260), 400
FEW = 20  # samples until the cycle is known, also if the first frames are late


class HeldDriver(CanDriverNode):
    """The driver, not executed while ``held``; ``samples`` has what it would publish."""

    def __init__(self):
        self.samples, self.held = [], False
        super().__init__()

    def _on_data(self, data, host_ns):
        while self.held:
            time.sleep(0.001)
        super()._on_data(data, host_ns)

    def restamp(self, sample):
        sample = super().restamp(sample)
        if type(sample) is SprocketSample:
            self.samples.append(sample)
        return sample


@pytest.fixture
def driver(real_time, domain, can):
    with started(HeldDriver, domain, **can) as node:
        yield node


def drive(driver, udp_port):
    """Send the frames of a steady drive; system times of each cycle and of the end of its sending."""
    wait_for(lambda: driver._link is not None and driver._link.state().connected)
    bus, began_ns = CanBus("udp_multicast", MULTICAST, {"port": udp_port}), time.time_ns()

    def sprockets(stamp_ns):
        angle = (stamp_ns - began_ns) * 1e-9 * SPEED
        return SprocketSample(stamp_ns, angle, angle, SPEED, SPEED)

    def hydraulics(stamp_ns):
        return HydraulicsSample(stamp_ns, 0.0, 0.0, 0.0, 0.0, 0.0)

    device, cycles = CanDevice(FRAMES, sprockets, hydraulics, began_ns), []
    for number in range(ALL_CYCLES):
        due_ns = began_ns + number * CYCLE_NS
        time.sleep(max(due_ns - time.time_ns(), 0) * 1e-9)
        driver.held = HELD_CYCLES[0] <= number < HELD_CYCLES[1]
        for frame in device.step(due_ns):
            bus.write(frame)
        cycles.append((due_ns, time.time_ns()))
    bus.close()
    wait_for(lambda: driver.samples and driver.samples[-1].stamp_ns > cycles[-10][0])
    return cycles


def test_frames_read_after_a_host_stall_keep_their_times(driver, udp_port):
    """The socket holds less than a second of frames; lost frames are a gap without positions."""
    cycles = drive(driver, udp_port)
    samples = driver.samples
    held_ns, free_ns = (cycles[number][0] for number in HELD_CYCLES)
    assert sum(held_ns < sample.stamp_ns < free_ns for sample in samples) > 50
    assert [s for s in samples[FEW:] if s.left_velocity != pytest.approx(SPEED, abs=0.1)] == []
    zero, first = samples[0].left_position, (samples[0].stamp_ns - cycles[0][0]) // CYCLE_NS
    for sample in itertools.takewhile(lambda sample: not math.isnan(sample.left_position), samples):
        number = first + round((sample.left_position - zero) / SPEED * 1e9 / CYCLE_NS)
        assert cycles[number][0] - MS < sample.stamp_ns < cycles[number][1] + MS


def test_delayed_frames_without_a_time_are_not_stamped_as_new(driver, udp_port, monkeypatch):
    """An adapter without timestamps: the delay is unknown."""
    monkeypatch.setattr("trackslip_drivers.transports.can_bus._stamp_ns", lambda _: time.time_ns())
    cycles = drive(driver, udp_port)
    assert driver.tally.total["can", StampEvent.DELAYED.value] > 50
    held_ns, free_ns = (cycles[number][0] for number in HELD_CYCLES)
    stamps = [sample.stamp_ns for sample in driver.samples]
    assert any(stamp > free_ns + 500 * MS for stamp in stamps)
    assert not [stamp for stamp in stamps if held_ns + 20 * MS < stamp < free_ns]
    assert [s for s in driver.samples[FEW:] if s.left_velocity != pytest.approx(SPEED, abs=0.1)] == []
