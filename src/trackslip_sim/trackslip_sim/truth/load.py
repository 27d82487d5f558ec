# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Distribution of the machine's weight over the elements of its contacts, compiled.

    G            gravity in the body frame: m g (sin θ, -cos θ sin ϕ, -cos θ cos ϕ)     N
    r_g          centre of gravity (x_g, y_g, h_g); h_g is its height above ground      m
    a            acceleration of C in the body frame, from the previous step           m/s²
    N            m g cos θ cos ϕ                                                        N
    x_N, y_N     centre of pressure: r_g - h_g (m a - G)/N                              m

Pressure is linear along the track while |x_N| <= l/6; beyond, it is a triangle that ends where the track
lifts. Moment balance divides N between the tracks. The machine tips over where the centre of pressure of the
weight alone leaves the contacts. With acceleration, the centre is limited to the contacts. N omits the
centripetal term v²κ of bends, < 0.3 % of N.
"""

import math
from typing import NamedTuple

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.units import GRAVITY
from trackslip_sim.truth.contact import Tracks

_MAX_OFFSET = 0.499  # of l and of B: the centre of pressure beyond which the machine tips over


class Load(NamedTuple):
    """Forces of one step that press the machine on the ground."""

    mass_properties: FloatArray  # (4,) m g, r_g; may change at each step
    acceleration: FloatArray  # (2,) a
    gravity: FloatArray  # (3,) G_x, G_y, and their moment about the normal at C
    normal_force: FloatArray  # (3,) N, x_N, y_N
    static_centre: FloatArray  # (2,) x_N, y_N without a
    tipped: FloatArray  # (1,) 1 once the machine has tipped over


@compiled
def set_normal_force(load: Load, pitch: float, roll: float) -> None:
    """Fill ``gravity``, ``normal_force`` and ``static_centre``."""
    weight, centre = load.mass_properties[0], load.mass_properties[1:]
    along, across = math.sin(pitch), -math.cos(pitch) * math.sin(roll)
    normal = math.cos(pitch) * math.cos(roll)
    load.gravity[0], load.gravity[1] = weight * along, weight * across
    load.gravity[2] = centre[0] * load.gravity[1] - centre[1] * load.gravity[0]
    load.normal_force[0] = weight * normal
    for i, share in ((0, along), (1, across)):
        load.normal_force[1 + i] = centre[i] - centre[2] * (load.acceleration[i] / GRAVITY - share) / normal
        load.static_centre[i] = centre[i] + centre[2] * share / normal


@compiled
def distribute_load(load: Load, tracks: Tracks) -> None:
    """Fill the loads of the elements; set ``tipped`` where the machine tips over."""
    n, length = len(tracks.x_e), tracks.length
    max_x, max_y = _MAX_OFFSET * length, _MAX_OFFSET * 2.0 * tracks.half_tread
    if abs(load.static_centre[0]) > max_x or abs(load.static_centre[1]) > max_y:
        load.tipped[0] = 1.0
    x = min(max(load.normal_force[1], -max_x), max_x)
    offset = min(max(load.normal_force[2], -max_y), max_y) / (2.0 * tracks.half_tread)
    for k in range(2):
        total = load.normal_force[0] * (0.5 + offset * (1.0 - 2.0 * k))
        for e in range(n):
            share = (1.0 + 12.0 * x * tracks.x_e[e] / length**2) / n
            if abs(x) > length / 6.0:
                loaded_share = 3.0 * (0.5 - abs(x) / length)  # share of the length that lies on the ground
                distance = (e if x > 0.0 else n - 1 - e) / n  # distance from the loaded end over l
                share = (
                    max(1.0 - distance / loaded_share, 0.0) ** 2
                    - max(1.0 - (distance + 1.0 / n) / loaded_share, 0.0) ** 2
                )
            tracks.load[k, e] = total * share
