# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Shear displacement of the soil under the tracks: (3.3) extended to turns and changing slip, compiled.

    u        track speed r ω                                                        m/s
    v_x, v_y, φ̇   velocity of C and yaw rate: the twist                              m/s, rad/s
    x_e, ξ   position of an element ahead of C; its distance from the leading edge m
    s        sliding velocity (v_x − φ̇ y_e − u, v_y + φ̇ x_e)                        m/s
    j        shear displacement, carried along the contact: dj = s dt, dt = dξ/|u|  m
    K        shear deformation modulus                                              m
    w        ratio of an element's strength to the mean, 1 + x_e lean ≥ 0: ``ground_load``  1
    q        F/F_max = mean over the contact of w (1 − e^(−|j|/K)) (−s_x/|s|)       1

In steady straight motion |j| = |i| ξ, and q is that of (3.3). In a turn the track also slides sideways, which
uses part of the strength. After a change of motion, j depends on the motion before for one contact length.
Arrays over tracks are left, right; element 0 is the foremost.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled

LARGEST_DISPLACEMENT = 0.5  # m, bound of |j|: all strength is mobilised, and a reversal need not undo more
LEAST_SLIDING = 1e-9  # m, m/s, least divisor: slower sliding is none
_LARGEST_RATIO = 40.0  # |j|/K at which 1 − e^(−|j|/K) rounds to 1
_HALVINGS = 6


class Contact(NamedTuple):
    """Geometry of the track contact."""

    x_e: FloatArray  # (n,) of the element centres, foremost first, m
    half_tread: float  # m


class Rolling(NamedTuple):
    """Motion of the machine."""

    twist: FloatArray  # (3,)
    tracks: FloatArray  # (2,) u
    lean: float = 0.0  # 1/m


class SoilPath(NamedTuple):
    """Positions ``dt`` ago of the soil under each element; arrays (2, n)."""

    place: NDArray[np.int64]  # index of the element centre in front of it
    following: NDArray[np.int64]  # index of the element centre behind it
    part: FloatArray  # share of the distance from the former to the latter
    scale: FloatArray  # factor of j there: falls to 0 at the leading edge
    time: FloatArray  # time under the track since then, s
    middle: FloatArray  # x of the middle of its travel, m


class RollingError(NamedTuple):
    """Error of a ``Rolling``, constant while the tracks rolled over the soil."""

    along: FloatArray  # (2,) error of s_x of each track, m/s
    across: FloatArray  # (2,) errors of v_y and φ̇ in s_y, m/s, rad/s
    lean: float  # 1/m


@compiled
def mobilised_share(ratio: float) -> float:
    """Return 1 − e^(−ratio) for a ratio ≥ 0, to 1e-14, in plain arithmetic so that loops are vectorised.

    The series of m = e^−y − 1 at y = ratio/64 is doubled six times: e^(−2y) − 1 = m (2 + m).
    """
    y = min(ratio, _LARGEST_RATIO) * 0.5**_HALVINGS
    m = 1.0 - y / 7.0 * (1.0 - y / 8.0 * (1.0 - y / 9.0 * (1.0 - y / 10.0 * (1.0 - y / 11.0))))
    m = 1.0 - y / 4.0 * (1.0 - y / 5.0 * (1.0 - y / 6.0 * m))
    m = -y * (1.0 - y / 2.0 * (1.0 - y / 3.0 * m))
    for _ in range(_HALVINGS):
        m *= 2.0 + m
    return -m


@compiled
def sliding_along(rolling: Rolling, k: int, half_tread: float) -> float:
    """Return s_x of track k, m/s."""
    return float(rolling.twist[0] - rolling.twist[2] * half_tread * (1.0 - 2.0 * k) - rolling.tracks[k])


