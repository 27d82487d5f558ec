# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``can_driver``: publishes sprockets, hydraulics and swing from the CAN bus, by the roles file."""

import errno
import os
import sys
from collections.abc import Iterable
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from trackslip_common.nodes.health import OK, WARN, Health
from trackslip_common.nodes.messages import make
from trackslip_common.nodes.outputs import PackedOutput
from trackslip_common.nodes.run import run
from trackslip_drivers import conversions
from trackslip_drivers.can_parameters import DEFAULT_FILES, NODE, CanDriverParameters
from trackslip_drivers.frequent_reason import STAMP_EVENTS
from trackslip_drivers.nodes.driver import DriverNode
from trackslip_drivers.protocols.can_errors import BusState, bus_state
from trackslip_drivers.protocols.can_frames import BUS, ERROR_FLAG, Rejection, load_frames
from trackslip_drivers.protocols.can_timing import TimingEvent
from trackslip_drivers.protocols.canopen import START_ALL, start_command
from trackslip_drivers.protocols.encoder import EncoderEvent
from trackslip_drivers.protocols.excavator_can import ExcavatorCan, PairingRejection
from trackslip_drivers.records import HydraulicsSample, SprocketSample, SwingSample
from trackslip_drivers.stamping import StampEvent
from trackslip_drivers.transports.can_bus import NO_LIBRARY, CanBus, CanFrame

_BODY_FRAME = "base_link"
_SET_UP = "ip link set {} up type can bitrate 250000 restart-ms 100"  # as in deploy/systemd
_FRAME_PATIENCE_NS = 1_000_000_000  # in which each frame should have come
_MESSAGES = {
    SprocketSample: ("sprockets", conversions.blank_joint_state, conversions.fill_joint_state),
    HydraulicsSample: ("hydraulics", conversions.blank_track_hydraulics, conversions.fill_track_hydraulics),
    SwingSample: ("swing", conversions.blank_swing, conversions.fill_swing),
}


