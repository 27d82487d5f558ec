# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Emulated Watson unit and excavator bus: rates, commands, and the data as the drivers parse them."""

import math

import pytest
from fixtures.driver_defaults import LAYOUT, WATSON
from fixtures.excavator_bus import FRAMES, PARAMETERS

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.excavator_can import ExcavatorCan
from trackslip_drivers.protocols.watson import BINARY, COMMAND_MODE, DECIMAL, REFERENCE, REINITIALISE
from trackslip_drivers.protocols.watson_stream import WatsonStream
from trackslip_drivers.records import HydraulicsSample, ImuSample, SprocketSample
from trackslip_sim.devices.can_device import ENCODERS, PRESSURES, SPOOLS, CanDevice
from trackslip_sim.devices.line import BaudLine
from trackslip_sim.devices.watson_device import BANNER, TICK_NS, WatsonDevice

MS = 1_000_000
S = 1_000_000_000
BAUD = WATSON.serial_baud


def motion(stamp_ns):
    t = stamp_ns / S
    return ImuSample(
        stamp_ns,
        (0.5 * math.sin(t), 0.2, 9.8),
        (0.0, 0.01, 1.3 * math.sin(3.0 * t)),
        (2e-5 * math.cos(t), 2e-5 * math.sin(t), -4e-5),
        False,
    )


def unit(reference=True, measure=motion):
    return WatsonDevice(LAYOUT, BaudLine(BAUD, 10), measure, reference, 0)


def run(device, parser, start_ns, stop_ns, step_ns=MS):
    samples = []
    for now_ns in range(start_ns, stop_ns, step_ns):
        samples += parser.feed(device.step(now_ns), now_ns)
    return samples


@pytest.fixture
def parser():
    return WatsonStream(LAYOUT, BAUD, 0, Tally())


def test_lines_at_the_units_rate_with_true_values_and_stamps(parser):
    device = unit()
    samples = run(device, parser, 0, 65 * S)
    assert len(samples) == pytest.approx(60 * 11.85, abs=1)
    assert device.lines_emitted - len(samples) in (0, 1)  # one may still be on the line
    assert dict(parser.tally.total) == {("imu/data_raw", "text, no data"): len(BANNER)}
    for k, sample in enumerate(samples):
        true_ns = 5 * S + 6 * TICK_NS * k
        assert 0 <= sample.stamp_ns - true_ns <= MS  # the polling step
        truth = motion(true_ns)
        assert sample.acceleration == pytest.approx(truth.acceleration, abs=0.0005 * 9.80665 + 1e-9)
        assert sample.angular_velocity == pytest.approx(
            truth.angular_velocity, abs=math.radians(0.005) + 1e-9
        )
        assert sample.magnetic_field == pytest.approx(truth.magnetic_field, abs=0.5e-7 + 1e-15)


def test_label_shows_mode_and_over_range():
    for reference, label in ((True, b"R"), (False, b"I")):
        assert b"\r" + label + b" " in unit(reference).step(6 * S)
    fast = ImuSample(0, (0.0, 0.0, 9.8), (0.0, 0.0, 4.0), None, False)  # 229 °/s
    assert b"\rr " in unit(measure=lambda stamp_ns: fast).step(6 * S)


def test_binary_frames_after_the_two_spaces(parser):
    device = unit()
    device.receive(COMMAND_MODE, 2 * S)
    device.receive(BINARY, 3 * S)
    samples = run(device, parser, 0, 15 * S)
    frame_ticks = 2  # 19 bytes take 19.8 ms
    assert len(samples) == pytest.approx(10 * S / (frame_ticks * TICK_NS), abs=2)
    assert samples[5].acceleration[2] == pytest.approx(9.8, abs=2 * 9.80665 / 8192)
    device.receive(DECIMAL, 15 * S)
    run(device, parser, 15 * S, 16 * S)
    assert b"\rR " in device.step(17 * S)


def test_commands_need_two_spaces_in_time():
    for data, at_ns in ((BINARY, 1 * S), (b" x ^", 2 * S), (COMMAND_MODE + BINARY, 6 * S)):
        device = unit(reference=False)
        device.receive(data, at_ns)
        device.receive(BINARY + REFERENCE, at_ns + 1)
        assert b"\rI " in device.step(8 * S)


def test_reinitialise_sends_the_banner_again(parser):
    device = unit()
    run(device, parser, 0, 10 * S)
    device.receive(REINITIALISE, 10 * S)
    samples = run(device, parser, 10 * S, 20 * S)
    assert parser.tally.total["imu/data_raw", "text, no data"] == 2 * len(BANNER)
    assert samples[-1].stamp_ns - samples[1].stamp_ns < 5 * S
    assert samples[1].stamp_ns >= 15 * S


def test_reference_command_and_the_accident():
    device = unit(reference=False)
    device.receive(COMMAND_MODE + REFERENCE, S)
    assert b"\rR " in device.step(6 * S)
    assert not device.north_offset_stored
    device.receive(b"RN", 6 * S)
    assert device.north_offset_stored


def sprockets(stamp_ns):
    t = stamp_ns / S
    left, right = 2.0 * t + math.sin(t), -3.0 * t
    return SprocketSample(stamp_ns, left, right, 2.0 + math.cos(t), -3.0)


def hydraulics(stamp_ns):
    t = stamp_ns / S
    return HydraulicsSample(stamp_ns, 1e6 * math.sin(t), 40e6, -0.25, 1.5, 1.2345678e7)


def test_bus_through_the_driver_in_simulated_time():
    device = CanDevice(FRAMES, sprockets, hydraulics, 0)
    driver = ExcavatorCan(PARAMETERS, FRAMES, Tally())
    encoders, pressures = [], []
    for now_ns in range(0, 20 * S, 10 * MS):
        for arbitration_id, data in device.step(now_ns):
            for sample in driver.receive(arbitration_id, data, now_ns):
                (encoders if isinstance(sample, SprocketSample) else pressures).append(sample)
    assert device.frames_emitted == {ENCODERS: 2000, SPOOLS: 2000, PRESSURES: 2000}
    assert len(encoders) == 1999
    assert len(pressures) == 2000
    assert not driver.tally.total
    per_count = 2.0 * math.pi / 12288
    right_start = encoders[0].right_position - sprockets(encoders[0].stamp_ns).right_position
    for sample in encoders[10:]:
        truth = sprockets(sample.stamp_ns)
        assert sample.left_position == pytest.approx(truth.left_position, abs=1.001 * per_count)
        assert sample.right_position - right_start == pytest.approx(truth.right_position, abs=2 * per_count)
        assert sample.left_velocity == pytest.approx(truth.left_velocity, abs=0.04)  # noise, and 20 ms lag
    for sample in pressures:
        truth = hydraulics(sample.stamp_ns)
        assert sample.left_pressure == pytest.approx(truth.left_pressure, abs=501.0)
        assert (sample.right_pressure, sample.right_spool) == (25e6, 1.0)  # saturated
        assert sample.left_spool == pytest.approx(-0.25)


def test_bus_catches_up_after_a_late_step():
    device = CanDevice(FRAMES, sprockets, hydraulics, 5 * MS)
    assert device.step(0) == []
    assert len(device.step(5 * MS)) == 3
    assert len(device.step(36 * MS)) == 9
    assert device.step(36 * MS) == []
