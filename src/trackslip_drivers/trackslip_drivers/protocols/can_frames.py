# SPDX-License-Identifier: Apache-2.0
"""Frames of ``config/excavator.dbc``: decode whole, check, then commit; and the encode half.

The DBC is the contract: ids, lengths, scaling, ranges, cycle time. Two checks that a DBC cannot express
are here: the alive counter and the checksum behind it, the last 4 + 12 bits of a payload.
"""

import math
from collections.abc import Mapping
from enum import Enum
from functools import cache
from pathlib import Path
from typing import NamedTuple

import cantools
from cantools.database import Database, Message
from cantools.database.can import Signal
from cantools.database.errors import EncodeError
from cantools.database.errors import Error as CantoolsError

from trackslip_common.errors import InputError
from trackslip_common.tally import Tally

ENCODERS = "encoders"
SPOOLS = "spools"
PRESSURES = "pressures"
SIGNALS: Mapping[str, tuple[str, ...]] = {
    ENCODERS: ("left_count", "right_count"),
    SPOOLS: ("left_spool", "right_spool"),
    PRESSURES: ("left_pressure", "right_pressure", "supply_pressure"),
}

ERROR_FLAG = 1 << 29  # set beside the 29-bit id by the transport for error frames
BUS = "can"  # what a rejection is counted under when the frame cannot be named

_ALIVE = "alive_counter"
_CHECKSUM = "checksum"
_ALIVE_BITS = 4
_CHECKSUM_BITS = 12
_MODULUS = 1 << _ALIVE_BITS
# A silence may hide whole turns of the counter; one more turn is assumed from this share of it on. A sender
# that stalls and catches up looks the same, hence above one half.
_TURN_SHARE = 0.75


class Rejection(Enum):
    """Why a frame was not used; LOST counts frames that never came."""

    ERROR_FRAME = "error frame"
    UNKNOWN_ID = "unknown id"
    WRONG_LENGTH = "wrong length"
    CHECKSUM = "checksum"
    UNUSED_BITS = "bits set that mean nothing"
    OUT_OF_RANGE = "out of range"
    ALIVE_REPEATED = "alive counter repeated"
    LOST = "lost"


class Frame(NamedTuple):
    """One accepted frame."""

    name: str
    stamp_ns: int
    cycles: int  # sender's cycles since the previous accepted frame of this name; 0 for the first
    values: Mapping[str, float]  # signal name → value in the DBC's unit (SI, or raw counts)


def sealed(frame_id: int, payload: bytes) -> bytes:
    """The payload with the checksum that belongs to its other bits, whatever it had.

    CRC-12/GSM over the id and what precedes the checksum. It finds every wrong byte and any three wrong
    bits; of two or more wrong bytes it misses one pattern in 4096. No checksum of 12 bits finds all those.
    """
    alive = payload[-2] & (_MODULUS - 1)
    crc = _remainder(payload[:-2] + bytes((alive,)), _remainder_of_id(frame_id)) ^ _CRC_FINAL
    return payload[:-2] + (alive | crc << _ALIVE_BITS).to_bytes(2, "little")


def _remainder(data: bytes, crc: int = 0) -> int:
    """CRC-12/GSM without its final XOR, continued from ``crc``."""
    for byte in data:
        crc = crc << 8 & 0xFFF ^ _CRC_TABLE[crc >> 4 ^ byte]
    return crc


@cache
def _remainder_of_id(frame_id: int) -> int:
    return _remainder(frame_id.to_bytes(4, "big"))


def _crc_table() -> tuple[int, ...]:
    """The CRC of each byte."""
    table = []
    for byte in range(256):
        crc = byte << 4
        for _ in range(8):
            crc = crc << 1 ^ (_CRC_POLYNOMIAL if crc & 0x800 else 0)
        table.append(crc & 0xFFF)
    return tuple(table)


_CRC_POLYNOMIAL, _CRC_FINAL = 0xD31, 0xFFF
_CRC_TABLE = _crc_table()


