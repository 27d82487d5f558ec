# SPDX-License-Identifier: Apache-2.0
"""The soil sheared under the tracks: (3.3) carried through turns and changes of slip, compiled.

    u        track speed r ω                                                        m/s
    v_x, v_y, φ̇   velocity of C and yaw rate: the twist                              m/s, rad/s
    x_e, ξ   an element's place ahead of C; its distance from the leading edge      m
    s        sliding velocity (v_x − φ̇ y_e − u, v_y + φ̇ x_e)                        m/s
    j        shear displacement, carried along the contact: dj = s dt, dt = dξ/|u|  m
    K        shear deformation modulus                                              m
    q        F/F_max = mean over the contact of (1 − e^(−|j|/K)) (−s_x/|s|)         1

In steady straight motion |j| = |i| ξ, and q is that of (3.3). In a turn the track slides sideways too, which
takes part of the strength from the thrust; and for a track's length after any change the soil remembers.
Arrays over tracks are left, right; element 0 is the foremost.
"""

import math

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled

FloatArray = NDArray[np.float64]

_FARTHEST = 0.5  # m, at which all strength is mobilised: a reversal need not undo more
_STILL = 1e-9  # m, m/s, below which nothing slides


def element_places(length: float, elements: int) -> FloatArray:
    """x_e of the elements' centres (n,), from the front, m."""
    return length * (0.5 - (np.arange(elements) + 0.5) / elements)


@compiled
def carry(
    j: FloatArray, twist: FloatArray, tracks: FloatArray, x_e: FloatArray, half_tread: float, dt: float
) -> FloatArray:
    """J (2, n, 2) after dt > 0 of steady motion, of any length.

    Each element's soil is followed back to where it was, between two centres, or to the leading edge, where
    it was not yet sheared.
    """
    n = len(x_e)
    dx = x_e[0] - x_e[1]
    after = np.empty_like(j)
    for k in range(2):
        u = tracks[k]
        s_x = twist[0] - twist[2] * half_tread * (1.0 - 2.0 * k) - u
        for i in range(n):  # from the leading edge
            e = i if u >= 0.0 else n - 1 - i
            xi = (i + 0.5) * dx
            way = min(abs(u) * dt, xi)
            time = way / abs(u) if way == xi else dt
            place = (xi - way) / dx - 0.5  # in elements behind the first centre
            first = max(math.floor(place), 0)
            part = max(place - first, 0.0)
            scale = min(1.0, 2.0 * (place + 0.5))  # down to 0 at the edge
            at = first if u >= 0.0 else n - 1 - first
            behind = at if part == 0.0 else (at + 1 if u >= 0.0 else at - 1)
            middle = x_e[e] + math.copysign(0.5 * way, u)
            for axis in range(2):
                before = scale * ((1.0 - part) * j[k, at, axis] + part * j[k, behind, axis])
                slide = s_x if axis == 0 else twist[1] + twist[2] * middle
                after[k, e, axis] = before + slide * time
            slid = math.hypot(after[k, e, 0], after[k, e, 1])
            after[k, e] *= min(1.0, _FARTHEST / max(slid, _STILL))
    return after


@compiled
def shares(
    j: FloatArray,
    twist: FloatArray,
    tracks: FloatArray,
    along: FloatArray,
    across: FloatArray,
    x_e: FloatArray,
    half_tread: float,
    moduli: FloatArray,
    q: FloatArray,
) -> None:
    """Fill q (2, moduli) for sliding velocities that are off, and were so while the tracks rolled over.

    ``along`` (2,) is the error of each track's s_x; ``across`` (2,) are those of v_y and φ̇ in s_y.
    """
    n = len(x_e)
    dx = x_e[0] - x_e[1]
    q[:] = 0.0
    for k in range(2):
        u = tracks[k]
        s_x = twist[0] - twist[2] * half_tread * (1.0 - 2.0 * k) - u + along[k]
        for e in range(n):
            xi = (e + 0.5) * dx if u >= 0.0 else (n - 0.5 - e) * dx
            time = xi / max(abs(u), _STILL)
            s_y = twist[1] + across[0] + (twist[2] + across[1]) * x_e[e]
            middle = x_e[e] + math.copysign(0.5 * xi, u)
            j_x = j[k, e, 0] + along[k] * time
            j_y = j[k, e, 1] + (across[0] + across[1] * middle) * time
            slid = math.hypot(j_x, j_y)
            share = -s_x / max(math.hypot(s_x, s_y), _STILL) / n
            for m in range(len(moduli)):
                q[k, m] -= share * math.expm1(-slid / moduli[m])
