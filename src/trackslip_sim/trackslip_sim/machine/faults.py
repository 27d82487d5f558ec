# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the emulated sensors: records with times, and the list of active faults.

    {sensor: watson, kind: power_cycle, start: 12.0, duration: 0.5}
    {sensor: sick, kind: corrupted_bytes, start: 20.0, duration: 5.0, value: 0.01}

Times are seconds of the drive: 0 at its begin, negative during the standstill before it. The effects are in
``faulty_line`` (bytes and frames), ``faulty_readings`` (measurements) and ``excavator`` (power).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from trackslip_common.errors import InputError
from trackslip_common.units import NS_PER_S
from trackslip_common.yaml_text import parse_yaml
from trackslip_common.yaml_tree import check_keys, number, text

CAN, WATSON, SICK, GNSS = SENSORS = ("can", "watson", "sick", "gnss")
_SERIAL = (WATSON, SICK, GNSS)
_MAX_DURATION = 86_400.0  # s
_KEYS = ("sensor", "kind", "start", "duration")
_NUMBERS = ("start", "duration", "value")


@dataclass(frozen=True)
class FaultKind:
    """A kind of fault: its sensors, and the meaning of ``value`` (0 < value ≤ largest; empty: no value)."""

    sensors: tuple[str, ...]
    value: str = ""
    largest: float = 1.0


POWER_CYCLE = "power_cycle"
UNPLUG = "unplug"
LOST_BYTES = "lost_bytes"
DOUBLED_BYTES = "doubled_bytes"
CORRUPTED_BYTES = "corrupted_bytes"
WRONG_BAUD = "wrong_baud"
BUS_OFF = "bus_off"
LOST_FRAMES = "lost_frames"
BURSTS = "bursts"
STUCK = "stuck"
NOISE = "noise"
POLLUTION = "pollution"
OCCLUSION = "occlusion"
GLARE = "glare"
RTK_FLOAT = "rtk_float"
CODE_ONLY = "code_only"
NO_FIX = "no_fix"
MULTIPATH = "multipath"
CLOCK_STEP = "clock_step"

_SHARE_OF_BYTES = "share of all bytes"
KINDS: Mapping[str, FaultKind] = MappingProxyType(
    {
        POWER_CYCLE: FaultKind(SENSORS),  # off for the duration, then boots
        UNPLUG: FaultKind(SENSORS),  # a serial port disappears, a bus is silent; the sensor keeps running
        LOST_BYTES: FaultKind(SENSORS, _SHARE_OF_BYTES),
        DOUBLED_BYTES: FaultKind(SENSORS, _SHARE_OF_BYTES),
        CORRUPTED_BYTES: FaultKind(SENSORS, _SHARE_OF_BYTES),
        WRONG_BAUD: FaultKind(_SERIAL),  # both ends receive noise
        BUS_OFF: FaultKind((CAN,)),  # an error frame, silence, then the error frame "restarted"
        LOST_FRAMES: FaultKind((CAN,), "share of all frames"),
        BURSTS: FaultKind(SENSORS, "s for which data are held back before they arrive at once", 60.0),
        STUCK: FaultKind(SENSORS),  # repeats the measurement at the fault's begin
        NOISE: FaultKind((CAN, WATSON, SICK), "standard deviation, as a share of full scale"),
        POLLUTION: FaultKind((SICK,)),
        OCCLUSION: FaultKind((SICK,), "rad around the middle beam that a near object covers", math.pi),
        GLARE: FaultKind((SICK,), "share of the rays lost to glare"),
        RTK_FLOAT: FaultKind((GNSS,)),  # ambiguities are no longer fixed
        CODE_ONLY: FaultKind((GNSS,)),  # corrections are lost
        NO_FIX: FaultKind((GNSS,)),  # too few satellites
        MULTIPATH: FaultKind((GNSS,), "m, error of the position to the east that is not stated", 100.0),
        CLOCK_STEP: FaultKind((GNSS,), "s by which its clock is ahead of UTC", 86_400.0),
    }
)


