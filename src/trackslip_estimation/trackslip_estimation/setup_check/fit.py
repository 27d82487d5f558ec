# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the path of the fixes shows of dead reckoning: scale of distance, lever arm, delay, with intervals.

    e^{−iφ_s} z_k = a_s + ρ_s q_k + (l + Δl) e^{iψ_k} + e      in each segment s, with a place and a scale
    of its own

Δl is common to all segments: a_s and ρ_s are projected out of z and of e^{iψ}, and its covariance is the
jackknife's over segments.
"""

from typing import NamedTuple

import numpy as np

from trackslip_estimation.setup_check.log import Fixes, FloatArray
from trackslip_estimation.setup_check.path import ComplexArray, IntArray, Moments, Path, segments

_LEAST_SEGMENTS = 3


class Scales(NamedTuple):
    """Distance by fixes over distance by tracks, of each segment."""

    ratios: FloatArray  # (s,) ρ
    directions: FloatArray  # (s,) φ, rad
    weights: FloatArray  # (s,) 1/variance
    times: FloatArray  # (s,) s, of the middle
    straight: FloatArray  # (s,) chord over length of the path
    extents: FloatArray  # (s,) m, of the path by the tracks


class Lever(NamedTuple):
    """Δl of a source."""

    value: complex  # m, forward and left
    stddevs: tuple[float, float]  # m
    log_ratio: float  # ln likelihood against Δl = 0
    turned: float  # rad, in all


def scales(path: Path, fixes: Fixes, length: float, noise: float) -> Scales | None:
    """Of segments of ``length`` s whose extent is six times the ``noise`` (m) of fixes."""
    parts = segments(path, fixes, length)
    if not len(parts):
        return None
    z = fixes.places @ np.array((1.0, 1.0j))
    z = z - z.mean()
    q = path.at(fixes.t, complex(*fixes.lever))
    moments = Moments(parts)
    of_q = np.maximum(moments.product(q, q).real, 1e-12)
    c = moments.product(q, z) / of_q
    extent = np.sqrt(of_q / moments.counts)
    begin, end = parts[:, 0], parts[:, 1] - 1
    distance = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(path.places)))))
    way = np.interp(fixes.t[end], path.edges, distance) - np.interp(fixes.t[begin], path.edges, distance)
    own = np.abs(z[end] - z[begin])
    wide = (np.maximum(extent, own / 3.5) > max(6.0 * noise, 0.25)) & (way > 0.3)
    if not wide.any():
        return None
    variances = (noise**2 + 1e-6) / of_q + (0.02 * np.abs(c)) ** 2
    middle = (fixes.t[begin] + fixes.t[end]) / 2.0
    straight = np.abs(q[end] - q[begin]) / np.maximum(way, 1e-9)
    found = (np.abs(c), np.angle(c), 1.0 / variances, middle, straight, extent)
    return Scales(*(column[wide] for column in found))


class _Projected(NamedTuple):
    """Sums of a segment, with place and scale projected out."""

    zz: FloatArray  # (s,)
    uz: ComplexArray
    uu: FloatArray
    free: FloatArray


def fit_lever(path: Path, fixes: Fixes, length: float) -> Lever | None:
    """Δl, from segments of ``length`` s; None where too few turn."""
    parts = segments(path, fixes, length)
    if len(parts) < _LEAST_SEGMENTS:
        return None
    z = fixes.places @ np.array((1.0, 1.0j))
    z = z - z.mean()
    sums, turned = _project(path, fixes, parts, z)
    noise = float(np.median(fixes.stddevs)) ** 2
    weights = 1.0 / (sums.zz / np.maximum(sums.free, 1.0) + noise + 1e-6)
    uz, uu = weights * sums.uz, weights * sums.uu
    if uu.sum() <= 0.0 or (uu > 0.05 * uu.sum()).sum() < _LEAST_SEGMENTS:
        return None
    value = uz.sum() / uu.sum()
    without = (uz.sum() - uz) / np.maximum(uu.sum() - uu, 1e-12)
    count = len(uu)
    moved = (without - value) * np.sqrt((count - 1) / count)
    stddevs = float(np.sqrt(np.sum(moved.real**2))), float(np.sqrt(np.sum(moved.imag**2)))
    rests = sums.zz - 2.0 * (np.conj(value) * sums.uz).real + abs(value) ** 2 * sums.uu
    floors = sums.free * noise + 1e-9
    gains = np.clip(sums.free * np.log((sums.zz + floors) / (np.maximum(rests, 0.0) + floors)), -4.0, 4.0)
    return Lever(complex(value), stddevs, float(gains.sum()), turned)


def _project(path: Path, fixes: Fixes, parts: IntArray, z: ComplexArray) -> tuple[_Projected, float]:
    q, moments = path.at(fixes.t, complex(*fixes.lever)), Moments(parts)
    heading = np.interp(fixes.t, path.edges, path.headings)
    u = np.exp(1j * heading)
    of_q = np.maximum(moments.product(q, q).real, 1e-12)
    qz, qu = moments.product(q, z), moments.product(q, u)
    uu = moments.product(u, u).real - np.abs(qu) ** 2 / of_q
    uz = moments.product(u, z) - np.conj(qu) * qz / of_q
    zz = np.maximum(moments.product(z, z).real - np.abs(qz) ** 2 / of_q, 0.0)
    # direction of the begin: of the scale once Δl is fitted too
    c = qz / of_q
    own = np.where(uu > 1e-6, uz / np.maximum(uu, 1e-6), 0.0)
    c = (qz - np.conj(np.conj(qu)) * own) / of_q
    turn = c / np.maximum(np.abs(c), 1e-12)
    duration = fixes.t[parts[:, 1] - 1] - fixes.t[parts[:, 0]]
    free = np.maximum(np.minimum(np.minimum(moments.counts, duration + 1.0), 16.0) - 2.0, 0.0)
    turned = float(np.sum(np.abs(heading[parts[:, 1] - 1] - heading[parts[:, 0]])))
    usable = of_q > 1e-3
    zero = np.zeros(len(parts))
    found = _Projected(
        np.where(usable, zz, zero),
        np.where(usable, np.conj(turn) * uz, zero),
        np.where(usable, np.maximum(uu, 0.0), zero),
        np.where(usable, free, zero),
    )
    return found, turned


def path_delay(path: Path, fixes: Fixes, length: float, lates: FloatArray) -> FloatArray:
    """(d,) ln likelihood of each delay of the fixes, s; place, scale, direction of segments are free."""
    parts = segments(path, fixes, length)
    if not len(parts):
        return np.zeros(len(lates))
    z = fixes.places @ np.array((1.0, 1.0j))
    z = z - z.mean()
    moments = Moments(parts)
    duration = fixes.t[parts[:, 1] - 1] - fixes.t[parts[:, 0]]
    free = np.maximum(np.minimum(np.minimum(moments.counts, duration + 1.0), 16.0) - 2.0, 0.0)
    noise = float(np.median(fixes.stddevs)) ** 2
    extent = moments.product(z, z).real / moments.counts
    floors = moments.counts * (noise + 1e-6 + (0.01**2) * np.maximum(extent, 0.0))
    rests = [moments.rests(path.at(fixes.t - late, complex(*fixes.lever)), z) for late in lates]
    logs = -free * np.log(np.array(rests) + floors)  # (d, s)
    logs -= logs.max(axis=0)
    return np.asarray(np.maximum(logs, -4.0).sum(axis=1))
