# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fit of dead reckoning to the path of the fixes: scale of distance, lever arm, delay, with intervals.

    e^{−iφ_s} z_k = a_s + ρ_s q_k + (l + Δl) e^{iψ_k} + b_s ∫e^{iψ}|dψ| − τ q̇_k + e   in each segment s

Each segment has its own place a_s, direction φ_s, scale ρ_s and b_s; Δl, τ and the mean b are common to all.
b, m/rad, is the distance that the tracks lose or gain in turns; if all turns are to one side, a lateral Δl
has the same effect. τ is a delay; if all turns have one speed, a longitudinal Δl has the same effect. a_s and
ρ_s are projected out. Standard deviations are the larger of those of the jackknife over segments and of the
fit.
"""

from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_estimation.setup_check.grid import running_sum
from trackslip_estimation.setup_check.log import ComplexArray, Fixes
from trackslip_estimation.setup_check.path import MOST_LOG, Moments, Path, degrees_of_freedom, segments

_LEAST_SEGMENTS = 3
_SLIP_CHANGE = 0.15  # standard deviation of b of one segment about the common b, share of that of b
_ITERATIONS = 4
_FEW_SEGMENTS = 3.0  # standard deviations by n segments grow by a share of _FEW_SEGMENTS / (n − 1)
_LEAST_CORRELATION = 0.95  # of the fixes with the path; below it, errors or slips dominate the scale


class Scales(NamedTuple):
    """Distance by fixes over distance by tracks, of each segment."""

    ratios: FloatArray  # (s,) ρ
    times: FloatArray  # (s,) s, of the middle
    straight: FloatArray  # (s,) chord over length of the path
    extents: FloatArray  # (s,) m, RMS extent of the path by the tracks


class Lever(NamedTuple):
    """Correction Δl of the lever arm of a source."""

    value: complex  # m, forward and left
    stddevs: tuple[float, float]  # m
    log_ratio: float  # ln likelihood ratio over Δl = 0
    turned: float  # rad, in all


def segment_scales(path: Path, fixes: Fixes, length: float) -> Scales | None:
    """Scales of segments of ``length`` s in which fixes follow the path and exceed six times their noise."""
    parts = segments(path, fixes, length)
    if not len(parts):
        return None
    moments, q, z = Moments(parts), path.places_at(fixes.t, fixes.complex_lever), fixes.centred_places
    of_q = np.maximum(moments.product(q, q).real, 1e-12)
    of_z = np.maximum(moments.product(z, z).real, 1e-12)
    c = moments.product(q, z) / of_q
    extent = np.sqrt(of_q / moments.counts)
    begin, end = parts[:, 0], parts[:, 1] - 1
    distance = running_sum(np.abs(np.diff(path.places)))
    distance = np.interp(fixes.t[end], path.edges, distance) - np.interp(fixes.t[begin], path.edges, distance)
    wide = (np.sqrt(of_z / moments.counts) > max(6.0 * fixes.noise, 0.25)) & (distance > 0.3)
    wide &= np.abs(c) * np.sqrt(of_q) > _LEAST_CORRELATION * np.sqrt(of_z)
    if not wide.any():
        return None
    middle = (fixes.t[begin] + fixes.t[end]) / 2.0
    straight = np.abs(q[end] - q[begin]) / np.maximum(distance, 1e-9)
    return Scales(np.abs(c)[wide], middle[wide], straight[wide], extent[wide])


class _NormalEquations(NamedTuple):
    """Sums of s segments over the columns of x, y, b and τ, with place and scale projected out."""

    zz: FloatArray  # (s,) of the fixes with each other
    products: FloatArray  # (s, 4, 4) of the columns with each other
    of_z: FloatArray  # (s, 4) of the columns with the fixes
    free: FloatArray  # (s,) degrees of freedom


def fit_lever(
    path: Path, fixes: Fixes, length: float, slip_stddev: float, delay_stddev: float
) -> Lever | None:
    """Δl, from segments of ``length`` s; None if too few turn. Standard deviations of b, m/rad, and τ, s."""
    parts = segments(path, fixes, length)
    if len(parts) < _LEAST_SEGMENTS:
        return None
    sums, turned = _normal_equations(path, fixes, parts)
    noise = fixes.noise**2 + 1e-6
    sums = _with_varying_slip(sums, noise / (_SLIP_CHANGE * slip_stddev) ** 2)
    prior = np.diag((1e-9, 1e-9, slip_stddev**-2, delay_stddev**-2))
    # weights that begin alike, or by the residuals without a correction: the better maximum
    starts = (np.full(len(parts), 1.0 / noise), sums.free / _residual_squares(sums, np.zeros(4), noise))
    fits = [_reweighted_fit(sums, prior, noise, weights) for weights in starts]
    value, weights = min(fits, key=lambda fit: _log_residual(sums, prior, noise, fit[0]))
    products = weights[:, np.newaxis, np.newaxis] * sums.products
    of_z = weights[:, np.newaxis] * sums.of_z
    total = products.sum(axis=0) + prior
    uu = products[:, 0, 0]
    if (uu > 0.05 * uu.sum()).sum() < _LEAST_SEGMENTS:
        return None
    count = float(uu.sum() ** 2 / np.sum(uu**2))  # effective number of turning segments
    without = np.linalg.solve(total - products, (of_z.sum(axis=0) - of_z)[:, :, np.newaxis])[:, :, 0]
    deviations = (without - value) * np.sqrt((len(parts) - 1) / len(parts))
    stddevs = np.maximum(np.sqrt(np.sum(deviations**2, axis=0)), np.sqrt(np.diag(np.linalg.inv(total))))
    stddevs = stddevs * (1.0 + _FEW_SEGMENTS / max(count - 1.0, 1e-3))
    without_lever = np.concatenate(((0.0, 0.0), np.linalg.solve(total[2:, 2:], of_z[:, 2:].sum(axis=0))))
    gains = sums.free * np.log(
        _residual_squares(sums, without_lever, noise) / _residual_squares(sums, value, noise)
    )
    gain = float(np.clip(gains, -MOST_LOG, MOST_LOG).sum())
    return Lever(complex(value[0], value[1]), (float(stddevs[0]), float(stddevs[1])), gain, turned)


def _with_varying_slip(sums: _NormalEquations, ridge: float) -> _NormalEquations:
    """The sums with a b of each segment projected out, which differs from the common one.

    ``ridge``: variance of a fix over the variance of this difference, (m / (m/rad))².
    """
    b = sums.products[:, :, 2]
    share = 1.0 / (b[:, 2] + ridge)
    of_z = sums.of_z - (share * sums.of_z[:, 2])[:, np.newaxis] * b
    products = sums.products - share[:, np.newaxis, np.newaxis] * b[:, :, np.newaxis] * b[:, np.newaxis, :]
    return sums._replace(zz=sums.zz - share * sums.of_z[:, 2] ** 2, products=products, of_z=of_z)


def _reweighted_fit(
    sums: _NormalEquations, prior: FloatArray, noise: float, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(4,) values and the (s,) weights by which they were fitted: by the residuals of the previous fit."""
    for k in range(_ITERATIONS):
        total = np.einsum("s,sij->ij", weights, sums.products) + prior
        value = np.linalg.solve(total, weights @ sums.of_z)
        if k < _ITERATIONS - 1:
            weights = sums.free / _residual_squares(sums, value, noise)
    return value, weights


