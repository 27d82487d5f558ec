# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of a DBC that have a role: decode whole, check, place in time, then commit; and the encode half.

The DBC has ids, lengths, scaling, ranges and units. What it cannot express is in the roles file: what a
signal is for, and which signals are a counter and a checksum. A frame is known by its id; one of J1939 by its
parameter group, whatever its priority and source address.
"""

from collections.abc import Mapping, Sequence
from enum import Enum
from pathlib import Path

from cantools.database import Message
from cantools.database.errors import Error as CantoolsError

from trackslip_common.config_files import config_file
from trackslip_common.errors import InputError
from trackslip_common.tally import Tally
from trackslip_common.vehicle import VehicleParameters
from trackslip_drivers.can_parameters import NODE, CanDriverParameters
from trackslip_drivers.protocols.can_binding import Binder
from trackslip_drivers.protocols.can_codec import CHECKSUMS, Codec, Protection
from trackslip_drivers.protocols.can_dbc import error_line, read_dbc
from trackslip_drivers.protocols.can_roles import read_roles
from trackslip_drivers.protocols.can_timing import (
    CountedFrames,
    Frame,
    FrameTiming,
    TimingEvent,
    UncountedFrames,
)

ERROR_FLAG = 1 << 29  # set beside the id by the transport for error frames
STANDARD_FLAG = 1 << 31  # an 11-bit id, which must not pass for a 29-bit one
BUS = "can"  # what a rejection is counted under when the frame cannot be named

_EXTENDED = 1 << 29  # ids below are data frames with 29 bits
_FIRST_BROADCAST = 0xF0  # of the PDU format: below it, the next byte is an address
_MOST_SENDERS = 256
_SHOWN_IDS = 8
_ID_BITS = _EXTENDED - 1


class Rejection(Enum):
    """Why a frame was not used."""

    ERROR_FRAME = "error frame"
    WRONG_LENGTH = "wrong length"
    CHECKSUM = "checksum"
    UNUSED_BITS = "bits set that mean nothing"
    OUT_OF_RANGE = "out of range"


class FrameSet:
    """The frames as the DBC describes them, with the roles of their signals.

    Raises:
        InputError: a file cannot be read or is none of its kind; a signal is missing; a unit is wrong.
    """

    def __init__(self, dbc: Path, roles: Path, vehicle: VehicleParameters) -> None:
        contract = read_dbc(dbc)
        database = contract.database
        given = read_roles(roles)
        self.roles = given.roles
        for message in database.messages:
            if given.protections.get(message.name, Protection()).j1939:
                message.protocol = "j1939"
        self.bindings = Binder(contract, vehicle, dbc, roles).bind(given.roles)
        names = {place.frame for place in self.bindings.places()}
        used = [message for message in database.messages if message.name in names]
        self.by_name = {message.name: message for message in used}
        if len(used) > len(self.by_name):
            twice = next(message.name for message in used if message is not self.by_name[message.name])
            raise InputError(f"dbc_file {dbc}: frame '{twice}' is there twice; accepted: a name for each")
        for name in given.protections.keys() - names:
            raise InputError(
                f"roles_file {roles}: frame '{name}' has no role; accepted: {', '.join(sorted(names))}"
            )
        self.codecs: dict[str, Codec] = {}
        for name, message in self.by_name.items():
            _check_signals(f"dbc_file {dbc}: frame '{name}'", message)
            protection = given.protections.get(name, Protection())
            _check_protection(f"roles_file {roles}: frame '{name}'", message, protection)
            self.codecs[name] = self._codec(message, protection)
        self._ids = {name: _flagged_id(message) for name, message in self.by_name.items()}
        self._by_id = {identifier: self.codecs[name] for name, identifier in self._ids.items()}
        self._by_group = {
            _group(message.frame_id): self.codecs[name]
            for name, message in self.by_name.items()
            if message.protocol == "j1939" and message.is_extended_frame
        }
        self._by_own_id = {
            _group(message.frame_id): (name, message.frame_id)
            for name, message in self.by_name.items()
            if message.protocol != "j1939" and message.is_extended_frame
        }

    def _codec(self, message: Message, protection: Protection) -> Codec:
        raw = {
            turned.place.signal
            for turned in self.bindings.turned.values()
            if turned.place.frame == message.name
        }
        used = {place.signal for place in self.bindings.places() if place.frame == message.name}
        order = [signal.name for signal in message.signals if signal.name in used]
        return Codec(
            message,
            [name for name in order if name not in raw],
            [name for name in order if name in raw],
            protection,
        )

    def find(self, arbitration_id: int) -> Codec | None:
        """The frame of an id as the transport gives it; None for those without a role."""
        codec = self._by_id.get(arbitration_id)
        if codec is None and self._by_group and arbitration_id < _EXTENDED:
            codec = self._by_group.get(_group(arbitration_id))
        return codec

    def find_other_source(self, arbitration_id: int) -> tuple[str, int] | None:
        """The frame that this would be if only its source address or priority differed, and its own id."""
        return self._by_own_id.get(_group(arbitration_id)) if arbitration_id < _EXTENDED else None

    def encode(self, name: str, values: Mapping[str, float], count: int) -> tuple[int, bytes]:
        """(arbitration id, payload) of one frame; values in the DBC's units.

        Raises:
            EncodeError: a value lies outside the range that the DBC gives.
        """
        frame_id = self._ids[name]
        return frame_id, self.codecs[name].pack(frame_id, values, count)


def load_frames(p: CanDriverParameters) -> FrameSet:
    """The frames that the parameters name.

    Raises:
        InputError: as ``FrameSet``.
    """
    return FrameSet(_file("dbc_file", p.dbc_file), _file("roles_file", p.roles_file), p.vehicle)


def _file(parameter: str, name: str) -> Path:
    try:
        return config_file(name)
    except InputError as error:
        raise InputError(f"{NODE}: {parameter}: {error}") from error


class FrameDecoder:
    """Accepts frames that pass every check, and knows when each was sent.

    Attributes:
        others: frames on the bus that have no role.
    """

    def __init__(self, frames: FrameSet, tally: Tally) -> None:
        self.others = 0
        self.others_ids: dict[int, None] = {}  # the first of them, as the transport gives them
        self.other_sources: dict[str, tuple[int, int]] = {}  # frame → its id, and that which comes
        self._has_role = False  # of any frame that came, though it was rejected
        self._frames = frames
        self._tally = tally
        self._timings: dict[int, FrameTiming] = {}  # by arbitration id

    def decode(self, arbitration_id: int, data: bytes, stamp_ns: int) -> Sequence[Frame] | Rejection:
        """The frames that are known now that this one was received: as a rule itself.

        None of them where its place in time is in doubt: it comes with the next of its name. A rejection has
        been counted and has changed nothing else.
        """
        codec = self._frames.find(arbitration_id)
        if codec is None:
            if arbitration_id & ERROR_FLAG and not arbitration_id & STANDARD_FLAG:
                return self._reject(BUS, Rejection.ERROR_FRAME)
            return self._set_aside(arbitration_id)
        self._has_role = True
        if len(data) < codec.length or (codec.is_exact and len(data) > codec.length):
            return self._reject(codec.name, Rejection.WRONG_LENGTH)
        data = data[: codec.length]  # some senders pad to eight bytes
        little, big = int.from_bytes(data, "little"), int.from_bytes(data, "big")
        if not codec.checks(arbitration_id, little, big):
            return self._reject(codec.name, Rejection.CHECKSUM)
        if codec.has_unused_bits(little):
            return self._reject(codec.name, Rejection.UNUSED_BITS)
        values = codec.unpack(little, big)
        if values is None:
            return self._reject(codec.name, Rejection.OUT_OF_RANGE)
        timing = self._timings.get(arbitration_id) or self._new_timing(arbitration_id, codec)
        return timing.add(codec.count(little, big), stamp_ns, values)

    def _set_aside(self, arbitration_id: int) -> Sequence[Frame]:
        """A frame without a role; one that differs by its source address alone may be meant."""
        found = self._frames.find_other_source(arbitration_id)
        if found is not None and found[1] not in self._timings:
            name, own_id = found
            self.other_sources[name] = (own_id, arbitration_id)
        self.others += 1
        if len(self.others_ids) < _SHOWN_IDS:
            self.others_ids[arbitration_id] = None
        return ()

    def other_source(self) -> str:
        """A frame that comes from another source address than the DBC's alone; empty where none does."""
        for name, (own_id, seen_id) in self.other_sources.items():
            if own_id not in self._timings:
                seen = f"0x{seen_id:X}, from source address 0x{seen_id & 0xFF:02X}"
                own = f"0x{own_id:X}, from 0x{own_id & 0xFF:02X}"
                remedy = "if it is the same frame, set j1939: true of it in the roles file"
                return f"frame '{name}' comes as {seen}; the DBC has {own}; {remedy}"
        return ""

    def ambiguous_source(self) -> str:
        """A frame that several senders send, of which a role names none; empty where there is none."""
        for frame in {place.frame for place in self._frames.bindings.places() if place.source < 0}:
            known = {identifier: self._frames.find(identifier) for identifier in self._timings}
            of_frame = {one & 0xFF for one, codec in known.items() if codec and codec.name == frame}
            if len(of_frame) > 1:
                sources = " and ".join(f"0x{source:02X}" for source in sorted(of_frame))
                remedy = "set source: one of them in its roles"
                return f"frame '{frame}' comes from source addresses {sources}; {remedy}"
        return ""

    def hint(self) -> str:
        """Why no frame has a role, and what to do; empty where nothing is known."""
        if found := self.other_source():
            return found
        if not self.others_ids or self._has_role:
            return ""
        ids = ", ".join(f"0x{name & _ID_BITS:X}" for name in self.others_ids)
        return f"frames come (ids {ids}), but none with a role; check dbc_file and roles_file"

    def resume(self) -> None:
        """The bus was reopened: what came before is continued by time alone."""
        for timing in self._timings.values():
            timing.resume()

    def cycle_ns(self, name: str) -> float:
        """The slowest measured cycle of a frame's senders; 0 while none is known."""
        known = [self._frames.find(identifier) for identifier in self._timings]
        cycles = [
            timing.cycle_ns or 0.0
            for codec, timing in zip(known, self._timings.values(), strict=True)
            if codec is not None and codec.name == name
        ]
        return max(cycles, default=0.0)

    def _new_timing(self, arbitration_id: int, codec: Codec) -> FrameTiming:
        if len(self._timings) >= _MOST_SENDERS:
            self._timings.clear()  # of a bus full of nonsense
        tally = self._tally

        def report(event: TimingEvent, times: int) -> None:
            tally.add(codec.name, event, times)

        timing: FrameTiming
        source = arbitration_id & 0xFF if arbitration_id < _EXTENDED else 0
        if codec.modulus:
            timing = CountedFrames(codec.nominal_ns, codec.modulus, report, codec.name, source)
        else:
            timing = UncountedFrames(codec.nominal_ns, report, codec.name, source)
        self._timings[arbitration_id] = timing
        return timing

    def _reject(self, source: str, reason: Rejection) -> Rejection:
        self._tally.add(source, reason)
        return reason


