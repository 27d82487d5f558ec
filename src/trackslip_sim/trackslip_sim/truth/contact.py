# SPDX-License-Identifier: Apache-2.0
"""Shear between tracks and soil, element by element (Wong & Chiang 2001), compiled.

    q        (v_x, v_y, φ̇, u_L, u_R): hull velocity at C, track speeds u = r ω    m/s, rad/s
    x_e      position of an element's centre along the contact                      m
    s        sliding velocity (v_x - φ̇ y_e - u, v_y + φ̇ x_e)                       m/s
    j        shear displacement carried along the contact, (j_x, j_y)               m
    f        strength mobilised on an element, (c A_e + N_e tan ϕ)(1 - e^(-|j|/K))  N
    ρ        √(|s|² + s₀²): the force -f s/ρ fades where sliding does, below s₀     m/s

Arrays over tracks and elements are (2, elements): left, right; element 0 is the foremost.
"""

import math

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_sim.truth.ground import soil_at
from trackslip_sim.truth.record import FloatArray, IntArray

FORGET = 10.0  # |j| is kept below this many K: all strength is mobilised there (5e-5 short of it)


@compiled
def mobilise(
    j: FloatArray, load: FloatArray, area: float, soil: IntArray, table: FloatArray, strength: FloatArray
) -> None:
    """Fill ``strength`` (2, n) N from the shear displacements ``j`` (2, n, 2) m and loads (2, n) N."""
    for k in range(2):
        for e in range(load.shape[1]):
            row = table[soil[k, e]]
            slid = math.sqrt(j[k, e, 0] ** 2 + j[k, e, 1] ** 2)
            strength[k, e] = (row[0] * area + load[k, e] * row[1]) * -math.expm1(-slid / row[2])


@compiled
def find_soils(
    pose: FloatArray,
    x_e: FloatArray,
    half_tread: float,
    edges: FloatArray,
    patch_soil: IntArray,
    soil: IntArray,
) -> None:
    """Fill ``soil`` (2, n) with the soil's index under each element; ``pose`` is x, y, yaw."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for k in range(2):
        y_e = half_tread * (1.0 - 2.0 * k)
        for e in range(len(x_e)):
            x = pose[0] + cos * x_e[e] - sin * y_e
            y = pose[1] + sin * x_e[e] + cos * y_e
            soil[k, e] = soil_at(x, y, edges, patch_soil)


@compiled
def carry(j: FloatArray, q: FloatArray, x_e: FloatArray, half_tread: float, step: float) -> None:
    """Advance j (2, n, 2) by one step: it grows by s and is carried rearwards (forwards in reverse) at |u|.

    Implicit upwind differences, swept from the leading edge, where j = 0: bounded at any step, and in
    steady motion the midpoint rule for ∫ s dx/|u|.
    """
    n = len(x_e)
    dx = x_e[0] - x_e[1]
    for k in range(2):
        u = q[3 + k]
        s_x = q[0] - q[2] * half_tread * (1.0 - 2.0 * k) - u
        ahead = 0.5 * dx if u > 0.0 else (-0.5 * dx if u < 0.0 else 0.0)
        share = abs(u) * step / dx
        before_x, before_y = 0.0, 0.0
        for i in range(n):
            e = i if u >= 0.0 else n - 1 - i
            entry = i == 0  # half an element from the edge to the first centre
            part = 2.0 * share if entry else share
            s_y = q[1] + q[2] * (x_e[e] + (0.5 * ahead if entry else ahead))
            before_x = (j[k, e, 0] + step * s_x + part * before_x) / (1.0 + part)
            before_y = (j[k, e, 1] + step * s_y + part * before_y) / (1.0 + part)
            j[k, e, 0], j[k, e, 1] = before_x, before_y


@compiled
def forget(j: FloatArray, soil: IntArray, table: FloatArray) -> None:
    """Shorten each j (2, n, 2) to at most ``FORGET`` K, so that a reversal need not undo a long slide."""
    for k in range(2):
        for e in range(j.shape[1]):
            limit = FORGET * table[soil[k, e], 2]
            slid = math.sqrt(j[k, e, 0] ** 2 + j[k, e, 1] ** 2)
            if slid > limit:
                j[k, e, 0] *= limit / slid
                j[k, e, 1] *= limit / slid


@compiled
def shear_sums(
    q: FloatArray,
    strength: FloatArray,
    x_e: FloatArray,
    half_tread: float,
    floor: float,
    force: FloatArray,
    curvature: FloatArray,
) -> None:
    """Derivatives of the shear forces' potential Σ f ρ by the sliding velocity, summed per track.

    ``force`` (2, 3): Σ g s_x, Σ g s_y, Σ g s_y x_e with g = f/ρ; the soil's force is minus that.
    ``curvature`` (2, 6): second derivatives, Σ of h_xx, h_xy, h_xy x_e, h_yy, h_yy x_e, h_yy x_e².
    """
    force[:] = 0.0
    curvature[:] = 0.0
    for k in range(2):
        s_x = q[0] - q[2] * half_tread * (1.0 - 2.0 * k) - q[3 + k]
        for e in range(len(x_e)):
            x = x_e[e]
            s_y = q[1] + q[2] * x
            rho = math.sqrt(s_x * s_x + s_y * s_y + floor * floor)
            g = strength[k, e] / rho
            bend = g / (rho * rho)
            force[k, 0] += g * s_x
            force[k, 1] += g * s_y
            force[k, 2] += g * s_y * x
            h_xy = -bend * s_x * s_y
            h_yy = g - bend * s_y * s_y
            curvature[k, 0] += g - bend * s_x * s_x
            curvature[k, 1] += h_xy
            curvature[k, 2] += h_xy * x
            curvature[k, 3] += h_yy
            curvature[k, 4] += h_yy * x
            curvature[k, 5] += h_yy * x * x


def element_positions(length: float, elements: int) -> FloatArray:
    """Centres of the elements (n,), m, from the front."""
    return length * (0.5 - (np.arange(elements) + 0.5) / elements)


def element_loads(
    weight: float, tread: float, x_e: FloatArray, length: float, load_x: float, load_y: float
) -> FloatArray:
    """Weight on each element (2, n), N: linear along the track, split between them by moments."""
    along = (1.0 + 12.0 * load_x * x_e / length**2) / len(x_e)
    split = np.array([0.5 + load_y / tread, 0.5 - load_y / tread])
    loads: FloatArray = weight * split[:, None] * along[None, :]
    return loads