def _log_residual(sums: _NormalEquations, prior: FloatArray, noise: float, value: FloatArray) -> float:
    """−2 ln of the posterior density of (4,) values, up to a constant."""
    logs = sums.free * np.log(_residual_squares(sums, value, noise))
    return float(logs.sum() + value @ prior @ value)


def _residual_squares(sums: _NormalEquations, value: FloatArray, noise: float) -> FloatArray:
    """(s,) residual squares at (4,) values, with those of the noise, m²."""
    squares = sums.zz - 2.0 * sums.of_z @ value + np.einsum("i,sij,j->s", value, sums.products, value)
    return np.asarray(np.maximum(squares, 0.0) + sums.free * noise + 1e-9)


def _normal_equations(path: Path, fixes: Fixes, parts: IntArray) -> tuple[_NormalEquations, float]:
    moments, q, z = Moments(parts), path.places_at(fixes.t, fixes.complex_lever), fixes.centred_places
    heading = np.interp(fixes.t, path.edges, path.headings)
    u = np.exp(1j * heading)
    columns = (u, 1j * u, _turn_path(path, fixes.t), _delay_derivative(path, fixes))
    of_q = np.maximum(moments.product(q, q).real, 1e-12)

    def product(a: ComplexArray, b: ComplexArray) -> ComplexArray:
        projected = moments.product(a, b) - np.conj(moments.product(q, a)) * moments.product(q, b) / of_q
        return np.where(of_q > 1e-3, projected, 0.0)

    uu = np.maximum(product(u, u).real, 0.0)
    # direction φ_s: that of the scale, with Δl fitted too
    lever = np.where(uu > 1e-6, product(u, z) / np.maximum(uu, 1e-6), 0.0)
    c = moments.product(q, z) - moments.product(q, u) * lever
    turn = c / np.maximum(np.abs(c), 1e-12)
    products = np.array([[product(a, b).real for b in columns] for a in columns])
    of_z = np.array([(np.conj(turn) * product(a, z)).real for a in columns])
    free = np.where(of_q > 1e-3, degrees_of_freedom(fixes, parts), 0.0)
    turned = float(np.sum(np.abs(heading[parts[:, 1] - 1] - heading[parts[:, 0]])))
    zz = np.maximum(product(z, z).real, 0.0)
    return _NormalEquations(zz, np.moveaxis(products, 2, 0), of_z.T, free), turned


def _turn_path(path: Path, t: FloatArray) -> ComplexArray:
    """(n,) ∫ e^{iψ} |dψ|: places of a machine that drives 1 m per radian."""
    middle = (path.headings[1:] + path.headings[:-1]) / 2.0
    places = running_sum(np.exp(1j * middle) * np.abs(np.diff(path.headings)))
    return np.asarray(np.interp(t, path.edges, places))


def _delay_derivative(path: Path, fixes: Fixes) -> ComplexArray:
    """(n,) −q̇: change of the places for each second of delay."""
    step, arm = path.edges[1] - path.edges[0], fixes.complex_lever
    return np.asarray(
        (path.places_at(fixes.t - step, arm) - path.places_at(fixes.t + step, arm)) / (2.0 * step)
    )


def path_delay_logs(path: Path, fixes: Fixes, length: float, delays: FloatArray) -> FloatArray:
    """(d, s) ln likelihood of each delay of the fixes, s; place, scale, direction of segments are free."""
    parts = segments(path, fixes, length, margin=float(np.abs(delays).max()))
    if not len(parts):
        return np.zeros((len(delays), 0))
    moments, z = Moments(parts), fixes.centred_places
    extent = moments.product(z, z).real / moments.counts
    floors = moments.counts * (fixes.noise**2 + 1e-6 + (0.01**2) * np.maximum(extent, 0.0))
    residual_squares = [
        moments.residual_squares(path.places_at(fixes.t - delay, fixes.complex_lever), z) for delay in delays
    ]
    logs = -degrees_of_freedom(fixes, parts) * np.log(np.array(residual_squares) + floors)  # (d, s)
    logs -= logs.max(axis=0)
    return np.asarray(np.maximum(logs, -MOST_LOG))