class CanDriverNode(DriverNode[CanDriverParameters, CanFrame]):
    """Receives frames; publishes those of ``sprockets``, ``hydraulics`` and ``swing`` that have roles."""

    data_name, advice = "frames", "check power, wiring and bitrate"
    format_advice = "check dbc_file and roles_file"
    remedies = MappingProxyType(
        {
            Rejection.ERROR_FRAME.value: "check wiring, terminators and bitrate",
            TimingEvent.ALIVE_REPEATED.value: "check its sender, and for another sender of the same id",
            TimingEvent.LOST.value: "check the wiring, the load of the bus, and that of this computer",
            TimingEvent.BURST.value: "check its sender, and for another sender of the same id",
            PairingRejection.TOO_OLD.value: "check the sender of the other frame, and pairing_timeout",
            EncoderEvent.JUMP.value: "check the encoder, and for another sender of the same id",
        }
    )
    events = STAMP_EVENTS | {
        one.value for one in (TimingEvent.LOST, EncoderEvent.RESTARTED, EncoderEvent.DISTANCE_UNKNOWN)
    }
    period = 0.01
    silence = 2.0
    realtime_priority = 10  # a message takes 0.5 ms, and odometry starts with it

    def __init__(self) -> None:
        super().__init__(NODE, CanDriverParameters, *DEFAULT_FILES)

    def configure(self) -> None:
        """Read the DBC and the roles file, and create the publishers.

        Raises:
            InputError: a file is missing or invalid, the files do not match, or a bus option is invalid.
        """
        super().configure()
        self._options = self.settings.bus_options()
        self._can = ExcavatorCan(self.settings, load_frames(self.settings), self.tally)
        self._bus_state = BusState.ACTIVE
        self._outputs: dict[type, tuple[PackedOutput, Any]] = {}
        frame_id = self.settings.frame_prefix + _BODY_FRAME
        for kind in self._can.kinds:
            topic, blank, fill = _MESSAGES[kind]
            self._outputs[kind] = (self.advertise_packed(topic, blank(make, frame_id)), fill)

    def link_name(self) -> str:
        """The bus, for messages."""
        return f"CAN on {self.settings.can_channel}"

    def open_port(self) -> CanBus:
        """Open the bus."""
        return CanBus(self.settings.can_interface, self.settings.can_channel, self._options)

    def restart_decoding(self) -> None:
        """After opening: continue positions over the time without a bus, and start CANopen nodes."""
        self._can.resume()
        if self.settings.canopen_start:
            self.link.write(START_ALL)

    def receive(self, data: CanFrame, steady_ns: int) -> None:
        """Decode one frame, and publish the samples that it completes."""
        if self.settings.canopen_start and (start := start_command(*data)):
            self.link.write(start)
        if data[0] & ERROR_FLAG:
            self._bus_state = bus_state(*data) or self._bus_state
        elif self._bus_state is BusState.OFF:
            self._bus_state = BusState.ACTIVE  # restarted without an error frame
        if self.can_be_delayed(steady_ns):
            self.tally.add(BUS, StampEvent.DELAYED)
            return
        sample: Any
        for sample in self._can.receive(*data, steady_ns):
            output, fill = self._outputs[type(sample)]
            fill(output.message, self.restamp(sample))
            output.publish()
            if type(sample) is self._can.main_kind:
                self.count_message()

    def dialogue_state(self) -> str:
        """That the controller has left the bus, if it has."""
        return "bus off" if self._bus_state is BusState.OFF else ""

    def port_remedy(self, error: str = "") -> str:
        """Remedy for the state of the controller or the interface; Linux restarts neither by itself."""
        channel = self.settings.can_channel
        if self.settings.can_interface == "socketcand" and error:
            return "check can_host and can_port, and that socketcand runs there"
        if NO_LIBRARY in error:
            return f"install the library of {self.settings.can_interface}, or set can_interface to socketcan"
        if self.settings.can_interface != "socketcan":
            return super().port_remedy(error)
        if error == os.strerror(errno.ENODEV):
            return f"check the adapter and can_channel: ip link does not list {channel}"
        if error == os.strerror(errno.EAFNOSUPPORT):
            return "load CAN into the kernel: modprobe can_raw"
        if error == os.strerror(errno.ENETDOWN):
            return f"set it up, with the bitrate of the bus: {_SET_UP.format(channel)}"
        if self._bus_state is BusState.OFF:
            return f"{self.advice}, then: ip link set {channel} type can restart (or set restart-ms)"
        return super().port_remedy(error)

    def unusable_data_message(self) -> str:
        """Reason why no received frame has a role, or which frames do not come; empty if unknown."""
        decoder = self._can.decoder
        return decoder.no_role_message() or self._unused_frames_message([self._can.main_kind])

    def health(self) -> list[Health]:
        """The link's health, with the state of the bus."""
        self.period = self._can.period or self.period
        if self.link.state().last_error == os.strerror(errno.ENETDOWN):
            self._bus_state = BusState.ACTIVE  # the controller restarts with its interface, without a word
        entries = super().health()
        if self.active:
            entries[0].values["bus state"] = self._bus_state.value
            entries[0].values["frames without a role"] = self._can.decoder.frames_without_role
            ambiguous = self._can.decoder.ambiguous_source_message(is_live=True)
            entries[0].values["another id"] = self._can.decoder.other_id_message() or ambiguous
            missing = self.missing_kinds(self._can.kinds)
            problem = ambiguous or self._unused_frames_message(missing, "frames come, but give none")
            if problem and entries[0].level in (OK, WARN):
                entries[0] = replace(entries[0], level=WARN, message=f"{entries[0].message}; {problem}")
        return entries

    def _unused_frames_message(self, kinds: Iterable[type], otherwise: str = "") -> str:
        """Message about the missing topics of these kinds of samples, and their frames; or empty.

        ``otherwise``: text if all frames come.
        """
        topics = {_MESSAGES[kind][0]: self._can.frames[kind] for kind in kinds}
        if not topics:
            return ""
        frames = set().union(*topics.values())
        message = self._can.decoder.unused_frames_message(frames, _FRAME_PATIENCE_NS) or otherwise
        return f"no {' and no '.join(sorted(topics))}: {message}" if message else ""


def main() -> None:
    """Entry point."""
    sys.exit(run(CanDriverNode))