@dataclass(frozen=True)
class Fault:
    """One failure of one sensor.

    Raises:
        InputError: sensor or kind is unknown, the sensor has no such fault, or a number is out of range.
    """

    sensor: str
    kind: str
    start: float  # s of the drive
    duration: float  # s
    value: float = 0.0  # meaning and unit as in its ``FaultKind``

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"fault: kind '{self.kind}' is unknown; accepted: {', '.join(KINDS)}")
        kind = KINDS[self.kind]
        if self.sensor not in kind.sensors:
            raise InputError(
                f"fault: sensor '{self.sensor}' has no {self.kind}; accepted: {', '.join(kind.sensors)}"
            )
        if not 0.0 < self.duration <= _MAX_DURATION:
            raise InputError(
                f"fault: duration = {self.duration!r} is refused; accepted: > 0 and <= {_MAX_DURATION:g} s"
            )
        if not kind.value and self.value != 0.0:
            raise InputError(f"fault: value = {self.value!r} is refused; accepted: none for {self.kind}")
        if kind.value and not 0.0 < self.value <= kind.largest:
            raise InputError(
                f"fault: value = {self.value!r} is refused; "
                f"accepted for {self.kind}: > 0 and <= {kind.largest:g} ({kind.value})"
            )

    def __str__(self) -> str:
        """Text for diagnostics."""
        value = f" {self.value:g}" if self.value else ""
        return f"{self.sensor} {self.kind}{value} until {self.start + self.duration:.1f} s"


def read_fault(tree: Mapping[str, Any]) -> Fault:
    """A fault from the mapping of a scenario file.

    Raises:
        InputError: a key is missing or unknown, or a value is refused.
    """
    check_keys("fault", tree, _KEYS, ("value",))
    sensor, kind = (text(f"fault: {key}", tree[key]) for key in ("sensor", "kind"))
    numbers = {key: number(f"fault: {key}", value) for key, value in tree.items() if key in _NUMBERS}
    return Fault(sensor, kind, **numbers)


def parse_fault(yaml_text: str, now: float) -> Fault:
    """A fault from the text of one YAML mapping, as in a message; without ``start`` it begins at ``now``, s.

    Raises:
        InputError: the text is no YAML mapping, or its content is refused.
    """
    tree = parse_yaml(yaml_text, "fault")
    if not isinstance(tree, Mapping):
        raise InputError(f"fault: {yaml_text!r} is refused; accepted: a mapping of {', '.join(_KEYS)}, value")
    return read_fault({"start": now, **tree})


class Faults:
    """The faults of a drive, looked up by the emulator's clock.

    Args:
        faults: the faults of the scenario.
        drive_start_ns: clock time at which the time of the faults is 0.

    Attributes:
        added: number of faults added since.
    """

    def __init__(self, faults: tuple[Fault, ...], drive_start_ns: int) -> None:
        self._faults = list(faults)
        self._start_ns = drive_start_ns
        self.added = 0

    def __bool__(self) -> bool:
        """Whether any fault is active or pending."""
        return bool(self._faults)

    def add(self, fault: Fault, now_ns: int) -> None:
        """Add a fault; remove those that are over."""
        now = self.time(now_ns)
        self._faults = [earlier for earlier in self._faults if earlier.start + earlier.duration > now]
        self._faults.append(fault)
        self.added += 1

    def time(self, now_ns: int) -> float:
        """Seconds of the drive."""
        return (now_ns - self._start_ns) / NS_PER_S

    def active_fault(self, sensor: str, kind: str, now_ns: int) -> Fault | None:
        """The active fault of a kind; the one added last if there are several."""
        if not self._faults:
            return None
        now = self.time(now_ns)
        for fault in reversed(self._faults):
            if fault.sensor == sensor and fault.kind == kind and _is_active(fault, now):
                return fault
        return None

    def active_faults(self, now_ns: int) -> list[Fault]:
        """All active faults."""
        now = self.time(now_ns)
        return [fault for fault in self._faults if _is_active(fault, now)]


def _is_active(fault: Fault, now: float) -> bool:
    return fault.start <= now < fault.start + fault.duration
