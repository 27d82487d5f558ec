# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The emulator's CAN bus and serial ports, which connect the emulated devices to the drivers."""

from contextlib import ExitStack
from pathlib import Path

import can

from trackslip_common.errors import InputError
from trackslip_drivers.transports.can_bus import CanBus
from trackslip_drivers.transports.link import error_text
from trackslip_sim.devices.pty_port import PtyPort
from trackslip_sim.machine.excavator import EmulatedExcavator
from trackslip_sim.machine.faults import GNSS, SICK, UNPLUG, WATSON
from trackslip_sim.parameters import EmulatorParameters


class EmulatorPorts:
    """Bus and ports, opened at construction.

    Raises:
        InputError: the bus cannot be opened.
        OSError: a port cannot be opened.
    """

    def __init__(self, p: EmulatorParameters) -> None:
        with ExitStack() as opened:
            self._bus = _open_bus(p)
            opened.callback(self._bus.close)
            self._ports = {}
            for sensor in (WATSON, SICK, GNSS):
                self._ports[sensor] = PtyPort(Path(p.device_directory) / sensor)
                opened.callback(self._ports[sensor].close)
            self._opened = opened.pop_all()

    @property
    def bytes_lost(self) -> int:
        """Number of bytes lost on serial lines that no client reads."""
        return sum(port.bytes_lost for port in self._ports.values())

    def exchange(self, excavator: EmulatedExcavator, now_ns: int) -> None:
        """Transfer frames and bytes between devices and drivers, in both directions.

        Raises:
            OSError: bus or port failed.
        """
        for sensor, port in self._ports.items():
            plugged = excavator.faults.active_fault(sensor, UNPLUG, now_ns) is None
            if plugged and not port.plugged:
                port.plug()
            elif not plugged:
                port.close()
        try:
            for frame in excavator.step_can(now_ns):
                self._bus.write(frame)
        except can.CanError as error:
            raise OSError(f"CAN: {error}") from error
        watson, sick = self._ports[WATSON], self._ports[SICK]
        excavator.receive_watson(watson.read(), now_ns)
        watson.write(excavator.step_watson(now_ns))
        excavator.receive_sick(sick.read(), now_ns, sick.baud)
        sent = excavator.step_sick(now_ns)
        if sick.baud == excavator.sick.baud:
            sick.write(sent)
        self._ports[GNSS].write(excavator.step_gnss(now_ns))

    def close(self) -> None:
        """Close bus and ports; safe to call twice."""
        self._opened.close()


def _open_bus(p: EmulatorParameters) -> CanBus:
    try:
        return CanBus(p.can_interface, p.can_channel, {"port": p.can_port})
    except (can.CanError, OSError) as error:
        raise InputError(
            f"emulator: {p.can_interface} '{p.can_channel}', can_port {p.can_port}: {error_text(error)};"
            " accepted: a port that no other program has, a multicast address, a network that is up"
        ) from error
