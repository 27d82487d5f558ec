# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The excavator's valve controller on the CAN bus: three frames per cycle as in ``config/excavator.dbc``."""

import math
from collections import Counter, deque
from collections.abc import Callable, Mapping

from trackslip_drivers.protocols.can_frames import FrameSet
from trackslip_drivers.records import HydraulicsSample, SprocketSample

ENCODERS, SPOOLS, PRESSURES = "encoders", "spools", "pressures"  # the frames, in the order sent

_MAX_STAMPS = 10_000


class CanDevice:
    """Samples and sends each cycle; readings saturate at a signal's range, as those of transducers do.

    Args:
        frames: the frames of the DBC file.
        sprockets: true sprockets at a stamp; the encoders measure their positions.
        hydraulics: true pressures and spools at a stamp.
        start_ns: time of the first cycle.

    Attributes:
        frames_emitted: number of frames per name.
        stamps: stamps of the latest cycles, ns.
    """

    def __init__(
        self,
        frames: FrameSet,
        sprockets: Callable[[int], SprocketSample],
        hydraulics: Callable[[int], HydraulicsSample],
        start_ns: int,
    ) -> None:
        self.frames_emitted: Counter[str] = Counter()
        self.stamps: deque[int] = deque(maxlen=_MAX_STAMPS)
        self._frames = frames
        self._limits = {
            name: [(signal, field.low, field.high) for signal, field in frames.codecs[name].fields.items()]
            for name in (SPOOLS, PRESSURES)
        }
        encoder = frames.roles["left_position"]
        self._counts_per_rad = encoder.counts_per_turn * encoder.ratio / (2.0 * math.pi)
        self._counts = round(encoder.counts_per_turn)
        self._cycle_ns = frames.codecs[ENCODERS].nominal_ns
        self._sprockets = sprockets
        self._hydraulics = hydraulics
        self.start(start_ns)

    def start(self, start_ns: int) -> None:
        """Restart after a loss of power; the first cycle is at ``start_ns``."""
        self._next_ns = start_ns
        self._alive_counter = 0

    @property
    def next_ns(self) -> int:
        """Time of the next cycle."""
        return self._next_ns

    def step(self, now_ns: int) -> list[tuple[int, bytes]]:
        """(arbitration id, payload) of every frame due by now and not yet sent."""
        sent: list[tuple[int, bytes]] = []
        while self._next_ns <= now_ns:
            for name, values in self._frame_signals(self._next_ns):
                sent.append(self._frames.encode(name, values, self._alive_counter))
                self.frames_emitted[name] += 1
            self.stamps.append(self._next_ns)
            self._alive_counter += 1
            self._next_ns += self._cycle_ns
        return sent

    def _frame_signals(self, stamp_ns: int) -> tuple[tuple[str, Mapping[str, float]], ...]:
        """Signals of the three frames, in the order sent."""
        sprockets, hydraulics = self._sprockets(stamp_ns), self._hydraulics(stamp_ns)
        counts = {
            "left_count": self._encoder_count(sprockets.left_position),
            "right_count": self._encoder_count(sprockets.right_position),
        }
        levels = hydraulics._asdict()
        return (ENCODERS, counts), *((name, self._saturate(name, levels)) for name in (SPOOLS, PRESSURES))

    def _encoder_count(self, position: float) -> int:
        """Raw count of an encoder at sprocket angle ``position``, rad."""
        return math.floor(position * self._counts_per_rad) % self._counts

    def _saturate(self, frame: str, levels: Mapping[str, float]) -> Mapping[str, float]:
        """The signals of a frame, limited to the ranges of the DBC."""
        return {name: min(max(levels[name], low), high) for name, low, high in self._limits[frame]}
