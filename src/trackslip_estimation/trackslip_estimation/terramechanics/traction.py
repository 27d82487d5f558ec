# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Thrust and slip of one track.

    i        longitudinal slip, 1 − v/(r ω)                         1
    F, F_max thrust and its limit (``strength.thrust_limit``)       N
    K        shear deformation modulus                              m
    l, b     contact length and width of the track                  m
    j        shear displacement of the soil, i x under the track    m
    τ        shear stress                                           Pa
    u        i l/K: displacement at the trailing end over K         1
    q        F/F_max = 1 − (1 − e^−u)/u                             1

Braking mirrors driving: negative slip gives the negative thrust of the same positive slip. The formulas
are exact for any slip; at slips above 1 a track drives forward while the vehicle moves backward.
"""

import numpy as np
from numpy.typing import ArrayLike

from trackslip_common.arrays import FloatArray
from trackslip_estimation.terramechanics.domain import validate

_SERIES_BELOW = 0.5  # u; above it the closed form of q is good to 2 ulp of q
_SERIES = [1.0]  # q/(u/2) = 1 − u/3 + u²/12 …; 15 terms reach 1e-17 at u = 0.5
for _k in range(1, 15):
    _SERIES.append(-_SERIES[-1] / (_k + 2))
_MAX_NEWTON_STEPS = 50  # five suffice


def shear_stress(displacement: ArrayLike, strength: ArrayLike, shear_modulus: ArrayLike) -> FloatArray:
    """τ = τ_max (1 − e^(−|j|/K)) sign j in Pa, the integrand of (3.2).

    Args:
        displacement: j, m.
        strength: τ_max ≥ 0, Pa; ``strength.shear_strength``.
        shear_modulus: K > 0, m.

    Raises:
        InputError: an argument is out of range.
    """
    j = validate("displacement", displacement, "m")
    ratio = _divide(np.abs(j), validate("shear_modulus", shear_modulus, "m", gt=0.0))
    return -np.expm1(-ratio) * np.sign(j) * validate("strength", strength, "Pa", ge=0.0)


def thrust_of_elements(
    slip: ArrayLike, strength: ArrayLike, width: float, length: float, shear_modulus: float
) -> FloatArray:
    """F = b ∫ τ_max(x) (1 − e^(−|i| x/K)) dx · sign i in N, (3.2), for any distribution of pressure.

    Exact where the strength is constant in each element, as it is for a uniform pressure.

    Args:
        slip: i, shape (...).
        strength: τ_max of n equal elements from the leading end to the trailing one, ≥ 0, Pa, shape (n,).
        width: b > 0, m.
        length: l > 0, m.
        shear_modulus: K > 0, m.

    Returns:
        Thrust of the shape of ``slip``.

    Raises:
        InputError: an argument is out of range.
    """
    i = validate("slip", slip)
    tau = np.atleast_1d(validate("strength", strength, "Pa", ge=0.0))
    b = validate("width", width, "m", gt=0.0)
    l = validate("length", length, "m", gt=0.0)  # noqa: E741 (the thesis' symbol)
    ends = np.linspace(0.0, 1.0, tau.size + 1)
    # Thrust up to x is x q(u x/l); its differences are those of the elements.
    up_to = ends * _mobilised_share(
        i[..., np.newaxis] * ends, validate("shear_modulus", shear_modulus, "m", gt=0.0), l
    )
    return np.asarray(b * l * np.sum(tau * np.diff(up_to), axis=-1))[()]


def thrust(slip: ArrayLike, limit: ArrayLike, shear_modulus: ArrayLike, length: ArrayLike) -> FloatArray:
    """F = F_max [1 − (K/(i l)) (1 − e^(−i l/K))] in N, (3.3); odd in i, and F_max i l/(2K) as i → 0.

    Args:
        slip: i; negative when the track brakes.
        limit: F_max ≥ 0 of the same track (or of both for the sum), N.
        shear_modulus: K > 0, m.
        length: l > 0, m.

    Raises:
        InputError: an argument is out of range.
    """
    share = _mobilised_share(
        validate("slip", slip),
        validate("shear_modulus", shear_modulus, "m", gt=0.0),
        validate("length", length, "m", gt=0.0),
    )
    return validate("limit", limit, "N", ge=0.0) * share


def slip_of_thrust(
    force: ArrayLike, limit: ArrayLike, shear_modulus: ArrayLike, length: ArrayLike
) -> FloatArray:
    """Slip i at which (3.3) gives this thrust: the exact inverse.

    Newton's method on (1 − q) u = 1 − e^−u, a convex function, from a point right of its root: each step
    decreases u and none passes the root. The lower bound u ≥ 2 q guards against rounding.

    Args:
        force: F, N, |F| < F_max; negative when the track brakes.
        limit: F_max > 0, N.
        shear_modulus: K > 0, m.
        length: l > 0, m.

    Raises:
        InputError: an argument is out of range; no slip gives a thrust of F_max or more.
    """
    q = _thrust_share(force, limit)
    k = validate("shear_modulus", shear_modulus, "m", gt=0.0)
    size = np.abs(q)
    # q lies between u/(u + 2) and u/2, and u never exceeds 1/(1 − q).
    u = np.asarray(np.minimum(2.0 * size, 1.0) / (1.0 - size))
    for _ in range(_MAX_NEWTON_STEPS):
        slope = -np.expm1(-u) - size
        step = np.divide(
            u * (_mean_mobilised_share(u) - size), slope, out=np.zeros_like(u), where=slope > 0.0
        )
        next_u = np.maximum(u - step, 2.0 * size)
        is_settled = np.all(np.abs(next_u - u) <= 1e-15 * u)
        u = next_u
        if is_settled:
            break
    return np.sign(q) * u * k / validate("length", length, "m", gt=0.0)


def slip_of_thrust_approximate(
    force: ArrayLike, limit: ArrayLike, shear_modulus: ArrayLike, length: ArrayLike
) -> FloatArray:
    """Slip i ≈ −(K/l) / ln(|F|/F_max) · sign F, (3.12).

    Its relative error is a function of u = i l/K alone: none at u = 1, at most 12.6 % too small above
    (worst at u = 2.66), without bound too large below (``docs/thesis.md``). ``slip_of_thrust`` is exact.

    Args:
        force: F, N, |F| < F_max; negative when the track brakes.
        limit: F_max > 0, N.
        shear_modulus: K > 0, m.
        length: l > 0, m.

    Raises:
        InputError: an argument is out of range.
    """
    q = _thrust_share(force, limit)
    k = validate("shear_modulus", shear_modulus, "m", gt=0.0)
    with np.errstate(divide="ignore"):  # ln 0 = −∞ gives the right slip, 0
        return np.sign(q) * -k / (validate("length", length, "m", gt=0.0) * np.log(np.abs(q)))


def _thrust_share(force: ArrayLike, limit: ArrayLike) -> FloatArray:
    """Share F/F_max, inside (−1, 1)."""
    ratio = validate("force", force, "N") / validate("limit", limit, "N", gt=0.0)
    return validate("force/limit", ratio, gt=-1.0, lt=1.0)


def _mobilised_share(slip: FloatArray, shear_modulus: FloatArray, length: FloatArray) -> FloatArray:
    """Share q, with the sign of i, of (3.3)."""
    return np.sign(slip) * _mean_mobilised_share(_divide(np.abs(slip) * length, shear_modulus))


def _mean_mobilised_share(u: FloatArray) -> FloatArray:
    """Share q(u) = 1 − (1 − e^−u)/u for u ≥ 0, to full precision at either end."""
    small = np.minimum(u, _SERIES_BELOW)
    series = 0.5 * small * np.polynomial.polynomial.polyval(small, _SERIES)
    large = np.maximum(u, _SERIES_BELOW)
    return np.where(u < _SERIES_BELOW, series, 1.0 + np.expm1(-large) / large)


def _divide(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """Return a ratio; an overflow to infinity is intended, as it gives the limit of the formula."""
    with np.errstate(over="ignore"):
        return numerator / denominator
