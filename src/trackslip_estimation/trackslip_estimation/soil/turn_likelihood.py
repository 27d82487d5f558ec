# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Squared distance of a pair of thrusts from each (K, F_max), with errors in slip and thrust, compiled.

    q        F/F_max of each track, see ``shear_field``                              1
    U        upper triangular, U Uᵀ the twist's covariance: errors (v_x, v_y, φ̇) = U z
    z        first component of z: error of v_x alone, in its standard deviations 1
    J        change of q for one standard deviation of each other error, and of the load's lean  1
    R        covariance of thrust and model errors, plus F_max² J Jᵀ                 N²
    d²       minimum over z of z² + (F − F_max q(z))ᵀ R⁻¹ (F − F_max q(z))

Both slip and thrust have errors: d is the distance from the measurement to the curve q(z), not along one
axis, so that small slips cause no bias. The curve is nonlinear within the errors of slip, and is replaced by
straight pieces between a few z. Errors of φ̇ shift the tracks along their curves in opposite directions.
"""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.soil.shear_field import Contact, Rolling, RollingError, fill_mobilised_shares

_DEPENDENT = 1e-9  # least share of a determinant, against rounding
_NODES = np.linspace(-4.0, 4.0, 17)  # z


class Turn(NamedTuple):
    """One averaged sample of a turn."""

    j: FloatArray  # (2, n, 2) shear displacement under the tracks, m
    rolling: Rolling
    spread: FloatArray  # (3, 3) U
    force: FloatArray  # (2,) N, nan if unknown: its track is left out
    variance: FloatArray  # (2,) N²
    share_stddev: float  # model error, as share of F_max
    lean_stddev: float  # 1/m, of the rolling's lean


class Curves(NamedTuple):
    """q along z, and its derivatives, for each K."""

    q: FloatArray  # (nodes, 2, moduli)
    J: FloatArray  # (3, nodes − 1, 2, moduli), between the nodes


@compiled
def thrust_curves(turn: Turn, contact: Contact, moduli: FloatArray) -> Curves:
    """Return q of both tracks for each K over errors of v_x, and its changes by the other errors."""
    j, rolling, spread = turn.j, turn.rolling, turn.spread
    nodes, count, half_tread = len(_NODES), len(moduli), contact.half_tread
    q, J = np.empty((nodes, 2, count)), np.empty((3, nodes - 1, 2, count))
    none = np.zeros(2)
    for m in range(nodes):
        along = np.full(2, _NODES[m] * spread[0, 0])
        fill_mobilised_shares(j, rolling, RollingError(along, none, 0.0), contact, moduli, q[m])
    high, low = np.empty((2, count)), np.empty((2, count))
    for c in range(2):
        across = spread[1:, c + 1].copy()
        fill_mobilised_shares(j, rolling, RollingError(none, across, 0.0), contact, moduli, high)
        fill_mobilised_shares(j, rolling, RollingError(none, -across, 0.0), contact, moduli, low)
        for k in range(2):
            along_k = spread[0, c + 1] - spread[2, c + 1] * half_tread * (1.0 - 2.0 * k)
            for m in range(nodes - 1):
                per_metre = 1.0 / ((_NODES[m + 1] - _NODES[m]) * spread[0, 0])
                for a in range(count):
                    slope = (q[m + 1, k, a] - q[m, k, a]) * per_metre
                    J[c, m, k, a] = 0.5 * (high[k, a] - low[k, a]) + slope * along_k
    fill_mobilised_shares(j, rolling, RollingError(none, none, turn.lean_stddev), contact, moduli, high)
    fill_mobilised_shares(j, rolling, RollingError(none, none, -turn.lean_stddev), contact, moduli, low)
    J[2] = 0.5 * (high - low)
    return Curves(q, J)


@compiled
def squared_distances(curves: Curves, turn: Turn, limits: FloatArray) -> FloatArray:
    """Return d² (moduli, limits) of the known thrusts; curves of unknown ones are set to 0 in place.

    For each piece of the curve the loop over F_max is plain arithmetic, so that it is vectorised (``/`` would
    check for zeros). Terms are divided by F_max², and multiplied by the determinant of R until the end.
    """
    q, J = curves.q, curves.J
    count, share_variance = q.shape[2], turn.share_stddev**2
    force, variance = np.zeros(2), np.ones(2)
    for k in range(2):
        if math.isfinite(turn.force[k]):
            force[k], variance[k] = turn.force[k], turn.variance[k]
        else:
            q[:, k] = 0.0
            J[:, :, k] = 0.0
    per_limit = 1.0 / limits
    force_left, force_right = force[0] * per_limit, force[1] * per_limit
    variance_left = variance[0] * per_limit**2 + share_variance
    variance_right = variance[1] * per_limit**2 + share_variance
    squares = np.full((count, len(limits)), np.inf)
    for a in range(count):
        best = squares[a]
        for m in range(len(_NODES) - 1):
            z, dz = _NODES[m], _NODES[m + 1] - _NODES[m]
            q_left, q_right = q[m, 0, a], q[m, 1, a]
            d_left, d_right = q_left - q[m + 1, 0, a], q_right - q[m + 1, 1, a]
            J_ll = J[0, m, 0, a] ** 2 + J[1, m, 0, a] ** 2 + J[2, m, 0, a] ** 2
            J_rr = J[0, m, 1, a] ** 2 + J[1, m, 1, a] ** 2 + J[2, m, 1, a] ** 2
            lr = J[0, m, 0, a] * J[0, m, 1, a] + J[1, m, 0, a] * J[1, m, 1, a]
            lr += J[2, m, 0, a] * J[2, m, 1, a]
            for b in range(len(limits)):
                ll, rr = variance_left[b] + J_ll, variance_right[b] + J_rr
                product = ll * rr
                determinant = max(product - lr * lr, _DEPENDENT * product)
                left, right = force_left[b] - q_left, force_right[b] - q_right
                w_left, w_right = rr * d_left - lr * d_right, ll * d_right - lr * d_left
                bend = dz * dz * determinant + d_left * w_left + d_right * w_right
                fall = z * dz * determinant + left * w_left + right * w_right
                start = rr * left * left - 2.0 * lr * left * right + ll * right * right
                t = min(max(np.divide(-fall, bend), 0.0), 1.0)
                square = z * z + np.divide(start + t * (2.0 * fall + t * bend), determinant)
                best[b] = min(best[b], square)
    return squares
