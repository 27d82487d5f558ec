# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The path of the fixes against paths of dead reckoning: which of them has its shape, and which is mirrored.

z_k      places that fixes show                                                 m, complex
q_k, ψ_k dead reckoning: place and heading of base_link, from any begin         m, rad
l        stated place of the sensor in base_link                                m, complex

    z_k = a + c (q_k + l e^{iψ_k}) + e      c complex: heading of the begin, share of the track distance

A segment is fitted for each path; ln(RSS_b/RSS_a) ν/2 says how much better path a is than b. ν counts
fixes that
are a second apart, and no segment counts for more than e⁴: errors of receivers and slips last.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_estimation.setup_check.grid import LONGEST_GAP, Grid
from trackslip_estimation.setup_check.log import ComplexArray, Fixes

LENGTHS = (5.0, 10.0, 20.0, 40.0, 80.0)  # s, of segments: which of them depends on speeds and noise
MOST_LOG = 4.0  # of one segment
_LEAST_FIXES = 5
_MOST_FIXES = 16.0  # that count in a segment
_SLIP_SHARE = 0.03  # of the extent of a segment: what slips leave of any path
_LEAST_STEPS = 30  # from fix to fix, which show their noise
_SPACING = 1.0  # s between fixes whose errors differ
_LONGEST_OUTAGE = 5.0  # s without fixes within a segment
_TELLING = 0.5  # ln likelihood that a segment could add, below which it is left out


@dataclass(frozen=True)
class Path:
    """Dead reckoning on the edges of a grid."""

    edges: FloatArray  # (m + 1,) s
    places: ComplexArray  # (m + 1,) m
    headings: FloatArray  # (m + 1,) rad
    is_known: BoolArray  # (m,) of cells

    def at(self, t: FloatArray, lever: complex = 0.0) -> ComplexArray:
        """(n,) places of a point of base_link."""
        heading = np.interp(t, self.edges, self.headings)
        q = np.interp(t, self.edges, self.places.real) + 1j * np.interp(t, self.edges, self.places.imag)
        return np.asarray(q + lever * np.exp(1j * heading))


class Shapes(NamedTuple):
    """How each of p paths fits."""

    logs: FloatArray  # (p,) ln likelihood, above that of the worst
    segments: int  # that tell some of the paths apart
    length: float  # s


def dead_reckoning(grid: Grid, distance: FloatArray, turn: FloatArray) -> Path:
    """From increments (m,) m and rad; cells where either is unknown stand still."""
    known = np.isfinite(distance) & np.isfinite(turn) & grid.is_driven
    steps, turns = np.where(known, distance, 0.0), np.where(known, turn, 0.0)
    headings = np.concatenate(([0.0], np.cumsum(turns)))
    middle = headings[:-1] + turns / 2.0
    places = np.concatenate(([0.0], np.cumsum(steps * np.exp(1j * middle))))
    return Path(grid.edges, places, headings, known)


def thinned(fixes: Fixes, spacing: float) -> Fixes:
    """Fixes at least ``spacing`` s apart, with finite places."""
    kept, last = [], -np.inf
    sound: BoolArray = np.asarray(np.isfinite(fixes.places).all(axis=1))
    for k, when in enumerate(fixes.t.tolist()):
        if sound[k] and when - last >= spacing:
            kept.append(k)
            last = when
    index = np.array(kept, dtype=np.int64)
    return replace(fixes, t=fixes.t[index], places=fixes.places[index], stddevs=fixes.stddevs[index])


def with_shown_noise(fixes: Fixes) -> Fixes:
    """With the noise that fixes a second apart show, where they state more; a tenth of that at the least.

    What they state may be a guess, or an error that lasts, which is in all of a turn and a straight alike.
    """
    thin = thinned(fixes, _SPACING)
    steps = np.diff(thin.places, axis=0)[np.diff(thin.t) < 1.5 * _SPACING]
    if len(steps) < _LEAST_STEPS:
        return fixes
    shown = 1.4826 * float(np.median(np.abs(np.diff(steps, axis=0)))) / float(np.sqrt(6.0))
    return replace(fixes, stddevs=np.minimum(fixes.stddevs, np.maximum(shown, 0.1 * fixes.stddevs)))


