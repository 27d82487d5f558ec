# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Lateral forces of the soil in a turn, their moment, and the centre of rotation of the vehicle.

    l        contact length of a track                                  m
    x        position along a track, in the thesis from 0 to l          m
    W        weight of the vehicle, m g                                 N
    μ_l      coefficient of lateral resistance                          1
    φ̇, v_x   yaw rate (left positive), speed of the track centre C      rad/s, m/s
    R        radius of the turn, |v_x/φ̇|                                m
    a        lateral acceleration φ̇² R                                  m/s²
    λ        a/(2 g μ_l): from 1 on no element pushes outward           1
    f        lateral force per metre of one track                       N/m
    x_0, x_s where f vanishes, centroid of |f|                          m
    M_r      moment of turning resistance of both tracks                N m
    D        distance of the centre of rotation ahead of C              m
    α        slip angle, tan α = v_y/v_x, positive to the left          rad

The thesis distributes the centrifugal force evenly over the tracks. Its x_s − l/2 to first order in λ is
the D that balances the lateral forces exactly; the full (3.6) is the centroid of |f|.
"""

import numpy as np
from numpy.typing import ArrayLike

from trackslip_common.arrays import FloatArray
from trackslip_common.units import GRAVITY
from trackslip_estimation.terramechanics.domain import validate


def lateral_force(
    x: ArrayLike, weight: ArrayLike, length: ArrayLike, mu_l: ArrayLike, acceleration: ArrayLike
) -> FloatArray:
    """f(x) = μ_l W (1 − 2x/l)/l − m a/(2 l) in N/m, (3.4); with a = 0 it is (3.9).

    F_I and F_II, the forces at the ends, are its values at 0 and l.

    Args:
        x: 0 ≤ x ≤ l, m.
        weight: W ≥ 0, N.
        length: l > 0, m.
        mu_l: μ_l > 0.
        acceleration: a ≥ 0, m/s².

    Raises:
        InputError: an argument is out of range.
    """
    contact = validate("length", length, "m", gt=0.0)
    share = validate("x/length", validate("x", x, "m") / contact, ge=0.0, le=1.0)
    mu = validate("mu_l", mu_l, gt=0.0)
    a = validate("acceleration", acceleration, "m/s²", ge=0.0)
    return (
        validate("weight", weight, "N", ge=0.0) / contact * (mu * (1.0 - 2.0 * share) - a / (2.0 * GRAVITY))
    )


def zero_force_point(length: ArrayLike, mu_l: ArrayLike, acceleration: ArrayLike) -> FloatArray:
    """x_0 = l/2 − a l/(4 g μ_l) in m, (3.4); negative when f vanishes nowhere on the track (λ > 1).

    Args:
        length: l > 0, m.
        mu_l: μ_l > 0.
        acceleration: a ≥ 0, m/s².

    Raises:
        InputError: an argument is out of range.
    """
    return 0.5 * validate("length", length, "m", gt=0.0) * (1.0 - _load_ratio(mu_l, acceleration))


def centre_point(length: ArrayLike, mu_l: ArrayLike, acceleration: ArrayLike) -> FloatArray:
    """x_s = M_y/A in m, (3.5) and (3.6), both cases: the centroid of |f|.

    λ ≤ 1: x_s/l = ½ + (λ/2 − λ³/6)/(1 + λ²), which is (3.6) on one denominator.
    λ ≥ 1: x_s/l = ½ + 1/(6 λ).

    Args:
        length: l > 0, m.
        mu_l: μ_l > 0.
        acceleration: a ≥ 0, m/s².

    Raises:
        InputError: an argument is out of range.
    """
    load = _load_ratio(mu_l, acceleration)
    low, high = np.minimum(load, 1.0), np.maximum(load, 1.0)
    shift = np.where(load <= 1.0, (low / 2.0 - low**3 / 6.0) / (1.0 + low**2), 1.0 / (6.0 * high))
    return validate("length", length, "m", gt=0.0) * (0.5 + shift)


def centre_point_approximate(length: ArrayLike, mu_l: ArrayLike, acceleration: ArrayLike) -> FloatArray:
    """x_s ≈ l/2 + a l/(4 g μ_l) in m, the last form of (3.6), for λ well below 1.

    Args:
        length: l > 0, m.
        mu_l: μ_l > 0.
        acceleration: a ≥ 0, m/s².

    Raises:
        InputError: an argument is out of range.
    """
    return 0.5 * validate("length", length, "m", gt=0.0) * (1.0 + _load_ratio(mu_l, acceleration))


def moment_with_centrifugal_force(
    weight: ArrayLike, length: ArrayLike, mu_l: ArrayLike, acceleration: ArrayLike
) -> FloatArray:
    """M_r = (μ_l W l/3) (1 − 3λ² + 2λ³) in N m, (3.7) with its ``g μ`` read as ``g μ_l``.

    This is the published integral: four times the moment about x_s of the part of the track beyond x_s.
    The moment about C of the whole distribution does not depend on λ and is (3.8), because a force
    spread evenly has no moment about the middle (``docs/thesis.md``).

    Args:
        weight: W ≥ 0, N.
        length: l > 0, m.
        mu_l: μ_l > 0.
        acceleration: 0 ≤ a ≤ 2 g μ_l, m/s² (λ ≤ 1; beyond it the integral has no extent).

    Raises:
        InputError: an argument is out of range.
    """
    load = validate("acceleration/(2 g mu_l)", _load_ratio(mu_l, acceleration), le=1.0)
    return triangular_moment(weight, length, mu_l) * (1.0 - load) ** 2 * (1.0 + 2.0 * load)


def triangular_moment(weight: ArrayLike, length: ArrayLike, mu_l: ArrayLike) -> FloatArray:
    """M_r = μ_l W l/3 in N m, (3.8): force grows from the middle to the ends.

    Args:
        weight: W ≥ 0, N.
        length: l > 0, m.
        mu_l: μ_l > 0.

    Raises:
        InputError: an argument is out of range.
    """
    return _force_times_length(weight, length, mu_l) / 3.0


def uniform_moment(weight: ArrayLike, length: ArrayLike, mu_l: ArrayLike) -> FloatArray:
    """M_r = μ_l W l/4 in N m, after Wong: the same force on every element.

    Args:
        weight: W ≥ 0, N.
        length: l > 0, m.
        mu_l: μ_l > 0.

    Raises:
        InputError: an argument is out of range.
    """
    return _force_times_length(weight, length, mu_l) / 4.0


def rotation_shift(speed: ArrayLike, yaw_rate: ArrayLike, length: ArrayLike, mu_l: ArrayLike) -> FloatArray:
    """D = v_x |φ̇| l/(4 g μ_l) in m, from (3.6): ahead of C when driving forward, behind it in reverse.

    Args:
        speed: v_x, m/s.
        yaw_rate: φ̇, rad/s.
        length: l > 0, m.
        mu_l: μ_l > 0.

    Raises:
        InputError: an argument is out of range.
    """
    acceleration = validate("speed", speed, "m/s") * np.abs(validate("yaw_rate", yaw_rate, "rad/s"))
    return acceleration * _shift_per_acceleration(length, mu_l)


def slip_angle(yaw_rate: ArrayLike, length: ArrayLike, mu_l: ArrayLike) -> FloatArray:
    """α = −sign(φ̇) atan(φ̇² l/(4 g μ_l)) in rad, (3.13) with its sign: tan α = −φ̇ D/v_x.

    Negative in a left turn, driving forward or in reverse: C moves outward of its x axis.

    Args:
        yaw_rate: φ̇, rad/s.
        length: l > 0, m.
        mu_l: μ_l > 0.

    Raises:
        InputError: an argument is out of range.
    """
    rate = validate("yaw_rate", yaw_rate, "rad/s")
    return -np.arctan(rate * np.abs(rate) * _shift_per_acceleration(length, mu_l))


def _load_ratio(mu_l: ArrayLike, acceleration: ArrayLike) -> FloatArray:
    """λ = a/(2 g μ_l)."""
    a = validate("acceleration", acceleration, "m/s²", ge=0.0)
    return a / (2.0 * GRAVITY * validate("mu_l", mu_l, gt=0.0))


def _shift_per_acceleration(length: ArrayLike, mu_l: ArrayLike) -> FloatArray:
    """D/a = l/(4 g μ_l), s²."""
    return validate("length", length, "m", gt=0.0) / (4.0 * GRAVITY * validate("mu_l", mu_l, gt=0.0))


def _force_times_length(weight: ArrayLike, length: ArrayLike, mu_l: ArrayLike) -> FloatArray:
    """μ_l W l, N m."""
    force = validate("mu_l", mu_l, gt=0.0) * validate("weight", weight, "N", ge=0.0)
    return force * validate("length", length, "m", gt=0.0)
