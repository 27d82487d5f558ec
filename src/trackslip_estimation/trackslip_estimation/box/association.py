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
class _Follower:
    """A candidate from scan to scan: its first and latest position, and the odometry at the first, m."""

    first: FloatArray
    last: FloatArray
    seen_ns: int
    odometry: FloatArray | None
    likely_ns: int | None = None  # when the odometry's gate last accepted it as a new object

    def follow(
        self, place: FloatArray, stamp_ns: int, odometry: Odometry | None, p: BoxLocalizerParameters
    ) -> None:
        """Add a position; restart from it if the candidate does not move like the odometry."""
        self.last, self.seen_ns = place, stamp_ns
        if odometry is None:
            return
        moved, driven = _apart(place, self.first), self.driven(odometry)
        if driven is None or abs(moved - driven) > p.confirmation_difference + p.proof_share * driven:
            self.first, self.odometry = place, odometry.place

    def driven(self, odometry: Odometry | None) -> float | None:
        """Return the distance of the odometry from its first position, m; None without odometry."""
        if odometry is None or self.odometry is None:
            return None
        return _apart(odometry.place, self.odometry)

    def moved(self, odometry: Odometry | None) -> float:
        """Return the distance from the first position, at most that of an odometry, m."""
        moved, driven = _apart(self.last, self.first), self.driven(odometry)
        return moved if driven is None else min(moved, driven)

    def is_likely(self, stamp_ns: int, p: BoxLocalizerParameters) -> bool:
        """Whether the gate accepted the candidate within the last ``ambiguity_time``."""
        return self.likely_ns is not None and stamp_ns - self.likely_ns <= round(p.ambiguity_time * 1e9)


class Association:
    """Chooses the box among candidates, scan by scan; keeps ambiguous candidates."""

    def __init__(self, p: BoxLocalizerParameters) -> None:
        self._parameters = p
        self._followers: list[_Follower] = []
        self._chi2 = float(chdtri(2, 1.0 - p.fit_probability))

    @property
    def places(self) -> list[FloatArray]:
        """Positions (2,) of base_link for the ambiguous candidates, m."""
        return [follower.last for follower in self._followers]

    def choose(
        self,
        candidates: Sequence[Candidate],
        expected: Expectation,
        odometry: Odometry | None,
        stamp_ns: int,
    ) -> Candidate | None:
        """Return the box if it is unambiguous; there must be at least one candidate."""
        chosen = self._identified(candidates, expected, odometry, stamp_ns)
        if chosen is None:
            chosen = self._followed(candidates, expected, odometry, stamp_ns)
        if chosen is not None:
            self._followers = []
        return chosen

    def _identified(
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
        if self._chi2 * np.linalg.eigvalsh(S)[1] > self._parameters.clearance**2:
            return None
        accepted = [c for c in candidates if self._is_accepted(c, odometry, stamp_ns)]
        return min(accepted, key=lambda c: _apart(c.place, odometry.place), default=None)

    def _followed(
        self,
        candidates: Sequence[Candidate],
        expected: Expectation,
        odometry: Odometry | None,
        stamp_ns: int,
    ) -> Candidate | None:
        """Return the only likely candidate, or the only one that has moved ``confirmation_distance``."""
        p = self._parameters
        followers = [self._follower(candidate, odometry, stamp_ns) for candidate in candidates]
        kept_ns = round(p.candidate_timeout * 1e9)
        self._followers = [f for f in self._followers if stamp_ns - f.seen_ns <= kept_ns]
        likely = []
        for candidate, follower in zip(candidates, followers, strict=True):
            is_new = candidate.is_new or math.isinf(expected.elapsed)
            if is_new and self._is_accepted(candidate, odometry, stamp_ns):
                follower.likely_ns = stamp_ns
                likely.append(candidate)
        if len(likely) == 1 and sum(f.is_likely(stamp_ns, p) for f in self._followers) == 1:
            return likely[0]
        driving = [
            candidate
            for candidate, follower in zip(candidates, followers, strict=True)
            if follower.moved(odometry) >= p.confirmation_distance
        ]
        return driving[0] if len(driving) == 1 else None

    def _follower(self, candidate: Candidate, odometry: Odometry | None, stamp_ns: int) -> _Follower:
        """Return the follower of a candidate, with its position added."""
        p = self._parameters
        nearest = min(self._followers, key=lambda f: _apart(f.last, candidate.place), default=None)
        if nearest is not None:
            reach = p.gate_distance + p.top_speed * (stamp_ns - nearest.seen_ns) * _NS
            if _apart(nearest.last, candidate.place) <= reach:
                nearest.follow(candidate.place, stamp_ns, odometry, p)
                return nearest
        place = candidate.place
        follower = _Follower(place, place, stamp_ns, None if odometry is None else odometry.place)
        self._followers.append(follower)
        return follower

    def _is_accepted(self, candidate: Candidate, odometry: Odometry | None, stamp_ns: int) -> bool:
        """Whether a candidate is inside the odometry's gate; true without odometry."""
        if odometry is None:
            return True
        off = candidate.place - odometry.place
        return bool(off @ np.linalg.solve(self._covariance(odometry, stamp_ns), off) <= self._chi2)

    def _covariance(self, odometry: Odometry, stamp_ns: int) -> FloatArray:
        """Return the covariance (2, 2) of fix minus odometry, m², with gate distance and motion between."""
        p = self._parameters
        apart = p.top_speed * abs(stamp_ns - odometry.stamp_ns) * _NS
        S: FloatArray = odometry.covariance + (p.gate_distance + apart) ** 2 / self._chi2 * np.eye(2)
        return S


def _apart(one: FloatArray, other: FloatArray) -> float:
    """Return the distance of two positions (2,), m."""
    return float(np.hypot(one[0] - other[0], one[1] - other[1]))
