# SPDX-License-Identifier: Apache-2.0
"""From CAN frames to samples: sprockets from each encoder frame, hydraulics from each pressure frame."""

from enum import Enum

from trackslip_common.tally import Tally
from trackslip_drivers.can_parameters import CanDriverParameters
from trackslip_drivers.protocols.can_frames import (
    ENCODERS,
    PRESSURES,
    SPOOLS,
    Frame,
    FrameDecoder,
    FrameSet,
    Rejection,
)
from trackslip_drivers.protocols.encoder import EncoderEvent, SprocketEncoder
from trackslip_drivers.records import HydraulicsSample, SprocketSample
from trackslip_drivers.stamping import PeriodicStamps

_NS_PER_S = 1_000_000_000
_CLOCK_TOLERANCE = 1e-3  # of the sender's cycle on our clock: two crystals, and ours may be slewed
_PATIENCE = 200  # frames


class PairingRejection(Enum):
    """Why a good pressure frame gave no sample."""

    NO_SPOOLS = "no recent spools"


class ExcavatorCan:
    """Everything between the bus and the records; what it does not use is in ``tally``."""

    def __init__(self, parameters: CanDriverParameters, frames: FrameSet, tally: Tally) -> None:
        self.tally = tally
        self._decoder = FrameDecoder(frames, tally)
        self._offset_ns = round(parameters.time_offset * _NS_PER_S)
        self._spool_timeout_ns = round(parameters.spool_timeout * _NS_PER_S)
        self._left, self._right = (
            SprocketEncoder(
                parameters.belt_ratio,
                parameters.max_sprocket_speed,
                parameters.velocity_window,
                frames.cycle_ns / _NS_PER_S,
            )
            for _ in range(2)
        )
        self._spools: Frame | None = None
        self._stamps = {
            name: PeriodicStamps(frames.cycle_ns, _CLOCK_TOLERANCE, _PATIENCE)
            for name in (ENCODERS, PRESSURES)
        }

    def receive(
        self, arbitration_id: int, data: bytes, stamp_ns: int
    ) -> SprocketSample | HydraulicsSample | None:
        """One frame of the bus, received at ``stamp_ns``; None when it completes no sample."""
        frame = self._decoder.decode(arbitration_id, data, stamp_ns)
        if isinstance(frame, Rejection):
            return None
        if frame.name == SPOOLS:
            self._spools = frame
            return None
        stamp_ns = self._stamps[frame.name].filter(frame.stamp_ns, frame.cycles) + self._offset_ns
        return (self._sprockets if frame.name == ENCODERS else self._hydraulics)(frame, stamp_ns)

    def _sprockets(self, frame: Frame, stamp_ns: int) -> SprocketSample | None:
        """Both sprockets, or None while either has no motion."""
        left = self._left.update(int(frame.values["left_count"]), frame.cycles)
        right = self._right.update(int(frame.values["right_count"]), frame.cycles)
        for side, motion in (("left_encoder", left), ("right_encoder", right)):
            if isinstance(motion, EncoderEvent):
                self.tally.add(side, motion)
        if isinstance(left, EncoderEvent) or isinstance(right, EncoderEvent):
            return None
        return SprocketSample(stamp_ns, left.position, right.position, left.velocity, right.velocity)

    def _hydraulics(self, frame: Frame, stamp_ns: int) -> HydraulicsSample | None:
        """Pressures with the spools of the same cycle, or of one not long before if that frame was lost."""
        spools = self._spools
        if spools is None or abs(frame.stamp_ns - spools.stamp_ns) > self._spool_timeout_ns:
            self.tally.add(PRESSURES, PairingRejection.NO_SPOOLS)
            return None
        return HydraulicsSample(
            stamp_ns,
            frame.values["left_pressure"],
            frame.values["right_pressure"],
            spools.values["left_spool"],
            spools.values["right_spool"],
            frame.values["supply_pressure"],
        )