def segments(path: Path, fixes: Fixes, length: float, margin: float = 0.0) -> IntArray:
    """(s, 2) first fix, and the one after the last, of pieces of ``length`` s without a gap of any sensor.

    Nor has the path a gap within ``margin`` s of them.
    """
    t = fixes.t
    unknown = np.concatenate(([0], np.cumsum(~path.is_known)))
    most = LONGEST_GAP / (path.edges[1] - path.edges[0])
    found, first = [], 0
    breaks = np.append(np.diff(t) > _LONGEST_OUTAGE, True)
    while first < len(t):
        stop = int(np.searchsorted(t, t[first] + length, side="right"))
        gap = np.flatnonzero(breaks[first:stop])
        stop = first + int(gap[0]) + 1 if len(gap) else stop
        if stop - first >= _LEAST_FIXES and t[first] >= path.edges[0] and t[stop - 1] <= path.edges[-1]:
            a, b = np.searchsorted(path.edges, (t[first] - margin, t[stop - 1] + margin))
            if unknown[min(b, len(unknown) - 1)] - unknown[max(a - 1, 0)] <= most:
                found.append((first, stop))
        first = stop
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def free_counts(fixes: Fixes, parts: IntArray) -> FloatArray:
    """(s,) fixes of segments whose errors differ, less what place and scale take."""
    duration = fixes.t[parts[:, 1] - 1] - fixes.t[parts[:, 0]]
    count = np.minimum(np.diff(parts, axis=1)[:, 0], duration / _SPACING + 1.0)
    return np.asarray(np.maximum(np.minimum(count, _MOST_FIXES) - 2.0, 0.0))


class Moments:
    """Sums of products of columns over segments, of which fits of one column to another follow."""

    def __init__(self, parts: IntArray) -> None:
        self._parts = parts
        self.counts = np.diff(parts, axis=1)[:, 0].astype(np.float64)

    def sums(self, values: ComplexArray) -> ComplexArray:
        """(s,) of (n,)."""
        total = np.concatenate(([0.0], np.cumsum(values)))
        return np.asarray(total[self._parts[:, 1]] - total[self._parts[:, 0]])

    def product(self, a: ComplexArray, b: ComplexArray) -> ComplexArray:
        """(s,) Σ conj(a) b of what both are from their means."""
        return np.asarray(self.sums(np.conj(a) * b) - np.conj(self.sums(a)) * self.sums(b) / self.counts)

    def rests(self, a: ComplexArray, z: ComplexArray) -> FloatArray:
        """(s,) squares that the best multiple of a leaves of z."""
        of_a = np.maximum(self.product(a, a).real, 1e-12)
        left = self.product(z, z).real - np.abs(self.product(a, z)) ** 2 / of_a
        return np.asarray(np.maximum(left, 0.0))


def compare(paths: Sequence[Path], fixes: Fixes) -> Shapes:
    """Likelihoods of the paths, with segments of the length that tells them apart best."""
    columns = np.array([path.at(fixes.t, fixes.arm) for path in paths])
    best, best_power = Shapes(np.zeros(len(paths)), 0, LENGTHS[0]), 0.0
    for length in LENGTHS:
        parts = segments(paths[0], fixes, length)
        if not len(parts):
            continue
        logs, might = _of_segments(columns, fixes, parts)
        if might.sum() > best_power:
            telling = might > _TELLING
            total = logs[:, telling].sum(axis=1)
            best, best_power = Shapes(total - total.min(), int(telling.sum()), length), float(might.sum())
    return best


def _of_segments(columns: ComplexArray, fixes: Fixes, parts: IntArray) -> tuple[FloatArray, FloatArray]:
    """(p, s) ln likelihoods, at most ``MOST_LOG`` apart; (s,) how far apart the paths alone let them be."""
    moments, z = Moments(parts), fixes.z
    extent = np.sqrt(np.maximum(moments.product(z, z).real, 0.0) / moments.counts)
    noise = np.sqrt(moments.sums((fixes.stddevs**2).astype(np.complex128)).real / moments.counts)
    floor = moments.counts * (2.0 * noise**2 + (_SLIP_SHARE * extent) ** 2 + 1e-6)
    free, both = free_counts(fixes, parts), np.vstack((columns, z))
    rests = np.array([_rests(both[:, first:stop]) for first, stop in parts.tolist()])  # (s, p + 1, p + 1)
    logs = -free * np.log(rests[:, :-1, -1].T + floor)
    logs = np.maximum(logs - logs.max(axis=0), -MOST_LOG)
    a, b = np.triu_indices(len(columns), 1)
    might = np.sum(np.minimum(free * np.log1p(rests[:, a, b].T / floor), MOST_LOG), axis=0)
    return logs, np.asarray(might)


def _rests(columns: ComplexArray) -> FloatArray:
    """(p, p) squares that a place and the best multiple of one column (p, n) leave of each other one."""
    own = columns - columns.mean(axis=1, keepdims=True)
    products = own.conj() @ own.T
    squares = np.diag(products).real
    explained = np.abs(products) ** 2 / np.maximum(squares, 1e-12)[:, np.newaxis]
    return np.asarray(np.maximum(squares - explained, 0.0))
