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
    crc = _crc12(payload[:-2] + bytes((alive,)), _crc12_of_id(frame_id)) ^ _CRC_FINAL
    return payload[:-2] + (alive | crc << _ALIVE_BITS).to_bytes(2, "little")


def _crc12(data: bytes, crc: int = 0) -> int:
    """CRC-12/GSM, without its final XOR, continued from ``crc``."""
    for byte in data:
        crc = crc << 8 & 0xFFF ^ _CRC_TABLE[crc >> 4 ^ byte]
    return crc


@cache
def _crc12_of_id(frame_id: int) -> int:
    return _crc12(frame_id.to_bytes(4, "big"))


def _crc12_table() -> tuple[int, ...]:
    """The CRC of each byte."""
    table = []
    for byte in range(256):
        crc = byte << 4
        for _ in range(8):
            crc = crc << 1 ^ (_CRC_POLYNOMIAL if crc & 0x800 else 0)
        table.append(crc & 0xFFF)
    return tuple(table)


_CRC_POLYNOMIAL, _CRC_FINAL = 0xD31, 0xFFF
_CRC_TABLE = _crc12_table()


class _Checks(NamedTuple):
    """What is asked of each frame of a kind; cantools checks ranges only when encoding."""

    name: str
    length: int
    unused_bits: int  # of a payload, read as a little-endian number
    ranges: tuple[tuple[str, float, float], ...]  # signal, low, high

    @staticmethod
    def of(message: Message) -> "_Checks":
        """As the DBC has it."""
        signals = [message.get_signal_by_name(name) for name in SIGNALS[message.name]]
        ranges = tuple(
            (
                signal.name,
                -math.inf if signal.minimum is None else signal.minimum,
                math.inf if signal.maximum is None else signal.maximum,
            )
            for signal in signals
        )
        return _Checks(message.name, message.length, ~_used_bits(message), ranges)


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
        self.checks = {message.frame_id: _Checks.of(message) for message in self.by_name.values()}

    def encode(self, name: str, values: Mapping[str, float], alive_counter: int) -> tuple[int, bytes]:
        """(arbitration id, payload) of one frame.

        Raises:
            cantools.database.errors.EncodeError: a value lies outside the range that the DBC gives.
        """
        message = self.by_name[name]
        payload = message.encode({**values, _ALIVE: alive_counter % _MODULUS, _CHECKSUM: 0})
        return message.frame_id, sealed(message.frame_id, payload)


class FrameDecoder:
    """Accepts frames that pass every check, and knows what was lost between them."""

    def __init__(self, frames: FrameSet, tally: Tally) -> None:
        self._frames = frames
        self._tally = tally
        self._alive = {name: _AliveCounter(frames.cycle_ns) for name in frames.by_name}

    def decode(self, arbitration_id: int, data: bytes, stamp_ns: int) -> Frame | Rejection:
        """One received frame; a rejection has been counted and has changed nothing else."""
        checks = self._frames.checks.get(arbitration_id)
        if checks is None:
            is_error = bool(arbitration_id & ERROR_FLAG)
            return self._reject(BUS, Rejection.ERROR_FRAME if is_error else Rejection.UNKNOWN_ID)
        name = checks.name
        if len(data) != checks.length:
            return self._reject(name, Rejection.WRONG_LENGTH)
        if data != sealed(arbitration_id, data):
            return self._reject(name, Rejection.CHECKSUM)
        if int.from_bytes(data, "little") & checks.unused_bits:
            return self._reject(name, Rejection.UNUSED_BITS)
        signals = self._frames.by_id[arbitration_id].decode_simple(data, decode_choices=False)
        values = {signal: float(signals[signal]) for signal in SIGNALS[name]}  # type: ignore[arg-type]
        if any(not low <= values[signal] <= high for signal, low, high in checks.ranges):
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
