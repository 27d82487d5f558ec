# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Error frames of a CAN controller: the reported bus state; bus-off reopens the bus."""

import can
import pytest

from trackslip_drivers.protocols.can_errors import BusState, bus_state
from trackslip_drivers.protocols.can_frames import ERROR_FLAG
from trackslip_drivers.transports.can_bus import CanBus


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
