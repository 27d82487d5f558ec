# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Converts CAN frames to samples according to the roles.

A sample is made when all frames with its leading roles have arrived since the previous sample. Leading are
both sprockets; all pressures (spools if there is no pressure); the swing. So an output has the rate of its
slowest leading frame. Other roles contribute their newest value, not older than ``pairing_timeout``. The
stamp is that of the newest leading frame; an older sprocket position is extrapolated to it by its velocity.
"""

import math
from abc import ABC, abstractmethod
from collections import defaultdict
from dataclasses import dataclass
from enum import Enum

from trackslip_common.tally import Tally
from trackslip_common.units import NS_PER_S
from trackslip_drivers.can_parameters import CanDriverParameters
from trackslip_drivers.protocols.can_binding import PositionSignal, ScaledSignal, SignalId
from trackslip_drivers.protocols.can_codec import Value
from trackslip_drivers.protocols.can_frames import FrameDecoder, FrameSet, Rejection
from trackslip_drivers.protocols.can_roles import MOTIONS, SIDES, SPOOLS, SUPPLY, SWING
from trackslip_drivers.protocols.can_timing import Frame
from trackslip_drivers.protocols.encoder import EncoderEvent, Motion, SprocketEncoder
from trackslip_drivers.records import HydraulicsSample, SprocketSample, SwingSample

Sample = SprocketSample | HydraulicsSample | SwingSample
"""What the bus measures."""

_NEVER_NS = -(2**62)  # before all stamps
_PRESSURES = tuple(f"{side}_pressure" for side in SIDES)
_HYDRAULIC_ROLES = (*_PRESSURES, *SPOOLS, SUPPLY)


class PairingRejection(Enum):
    """Why an accepted frame gave no sample."""

    TOO_OLD = "no recent value of the other frame"


class ExcavatorCan:
    """Decodes the frames of the bus to samples; unused frames are counted in ``tally``.

    Attributes:
        frames: type of a sample that the roles provide → names of the frames that it needs.
        kinds: the same types.
        main_kind: the type that the driver monitors: sprockets, or the first of the rest.
    """

    def __init__(self, parameters: CanDriverParameters, frames: FrameSet, tally: Tally) -> None:
        self.decoder = FrameDecoder(frames, tally)
        self.tally = tally
        self._offset_ns = round(parameters.time_offset * NS_PER_S)
        self._outputs: list[_Output] = []
        if any(f"left_{what}" in frames.roles for what in MOTIONS):
            self._outputs.append(_Sprockets(parameters, frames, tally))
        if frames.roles.keys() & set(_HYDRAULIC_ROLES):
            self._outputs.append(_Hydraulics(parameters, frames, tally))
        if SWING in frames.roles:
            self._outputs.append(_Swing(parameters, frames, tally))

        self._by_frame = {
            name: [output for output in self._outputs if name in output.frames] for name in frames.codecs
        }
        self.frames: dict[type, set[str]] = {output.kind: set(output.frames) for output in self._outputs}
        self.kinds = [output.kind for output in self._outputs]
        self.main_kind = self.kinds[0]

    @property
    def period(self) -> float:
        """Time between samples of the main kind, s; 0 while unknown."""
        return max(map(self.decoder.cycle_ns, self._outputs[0].leading_frames), default=0.0) / NS_PER_S

    def receive(self, arbitration_id: int, data: bytes, stamp_ns: int) -> list[Sample]:
        """The samples completed by a frame of the bus received at ``stamp_ns``."""
        frames = self.decoder.decode(arbitration_id, data, stamp_ns)
        if isinstance(frames, Rejection):
            return []
        outputs = ((output, frame) for frame in frames for output in self._by_frame[frame.name])
        samples = [sample for output, frame in outputs if (sample := output.receive(frame))]
        if self._offset_ns:
            samples = [sample._replace(stamp_ns=sample.stamp_ns + self._offset_ns) for sample in samples]
        return samples

    def resume(self) -> None:
        """After the bus is reopened: continue positions by the elapsed time."""
        self.decoder.resume()


@dataclass(slots=True, eq=False)
class _Reading:
    """The newest value of a signal."""

    role: str
    signal_id: SignalId
    is_leading: bool
    encoder: SprocketEncoder | None  # for positions
    motion: Motion | EncoderEvent = EncoderEvent.STARTED  # from the encoder
    value: Value = math.nan
    stamp_ns: int = _NEVER_NS
    elapsed_ns: int = 0  # sender's time since ``value``
    is_fresh: bool = False  # received since the previous sample


class _Output(ABC):
    """One kind of sample, composed of the newest values of its roles."""

    kind: type[Sample]
    leading: tuple[str, ...]
    others: tuple[str, ...] = ()

    def __init__(self, p: CanDriverParameters, frames: FrameSet, tally: Tally) -> None:
        self.tally = tally
        self._timeout_ns = round(p.pairing_timeout * NS_PER_S)
        self.bindings = frames.bindings
        self.readings: dict[str, list[_Reading]] = {}
        self._parts: dict[str, tuple[tuple[_Reading, ScaledSignal], ...]] = {}
        for role in (*self.leading, *self.others):
            is_leading = role in self.leading
            if (position := self.bindings.position_signals.get(role)) is not None:
                encoder = _make_encoder(position, p)
                self.readings[role] = [_Reading(role, position.signal_id, is_leading, encoder)]
            elif (parts := self.bindings.scaled_signals.get(role)) is not None:
                self.readings[role] = [_Reading(role, part.signal_id, is_leading, None) for part in parts]
                self._parts[role] = tuple(zip(self.readings[role], parts, strict=True))
        all_readings = [reading for readings in self.readings.values() for reading in readings]
        self._leading = [reading for reading in all_readings if reading.is_leading]
        self._others = [reading for reading in all_readings if not reading.is_leading]
        self._missing = len(self._leading)  # leading readings not received since the previous sample
        self.leading_frames = {reading.signal_id.frame for reading in self._leading}
        self._by_frame: defaultdict[str, list[_Reading]] = defaultdict(list)
        for reading in all_readings:
            self._by_frame[reading.signal_id.frame].append(reading)
        self.frames = self._by_frame.keys()

    def receive(self, frame: Frame) -> Sample | None:
        """Store the values of a frame; returns the sample if the frame completes one."""
        name, source, stamp_ns, elapsed_ns, values = frame
        has_leading = False
        for reading in self._by_frame[name]:
            _, signal, sender = reading.signal_id
            if sender not in (-1, source):
                continue
            reading.elapsed_ns += elapsed_ns
            value = values.get(signal)
            if value is None:
                continue  # not selected by the multiplexer
            reading.value, reading.stamp_ns = value, stamp_ns
            if reading.encoder is not None:
                reading.motion = reading.encoder.update(value, reading.elapsed_ns)
                self._count_encoder_event(reading)
            reading.elapsed_ns = 0
            if reading.is_leading:
                has_leading = True
                self._missing -= not reading.is_fresh
                reading.is_fresh = True
        return self._complete_sample() if has_leading and not self._missing else None

    def _complete_sample(self) -> Sample | None:
        """The sample of the leading values, all of them present; None if another value is too old."""
        for reading in self._leading:
            reading.is_fresh = False
        self._missing = len(self._leading)
        stamp_ns = max([reading.stamp_ns for reading in self._leading])
        for reading in self._others:
            if abs(stamp_ns - reading.stamp_ns) > self._timeout_ns:
                self.tally.add(self.kind.__name__, PairingRejection.TOO_OLD)
                return None
        return self.make_sample(stamp_ns)

    def si_value(self, role: str) -> float:
        """The value of a role in SI; nan if the role has no signal."""
        parts = self._parts.get(role)
        if not parts:
            return math.nan
        total = 0.0
        for reading, part in parts:
            total += part.si_value(reading.value)
        return total

    def _count_encoder_event(self, reading: _Reading) -> None:
        """Count an encoder event, or a motion without a position; any encoder starts with a first reading."""
        event = reading.motion
        if event is EncoderEvent.STARTED:
            return
        if isinstance(event, Motion):
            if not math.isnan(event.position):
                return
            event = EncoderEvent.DISTANCE_UNKNOWN
        self.tally.add(f"{reading.role.removesuffix('_position')}_encoder", event)

    @abstractmethod
    def make_sample(self, stamp_ns: int) -> Sample | None:
        """A sample of the present values, or None."""


def _make_encoder(position: PositionSignal, p: CanDriverParameters) -> SprocketEncoder:
    return SprocketEncoder(
        position.rad_per_step, position.steps_per_wrap, p.max_sprocket_speed, p.velocity_window
    )


class _Sprockets(_Output):
    kind = SprocketSample
    leading = tuple(f"{side}_{what}" for side in SIDES for what in MOTIONS)

    def __init__(self, p: CanDriverParameters, frames: FrameSet, tally: Tally) -> None:
        super().__init__(p, frames, tally)
        self._sides = sorted(self.readings)  # left before right

    def make_sample(self, stamp_ns: int) -> SprocketSample | None:
        """Both sprockets, or None while either has no motion."""
        sides = []
        for role in self._sides:
            reading = self.readings[role][0]
            motion = reading.motion if reading.encoder else Motion(math.nan, self.si_value(role))
            if isinstance(motion, EncoderEvent):
                return None
            delay = (stamp_ns - reading.stamp_ns) / NS_PER_S
            sides.append((motion.position + motion.velocity * delay, motion.velocity))
        (left, left_velocity), (right, right_velocity) = sides
        if math.isnan(left) or math.isnan(right):
            left = right = math.nan
        return SprocketSample(stamp_ns, left, right, left_velocity, right_velocity)


class _Hydraulics(_Output):
    kind = HydraulicsSample

    def __init__(self, p: CanDriverParameters, frames: FrameSet, tally: Tally) -> None:
        groups = (_PRESSURES, SPOOLS, (SUPPLY,))
        present = [group for group in groups if group[0] in frames.roles]
        self.leading, self.others = present[0], tuple(role for group in present[1:] for role in group)
        super().__init__(p, frames, tally)

    def make_sample(self, stamp_ns: int) -> HydraulicsSample:
        """Pressures and spools."""
        return HydraulicsSample(stamp_ns, *map(self.si_value, _HYDRAULIC_ROLES))


class _Swing(_Output):
    kind = SwingSample
    leading = (SWING,)

    def make_sample(self, stamp_ns: int) -> SwingSample | None:
        """The absolute angle in [−π, π] and its velocity; None while there is no velocity."""
        (reading,), position = self.readings[SWING], self.bindings.position_signals[SWING]
        if isinstance(reading.motion, EncoderEvent):
            return None
        angle = (reading.value - position.zero_steps) * position.rad_per_step
        return SwingSample(stamp_ns, math.remainder(angle, 2.0 * math.pi), reading.motion.velocity)
