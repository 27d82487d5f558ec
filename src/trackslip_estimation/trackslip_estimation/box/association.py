# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Choice of the box among objects of its shape, after an absence or a restart.

No other object of its shape is within the clearance of the machine. A recent track therefore identifies the
box, and so does an odometry whose uncertainty is within the clearance. Otherwise the box is the only
candidate that the odometry's gate accepts and that was not there before. With several such candidates, or
none, the choice is ambiguous and none is made. Each candidate is followed until one moves with the odometry.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from trackslip_common.arrays import FloatArray
from trackslip_estimation.box.odometry import Odometry
from trackslip_estimation.box.parameters import BoxLocalizerParameters
from trackslip_estimation.box.search import Candidate
from trackslip_estimation.box.track import Expectation

_NS = 1e-9  # s


@dataclass
class _CandidateTrack:
    """A candidate from scan to scan: its first and latest position, and the odometry at the first, m."""

    first: FloatArray
    last: FloatArray
    seen_ns: int
    odometry: FloatArray | None
    likely_ns: int | None = None  # when the odometry's gate last accepted it as a new object

    def add_position(
        self, position: FloatArray, stamp_ns: int, odometry: Odometry | None, p: BoxLocalizerParameters
    ) -> None:
        """Add a position; restart from it if the candidate does not move like the odometry."""
        self.last, self.seen_ns = position, stamp_ns
        if odometry is None:
            return
        moved, driven = _distance(position, self.first), self.odometry_distance(odometry)
        if driven is None or abs(moved - driven) > p.confirmation_difference + p.proof_share * driven:
            self.first, self.odometry = position, odometry.position

    def odometry_distance(self, odometry: Odometry | None) -> float | None:
        """Return the distance of the odometry from its first position, m; None without odometry."""
        if odometry is None or self.odometry is None:
            return None
        return _distance(odometry.position, self.odometry)

    def distance_moved(self, odometry: Odometry | None) -> float:
        """Return the distance from the first position, at most that of an odometry, m."""
        moved, driven = _distance(self.last, self.first), self.odometry_distance(odometry)
        return moved if driven is None else min(moved, driven)

    def is_likely(self, stamp_ns: int, p: BoxLocalizerParameters) -> bool:
        """Whether the gate accepted the candidate within the last ``ambiguity_time``."""
        return self.likely_ns is not None and stamp_ns - self.likely_ns <= round(p.ambiguity_time * 1e9)


class Association:
    """Chooses the box among candidates, scan by scan; keeps ambiguous candidates."""

    def __init__(self, p: BoxLocalizerParameters) -> None:
        self._parameters = p
        self._tracks: list[_CandidateTrack] = []
        self._chi2_limit = float(chdtri(2, 1.0 - p.fit_probability))

    @property
    def ambiguous_positions(self) -> list[FloatArray]:
        """Positions (2,) of base_link for the ambiguous candidates, m."""
        return [track.last for track in self._tracks]

    def choose(
        self,
        candidates: Sequence[Candidate],
        expected: Expectation,
        odometry: Odometry | None,
        stamp_ns: int,
    ) -> Candidate | None:
        """Return the box if it is unambiguous; there must be at least one candidate."""
        chosen = self._identify(candidates, expected, odometry, stamp_ns)
        if chosen is None:
            chosen = self._confirm_by_motion(candidates, expected, odometry, stamp_ns)
        if chosen is not None:
            self._tracks = []
        return chosen

    def _identify(
        self,
        candidates: Sequence[Candidate],
        expected: Expectation,
        odometry: Odometry | None,
        stamp_ns: int,
    ) -> Candidate | None:
        """Return the candidate that the track, or the odometry, identifies to within the clearance."""
        nearest = min(candidates, key=lambda candidate: candidate.distance)
        is_start = math.isinf(expected.elapsed)
        if not is_start and expected.reach <= self._parameters.clearance:
            return nearest
        if odometry is None:
            return nearest if is_start else None
        S = self._covariance(odometry, stamp_ns)
        if self._chi2_limit * np.linalg.eigvalsh(S)[1] > self._parameters.clearance**2:
            return None
        accepted = [c for c in candidates if self._is_accepted(c, odometry, stamp_ns)]
        return min(accepted, key=lambda c: _distance(c.position, odometry.position), default=None)

    def _confirm_by_motion(
        self,
        candidates: Sequence[Candidate],
        expected: Expectation,
        odometry: Odometry | None,
        stamp_ns: int,
    ) -> Candidate | None:
        """Return the only likely candidate, or the only one that has moved ``confirmation_distance``."""
        p = self._parameters
        tracks = [self._extend_track(candidate, odometry, stamp_ns) for candidate in candidates]
        timeout_ns = round(p.candidate_timeout * 1e9)
        self._tracks = [t for t in self._tracks if stamp_ns - t.seen_ns <= timeout_ns]
        likely = []
        for candidate, track in zip(candidates, tracks, strict=True):
            is_new = candidate.is_new or math.isinf(expected.elapsed)
            if is_new and self._is_accepted(candidate, odometry, stamp_ns):
                track.likely_ns = stamp_ns
                likely.append(candidate)
        if len(likely) == 1 and sum(t.is_likely(stamp_ns, p) for t in self._tracks) == 1:
            return likely[0]
        driving = [
            candidate
            for candidate, track in zip(candidates, tracks, strict=True)
            if track.distance_moved(odometry) >= p.confirmation_distance
        ]
        return driving[0] if len(driving) == 1 else None

    def _extend_track(
        self, candidate: Candidate, odometry: Odometry | None, stamp_ns: int
    ) -> _CandidateTrack:
        """Return the track of a candidate, with its position added."""
        p = self._parameters
        nearest = min(self._tracks, key=lambda t: _distance(t.last, candidate.position), default=None)
        if nearest is not None:
            reach = p.gate_distance + p.top_speed * (stamp_ns - nearest.seen_ns) * _NS
            if _distance(nearest.last, candidate.position) <= reach:
                nearest.add_position(candidate.position, stamp_ns, odometry, p)
                return nearest
        position = candidate.position
        track = _CandidateTrack(position, position, stamp_ns, None if odometry is None else odometry.position)
        self._tracks.append(track)
        return track

    def _is_accepted(self, candidate: Candidate, odometry: Odometry | None, stamp_ns: int) -> bool:
        """Whether a candidate is inside the odometry's gate; true without odometry."""
        if odometry is None:
            return True
        innovation = candidate.position - odometry.position
        return bool(
            innovation @ np.linalg.solve(self._covariance(odometry, stamp_ns), innovation) <= self._chi2_limit
        )

    def _covariance(self, odometry: Odometry, stamp_ns: int) -> FloatArray:
        """Return the covariance (2, 2) of fix minus odometry, m², with gate distance and motion between."""
        p = self._parameters
        travel = p.top_speed * abs(stamp_ns - odometry.stamp_ns) * _NS
        S: FloatArray = odometry.covariance + (p.gate_distance + travel) ** 2 / self._chi2_limit * np.eye(2)
        return S


def _distance(one: FloatArray, other: FloatArray) -> float:
    """Return the distance of two positions (2,), m."""
    return float(np.hypot(one[0] - other[0], one[1] - other[1]))
