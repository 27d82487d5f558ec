# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes of base_link in odom from scan to scan: check the scan, find the box near its track, return the fix.

Fixes are computed from scans alone, so that they stay independent of any estimator's errors. The odometry
only decides which of several objects is the box after an absence (``association.py``).

Time is that of the stamps. A stamp far ahead is rejected until the next ones confirm it. Confirmed stamps
that go back restart the localizer. If they lie before the run's first scan, another run begins at the initial
pose; else the clock was set, and the box is at its last pose. Without a fix at one, the other is tried.
"""

from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.clock_monitor import ClockMonitor, StampStatus
from trackslip_common.tally import Tally
from trackslip_common.vehicle import Box
from trackslip_estimation.box.association import Association
from trackslip_estimation.box.fit import posterior
from trackslip_estimation.box.frames import Frames
from trackslip_estimation.box.heading_ambiguity import (
    NEGLIGIBLE_PROBABILITY,
    QUARTER_TURN,
    Headings,
    Mode,
    mix_modes,
)
from trackslip_estimation.box.odometry import Odometry
from trackslip_estimation.box.parameters import BoxLocalizerParameters
from trackslip_estimation.box.scan import Scan
from trackslip_estimation.box.search import BoxSearch, Candidate, Reason
from trackslip_estimation.box.track import Expectation, LocalizerState, Track, initial_expectation

_MISFIT_FIXES = 100.0  # fixes over which the misfit is averaged


@dataclass(frozen=True)
class BoxFix:
    """base_link in odom when the beams hit the box, m and rad; covariance (3, 3) of (x, y, yaw)."""

    stamp_ns: int
    x: float
    y: float
    yaw: float
    covariance: FloatArray


class BoxLocalizer:
    """Tracks the box through scans in order; the odometry only decides which object is the box."""

    def __init__(
        self, parameters: BoxLocalizerParameters, box: Box, saved_state: LocalizerState | None = None
    ) -> None:
        """``saved_state``: state of the localizer that ran before this one."""
        self._parameters = parameters
        self._saved_state = saved_state
        self._box = box
        self._frames = Frames(parameters, box)
        self.tally = Tally()
        self.restarts = 0
        self.resumed = False  # whether the saved track was continued
        self.reset()

    @property
    def saved_state(self) -> LocalizerState | None:
        """State for the next localizer; None before the first fix."""
        if len(self._tracks) != 1 or self._tracks[0] is None:
            return None
        return LocalizerState(self._tracks[0], self._scan_ns, self._search.background, self._laser_pose)

    @property
    def ambiguous_positions(self) -> list[FloatArray]:
        """Positions (2,) of base_link in odom for ambiguous candidates, m; empty if unambiguous."""
        return self._association.ambiguous_positions

    def reset(self) -> None:
        """Reset to the initial pose."""
        self._search = BoxSearch(self._parameters, self._box, self.tally)
        self._association = Association(self._parameters)
        self._tracks: list[Track | None] = [None]  # searched in turn; None: the initial pose
        self._first_ns: int | None = None  # stamp of the run's first scan
        self._scan_ns = 0  # stamp of its latest scan
        self.misfit = 1.0  # mean χ² per degree of freedom of the latest fixes
        self._clock = self._new_clock()

    def locate(self, scan: Scan, odometry: Odometry | None = None) -> BoxFix | Reason:
        """Return the fix of one scan, or why there is none.

        ``odometry``: at the time of the scan, if available; it only decides which object is the box if the
        localizer's own track does not.
        """
        scan = scan.to_counter_clockwise()
        reason = self._check_stamp(scan.stamp_ns) if scan.is_usable() else Reason.MALFORMED
        result = reason or self._find_box(scan, odometry)
        if isinstance(result, Reason):
            self.tally.add("scan", result)
        return result

    def _new_clock(self) -> ClockMonitor:
        return ClockMonitor(round(self._parameters.max_gap * 1e9), self._parameters.jump_confirmations)

    def _check_stamp(self, stamp_ns: int) -> Reason | None:
        """Return why a scan is rejected for its stamp, or None; restart if stamps have gone back."""
        status = self._clock.check_increasing_sample(stamp_ns)
        if status is StampStatus.BACK:
            self._restart(stamp_ns)
        elif status is not StampStatus.IN_LINE:
            return Reason.AHEAD if status is StampStatus.AHEAD else Reason.NOT_LATER
        if self._first_ns is None:
            self._first_ns = stamp_ns
            self._resume_saved_track(stamp_ns)
        self._scan_ns = stamp_ns
        return None

    def _resume_saved_track(self, stamp_ns: int) -> None:
        """Continue the saved track if its last scan, with or without the box, is recent (``resume_time``)."""
        saved, self._saved_state = self._saved_state, None
        if saved is not None and 0 <= stamp_ns - saved.scan_ns <= self._parameters.resume_time * 1e9:
            self._tracks = [saved.track]
            self.resumed = True
            if np.allclose(saved.laser, self._laser_pose, rtol=0.0, atol=1e-6):
                self._search.background = saved.background

    def _restart(self, stamp_ns: int) -> None:
        """Restart after stamps have gone back: another run, or the same with the clock set."""
        assert self._first_ns is not None
        confirmation_ns = round(self._parameters.max_gap * 1e9)  # longest time until the confirmation
        is_another_run = stamp_ns < self._first_ns + confirmation_ns
        tracks = [track.restamp(stamp_ns, self._parameters) for track in self._tracks if track is not None]
        if is_another_run:
            self.reset()
        self._tracks = [None, *tracks] if is_another_run else [*tracks, None]
        self._clock = self._new_clock()
        self._clock.check_increasing_sample(stamp_ns)
        self.restarts += 1

    @property
    def _laser_pose(self) -> tuple[float, float, float]:
        """Pose of the laser in odom, m and rad."""
        p = self._parameters
        return p.laser_x, p.laser_y, p.laser_yaw

    def _find_box(self, scan: Scan, odometry: Odometry | None) -> BoxFix | Reason:
        """Return the fix of the box near its track, or why there is none: the last check that was reached."""
        reasons = []
        angles = scan.angles()
        for track in self._tracks:
            if track is None:
                expected = initial_expectation(self._parameters)
            else:
                expected = track.expectation(scan.stamp_ns, self._parameters)
            candidates = self._search.find_candidates(scan.ranges, angles, expected)
            if isinstance(candidates, Reason):
                reasons.append(candidates)
                continue
            chosen = self._association.choose(candidates, expected, odometry, scan.stamp_ns)
            if chosen is not None:
                return self._accept_fix(scan, expected, chosen)
            reasons.append(Reason.UNCERTAIN)
        return max(reasons, key=list(Reason).index)

    def _accept_fix(self, scan: Scan, expected: Expectation, candidate: Candidate) -> BoxFix:
        """Update the track with a fix; return the fix of base_link in odom."""
        best = min(candidate.fits, key=lambda fit: fit.chi2)
        self.misfit += (best.chi2 / best.freedom - self.misfit) / _MISFIT_FIXES
        step = candidate.beams.spacing * float(candidate.beams.ranges.mean())
        update = expected.headings.update(
            self._heading_modes(expected, candidate), float(expected.pose[2]), expected.yaw_variance, step
        )
        # the box is certain, and the rest is background
        if update.probabilities[0] > 1.0 - NEGLIGIBLE_PROBABILITY:
            self._search.background = self._search.background.update(
                scan.ranges, scan.angles(), candidate.beams, self._parameters.clearance
            )
        stamp_ns = scan.beam_stamp_ns(float(candidate.beams.indices.mean()))
        self._tracks = [self._update_track(stamp_ns, update.modes[0], update.headings)]
        pose, covariance = mix_modes(update.modes, update.probabilities, expected.elapsed)
        covariance[2, 2] = max(
            covariance[2, 2], expected.innovation_variance(update.modes[0], self._parameters)
        )
        yaw = float(np.arctan2(np.sin(pose[2]), np.cos(pose[2])))
        return BoxFix(stamp_ns, float(pose[0]), float(pose[1]), yaw, covariance)

    def _heading_modes(self, expected: Expectation, candidate: Candidate) -> list[Mode]:
        """Return the hypotheses: about the expected heading, and one, two and three quarter turns from it.

        If the box is fitted one way only, the others are that fit rotated: they are refuted hypotheses.
        """
        box, range_stddev = self._search.box, self._search.range_stddev
        heading = float(self._frames.laser_from_odom(expected.pose)[2])
        fits = [
            posterior(optimum, heading + k * QUARTER_TURN, box, candidate.beams, range_stddev)
            for k, optimum in enumerate(candidate.fits)
        ]
        modes = []
        for k in range(4):
            fit = fits[k % len(fits)]
            in_laser = fit.pose + np.array((0.0, 0.0, QUARTER_TURN * (k - k % len(fits))))
            in_odom = self._frames.odom_from_laser(in_laser)
            covariance = self._frames.covariance_in_odom(float(in_odom[2]), fit.covariance)
            modes.append(Mode(in_odom, covariance, fit.log_evidence))
        return modes

    def _update_track(self, stamp_ns: int, fix: Mode, headings: Headings) -> Track:
        """Return the track updated with a fix, the first hypothesis."""
        p = self._parameters
        if len(self._tracks) == 1 and (track := self._tracks[0]) is not None:
            return track.update(stamp_ns, fix, headings, p)
        return Track.from_pose(stamp_ns, fix.pose, fix.covariance.diagonal(), headings, p)
