# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Decodes frames that have a role: unpack, check, determine the time of sending, then commit. Also encodes.

The DBC has ids, lengths, scaling, ranges and units. The roles file adds the purpose of each signal, and the
counter and checksum of a frame. A frame is matched by its id; a J1939 frame by its parameter group, with any
priority and source address.
"""

from collections.abc import Iterable, Mapping, Sequence
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
from trackslip_drivers.protocols.can_timing import CountedFrames, Frame, FrameTiming, UncountedFrames

ERROR_FLAG = 1 << 29  # set in the id of error frames by the transport
STANDARD_FLAG = 1 << 31  # marks an 11-bit id, to distinguish it from a 29-bit one
BUS = "can"  # name in the tally for frames that cannot be named

_EXTENDED = 1 << 29  # lower ids are data frames with 29 bits
_FIRST_BROADCAST = 0xF0  # PDU format; below it, the next byte is a destination address
_MAX_SENDERS = 256
_SHOWN_IDS = 8
_PRESENCE_NS = 5_000_000_000  # since the latest frame of a sender that is present
_ID_BITS = _EXTENDED - 1
_DBC_EXTENDED = 1 << 31  # set in a DBC's number of a frame with 29 bits
_ABSENT_CYCLES = 10  # of a frame, after which it does not come


class Rejection(Enum):
    """Reason for the rejection of a frame."""

    ERROR_FRAME = "error frame"
    WRONG_LENGTH = "wrong length"
    CHECKSUM = "checksum"
    UNUSED_BITS = "unused bits are set"
    OUT_OF_RANGE = "out of range"


class FrameSet:
    """Codecs of the DBC's frames that have a role, and the bindings of their signals.

    Raises:
        InputError: a file cannot be read or has another format; a signal is missing; a unit is wrong.
    """

    def __init__(self, dbc: Path, roles: Path, vehicle: VehicleParameters) -> None:
        parsed_dbc = read_dbc(dbc)
        database = parsed_dbc.database
        roles_file = read_roles(roles)
        self.roles = roles_file.roles
        for message in database.messages:
            if roles_file.protections.get(message.name, Protection()).j1939:
                message.protocol = "j1939"
        self.bindings = Binder(parsed_dbc, vehicle, dbc, roles).bind(roles_file.roles)
        names = {signal_id.frame for signal_id in self.bindings.signal_ids()}
        used = [message for message in database.messages if message.name in names]
        self.by_name = {message.name: message for message in used}
        if len(used) > len(self.by_name):
            twice = next(message.name for message in used if message is not self.by_name[message.name])
            raise InputError(f"dbc_file {dbc}: frame '{twice}' is there twice; accepted: a name for each")
        for name in roles_file.protections.keys() - names:
            raise InputError(
                f"roles_file {roles}: frame '{name}' has no role; accepted: {', '.join(sorted(names))}"
            )
        self.codecs: dict[str, Codec] = {}
        for name, message in self.by_name.items():
            _check_signals(f"dbc_file {dbc}: frame '{name}'", message)
            protection = roles_file.protections.get(name, Protection())
            _check_protection(f"roles_file {roles}: frame '{name}'", message, protection)
            self.codecs[name] = self._make_codec(message, protection)
        self._ids = {name: _flagged_id(message) for name, message in self.by_name.items()}
        self._by_id = {identifier: self.codecs[name] for name, identifier in self._ids.items()}
        self._by_group: dict[int, Codec] = {}
        self._by_group_without_j1939: dict[int, tuple[str, int]] = {}
        for message in used:
            group = _parameter_group(message.frame_id)
            if message.is_extended_frame and message.protocol == "j1939":
                self._by_group[group] = self.codecs[message.name]
            elif message.is_extended_frame:
                self._by_group_without_j1939[group] = message.name, message.frame_id

    def _make_codec(self, message: Message, protection: Protection) -> Codec:
        used = {one.signal for one in self.bindings.signal_ids() if one.frame == message.name}
        positions = [position.signal_id for position in self.bindings.position_signals.values()]
        raw = {one.signal for one in positions if one.frame == message.name}
        return Codec(message, [s.name for s in message.signals if s.name in used], raw, protection)

    def find_codec(self, arbitration_id: int) -> Codec | None:
        """The codec of an id in the transport's format; None for frames without a role."""
        codec = self._by_id.get(arbitration_id)
        if codec is None and self._by_group and arbitration_id < _EXTENDED:
            codec = self._by_group.get(_parameter_group(arbitration_id))
        return codec

    def find_similar(self, arbitration_id: int) -> tuple[str, int] | None:
        """(name, DBC id) of the frame that differs by format, or by source address and priority; or None."""
        codec = self._by_id.get(arbitration_id ^ STANDARD_FLAG)
        if codec is not None:
            return codec.name, arbitration_id ^ STANDARD_FLAG
        if arbitration_id >= _EXTENDED:
            return None
        return self._by_group_without_j1939.get(_parameter_group(arbitration_id))

    def id_of(self, name: str) -> int:
        """The id of a frame in the DBC."""
        return self.by_name[name].frame_id

    def encode(self, name: str, values: Mapping[str, float], count: int) -> tuple[int, bytes]:
        """(arbitration id, payload) of one frame; ``values`` are in the DBC's units.

        Raises:
            EncodeError: a value is outside the DBC's range.
        """
        frame_id = self._ids[name]
        return frame_id, self.codecs[name].pack(frame_id, values, count)