class _Field(NamedTuple):
    """Where a signal lies in a payload that is read as one number, and what its raw value means."""

    big: bool  # which byte order that number has
    shift: int
    mask: int
    sign: int  # bit of the raw value; 0 where it has none
    scale: float
    offset: float
    low: float
    high: float


class _Codec:
    """Payloads of one frame to values and back: what cantools does, at a tenth of its time."""

    def __init__(self, message: Message) -> None:
        self.name = message.name
        self.length = message.length
        self.unused_bits = ~_used_bits(message)  # of a payload, read as a little-endian number
        self._fields = {
            name: _field(message, message.get_signal_by_name(name)) for name in SIGNALS[message.name]
        }
        self._alive_shift = 8 * message.length - _CHECKSUM_BITS - _ALIVE_BITS

    def pack(self, values: Mapping[str, float], alive_counter: int) -> bytes:
        """The payload without its checksum.

        Raises:
            EncodeError: a value lies outside the range that the DBC gives.
        """
        little, big = alive_counter << self._alive_shift, 0
        for name, field in self._fields.items():
            value = values[name]
            if not field.low <= value <= field.high:
                raise EncodeError(f"{name}: {value!r}; accepted: {field.low:g} to {field.high:g}")
            bits = (round((value - field.offset) / field.scale) & field.mask) << field.shift
            little, big = (little, big | bits) if field.big else (little | bits, big)
        whole = little.to_bytes(self.length, "little")
        return (int.from_bytes(whole, "big") | big).to_bytes(self.length, "big") if big else whole

    def unpack(self, data: bytes) -> dict[str, float] | None:
        """The values; None where one lies outside its range."""
        little, big = int.from_bytes(data, "little"), int.from_bytes(data, "big")
        values = {}
        for name, field in self._fields.items():
            raw = (big if field.big else little) >> field.shift & field.mask
            value = float((raw - 2 * (raw & field.sign)) * field.scale + field.offset)
            if not field.low <= value <= field.high:
                return None
            values[name] = value
        return values


def _field(message: Message, signal: Signal) -> _Field:
    """Raise ``InputError`` for what is no whole number."""
    if signal.is_float:
        raise InputError(f"dbc_file: signal '{signal.name}' is a floating-point one; accepted: integers")
    big = signal.byte_order == "big_endian"
    ahead = signal.start // 8 * 8 + 7 - signal.start % 8  # bits before the highest, from the first byte on
    return _Field(
        big,
        8 * message.length - ahead - signal.length if big else signal.start,
        (1 << signal.length) - 1,
        1 << signal.length - 1 if signal.is_signed else 0,
        signal.scale,
        signal.offset,
        -math.inf if signal.minimum is None else signal.minimum,
        math.inf if signal.maximum is None else signal.maximum,
    )


class FrameSet:
    """The frames as the DBC describes them.

    Raises:
        InputError: the file cannot be read, is no DBC, or lacks a frame or signal.
    """

    def __init__(self, path: Path) -> None:
        try:
            database = cantools.database.load_file(path, strict=True)
        except (OSError, UnicodeDecodeError, CantoolsError) as error:
            raise InputError(f"dbc_file {path}: not a usable DBC ({' '.join(str(error).split())})") from error
        if not isinstance(database, Database):
            raise InputError(f"dbc_file {path}: not a DBC of CAN frames")
        self.by_name = {name: _find(database, name, path) for name in SIGNALS}
        self.by_id = {message.frame_id: message for message in self.by_name.values()}
        cycles_ms = {message.cycle_time for message in self.by_name.values()}
        cycle_ms = cycles_ms.pop()
        if cycles_ms or not cycle_ms:
            raise InputError(f"dbc_file {path}: GenMsgCycleTime must be set, the same for all frames")
        self.cycle_ns = cycle_ms * 1_000_000
        self.codecs = {frame_id: _Codec(message) for frame_id, message in self.by_id.items()}

    def encode(self, name: str, values: Mapping[str, float], alive_counter: int) -> tuple[int, bytes]:
        """(arbitration id, payload) of one frame.

        Raises:
            EncodeError: a value lies outside the range that the DBC gives.
        """
        frame_id = self.by_name[name].frame_id
        return frame_id, sealed(frame_id, self.codecs[frame_id].pack(values, alive_counter % _MODULUS))


