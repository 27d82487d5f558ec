# SPDX-License-Identifier: Apache-2.0
"""A CAN bus behind python-can: SocketCAN on the vehicle, UDP multicast between processes, virtual in one."""

import time
from collections.abc import Iterable, Iterator
from typing import Any

import can

from trackslip_drivers.protocols.can_errors import BusState, bus_state
from trackslip_drivers.protocols.can_frames import ERROR_FLAG
from trackslip_drivers.transports.link import READ_TIMEOUT_S

CanFrame = tuple[int, bytes]  # (arbitration id, payload); ERROR_FLAG is set in the id of error frames

REMOTE_FLAG = 1 << 30
STANDARD_FLAG = 1 << 31  # an 11-bit id, which must not pass for a 29-bit one

_NS_PER_S = 1_000_000_000
_SEND_TIMEOUT_S = 0.1


class CanBus:
    """An open bus (a ``link.Port`` of frames).

    Args:
        interface: python-can's name of it.
        channel: device, or multicast address.
        port: UDP port, used by ``udp_multicast`` alone.

    Raises:
        can.CanError, OSError, ImportError: it cannot be opened.
    """

    def __init__(self, interface: str, channel: str, port: int) -> None:
        self.note = ""
        self._is_off = False
        options: dict[str, Any] = {"port": port} if interface == "udp_multicast" else {}
        self._bus = can.Bus(channel=channel, interface=interface, **options)

    def read(self) -> Iterable[tuple[CanFrame, int]]:
        """The frames that are there, once there is one, each with its time of reception.

        Raises:
            can.CanError, OSError: the bus failed, or an error frame of the read before reported it off.
        """
        if self._is_off:
            raise can.CanOperationError("bus off")
        return self._frames()

    def write(self, data: CanFrame) -> None:
        """Send one frame with a 29-bit id; an error frame where ``ERROR_FLAG`` is set.

        Raises:
            can.CanError: the bus did not accept it.
        """
        name, payload = data
        is_error = bool(name & ERROR_FLAG)
        message = can.Message(
            arbitration_id=name & ~ERROR_FLAG, data=payload, is_extended_id=True, is_error_frame=is_error
        )
        self._bus.send(message, timeout=_SEND_TIMEOUT_S)

    def _frames(self) -> Iterator[tuple[CanFrame, int]]:
        """One by one: a frame is returned before the next is looked for."""
        message = self._bus.recv(READ_TIMEOUT_S)
        while message is not None:
            frame = (_flagged_id(message), bytes(message.data))
            if message.is_error_frame:
                self._is_off = bus_state(*frame) is BusState.OFF
            yield frame, _stamp_ns(message)
            message = self._bus.recv(0.0)

    def close(self) -> None:
        """Release the bus."""
        self._bus.shutdown()


def _flagged_id(message: can.Message) -> int:
    """The id, with a flag for every kind of frame that is not an extended data frame."""
    if message.is_error_frame:
        return message.arbitration_id | ERROR_FLAG
    flags = REMOTE_FLAG if message.is_remote_frame else 0
    return message.arbitration_id | flags | (0 if message.is_extended_id else STANDARD_FLAG)


def _stamp_ns(message: can.Message) -> int:
    """The kernel's time stamp where there is one: it does not suffer from a busy host."""
    return round(message.timestamp * _NS_PER_S) if message.timestamp > 0.0 else time.time_ns()
