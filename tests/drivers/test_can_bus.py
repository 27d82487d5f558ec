# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The CAN bus class on python-can's virtual bus; error frames state the bus, and bus-off reopens it."""

import can
import pytest

from trackslip_drivers.protocols.can_errors import BusState, bus_state
from trackslip_drivers.protocols.can_frames import ERROR_FLAG, STANDARD_FLAG
from trackslip_drivers.transports.can_bus import CanBus


def test_kinds_of_frames_on_the_virtual_bus():
    port = CanBus("virtual", "kinds", {})
    with can.Bus("kinds", interface="virtual") as peer:
        peer.send(can.Message(arbitration_id=0x7F, data=b"a", is_extended_id=False))
        peer.send(can.Message(arbitration_id=0x7F, data=b"b", is_extended_id=True))
        peer.send(can.Message(arbitration_id=0x40, is_error_frame=True, is_extended_id=False))
        received = [frame for frame, _ in port.read()]
    port.close()
    assert received == [(0x7F | STANDARD_FLAG, b"a"), (0x7F, b"b"), (0x40 | ERROR_FLAG, b"")]


def test_each_frame_is_delivered_before_the_next_read():
    port = CanBus("virtual", "one by one", {})
    with can.Bus("one by one", interface="virtual") as peer:
        peer.send(can.Message(arbitration_id=1))
        frames = iter(port.read())
        (first, _) = next(frames)
        peer.send(can.Message(arbitration_id=2))
        assert [first, *(frame for frame, _ in frames)] == [(1, b""), (2, b"")]
    port.close()


def test_damaged_lines_of_an_adapter_are_error_frames_and_the_bus_stays_open(pty_port):
    bus = CanBus("slcan", str(pty_port.link), {"bitrate": 250000, "sleep_after_open": 0.0})
    damaged = b"T1234\rTZZZZZZZZ8\rtt\r"
    pty_port.write(b"T00000012155\r" + damaged + b"T00000012166\r")
    frames = []
    while len(frames) < 5:
        frames += [frame for frame, _ in bus.read()]
    bus.close()
    assert [frame for frame in frames if not frame[0] & ERROR_FLAG] == [(0x12, b"\x55"), (0x12, b"\x66")]


@pytest.mark.parametrize(
    ("arbitration_id", "data", "state"),
    [
        (0x040, bytes(8), BusState.OFF),
        (0x100, bytes(8), BusState.ACTIVE),
        (0x004, bytes((0, 0x08, 0, 0, 0, 0, 0, 0)), BusState.WARNING),
        (0x004, bytes((0, 0x30, 0, 0, 0, 0, 0, 0)), BusState.PASSIVE),
        (0x004, bytes((0, 0x40, 0, 0, 0, 0, 0, 0)), BusState.ACTIVE),
        (0x004, bytes((0, 0x01, 0, 0, 0, 0, 0, 0)), None),  # a receive buffer overflowed
        (0x004, b"", None),
        (0x080, bytes(8), None),
    ],
)
def test_state_of_the_bus(arbitration_id, data, state):
    assert bus_state(arbitration_id | ERROR_FLAG, data) is state


def test_bus_off_is_delivered_and_then_is_an_error():
    device, port = CanBus("virtual", "off", {}), CanBus("virtual", "off", {})
    try:
        device.write((0x0CFF1080, b"12345678"))
        device.write((0x100 | ERROR_FLAG, bytes(8)))
        assert [frame for frame, _ in port.read()] == [
            (0x0CFF1080, b"12345678"),
            (0x100 | ERROR_FLAG, bytes(8)),
        ]
        device.write((0x40 | ERROR_FLAG, bytes(8)))
        assert [frame for frame, _ in port.read()] == [(0x40 | ERROR_FLAG, bytes(8))]
        with pytest.raises(can.CanOperationError, match="bus off"):
            port.read()
    finally:
        device.close()
        port.close()
