# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A CAN bus by python-can: SocketCAN on the vehicle, UDP multicast in one host, virtual in one process."""

import logging
import os
import socket
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import can

from trackslip_common.units import NS_PER_S
from trackslip_drivers.protocols.can_errors import BusState, bus_state
from trackslip_drivers.protocols.can_frames import ERROR_FLAG, STANDARD_FLAG
from trackslip_drivers.transports.link import READ_TIMEOUT_S

CanFrame = tuple[int, bytes]  # (arbitration id, payload); flags in the id for all but 29-bit data frames

REMOTE_FLAG = 1 << 30

_SEND_TIMEOUT_S = 0.1
_CONNECT_TIMEOUT_S = 2.0
_CLASSIC_BYTES = 8
NO_LIBRARY = "without its library"  # text of the error of an interface that this computer lacks

for _name in ("can.bus", "can.interfaces"):  # else they warn of buses that did not open
    logging.getLogger(_name).setLevel(logging.ERROR)


class CanBus:
    """An open bus (a ``link.Port`` of frames).

    Args:
        interface: its name in python-can.
        channel: device, or multicast address.
        options: further settings, by their names in python-can.

    Raises:
        can.CanError, OSError, ImportError, TypeError, ValueError: the bus cannot be opened.
    """

    def __init__(self, interface: str, channel: str, options: Mapping[str, Any]) -> None:
        is_system = interface == "socketcan" and "bitrate" in options
        self.note = f"{channel}: ip link sets the bitrate, not python-can" if is_system else ""
        self._is_off = False
        self._is_text = interface == "slcan"
        if interface == "socketcand" and "host" in options:  # python-can tries for 10 s without a pause
            socket.create_connection((options["host"], options["port"]), _CONNECT_TIMEOUT_S).close()
        self._bus = _open(interface, channel, options)
        if interface == "udp_multicast":
            try:
                _bind_to_loopback(self._bus.fileno(), channel)
            except BaseException:
                self._bus.shutdown()
                raise

    def read(self) -> Iterable[tuple[CanFrame, int]]:
        """The available frames, after a wait for the first, each with its time of reception.

        Raises:
            can.CanError, OSError: the bus failed, or an error frame of the previous read reported bus off.
        """
        if self._is_off:
            raise can.CanOperationError("bus off")
        return self._frames()

    def write(self, data: CanFrame) -> None:
        """Send one frame: 29-bit, 11-bit with ``STANDARD_FLAG``, an error frame with ``ERROR_FLAG``.

        Raises:
            can.CanError: the bus did not accept the frame.
        """
        identifier, payload = data
        message = can.Message(
            arbitration_id=identifier & ~(ERROR_FLAG | STANDARD_FLAG),
            data=payload,
            is_extended_id=not identifier & STANDARD_FLAG,
            is_error_frame=bool(identifier & ERROR_FLAG),
            is_fd=len(payload) > _CLASSIC_BYTES,
        )
        self._bus.send(message, timeout=_SEND_TIMEOUT_S)

    def _frames(self) -> Iterator[tuple[CanFrame, int]]:
        """Yield each frame before the next is looked for."""
        message = self._receive(READ_TIMEOUT_S)
        while message is not None:
            frame = (flagged_id(message), bytes(message.data))
            if message.is_error_frame:
                self._is_off = bus_state(*frame) is BusState.OFF
            yield frame, _stamp_ns(message)
            message = self._receive(0.0)

    def _receive(self, timeout_s: float) -> can.Message | None:
        """One frame; a damaged line of an adapter becomes an error frame: to open again takes seconds."""
        try:
            return self._bus.recv(timeout_s)
        except (ValueError, IndexError):
            if not self._is_text:
                raise
            return can.Message(is_error_frame=True)

    def close(self) -> None:
        """Release the bus."""
        self._bus.shutdown()


def _open(interface: str, channel: str, options: Mapping[str, Any]) -> can.BusABC:
    """The bus of python-can; without the library of an interface each raises another kind of error."""
    try:
        return can.Bus(channel=channel, interface=interface, **options)
    except (ImportError, NotImplementedError, NameError, OSError) as error:
        if isinstance(error, OSError) and (type(error) is not OSError or error.errno is not None):
            raise  # of the system, or of a serial port
        raise can.CanInterfaceNotImplementedError(f"{interface} {NO_LIBRARY}: {error}") from None


def _bind_to_loopback(descriptor: int, group: str) -> None:
    """Bind the socket to the loopback device: no host of the network can send frames of the machine."""
    with socket.socket(fileno=os.dup(descriptor)) as shared:
        loopback = socket.inet_aton("127.0.0.1")
        shared.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo")
        shared.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
        shared.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + loopback)


def flagged_id(message: can.Message) -> int:
    """The id, with a flag for every kind of frame that is not an extended data frame."""
    if message.is_error_frame:
        return message.arbitration_id | ERROR_FLAG
    flags = REMOTE_FLAG if message.is_remote_frame else 0
    return message.arbitration_id | flags | (0 if message.is_extended_id else STANDARD_FLAG)


def _stamp_ns(message: can.Message) -> int:
    """The kernel's time stamp if there is one, as a busy host does not delay it; else the present time."""
    return round(message.timestamp * NS_PER_S) if message.timestamp > 0.0 else time.time_ns()
