# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Likelihoods of dead-reckoning paths, given the path of the fixes: by shape, with or without mirroring.

z_k      places of the fixes                                                    m, complex
q_k, ψ_k dead reckoning: place and heading of base_link, from any start         m, rad
l        stated place of the sensor in base_link                                m, complex

    z_k = a + c (q_k + l e^{iψ_k}) + e      c complex: start heading, share of the track distance

Each path is fitted to each segment; ln(RSS_b/RSS_a) ν/2 is the ln likelihood ratio of path a over b. ν counts
fixes at least a second apart, and no ratio of a segment exceeds e⁴: errors of receivers and slips are
time-correlated. RSS is at least the median, over the segments, of the best path: fixes that wander.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_estimation.setup_check.grid import LONGEST_GAP, Grid, running_sum
from trackslip_estimation.setup_check.log import ComplexArray, Fixes
from trackslip_estimation.setup_check.turning import robust_stddev

LENGTHS = (5.0, 10.0, 20.0, 40.0, 80.0)  # s, of segments; the best depends on speeds and noise
MOST_LOG = 4.0  # ln likelihood ratio of one segment
_LEAST_FIXES = 5
_MOST_FIXES = 16.0  # that count in a segment
_SLIP_SHARE = 0.03  # residual of any path by slips, share of the extent of a segment
_LEAST_STEPS = 30  # between fixes, to estimate their noise
_SPACING = 1.0  # s between fixes with independent errors
_LONGEST_OUTAGE = 5.0  # s without fixes within a segment
_LEAST_DISTINCTION = 0.5  # ln likelihood ratio that a segment must be able to add


@dataclass(frozen=True)
class Path:
    """Dead reckoning on the edges of a grid."""

    edges: FloatArray  # (m + 1,) s
    places: ComplexArray  # (m + 1,) m
    headings: FloatArray  # (m + 1,) rad
    is_known: BoolArray  # (m,) cells with known increments

    def places_at(self, t: FloatArray, lever: complex = 0.0) -> ComplexArray:
        """(n,) places of a point of base_link at times t, m."""
        direction = np.exp(1j * np.interp(t, self.edges, self.headings))
        return np.asarray(np.interp(t, self.edges, self.places) + lever * direction)


class PathFits(NamedTuple):
    """Fits of p paths."""

    logs: FloatArray  # (p,) ln likelihood ratio over the worst path
    segments: int  # number of those that distinguish some of the paths


def dead_reckoning(grid: Grid, distance: FloatArray, turn: FloatArray) -> Path:
    """Path by increments (m,), m and rad; both are zero in cells where either is unknown."""
    known = np.isfinite(distance) & np.isfinite(turn) & grid.is_driven
    steps, turns = np.where(known, distance, 0.0), np.where(known, turn, 0.0)
    headings = running_sum(turns)
    places = running_sum(steps * np.exp(1j * (headings[:-1] + turns / 2.0)))
    return Path(grid.edges, places, headings, known)


def thin_fixes(fixes: Fixes, spacing: float) -> Fixes:
    """Fixes at least ``spacing`` s apart, with finite places."""
    indices, last = [], -np.inf
    is_finite: BoolArray = np.asarray(np.isfinite(fixes.places).all(axis=1))
    for k, time in enumerate(fixes.t.tolist()):
        if is_finite[k] and time - last >= spacing:
            indices.append(k)
            last = time
    return fixes.select(np.array(indices, dtype=np.int64))


def with_measured_noise(fixes: Fixes) -> Fixes:
    """Fixes with the noise that those a second apart show, if they state more; at least a tenth of theirs.

    The stated value may be a guess, or a time-correlated error, which is equal in turns and on straights.
    """
    thin = thin_fixes(fixes, _SPACING)
    steps = np.diff(thin.places, axis=0)[np.diff(thin.t) < 1.5 * _SPACING]
    if len(steps) < _LEAST_STEPS:
        return fixes
    measured = robust_stddev(np.diff(steps, axis=0)) / float(np.sqrt(6.0))
    return replace(fixes, stddevs=np.minimum(fixes.stddevs, np.maximum(measured, 0.1 * fixes.stddevs)))


def segments(path: Path, fixes: Fixes, length: float, margin: float = 0.0) -> IntArray:
    """(s, 2) first fix, and the one after the last, of segments of ``length`` s without a gap of any sensor.

    The path has no gap within ``margin`` s of a segment either.
    """
    t = fixes.t
    unknown = running_sum((~path.is_known).astype(np.float64))
    most = LONGEST_GAP / (path.edges[1] - path.edges[0])
    parts, first = [], 0
    breaks = np.append(np.diff(t) > _LONGEST_OUTAGE, True)
    while first < len(t):
        stop = int(np.searchsorted(t, t[first] + length, side="right"))
        gap = np.flatnonzero(breaks[first:stop])
        stop = first + int(gap[0]) + 1 if len(gap) else stop
        if stop - first >= _LEAST_FIXES and t[first] >= path.edges[0] and t[stop - 1] <= path.edges[-1]:
            a, b = np.searchsorted(path.edges, (t[first] - margin, t[stop - 1] + margin))
            if unknown[min(b, len(unknown) - 1)] - unknown[max(a - 1, 0)] <= most:
                parts.append((first, stop))
        first = stop
    return np.array(parts, dtype=np.int64).reshape(-1, 2)


