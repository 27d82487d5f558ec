# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Shear between tracks and soil per contact element (Wong & Chiang 2001), compiled.

    q        (v_x, v_y, φ̇, u_L, u_R): hull velocity at C, track speeds u = r ω    m/s, rad/s
    x_e      position of an element's centre along the contact                      m
    s        sliding velocity (v_x - φ̇ y_e - u, v_y + φ̇ x_e)                       m/s
    j        shear displacement carried along the contact, (j_x, j_y)               m
    f        strength mobilised on an element, (c A_e + N_e tan ϕ)(1 - e^(-|j|/K))  N
    ρ        √(|s|² + s₀²): the force -f s/ρ goes to zero with s where |s| < s₀     m/s

Arrays over tracks and elements are (2, elements): left, right; element 0 is the foremost.
"""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.compiled import compiled
from trackslip_sim.truth.ground import SoilMap, soil_at

MAX_SHEAR = 10.0  # upper limit of |j|/K: all but 5e-5 of the strength is mobilised there


class Tracks(NamedTuple):
    """Geometry and load of both contacts; only the load changes during a run."""

    x_e: FloatArray  # (n,) m
    load: FloatArray  # (2, n) N
    element_area: float  # m²
    half_tread: float  # m
    length: float  # m


class Shear(NamedTuple):
    """State of the soil under the elements."""

    j: FloatArray  # (2, n, 2) m
    soil: IntArray  # (2, n) index into the map's table
    strength: FloatArray  # (2, n) f, N


class ShearSums(NamedTuple):
    """Derivatives of the shear potential Σ f ρ with respect to the sliding velocity, summed per track."""

    force: FloatArray  # (2, 3) Σ of g s_x, g s_y, g s_y x_e with g = f/ρ: the negative of the soil's force
    curvature: FloatArray  # (2, 6) second derivatives, Σ of h_xx, h_xy, h_xy x_e, h_yy, h_yy x_e, h_yy x_e²


def undisturbed_shear(elements: int) -> Shear:
    """Shear state of undisturbed soil: j = 0."""
    return Shear(np.zeros((2, elements, 2)), np.zeros((2, elements), np.int64), np.zeros((2, elements)))


@compiled
def mobilise(shear: Shear, tracks: Tracks, ground: SoilMap) -> None:
    """Fill the mobilised strengths f from the shear displacements."""
    for k in range(2):
        for e in range(len(tracks.x_e)):
            soil = shear.soil[k, e]
            cohesion = ground.table[soil, 0]
            tan_friction = ground.table[soil, 1]
            modulus = ground.table[soil, 2]
            displacement = math.sqrt(shear.j[k, e, 0] ** 2 + shear.j[k, e, 1] ** 2)
            area = tracks.element_area if tracks.load[k, e] > 0.0 else 0.0  # 0 where the track has lifted
            full = cohesion * area + tracks.load[k, e] * tan_friction
            shear.strength[k, e] = full * -math.expm1(-displacement / modulus)


@compiled
def find_soils(pose: FloatArray, tracks: Tracks, ground: SoilMap, shear: Shear) -> None:
    """Fill the soils under the elements; ``pose`` is x, y, yaw."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for k in range(2):
        y_e = tracks.half_tread * (1.0 - 2.0 * k)
        for e in range(len(tracks.x_e)):
            x = pose[0] + cos * tracks.x_e[e] - sin * y_e
            y = pose[1] + sin * tracks.x_e[e] + cos * y_e
            shear.soil[k, e] = soil_at(x, y, ground)


@compiled
def advect_shear(shear: Shear, q: FloatArray, tracks: Tracks, step: float) -> None:
    """Advance j by one step: j grows at rate s and is advected rearwards (forwards in reverse) at |u|.

    Implicit upwind differences, swept from the leading edge, where j = 0. They are bounded at any step. In
    steady motion they equal the midpoint rule for ∫ s dx/|u|.
    """
    j, x_e = shear.j, tracks.x_e
    n = len(x_e)
    dx = x_e[0] - x_e[1]
    for k in range(2):
        u = q[3 + k]
        s_x = q[0] - q[2] * tracks.half_tread * (1.0 - 2.0 * k) - u
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
def limit_shear(shear: Shear, ground: SoilMap) -> None:
    """Limit each |j| to ``MAX_SHEAR`` K, so that a reversal need not first undo a long slide."""
    j = shear.j
    for k in range(2):
        for e in range(j.shape[1]):
            limit = MAX_SHEAR * ground.table[shear.soil[k, e], 2]
            displacement = math.sqrt(j[k, e, 0] ** 2 + j[k, e, 1] ** 2)
            if displacement > limit:
                j[k, e, 0] *= limit / displacement
                j[k, e, 1] *= limit / displacement


@compiled
def shear_sums(q: FloatArray, shear: Shear, tracks: Tracks, floor: float, sums: ShearSums) -> None:
    """Fill ``sums`` at q; ``floor`` is s₀."""
    for k in range(2):
        s_x = q[0] - q[2] * tracks.half_tread * (1.0 - 2.0 * k) - q[3 + k]
        f_x, f_y, moment = 0.0, 0.0, 0.0
        h_xx, h_xy, h_xyx, h_yy, h_yyx, h_yyxx = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for e in range(len(tracks.x_e)):
            x = tracks.x_e[e]
            s_y = q[1] + q[2] * x
            rho = math.sqrt(s_x * s_x + s_y * s_y + floor * floor)
            g = shear.strength[k, e] / rho
            bend = g / (rho * rho)
            f_x += g * s_x
            f_y += g * s_y
            moment += g * s_y * x
            xy = -bend * s_x * s_y
            yy = g - bend * s_y * s_y
            h_xx += g - bend * s_x * s_x
            h_xy += xy
            h_xyx += xy * x
            h_yy += yy
            h_yyx += yy * x
            h_yyxx += yy * x * x
        sums.force[k, 0], sums.force[k, 1], sums.force[k, 2] = f_x, f_y, moment
        curvature = sums.curvature
        curvature[k, 0], curvature[k, 1], curvature[k, 2] = h_xx, h_xy, h_xyx
        curvature[k, 3], curvature[k, 4], curvature[k, 5] = h_yy, h_yyx, h_yyxx
