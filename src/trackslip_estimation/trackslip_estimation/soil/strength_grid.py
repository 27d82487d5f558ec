# SPDX-License-Identifier: Apache-2.0
"""How well each (K, F_max) explains one pair of thrusts, with errors in slip and thrust, compiled.

    q        F/F_max of each track, see ``shear_field``                              1
    U        upper triangular, U Uᵀ the twist's covariance: errors (v_x, v_y, φ̇) = U z
    z        error of v_x alone, the first of them, in its standard deviations       1
    J        change of q for one standard deviation of either of the others          1
    R        what thrust and model leave open, and F_max² J Jᵀ                       N²
    d²       least z² + (F − F_max q(z))ᵀ R⁻¹ (F − F_max q(z)) over z

A slip error is as good an excuse for a thrust as an error of the thrust: d is the distance from what was
measured to the curve q(z), not along one axis, so that weak slips bias nothing. The curve bends within the
errors of slip, so it is walked along, as straight pieces between a few z. Errors of φ̇ shift the tracks along
their curves in opposite ways.
"""

import math

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.soil.shear_field import shares

FloatArray = NDArray[np.float64]

_DEPENDENT = 1e-9  # least share of a determinant: below it rounding decides
NODES = np.linspace(-4.0, 4.0, 17)  # z


@compiled
def curves(
    j: FloatArray,
    twist: FloatArray,
    spread: FloatArray,
    tracks: FloatArray,
    x_e: FloatArray,
    half_tread: float,
    moduli: FloatArray,
    nodes: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """(nodes, 2, moduli) q along z, and (2, nodes − 1, 2, moduli) J between the nodes; ``spread`` is U."""
    count = len(moduli)
    q, J = np.empty((len(nodes), 2, count)), np.empty((2, len(nodes) - 1, 2, count))
    none = np.zeros(2)
    for m in range(len(nodes)):
        along = np.full(2, nodes[m] * spread[0, 0])
        shares(j, twist, tracks, along, none, x_e, half_tread, moduli, q[m])
    high, low = np.empty((2, count)), np.empty((2, count))
    for c in range(2):
        across = spread[1:, c + 1].copy()
        shares(j, twist, tracks, none, across, x_e, half_tread, moduli, high)
        shares(j, twist, tracks, none, -across, x_e, half_tread, moduli, low)
        for k in range(2):
            along_k = spread[0, c + 1] - spread[2, c + 1] * half_tread * (1.0 - 2.0 * k)
            for m in range(len(nodes) - 1):
                slope = (q[m + 1, k] - q[m, k]) / ((nodes[m + 1] - nodes[m]) * spread[0, 0])
                J[c, m, k] = 0.5 * (high[k] - low[k]) + slope * along_k
    return q, J


@compiled
def distances(
    q: FloatArray,
    J: FloatArray,
    thrusts: FloatArray,
    variances: FloatArray,
    limits: FloatArray,
    nodes: FloatArray,
    share_stddev: float,
) -> FloatArray:
    """d² (moduli, limits) of thrusts (2,) N with variances (2,) N² and ``share_stddev`` of F_max."""
    squares = np.empty((q.shape[2], len(limits)))
    for a in range(q.shape[2]):
        for b in range(len(limits)):
            limit = limits[b]
            own = share_stddev * share_stddev
            best = np.inf
            for m in range(len(nodes) - 1):
                ll = variances[0] / limit**2 + own + J[0, m, 0, a] ** 2 + J[1, m, 0, a] ** 2
                rr = variances[1] / limit**2 + own + J[0, m, 1, a] ** 2 + J[1, m, 1, a] ** 2
                lr = J[0, m, 0, a] * J[0, m, 1, a] + J[1, m, 0, a] * J[1, m, 1, a]
                scale = 1.0 / max(ll * rr - lr * lr, _DEPENDENT * ll * rr)
                left, right = thrusts[0] / limit - q[m, 0, a], thrusts[1] / limit - q[m, 1, a]
                d_left, d_right = q[m, 0, a] - q[m + 1, 0, a], q[m, 1, a] - q[m + 1, 1, a]
                z, dz = nodes[m], nodes[m + 1] - nodes[m]
                w_left, w_right = (rr * d_left - lr * d_right) * scale, (ll * d_right - lr * d_left) * scale
                bend = dz * dz + d_left * w_left + d_right * w_right
                fall = z * dz + left * w_left + right * w_right
                start = z * z + scale * (rr * left * left - 2.0 * lr * left * right + ll * right * right)
                t = min(max(-fall / bend, 0.0), 1.0)
                best = min(best, start + t * (2.0 * fall + t * bend))
            squares[a, b] = best
    return squares


@compiled
def log_likelihood(
    j: FloatArray,
    twist: FloatArray,
    spread: FloatArray,
    tracks: FloatArray,
    thrusts: FloatArray,
    variances: FloatArray,
    x_e: FloatArray,
    half_tread: float,
    moduli: FloatArray,
    limits: FloatArray,
    nodes: FloatArray,
    share_stddev: float,
    degrees: float,
) -> FloatArray:
    """Student-t log-likelihood (moduli, limits), up to a constant.

    A thrust that is not a number leaves its track out.
    """
    q, J = curves(j, twist, spread, tracks, x_e, half_tread, moduli, nodes)
    known, force, variance = 0, np.zeros(2), np.ones(2)
    for k in range(2):
        if math.isfinite(thrusts[k]):
            known += 1
            force[k], variance[k] = thrusts[k], variances[k]
        else:
            q[:, k] = 0.0
            J[:, :, k] = 0.0
    squares = distances(q, J, force, variance, limits, nodes, share_stddev)
    return -0.5 * (degrees + known) * np.log1p(squares / degrees)
