# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of transmission: bytes on a serial line, frames on a CAN bus."""

from collections.abc import Sequence
from functools import partial
from typing import Generic, TypeVar

import numpy as np

from trackslip_drivers.protocols.can_frames import ERROR_FLAG
from trackslip_sim.machine import faults as f
from trackslip_sim.machine.faults import Fault, Faults

T = TypeVar("T")
Frame = tuple[int, bytes]  # (arbitration id, payload)

BUS_OFF_FRAME: Frame = (ERROR_FLAG | 0x40, bytes(8))
RESTARTED_FRAME: Frame = (ERROR_FLAG | 0x100, bytes(8))
_FRAME_LENGTH = 8  # largest payload, bytes


class _BurstBuffer(Generic[T]):
    """Passes items through, or holds them until the next multiple of the fault's value."""

    def __init__(self) -> None:
        self._buffer: list[T] = []
        self._burst = 0

    def __bool__(self) -> bool:
        """Whether any item is held."""
        return bool(self._buffer)

    def transmit(self, items: Sequence[T], fault: Fault | None, now: float) -> list[T]:
        """The items released at ``now``, s."""
        self._buffer += items
        burst = 0 if fault is None else int((now - fault.start) / fault.value)
        if fault is not None and burst == self._burst:
            return []
        self._burst = burst
        out, self._buffer = self._buffer, []
        return out


class _FaultyLine(Generic[T]):
    """What carries the items of one sensor to the host, with the faults of the sensor."""

    def __init__(self, sensor: str, faults: Faults, seed: int) -> None:
        self._faults = faults
        self._active_fault = partial(faults.active_fault, sensor)
        self._random = np.random.default_rng(seed)
        self._buffer: _BurstBuffer[T] = _BurstBuffer()

    def _corrupt(self, data: bytes, now_ns: int) -> bytes:
        """The bytes as they arrive: dropped, doubled and changed at the rates of the faults."""
        if not data:
            return data
        if lost := self._active_fault(f.LOST_BYTES, now_ns):
            affected = self._draw_affected(data, lost)
            data = bytes(byte for byte, is_lost in zip(data, affected, strict=True) if not is_lost)
        if doubled := self._active_fault(f.DOUBLED_BYTES, now_ns):
            affected = self._draw_affected(data, doubled)
            data = b"".join(bytes((byte,)) * (1 + twice) for byte, twice in zip(data, affected, strict=True))
        if corrupted := self._active_fault(f.CORRUPTED_BYTES, now_ns):
            data = corrupt_bytes(data, corrupted.value, self._random)
        return data

    def _draw_affected(self, data: bytes, fault: Fault) -> list[bool]:
        """Whether each byte is affected."""
        affected: list[bool] = (self._random.random(len(data)) < fault.value).tolist()
        return affected


class FaultySerial(_FaultyLine[int]):
    """The line from a serial sensor to the host."""

    def transmit(self, data: bytes, now_ns: int) -> bytes:
        """The bytes that arrive now."""
        if not self._faults and not self._buffer:
            return data
        if self._active_fault(f.UNPLUG, now_ns) is not None:
            return b""
        if self._active_fault(f.WRONG_BAUD, now_ns) is not None:
            data = self._random.bytes(len(data))
        data = self._corrupt(data, now_ns)
        bursts = self._active_fault(f.BURSTS, now_ns)
        return bytes(self._buffer.transmit(data, bursts, self._faults.time(now_ns)))


class FaultyBus(_FaultyLine[Frame]):
    """The CAN bus from the valve controller to its listeners; byte faults change the payloads."""

    def __init__(self, sensor: str, faults: Faults, seed: int) -> None:
        super().__init__(sensor, faults, seed)
        self._is_off = False

    def transmit(self, frames: Sequence[Frame], now_ns: int) -> list[Frame]:
        """The frames on the bus now."""
        if not (self._faults or self._buffer or self._is_off):
            return list(frames)
        was_off, self._is_off = self._is_off, self._active_fault(f.BUS_OFF, now_ns) is not None
        if self._is_off:
            return [] if was_off else [BUS_OFF_FRAME]
        lost = self._active_fault(f.LOST_FRAMES, now_ns)
        if self._active_fault(f.UNPLUG, now_ns) is not None:
            frames = []
        elif lost is not None:
            frames = [frame for frame in frames if self._random.random() >= lost.value]
        frames = [(number, self._corrupt(data, now_ns)[:_FRAME_LENGTH]) for number, data in frames]
        out = self._buffer.transmit(frames, self._active_fault(f.BURSTS, now_ns), self._faults.time(now_ns))
        return [RESTARTED_FRAME, *out] if was_off else out


def corrupt_bytes(data: bytes, rate: float, random: np.random.Generator) -> bytes:
    """The bytes, each changed to a random other one with probability ``rate``."""
    values = np.frombuffer(data, dtype=np.uint8)
    change = random.integers(1, 256, len(values), dtype=np.uint8)
    hit = random.random(len(values)) < rate
    return np.where(hit, values ^ change, values).astype(np.uint8).tobytes()