def _check_signals(where: str, message: Message) -> None:
    """Raise ``InputError`` where signals overlap, or do not fit in the frame."""
    try:
        message.refresh(strict=True)
    except CantoolsError as error:
        accepted = "signals that fit in their frame, each with bits of its own"
        raise InputError(f"{where}: {error_line(error).rstrip('.')}; accepted: {accepted}") from error


def _check_protection(where: str, message: Message, protection: Protection) -> None:
    """Raise ``InputError`` unless counter and checksum are whole numbers of the frame, of the right size."""
    signals = {signal.name: signal for signal in message.signals}
    for key, name in (("counter", protection.counter), ("checksum", protection.checksum)):
        if name and name not in signals:
            raise InputError(f"{where}: {key}: signal '{name}' is missing; accepted: {', '.join(signals)}")
        if name and (signals[name].is_float or signals[name].is_signed):
            raise InputError(
                f"{where}: {key}: signal '{name}' is no unsigned whole number; accepted: one that is"
            )
    if protection.checksum:
        bits, length = CHECKSUMS[protection.checksum_type][0], signals[protection.checksum].length
        if bits != length:
            raise InputError(
                f"{where}: checksum: signal '{protection.checksum}' has {length} bits; accepted: {bits}"
            )


def _flagged_id(message: Message) -> int:
    """As the transport gives it."""
    return message.frame_id if message.is_extended_frame else message.frame_id | STANDARD_FLAG


def _group(identifier: int) -> int:
    """Parameter group of a 29-bit id: neither priority, nor source, nor destination."""
    group = identifier >> 8 & 0x3FFFF
    return group if group >> 8 & 0xFF >= _FIRST_BROADCAST else group & 0x3FF00