def degrees_of_freedom(fixes: Fixes, parts: IntArray) -> FloatArray:
    """(s,) degrees of freedom: fixes with independent errors, less those of place and scale."""
    duration = fixes.t[parts[:, 1] - 1] - fixes.t[parts[:, 0]]
    count = np.minimum(np.diff(parts, axis=1)[:, 0], duration / _SPACING + 1.0)
    return np.asarray(np.maximum(np.minimum(count, _MOST_FIXES) - 2.0, 0.0))


class Moments:
    """Sums of products of columns over segments, for fits of one column to another."""

    def __init__(self, parts: IntArray) -> None:
        self._parts = parts
        self.counts = np.diff(parts, axis=1)[:, 0].astype(np.float64)

    def sums(self, values: ComplexArray) -> ComplexArray:
        """(s,) sums of (n,) values."""
        total = running_sum(values)
        return np.asarray(total[self._parts[:, 1]] - total[self._parts[:, 0]])

    def product(self, a: ComplexArray, b: ComplexArray) -> ComplexArray:
        """(s,) Σ conj(a) b of the deviations of both from their means."""
        return np.asarray(self.sums(np.conj(a) * b) - np.conj(self.sums(a)) * self.sums(b) / self.counts)

    def residual_squares(self, a: ComplexArray, z: ComplexArray) -> FloatArray:
        """(s,) residual squares of z after the best multiple of a."""
        of_a = np.maximum(self.product(a, a).real, 1e-12)
        squares = self.product(z, z).real - np.abs(self.product(a, z)) ** 2 / of_a
        return np.asarray(np.maximum(squares, 0.0))


def compare_paths(paths: Sequence[Path], fixes: Fixes) -> PathFits:
    """Likelihoods of the paths, with segments of the length that distinguishes them best."""
    columns = np.array([path.places_at(fixes.t, fixes.complex_lever) for path in paths])
    best, best_power = PathFits(np.zeros(len(paths)), 0), 0.0
    for length in LENGTHS:
        parts = segments(paths[0], fixes, length)
        if not len(parts):
            continue
        logs, distinction = _segment_logs(columns, fixes, parts)
        if distinction.sum() > best_power:
            is_distinct = distinction > _LEAST_DISTINCTION
            total = logs[:, is_distinct].sum(axis=1)
            best = PathFits(total - total.min(), int(is_distinct.sum()))
            best_power = float(distinction.sum())
    return best


def _segment_logs(columns: ComplexArray, fixes: Fixes, parts: IntArray) -> tuple[FloatArray, FloatArray]:
    """(p, s) ln likelihoods, at most ``MOST_LOG`` apart; (s,) sums of the ratios that the paths allow."""
    moments, z = Moments(parts), fixes.centred_places
    extent = np.sqrt(np.maximum(moments.product(z, z).real, 0.0) / moments.counts)
    noise = np.sqrt(moments.sums((fixes.stddevs**2).astype(np.complex128)).real / moments.counts)
    floor = moments.counts * (2.0 * noise**2 + (_SLIP_SHARE * extent) ** 2 + 1e-6)
    free, both = degrees_of_freedom(fixes, parts), np.vstack((columns, z))
    parts_of_both = [both[:, first:stop] for first, stop in parts.tolist()]
    squares = np.array([_pairwise_residual_squares(part) for part in parts_of_both])  # (s, p + 1, p + 1)
    usual = np.median(squares[:, :-1, -1].min(axis=1) / moments.counts)
    floor = np.maximum(floor, moments.counts * usual)
    logs = -free * np.log(squares[:, :-1, -1].T + floor)
    logs = np.maximum(logs - logs.max(axis=0), -MOST_LOG)
    a, b = np.triu_indices(len(columns), 1)
    distinction = np.sum(np.minimum(free * np.log1p(squares[:, a, b].T / floor), MOST_LOG), axis=0)
    return logs, np.asarray(distinction)


def _pairwise_residual_squares(columns: ComplexArray) -> FloatArray:
    """(p, p) residual squares of each column (p, n) after a place and the best multiple of each other one."""
    centred = columns - columns.mean(axis=1, keepdims=True)
    products = centred.conj() @ centred.T
    squares = np.diag(products).real
    explained = np.abs(products) ** 2 / np.maximum(squares, 1e-12)[:, np.newaxis]
    return np.asarray(np.maximum(squares - explained, 0.0))
