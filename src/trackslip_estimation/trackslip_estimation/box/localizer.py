# SPDX-License-Identifier: Apache-2.0
"""base_link in odom from scan to scan: check the scan, find the box near its track, give the fix.

The localizer knows only its own fixes, so that they stay independent of any estimator's errors.

Time is what the stamps state. A stamp far ahead is refused until the next ones confirm it. Stamps that go
back, once confirmed, start over: before the run's first scan, another run begins, at the initial pose; else
the clock was set, and the box is where it was. Either is tried where the other fails.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_common.clock_monitor import ClockMonitor, StampStatus
from trackslip_common.tally import Tally
from trackslip_common.vehicle import Box
from trackslip_estimation.box.fit import Optimum, posterior
from trackslip_estimation.box.frames import Frames
from trackslip_estimation.box.parameters import BoxLocalizerParameters
from trackslip_estimation.box.scan import Scan
from trackslip_estimation.box.search import SPREADS, BoxSearch, Candidate, Reason
from trackslip_estimation.box.sides import SideDoubt, half_turn_variance
from trackslip_estimation.box.track import Expectation, Track, initial_expectation

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Rejection:
    """A scan without a fix."""

    reason: Reason


@dataclass(frozen=True)
class BoxFix:
    """base_link in odom when the beams hit the box, m and rad; covariance (3, 3) of (x, y, yaw)."""

    stamp_ns: int
    x: float
    y: float
    yaw: float
    covariance: FloatArray


class BoxLocalizer:
    """Follows the box through scans given in order; its state depends on nothing else."""

    def __init__(self, parameters: BoxLocalizerParameters, box: Box) -> None:
        self._parameters = parameters
        self._box = box
        self._frames = Frames(parameters, box)
        self.tally = Tally()
        self.restarts = 0
        self.reset()

    def reset(self) -> None:
        """Drop every scan: start again from the initial pose."""
        self._search = BoxSearch(self._parameters, self._box, self.tally)
        self._tracks: list[Track | None] = [None]  # to look at, in turn; None: the initial pose
        self._first_ns: int | None = None  # stamp of the run's first scan
        self._clock = self._new_clock()

    def locate(self, scan: Scan) -> BoxFix | Rejection:
        """The fix that one scan gives, or why it gives none."""
        refused = self._check_stamp(scan.stamp_ns) if scan.is_usable() else Reason.MALFORMED
        found = refused or self._find(scan)
        if isinstance(found, Reason):
            self.tally.add("scan", found)
            return Rejection(found)
        return self._accept(scan, *found)

    def _new_clock(self) -> ClockMonitor:
        return ClockMonitor(round(self._parameters.max_gap * 1e9), self._parameters.jump_confirmations)

    def _check_stamp(self, stamp_ns: int) -> Reason | None:
        """Why a scan is refused for its stamp; starts over where stamps have gone back."""
        head_ns = self._clock.head_ns
        status = self._clock.sample(stamp_ns, None if head_ns is None else head_ns + 1)
        if status is StampStatus.BACK:
            self._start_over(stamp_ns)
        elif status is not StampStatus.IN_LINE:
            return Reason.AHEAD if status is StampStatus.AHEAD else Reason.NOT_LATER
        if self._first_ns is None:
            self._first_ns = stamp_ns
        return None

    def _start_over(self, stamp_ns: int) -> None:
        """Stamps have gone back: another run, or the same with the clock set."""
        assert self._first_ns is not None
        before_ns = round(self._parameters.max_gap * 1e9)  # by when the confirmation has come
        is_another_run = stamp_ns < self._first_ns + before_ns
        last = [track.restamped(stamp_ns) for track in self._tracks if track is not None]
        if is_another_run:
            self.reset()
        self._tracks = [None, *last] if is_another_run else [*last, None]
        self._clock = self._new_clock()
        self._clock.sample(stamp_ns)
        self.restarts += 1

    def _find(self, scan: Scan) -> tuple[Expectation, Candidate] | Reason:
        """The box near its track, and what was expected of it."""
        reasons = []
        angles = scan.angles()
        for track in self._tracks:
            if track is None:
                expected = initial_expectation(self._parameters)
            else:
                expected = track.expectation(scan.stamp_ns, self._parameters)
            found = self._search.find(scan.ranges, angles, expected)
            if isinstance(found, Candidate):
                return expected, found
            reasons.append(found)
        return max(reasons, key=list(Reason).index)

    def _accept(self, scan: Scan, expected: Expectation, found: Candidate) -> BoxFix:
        """Continue the track with a fix, and give it for base_link in odom."""
        variance = expected.half_turn_variance
        if expected.is_ambiguous:
            turned = float(found.optimum.pose[2] - self._frames.laser_from_odom(expected.pose)[2])
            variance += half_turn_variance(turned, expected.yaw_reach / SPREADS)
        else:  # sure enough that this is the box, and the rest is not
            self._search.background.update(scan.ranges, found.beams)
        optimum, doubt = self._settle_sides(found, ambiguous=expected.is_ambiguous)
        box, range_stddev = self._search.box, self._search.range_stddev
        in_laser, covariance = posterior(optimum, box, found.beams, range_stddev)
        covariance[2, 2] += variance
        if doubt is not None:
            shift = 0.5 * (box.length - box.width)  # of the centre, were the sides exchanged
            covariance += doubt.probability() * np.diag([shift, shift, doubt.turn]) ** 2
        stamp_ns = scan.time_ns(float(found.beams.indices.mean()))
        pose = self._frames.odom_from_laser(in_laser)
        last = self._tracks[0] if len(self._tracks) == 1 else None
        velocity = np.zeros(3) if last is None else last.velocity_after(stamp_ns, pose, self._parameters)
        self._tracks = [Track(stamp_ns, pose, velocity, doubt, variance)]
        yaw = float(np.arctan2(np.sin(pose[2]), np.cos(pose[2])))
        covariance = self._frames.covariance_in_odom(float(pose[2]), covariance)
        return BoxFix(stamp_ns, float(pose[0]), float(pose[1]), yaw, covariance)

    def _settle_sides(self, found: Candidate, *, ambiguous: bool) -> tuple[Optimum, SideDoubt | None]:
        """Raise or settle the doubt about the sides; the fit that is more likely, and what doubt is left."""
        optimum, doubt = found.optimum, found.doubt
        if ambiguous or doubt is None:
            return optimum, doubt
        turn = doubt.turn
        other = self._search.settled(optimum.pose[2] + turn, found.beams)
        doubt = doubt.after(optimum.chi2 - other.chi2)
        return (optimum if doubt is None or doubt.turn == turn else other), doubt