class FrameDecoder:
    """Accepts frames that pass every check, and knows what was lost between them."""

    def __init__(self, frames: FrameSet, tally: Tally) -> None:
        self._frames = frames
        self._tally = tally
        self._alive = {name: _AliveCounter(frames.cycle_ns) for name in frames.by_name}

    def decode(self, arbitration_id: int, data: bytes, stamp_ns: int) -> Frame | Rejection:
        """One received frame; a rejection has been counted and has changed nothing else."""
        codec = self._frames.codecs.get(arbitration_id)
        if codec is None:
            is_error = bool(arbitration_id & ERROR_FLAG)
            return self._reject(BUS, Rejection.ERROR_FRAME if is_error else Rejection.UNKNOWN_ID)
        name = codec.name
        if len(data) != codec.length:
            return self._reject(name, Rejection.WRONG_LENGTH)
        if data != sealed(arbitration_id, data):
            return self._reject(name, Rejection.CHECKSUM)
        if int.from_bytes(data, "little") & codec.unused_bits:
            return self._reject(name, Rejection.UNUSED_BITS)
        values = codec.unpack(data)
        if values is None:
            return self._reject(name, Rejection.OUT_OF_RANGE)
        cycles = self._alive[name].advance(data[-2] & (_MODULUS - 1), stamp_ns)
        if cycles is None:
            return self._reject(name, Rejection.ALIVE_REPEATED)
        if cycles > 1:
            self._tally.add(name, Rejection.LOST, cycles - 1)
        return Frame(name, stamp_ns, cycles, values)

    def _reject(self, source: str, reason: Rejection) -> Rejection:
        self._tally.add(source, reason)
        return reason


class _AliveCounter:
    """How many cycles passed between accepted frames, from the 4-bit counter and the stamps."""

    def __init__(self, cycle_ns: int) -> None:
        self._cycle_ns = cycle_ns
        self._count: int | None = None
        self._accepted_ns = 0
        self._seen_ns = 0

    def advance(self, count: int, stamp_ns: int) -> int | None:
        """Cycles since the last accepted frame (0: this is the first); None: the counter stands still."""
        if self._count is None:
            cycles = 0
        else:
            cycles = (count - self._count) % _MODULUS
            # A sender stuck at one count keeps being seen, so its silence never grows to a turn.
            since_ns = self._seen_ns if cycles == 0 else self._accepted_ns
            excess = (stamp_ns - since_ns) / self._cycle_ns - cycles
            cycles += _MODULUS * max(0, int(excess / _MODULUS + (1.0 - _TURN_SHARE)))
            self._seen_ns = stamp_ns
            if cycles == 0:
                return None
        self._count = count
        self._accepted_ns = self._seen_ns = stamp_ns
        return cycles


def _find(database: Database, name: str, path: Path) -> Message:
    """The frame called ``name``, once it is sure to have what the code relies on."""
    try:
        message = database.get_message_by_name(name)
    except KeyError as error:
        raise InputError(f"dbc_file {path}: frame '{name}' is missing") from error
    places = {s.name: (s.start, s.length, s.byte_order) for s in message.signals}
    for signal in SIGNALS[name]:
        if signal not in places:
            raise InputError(f"dbc_file {path}: signal '{signal}' of frame '{name}' is missing")
    behind = 8 * message.length
    for signal, bits in ((_CHECKSUM, _CHECKSUM_BITS), (_ALIVE, _ALIVE_BITS)):
        behind -= bits
        if places.get(signal) != (behind, bits, "little_endian"):
            layout = f"{_ALIVE_BITS} bits alive_counter, {_CHECKSUM_BITS} bits checksum"
            raise InputError(f"dbc_file {path}: frame '{name}' must end in {layout}")
    return message


def _used_bits(message: Message) -> int:
    """The bits of a payload, read as a little-endian number, that belong to a signal."""
    full = {s.name: -1 if s.is_signed else (1 << s.length) - 1 for s in message.signals}
    return int.from_bytes(message.encode(full, scaling=False, strict=False), "little")