def load_frames(p: CanDriverParameters) -> FrameSet:
    """Load the frames named by the parameters.

    Raises:
        InputError: see ``FrameSet``.
    """
    return FrameSet(_find_file("dbc_file", p.dbc_file), _find_file("roles_file", p.roles_file), p.vehicle)


def _find_file(parameter: str, name: str) -> Path:
    try:
        return config_file(name)
    except InputError as error:
        raise InputError(f"{NODE}: {parameter}: {error}") from error


class FrameDecoder:
    """Accepts frames that pass every check, and determines when each was sent.

    Attributes:
        frames_without_role: number of received frames without a role.
    """

    def __init__(self, frames: FrameSet, tally: Tally) -> None:
        self.frames_without_role = 0
        self.ids_without_role: dict[int, None] = {}  # the first of them, in the transport's format
        self._similar: dict[str, tuple[int, int]] = {}  # frame → its DBC id, and the id received
        self._has_role = False  # of any frame received, even if rejected
        self._frames = frames
        self._tally = tally
        self._timings: dict[int, FrameTiming] = {}  # by arbitration id
        self._accepted_ns: dict[str, int] = {}  # frame → arrival of the newest one accepted
        self._rejected: dict[str, tuple[int, str]] = {}  # frame → arrival of the newest one rejected, why
        self._first_ns: int | None = None  # arrival of the first frame, and of the newest one
        self._now_ns = 0

    def decode(self, arbitration_id: int, data: bytes, stamp_ns: int) -> Sequence[Frame] | Rejection:
        """The frames whose time of sending is known after this one was received: usually this one.

        A frame whose time is ambiguous is held until later frames of its id resolve it. A rejection is
        counted and affects neither values nor times.
        """
        if self._first_ns is None:
            self._first_ns = stamp_ns
        self._now_ns = stamp_ns
        codec = self._frames.find_codec(arbitration_id)
        if codec is None:
            if arbitration_id & ERROR_FLAG and not arbitration_id & STANDARD_FLAG:
                return self._reject(BUS, Rejection.ERROR_FRAME)
            return self._count_frame_without_role(arbitration_id)
        self._has_role = True
        if len(data) < codec.length or (codec.is_exact and len(data) > codec.length):
            detail = f"{len(data)} bytes, {codec.length} in the DBC"
            return self._reject(codec.name, Rejection.WRONG_LENGTH, detail)
        data = data[: codec.length]  # some senders pad to eight bytes
        little, big = int.from_bytes(data, "little"), int.from_bytes(data, "big")
        if not codec.has_valid_checksum(arbitration_id, little, big):
            return self._reject(codec.name, Rejection.CHECKSUM)
        if codec.has_unused_bits(little):
            return self._reject(codec.name, Rejection.UNUSED_BITS)
        values = codec.unpack(little, big)
        if values is None:
            return self._reject(codec.name, Rejection.OUT_OF_RANGE)
        self._accepted_ns[codec.name] = stamp_ns
        timing = self._timings.get(arbitration_id) or self._add_timing(arbitration_id, codec, stamp_ns)
        return timing.add(codec.counter_value(little, big), stamp_ns, values)

    def _count_frame_without_role(self, arbitration_id: int) -> Sequence[Frame]:
        """Count a frame without a role; note one whose id is similar to that of a frame with a role."""
        similar = self._frames.find_similar(arbitration_id)
        if similar is not None and similar[1] not in self._timings:
            name, own_id = similar
            self._similar[name] = (own_id, arbitration_id)
        self.frames_without_role += 1
        if len(self.ids_without_role) < _SHOWN_IDS:
            self.ids_without_role[arbitration_id] = None
        return ()

    def other_id_message(self) -> str:
        """Message about a frame received only with another id than the DBC's; or empty."""
        for name, (own_id, seen_id) in self._similar.items():
            if own_id in self._timings:
                continue
            if (own_id ^ seen_id) & STANDARD_FLAG:
                own_bits, seen_bits = (11 if one & STANDARD_FLAG else 29 for one in (own_id, seen_id))
                entry = seen_id & _ID_BITS | (0 if seen_id & STANDARD_FLAG else _DBC_EXTENDED)
                seen = f"with {seen_bits} bits of its id 0x{seen_id & _ID_BITS:X}"
                return f"frame '{name}' comes {seen}; the DBC has {own_bits}; write BO_ {entry} there"
            seen = f"0x{seen_id:X}, from source address 0x{seen_id & 0xFF:02X}"
            own = f"0x{own_id:X}, from 0x{own_id & 0xFF:02X}"
            remedy = "if it is the same frame, set j1939: true of it in the roles file"
            return f"frame '{name}' comes as {seen}; the DBC has {own}; {remedy}"
        return ""

    def unused_frames_message(self, names: Iterable[str], patience_ns: int) -> str:
        """Message about those of the frames that do not come, else about one that is rejected; or empty."""
        absent, rejected, remedy = [], "", "check the sender and its cable"
        for name in sorted(names):
            earliest_ns = self._now_ns - patience_ns - _ABSENT_CYCLES * self.cycle_ns(name)
            start_ns = self._now_ns if self._first_ns is None else self._first_ns
            rejected_ns, reason = self._rejected.get(name, (start_ns, ""))
            if self._accepted_ns.get(name, start_ns) >= earliest_ns:
                continue
            if reason and rejected_ns >= earliest_ns:
                rejected = f"frame '{name}' is rejected: {reason}; check it against the DBC"
                continue
            absent.append(f"'{name}' (0x{self._frames.id_of(name):X})")
            remedy = remedy if name in self._accepted_ns else "check the sender, and the roles file"
        if not absent:
            return rejected
        frames = f"frame {absent[0]} does" if len(absent) == 1 else f"frames {', '.join(absent)} do"
        return self.other_id_message() or f"{frames} not come; {remedy}"

    def ambiguous_source_message(self, *, is_live: bool = False) -> str:
        """Message about a frame of several senders at a time whose role names none of them; or empty.

        A sender that has changed its address is one. ``is_live``: leave out senders that are gone.
        """
        latest_ns = max((timing.seen_ns for timing in self._timings.values()), default=0)
        earliest_ns = latest_ns - _PRESENCE_NS if is_live else 0
        for frame in {
            signal_id.frame for signal_id in self._frames.bindings.signal_ids() if signal_id.source < 0
        }:
            senders = [
                one for one in self._timings.values() if one.name == frame and one.seen_ns >= earliest_ns
            ]
            addresses = {
                one.source
                for one in senders
                for other in senders
                if one.source != other.source
                and max(one.first_ns, other.first_ns) < min(one.seen_ns, other.seen_ns)
            }
            if addresses:
                sources = " and ".join(f"0x{source:02X}" for source in sorted(addresses))
                remedy = "set source: one of them in its roles"
                return f"frame '{frame}' comes from source addresses {sources}; {remedy}"
        return ""

    def no_role_message(self) -> str:
        """Message with the reason why no frame has a role, and the remedy; empty if unknown."""
        if message := self.other_id_message():
            return message
        if not self.ids_without_role or self._has_role:
            return ""
        ids = ", ".join(f"0x{identifier & _ID_BITS:X}" for identifier in self.ids_without_role)
        return f"frames come (ids {ids}), but none with a role; check dbc_file and roles_file"

    def resume(self) -> None:
        """After the bus is reopened: take the elapsed time of the gap from stamps, not from counters."""
        for timing in self._timings.values():
            timing.resume()

    def cycle_ns(self, name: str) -> float:
        """The longest measured cycle of a frame's senders, ns; 0 while none is known."""
        timings = (timing for timing in self._timings.values() if timing.name == name)
        return max((timing.cycle_ns or 0.0 for timing in timings), default=0.0)

    def _add_timing(self, arbitration_id: int, codec: Codec, first_ns: int) -> FrameTiming:
        if len(self._timings) >= _MAX_SENDERS:
            self._timings.clear()  # a bus full of random ids
        timing: FrameTiming
        source = arbitration_id & 0xFF if arbitration_id < _EXTENDED else 0
        if codec.modulus:
            timing = CountedFrames(codec.nominal_ns, codec.modulus, self._tally, codec.name, source, first_ns)
        else:
            timing = UncountedFrames(codec.nominal_ns, self._tally, codec.name, source, first_ns)
        self._timings[arbitration_id] = timing
        return timing

    def _reject(self, source: str, reason: Rejection, detail: str = "") -> Rejection:
        text = f"{reason.value} ({detail})" if detail else reason.value
        self._rejected[source] = self._now_ns, text
        self._tally.add(source, reason, detail=text if source == BUS else f"frame '{source}': {text}")
        return reason


def _check_signals(where: str, message: Message) -> None:
    """Raise ``InputError`` if signals overlap or exceed the frame."""
    try:
        message.refresh(strict=True)
    except CantoolsError as error:
        accepted = "signals that fit in their frame, each with bits of its own"
        raise InputError(f"{where}: {error_line(error).rstrip('.')}; accepted: {accepted}") from error


def _check_protection(where: str, message: Message, protection: Protection) -> None:
    """Raise ``InputError`` unless counter and checksum are unsigned signals of the right size."""
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
    """The id in the transport's format."""
    return message.frame_id if message.is_extended_frame else message.frame_id | STANDARD_FLAG


def _parameter_group(identifier: int) -> int:
    """Parameter group of a 29-bit id: without priority, source and destination."""
    group = identifier >> 8 & 0x3FFFF
    return group if group >> 8 & 0xFF >= _FIRST_BROADCAST else group & 0x3FF00