@compiled
def soil_path(tracks: FloatArray, x_e: FloatArray, dt: float) -> SoilPath:
    """Return where the soil under each element was ``dt`` ago, between two element centres.

    Soil that was not yet under the track is traced to the leading edge, where it is not sheared.
    """
    n = len(x_e)
    dx = x_e[0] - x_e[1]
    shape = (2, n)
    path = SoilPath(
        np.empty(shape, np.int64),
        np.empty(shape, np.int64),
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
    )
    for k in range(2):
        u = tracks[k]
        for i in range(n):  # from the leading edge
            e = i if u >= 0.0 else n - 1 - i
            xi = (i + 0.5) * dx
            distance = min(abs(u) * dt, xi)
            position = (xi - distance) / dx - 0.5  # in elements behind the first centre
            first = max(math.floor(position), 0)
            part = max(position - first, 0.0)
            front = first if u >= 0.0 else n - 1 - first
            path.place[k, e] = front
            path.following[k, e] = front if part == 0.0 else (front + 1 if u >= 0.0 else front - 1)
            path.part[k, e] = part
            path.scale[k, e] = min(1.0, 2.0 * (position + 0.5))
            path.time[k, e] = distance / abs(u) if distance == xi else dt
            path.middle[k, e] = x_e[e] + math.copysign(0.5 * distance, u)
    return path


@compiled
def displacement_before(j: FloatArray, path: SoilPath, k: int, e: int, axis: int) -> float:
    """Return a component of j (2, n, 2) at the former position of the soil under element e of track k, m."""
    before, behind = j[k, path.place[k, e], axis], j[k, path.following[k, e], axis]
    return float(path.scale[k, e] * ((1.0 - path.part[k, e]) * before + path.part[k, e] * behind))


@compiled
def propagate_displacement(j: FloatArray, rolling: Rolling, contact: Contact, dt: float) -> FloatArray:
    """Return j (2, n, 2) after steady motion for any dt > 0."""
    n, twist = len(contact.x_e), rolling.twist
    path = soil_path(rolling.tracks, contact.x_e, dt)
    after = np.empty_like(j)
    for k in range(2):
        s_x = sliding_along(rolling, k, contact.half_tread)
        for e in range(n):
            time = path.time[k, e]
            j_x = displacement_before(j, path, k, e, 0) + s_x * time
            j_y = displacement_before(j, path, k, e, 1) + (twist[1] + twist[2] * path.middle[k, e]) * time
            scale = min(1.0, LARGEST_DISPLACEMENT / max(math.hypot(j_x, j_y), LEAST_SLIDING))
            after[k, e, 0], after[k, e, 1] = scale * j_x, scale * j_y
    return after


@compiled
def fill_mobilised_shares(
    j: FloatArray, rolling: Rolling, error: RollingError, contact: Contact, moduli: FloatArray, q: FloatArray
) -> None:
    """Fill q (2, moduli) for ``rolling`` with ``error`` added."""
    x_e, twist = contact.x_e, rolling.twist
    n = len(x_e)
    dx = x_e[0] - x_e[1]
    q[:] = 0.0
    for k in range(2):
        u = rolling.tracks[k]
        s_x = sliding_along(rolling, k, contact.half_tread) + error.along[k]
        of_track, per_modulus = q[k], 1.0 / moduli
        for e in range(n):
            xi = (e + 0.5) * dx if u >= 0.0 else (n - 0.5 - e) * dx
            time = xi / max(abs(u), LEAST_SLIDING)
            s_y = twist[1] + error.across[0] + (twist[2] + error.across[1]) * x_e[e]
            middle = x_e[e] + math.copysign(0.5 * xi, u)
            j_x = j[k, e, 0] + error.along[k] * time
            j_y = j[k, e, 1] + (error.across[0] + error.across[1] * middle) * time
            displacement = math.hypot(j_x, j_y)
            share = -s_x / max(math.hypot(s_x, s_y), LEAST_SLIDING) / n
            share *= max(1.0 + (rolling.lean + error.lean) * x_e[e], 0.0)
            for m in range(len(moduli)):
                of_track[m] += share * mobilised_share(displacement * per_modulus[m])
