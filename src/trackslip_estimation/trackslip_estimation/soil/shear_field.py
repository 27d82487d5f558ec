# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The soil sheared under the tracks: (3.3) carried through turns and changes of slip, compiled.

    u        track speed r ω                                                        m/s
    v_x, v_y, φ̇   velocity of C and yaw rate: the twist                              m/s, rad/s
    x_e, ξ   an element's place ahead of C; its distance from the leading edge      m
    s        sliding velocity (v_x − φ̇ y_e − u, v_y + φ̇ x_e)                        m/s
    j        shear displacement, carried along the contact: dj = s dt, dt = dξ/|u|  m
    K        shear deformation modulus                                              m
    w        strength of an element over the mean, 1 + x_e lean ≥ 0: ``ground_load``  1
    q        F/F_max = mean over the contact of w (1 − e^(−|j|/K)) (−s_x/|s|)       1

In steady straight motion |j| = |i| ξ, and q is that of (3.3). In a turn the track slides sideways too, which
takes part of the strength from the thrust; and for a track's length after any change the soil remembers.
Arrays over tracks are left, right; element 0 is the foremost.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled

FARTHEST = 0.5  # m, at which all strength is mobilised: a reversal need not undo more
STILL = 1e-9  # m, m/s, below which nothing slides
_ALL = 40.0  # |j|/K, at which 1 − e^(−|j|/K) is 1 to the last bit
_HALVINGS = 6


class Contact(NamedTuple):
    """Where the tracks touch the ground."""

    x_e: FloatArray  # (n,) of the elements' centres, from the front, m
    half_tread: float  # m


class Rolling(NamedTuple):
    """How the machine moves."""

    twist: FloatArray  # (3,)
    tracks: FloatArray  # (2,) u
    lean: float = 0.0  # 1/m


class Path(NamedTuple):
    """Where the soil under each element was ``dt`` ago; (2, n) each."""

    place: NDArray[np.int64]  # in front of it, the element
    following: NDArray[np.int64]  # behind it, the next one
    part: FloatArray  # of the way from the one to the other
    scale: FloatArray  # of j there: down to 0 at the leading edge
    time: FloatArray  # for which the soil was under the track, s
    middle: FloatArray  # x of the middle of its way, m


class RollingError(NamedTuple):
    """By how much a ``Rolling`` is off, and was so while the tracks rolled over the soil."""

    along: FloatArray  # (2,) of each track's s_x, m/s
    across: FloatArray  # (2,) of v_y and φ̇ in s_y
    lean: float  # 1/m


def element_places(length: float, elements: int) -> FloatArray:
    """x_e of the elements' centres (n,), from the front, m."""
    return length * (0.5 - (np.arange(elements) + 0.5) / elements)


@compiled
def mobilised(ratio: float) -> float:
    """1 − e^(−ratio) for a ratio ≥ 0, to 1e-14; of plain arithmetic, so that loops over it are vectorised.

    e^−y − 1 of y = ratio/64 by its series, then doubled six times: e^(−2y) − 1 = m (2 + m).
    """
    y = min(ratio, _ALL) * 0.5**_HALVINGS
    m = 1.0 - y / 7.0 * (1.0 - y / 8.0 * (1.0 - y / 9.0 * (1.0 - y / 10.0 * (1.0 - y / 11.0))))
    m = 1.0 - y / 4.0 * (1.0 - y / 5.0 * (1.0 - y / 6.0 * m))
    m = -y * (1.0 - y / 2.0 * (1.0 - y / 3.0 * m))
    for _ in range(_HALVINGS):
        m *= 2.0 + m
    return -m


@compiled
def sliding_along(rolling: Rolling, k: int, half_tread: float) -> float:
    """s_x of track k."""
    return float(rolling.twist[0] - rolling.twist[2] * half_tread * (1.0 - 2.0 * k) - rolling.tracks[k])


@compiled
def path_of(tracks: FloatArray, x_e: FloatArray, dt: float) -> Path:
    """Follow each element's soil back to where it was, between two centres.

    Or to the leading edge, where it was not yet sheared.
    """
    n = len(x_e)
    dx = x_e[0] - x_e[1]
    shape = (2, n)
    path = Path(
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
            place = (xi - distance) / dx - 0.5  # in elements behind the first centre
            first = max(math.floor(place), 0)
            part = max(place - first, 0.0)
            at = first if u >= 0.0 else n - 1 - first
            path.place[k, e] = at
            path.following[k, e] = at if part == 0.0 else (at + 1 if u >= 0.0 else at - 1)
            path.part[k, e] = part
            path.scale[k, e] = min(1.0, 2.0 * (place + 0.5))
            path.time[k, e] = distance / abs(u) if distance == xi else dt
            path.middle[k, e] = x_e[e] + math.copysign(0.5 * distance, u)
    return path


@compiled
def carried(j: FloatArray, path: Path, k: int, e: int, axis: int) -> float:
    """What j (2, n, 2) was where the soil under an element was, m."""
    before, behind = j[k, path.place[k, e], axis], j[k, path.following[k, e], axis]
    return float(path.scale[k, e] * ((1.0 - path.part[k, e]) * before + path.part[k, e] * behind))


@compiled
def carry(j: FloatArray, rolling: Rolling, contact: Contact, dt: float) -> FloatArray:
    """J (2, n, 2) after dt > 0 of steady motion, of any length."""
    n, twist = len(contact.x_e), rolling.twist
    path = path_of(rolling.tracks, contact.x_e, dt)
    after = np.empty_like(j)
    for k in range(2):
        s_x = sliding_along(rolling, k, contact.half_tread)
        for e in range(n):
            time = path.time[k, e]
            j_x = carried(j, path, k, e, 0) + s_x * time
            j_y = carried(j, path, k, e, 1) + (twist[1] + twist[2] * path.middle[k, e]) * time
            scale = min(1.0, FARTHEST / max(math.hypot(j_x, j_y), STILL))
            after[k, e, 0], after[k, e, 1] = scale * j_x, scale * j_y
    return after


@compiled
def shares(
    j: FloatArray, rolling: Rolling, error: RollingError, contact: Contact, moduli: FloatArray, q: FloatArray
) -> None:
    """Fill q (2, moduli) for a rolling that is off by ``error``."""
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
            time = xi / max(abs(u), STILL)
            s_y = twist[1] + error.across[0] + (twist[2] + error.across[1]) * x_e[e]
            middle = x_e[e] + math.copysign(0.5 * xi, u)
            j_x = j[k, e, 0] + error.along[k] * time
            j_y = j[k, e, 1] + (error.across[0] + error.across[1] * middle) * time
            slid = math.hypot(j_x, j_y)
            share = -s_x / max(math.hypot(s_x, s_y), STILL) / n
            share *= max(1.0 + (rolling.lean + error.lean) * x_e[e], 0.0)
            for m in range(len(moduli)):
                of_track[m] += share * mobilised(slid * per_modulus[m])
