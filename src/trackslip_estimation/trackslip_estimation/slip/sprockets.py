# SPDX-License-Identifier: Apache-2.0
"""What the sprockets did over time, told from their samples, whatever the order in which these came.

A stretch lies between two samples. Where it is longer than the timeout, its first part (as long as the
timeout) is taken to go on as the stretch before; the rest is *silence*: how fast the sprockets turned in
it is unknown, whatever the positions at its ends say (a driver that was restarted counts from elsewhere).
Beyond the newest sample it is the same.
"""

from bisect import bisect_left, bisect_right

from trackslip_estimation.slip.measurements import Sprockets
from trackslip_estimation.slip.motion import STANDSTILL, Speeds


class SprocketTrack:
    """The sprocket samples in stamp order, to be asked for the mean speed over a stretch."""

    def __init__(self, timeout_ns: int, max_speed: float) -> None:
        """``max_speed``, rad/s: positions that ask for more have jumped, speeds above it are no speeds."""
        self._timeout_ns = timeout_ns
        self._max_speed = max_speed
        self._stamps: list[int] = []
        self._samples: list[Sprockets] = []

    def add(self, sample: Sprockets) -> None:
        """Put a sample in its place; of two with the same stamp the first counts."""
        at = bisect_left(self._stamps, sample.stamp_ns)
        if self._stamps[at : at + 1] == [sample.stamp_ns]:
            return
        self._stamps.insert(at, sample.stamp_ns)
        self._samples.insert(at, sample)

    def forget_before(self, stamp_ns: int) -> None:
        """Drop what the speeds from ``stamp_ns`` on do not need: all before the stretch before it."""
        keep = max(min(bisect_left(self._stamps, stamp_ns) - 2, len(self._stamps) - 2), 0)
        del self._stamps[:keep], self._samples[:keep]

    def last_before(self, stamp_ns: int) -> int | None:
        """Stamp of the last sample strictly before ``stamp_ns``."""
        at = bisect_left(self._stamps, stamp_ns)
        return self._stamps[at - 1] if at else None

    def stretch(self, end_ns: int) -> tuple[Speeds, int]:
        """Mean speeds over the stretch between samples in which ``end_ns`` lies, and until when they hold.

        They hold until ``end_ns``, or until an earlier stamp beyond which there is silence: then the speeds
        are those of a sample at ``end_ns`` itself, or as at a standstill.

        Speeds come from the difference of positions where there are positions and they do not jump; else
        they are the measured ones of the sample that closes the stretch.
        """
        at = bisect_left(self._stamps, end_ns)
        if at == 0:
            known = self._between(0) if self._samples else None
            return (STANDSTILL, min(0, end_ns - 1)) if known is None else (known, end_ns)
        begins_ns = self._stamps[at - 1]
        new = at == len(self._stamps)
        if not new and self._stamps[at] - begins_ns <= self._timeout_ns:
            known = self._between(at)
            return (STANDSTILL, begins_ns) if known is None else (known, end_ns)
        known = self._between(at - 1)
        known_ns = begins_ns if known is None else min(end_ns, begins_ns + self._timeout_ns)
        if known is None or known_ns < end_ns:
            closes = not new and self._stamps[at] == end_ns
            return (self._between(at) if closes else None) or STANDSTILL, known_ns
        return known, end_ns

    def jumps(self, stamp_ns: int) -> bool:
        """Whether the positions of the sample with this stamp are not the continuation of those before."""
        at = bisect_left(self._stamps, stamp_ns)
        return (
            at > 0 and not self._is_long(at) and self._differences(at) is not None and not self._is_sound(at)
        )

    def contradicts(self, sample: Sprockets) -> bool:
        """Whether its positions cannot be reached from those of the last sample at or before its stamp."""
        at = bisect_right(self._stamps, sample.stamp_ns)
        if at == 0:
            return False
        before = self._samples[at - 1]
        elapsed_ns = sample.stamp_ns - before.stamp_ns
        if before.positions is None or sample.positions is None or elapsed_ns > self._timeout_ns:
            return False
        turned = (abs(b - a) for a, b in zip(before.positions, sample.positions, strict=True))
        return max(turned) > self._max_speed * elapsed_ns * 1e-9

    def _between(self, at: int) -> Speeds | None:
        """Mean speeds over the stretch that sample ``at`` closes; None where it does not tell."""
        sample = self._samples[at]
        stretch = min(sample.stamp_ns - self._stamps[max(at - 1, 0)], self._timeout_ns) * 1e-9
        if at > 0 and not self._is_long(at) and self._is_sound(at):
            differences = self._differences(at)
            assert differences is not None
            return Speeds(*differences, stretch, differenced=True)
        if max(abs(sample.left_speed), abs(sample.right_speed)) > self._max_speed:
            return None
        return Speeds(sample.left_speed, sample.right_speed, stretch, differenced=False)

    def _is_long(self, at: int) -> bool:
        """Whether sample ``at`` closes a stretch that holds silence."""
        return at > 0 and self._stamps[at] - self._stamps[at - 1] > self._timeout_ns

    def _is_sound(self, at: int) -> bool:
        differences = self._differences(at)
        return differences is not None and max(map(abs, differences)) <= self._max_speed

    def _differences(self, at: int) -> tuple[float, float] | None:
        """Differences of the positions over time, rad/s."""
        a, b = self._samples[at - 1], self._samples[at]
        if a.positions is None or b.positions is None:
            return None
        dt = (b.stamp_ns - a.stamp_ns) * 1e-9
        return (b.positions[0] - a.positions[0]) / dt, (b.positions[1] - a.positions[1]) / dt
