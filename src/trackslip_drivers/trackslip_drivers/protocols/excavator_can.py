# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""From CAN frames to samples, as the roles say.

A sample is made when all frames with its leading roles have come since the sample before: sprockets when
both sides have, hydraulics when all pressures have (spools where there is no pressure), the swing with its
own frame. So an output has the rate of the slowest of its leading frames. What it has from other frames is
the newest there, not older than ``pairing_timeout``. Its stamp is that of the newest leading frame; a
sprocket that was read before is carried on to it by its velocity.
"""

import math
from abc import ABC, abstractmethod
from collections import defaultdict
from enum import Enum

from trackslip_common.tally import Tally
from trackslip_drivers.can_parameters import CanDriverParameters
from trackslip_drivers.protocols.can_binding import Place, Turned
from trackslip_drivers.protocols.can_codec import Value
from trackslip_drivers.protocols.can_frames import Frame, FrameDecoder, FrameSet, Rejection
from trackslip_drivers.protocols.can_roles import MOTIONS, SIDES, SUPPLY, SWING
from trackslip_drivers.protocols.encoder import EncoderEvent, Motion, SprocketEncoder
from trackslip_drivers.records import HydraulicsSample, SprocketSample, SwingSample

Sample = SprocketSample | HydraulicsSample | SwingSample
"""What the bus measures."""

_NS_PER_S = 1_000_000_000
_SPOOLS = tuple(f"{side}_spool" for side in SIDES)
_PRESSURES = tuple(f"{side}_pressure" for side in SIDES)


class PairingRejection(Enum):
    """Why a good frame gave no sample."""

    TOO_OLD = "nothing recent to go with it"


class ExcavatorCan:
    """Everything between the bus and the records; what it does not use is in ``tally``.

    Attributes:
        kinds: of the samples that the roles make.
        main_kind: what the driver is there for: sprockets, or the first of the rest.
    """

    def __init__(self, parameters: CanDriverParameters, frames: FrameSet, tally: Tally) -> None:
        self.decoder = FrameDecoder(frames, tally)
        self.tally = tally
        self._offset_ns = round(parameters.time_offset * _NS_PER_S)
        self._outputs: list[_Output] = []
        if any(f"left_{what}" in frames.roles for what in MOTIONS):
            self._outputs.append(_Sprockets(parameters, frames, tally))
        if frames.roles.keys() & {*_PRESSURES, *_SPOOLS, SUPPLY}:
            self._outputs.append(_Hydraulics(parameters, frames, tally))
        if SWING in frames.roles:
            self._outputs.append(_Swing(parameters, frames, tally))

        self._by_frame = {
            name: [output for output in self._outputs if name in output.frames] for name in frames.codecs
        }
        self.kinds = [output.kind for output in self._outputs]
        self.main_kind = self.kinds[0]

    @property
    def period(self) -> float:
        """Time between samples of the main kind, s; 0 while it is not known."""
        return max(map(self.decoder.cycle_ns, self._outputs[0].leading_frames), default=0.0) / _NS_PER_S

    def receive(self, arbitration_id: int, data: bytes, stamp_ns: int) -> list[Sample]:
        """One frame of the bus, received at ``stamp_ns``; the samples that it completes."""
        frames = self.decoder.decode(arbitration_id, data, stamp_ns)
        if isinstance(frames, Rejection):
            return []
        found = [output.receive(frame) for frame in frames for output in self._by_frame[frame.name]]
        return [sample._replace(stamp_ns=sample.stamp_ns + self._offset_ns) for sample in found if sample]

    def resume(self) -> None:
        """The bus was opened anew: positions go on, by the time that passed."""
        self.decoder.resume()


class _Output(ABC):
    """One kind of sample, made of the newest values of its roles."""

    kind: type[Sample]
    leading: tuple[str, ...]
    others: tuple[str, ...] = ()

    def __init__(self, p: CanDriverParameters, frames: FrameSet, tally: Tally) -> None:
        self.tally = tally
        self._timeout_ns = round(p.pairing_timeout * _NS_PER_S)
        bindings = frames.bindings
        self.parts = {r: bindings.scaled[r] for r in (*self.leading, *self.others) if r in bindings.scaled}
        self.turned = {r: bindings.turned[r] for r in self.leading if r in bindings.turned}
        self.places = {role: [part.place for part in parts] for role, parts in self.parts.items()}
        self.places |= {role: [turned.place] for role, turned in self.turned.items()}
        self._leading = {place for role in self.leading for place in self.places.get(role, ())}
        self._others = {place for role in self.others for place in self.places.get(role, ())}
        self.leading_frames = {place.frame for place in self._leading}
        self._by_frame: defaultdict[str, list[Place]] = defaultdict(list)
        for place in (*self._leading, *self._others):
            self._by_frame[place.frame].append(place)
        self.frames = self._by_frame.keys()
        self._elapsed_ns: defaultdict[Place, int] = defaultdict(int)  # since the value in hand
        self._fresh: set[Place] = set()
        self.values: dict[Place, Value] = {}
        self.stamps_ns: dict[Place, int] = {}

    def receive(self, frame: Frame) -> Sample | None:
        """Take what is in the frame; the sample, if it completes one."""
        has_come = False
        for place in self._by_frame[frame.name]:
            if place.source not in (-1, frame.source):
                continue
            self._elapsed_ns[place] += frame.elapsed_ns
            value = frame.values.get(place.signal)
            if value is None:
                continue  # the multiplexer has others
            self.values[place], self.stamps_ns[place] = value, frame.stamp_ns
            self.take(place, value, self._elapsed_ns.pop(place))
            if place in self._leading:
                has_come = True
                self._fresh.add(place)
        if not has_come or len(self._fresh) < len(self._leading):
            return None
        self._fresh.clear()
        stamp_ns = max(self.stamps_ns[place] for place in self._leading)
        if self._others and any(self._is_old(place, stamp_ns) for place in self._others):
            self.tally.add(self.kind.__name__, PairingRejection.TOO_OLD)
            return None
        return self.make(stamp_ns)

    def _is_old(self, place: Place, stamp_ns: int) -> bool:
        return place not in self.stamps_ns or abs(stamp_ns - self.stamps_ns[place]) > self._timeout_ns

    def si(self, role: str) -> float:
        """The value of a role; nan where there is none of it."""
        parts = self.parts.get(role, ())
        return sum((part.si(self.values[part.place]) for part in parts), 0.0) if parts else math.nan

    def take(self, place: Place, value: Value, elapsed_ns: int) -> None:  # noqa: B027 (nothing, as a rule)
        """A new value, so long after the one before."""

    @abstractmethod
    def make(self, stamp_ns: int) -> Sample | None:
        """A sample of the values in hand."""


class _Turning(_Output):
    """With encoders."""

    def __init__(self, p: CanDriverParameters, frames: FrameSet, tally: Tally) -> None:
        super().__init__(p, frames, tally)
        self._encoders = {turned.place: (role, _encoder(turned, p)) for role, turned in self.turned.items()}
        self.motions: dict[str, Motion | EncoderEvent] = {}  # by role

    def take(self, place: Place, value: Value, elapsed_ns: int) -> None:
        """One reading of an encoder."""
        if place not in self._encoders:
            return
        role, encoder = self._encoders[place]
        motion = self.motions[role] = encoder.update(value, elapsed_ns)
        event = motion
        if isinstance(event, Motion):
            if not math.isnan(event.position):
                return
            event = EncoderEvent.BROKEN
        self.tally.add(f"{role.removesuffix('_position')}_encoder", event)


def _encoder(turned: Turned, p: CanDriverParameters) -> SprocketEncoder:
    return SprocketEncoder(
        turned.rad_per_step, turned.steps_per_wrap, p.max_sprocket_speed, p.velocity_window
    )


class _Sprockets(_Turning):
    kind = SprocketSample
    leading = tuple(f"{side}_{what}" for side in SIDES for what in MOTIONS)

    def make(self, stamp_ns: int) -> SprocketSample | None:
        """Both sprockets, or None while either has no motion."""
        sides = []
        for role, (place, *_) in self.places.items():
            motion = self.motions[role] if role in self.turned else Motion(math.nan, self.si(role))
            if isinstance(motion, EncoderEvent):
                return None
            later = (stamp_ns - self.stamps_ns[place]) / _NS_PER_S
            sides.append((role, motion.position + motion.velocity * later, motion.velocity))
        (_, left, left_velocity), (_, right, right_velocity) = sorted(sides)
        if math.isnan(left) or math.isnan(right):
            left = right = math.nan
        return SprocketSample(stamp_ns, left, right, left_velocity, right_velocity)


class _Hydraulics(_Output):
    kind = HydraulicsSample

    def __init__(self, p: CanDriverParameters, frames: FrameSet, tally: Tally) -> None:
        levels = (_PRESSURES, _SPOOLS, (SUPPLY,))
        there = [level for level in levels if level[0] in frames.roles]
        self.leading, self.others = there[0], tuple(role for level in there[1:] for role in level)
        super().__init__(p, frames, tally)

    def make(self, stamp_ns: int) -> HydraulicsSample:
        """Pressures and what goes with them."""
        return HydraulicsSample(stamp_ns, *map(self.si, (*_PRESSURES, *_SPOOLS, SUPPLY)))


class _Swing(_Turning):
    kind = SwingSample
    leading = (SWING,)

    def make(self, stamp_ns: int) -> SwingSample | None:
        """The angle as it is read; None while there is no velocity."""
        motion, turned = self.motions[SWING], self.turned[SWING]
        if isinstance(motion, EncoderEvent):
            return None
        angle = (self.values[turned.place] - turned.zero_steps) * turned.rad_per_step
        return SwingSample(stamp_ns, math.remainder(angle, 2.0 * math.pi), motion.velocity)
