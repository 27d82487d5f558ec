# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Laws of soil and traction: monotonic, odd, bounded, exact at their limits, with exact inverses."""

import math

import numpy as np
import pytest
from fixtures.number_strategies import between, either_sign, power_of_ten
from hypothesis import assume, given
from hypothesis import strategies as st

from trackslip_estimation.terramechanics import resistance, sinkage, strength, traction

pressures = between(0.0, 1e5)
cohesions = between(0.0, 2e4)
angles = between(0.0, 1.5)
lengths = between(0.5, 4.0)
limits = power_of_ten(0, 5)
moduli = power_of_ten(-4, -1)  # shear modulus K
slips = power_of_ten(-12, 0)
grounds = st.tuples(power_of_ten(4, 8), between(0.1, 2.0))  # k, n
speeds = either_sign(between(0.01, 4.0))


# Strength


@given(pressures, pressures, cohesions, cohesions, angles, angles)
def test_strength_grows_with_each_argument(p1, p2, c1, c2, a1, a2):
    low = strength.shear_strength(min(p1, p2), min(c1, c2), min(a1, a2))
    assert low <= strength.shear_strength(max(p1, p2), max(c1, c2), max(a1, a2))
    assert strength.shear_strength(0.0, c1, a1) == c1


@given(cohesions, angles, between(0.1, 2.0), between(0.0, 2e4))
def test_thrust_limit_is_strength_on_half_the_area(c, phi, area, weight):
    expected = 0.5 * area * c + 0.5 * weight * math.tan(phi)
    assert strength.thrust_limit(c, phi, area, weight) == pytest.approx(expected, rel=1e-12)


# Sinkage and resistance


@given(between(1e-6, 0.5), grounds)
def test_sinkage_inverts_pressure(z, ground):
    assert sinkage.bekker_sinkage(sinkage.bekker_pressure(z, *ground), *ground) == pytest.approx(z, rel=1e-10)


@given(pressures, pressures, grounds)
def test_sinkage_grows_with_pressure_from_nothing(p1, p2, ground):
    assert sinkage.bekker_sinkage(min(p1, p2), *ground) <= sinkage.bekker_sinkage(max(p1, p2), *ground)
    assert sinkage.bekker_sinkage(0.0, *ground) == 0.0
    assert sinkage.bekker_pressure(0.0, *ground) == 0.0


@given(between(0.0, 0.3), between(0.1, 1.0), between(1e3, 1e5), between(0.1, 2.0))
def test_reece_is_bekker_in_widths(z, width, bracket, n):
    expected = sinkage.bekker_pressure(z, bracket / width**n, n)
    assert sinkage.reece_pressure(z, width, bracket, n) == pytest.approx(expected, rel=1e-9, abs=1e-250)


@given(between(0.0, 0.3), between(0.0, 1.0), between(0.0, 1.0), between(0.0, 1e5), between(0.0, 1e7))
def test_unloading_ends_on_the_fresh_curve_and_never_pulls(z_u, s1, s2, p_u, k_u):
    line = [sinkage.unloading_pressure(s * z_u, z_u, p_u, k_u) for s in (min(s1, s2), max(s1, s2), 1.0)]
    assert 0.0 <= line[0] <= line[1] <= line[2] == p_u


@given(between(0.1, 1.5), between(0.1, 1.5), between(0.0, 1.4))
def test_blunt_tracks_push_less_soil_than_flat_ones(a1, a2, phi):
    """sin(α + ϕ)/(sin α cos ϕ) = 1 + tan ϕ/tan α falls with α."""
    flat, blunt = (resistance.bulldozing_resistance(1.0, 0.5, a, phi) for a in (min(a1, a2), max(a1, a2)))
    assert flat >= blunt * (1 - 1e-12)
    assert blunt == pytest.approx(1.0 + math.tan(phi) / math.tan(max(a1, a2)), rel=1e-9)


@given(speeds, between(0.0, 1.0), between(0.0, 2e4))
def test_resistance_opposes_motion(v, mu_r, weight):
    force = resistance.longitudinal_resistance(v, mu_r, weight)
    assert force * v >= 0.0
    assert force == -resistance.longitudinal_resistance(-v, mu_r, weight)
    assert resistance.longitudinal_resistance(0.0, mu_r, weight) == 0.0


# Traction


@given(either_sign(power_of_ten(-12, 1)), between(1.0, 1e5), moduli)
def test_shear_stress_is_odd_and_between_its_tangents(j, tau, modulus):
    stress = traction.shear_stress(j, tau, modulus)
    assert stress == -traction.shear_stress(-j, tau, modulus)
    x = abs(j) / modulus
    assert tau * x / (1.0 + x) * (1 - 1e-12) <= abs(stress) <= tau * min(x, 1.0) * (1 + 1e-12)


@given(power_of_ten(-3, 0), between(1.0, 1e5))
def test_a_soil_without_shear_modulus_yields_at_once(value, tau):
    assert traction.shear_stress(value, tau, 1e-300) == tau
    assert traction.thrust(value, tau, 1e-300, 1.0) == tau
    assert traction.thrust(0.0, tau, 1e-300, 1.0) == 0.0


@given(slips, limits, moduli, lengths)
def test_thrust_is_odd_and_between_its_bounds(slip, limit, modulus, length):
    """u/(u + 2) ≤ q ≤ u/2."""
    force = traction.thrust(slip, limit, modulus, length)
    assert traction.thrust(-slip, limit, modulus, length) == -force
    u = slip * length / modulus
    assert limit * u / (u + 2.0) * (1 - 1e-12) <= force <= limit * min(u / 2.0, 1.0) * (1 + 1e-12)


@given(power_of_ten(-15, -1))
def test_thrust_at_small_slip_is_its_series(u):
    """The share is u/2 − u²/6 + u³/24 − u⁴/120 + …: no digit is lost to cancellation."""
    series = sum((-u) ** k / math.factorial(k + 1) for k in range(1, 12)) * -1.0
    assert traction.thrust(u, 1.0, 1.0, 1.0) == pytest.approx(series, rel=1e-14)


@given(between(0.4999, 0.5001))
def test_thrust_is_smooth_where_its_formula_changes(u):
    direct = 1.0 + math.expm1(-u) / u
    assert traction.thrust(u, 1.0, 1.0, 1.0) == pytest.approx(direct, rel=2e-15)


@given(either_sign(slips), limits, moduli, lengths)
def test_slip_inverts_thrust(slip, limit, modulus, length):
    u = abs(slip) * length / modulus
    assume(u < 1e4)
    force = traction.thrust(slip, limit, modulus, length)
    found = traction.slip_of_thrust(force, limit, modulus, length)
    assert found == pytest.approx(slip, rel=1e-14 * (1.0 + u) + 5e-14)


@given(either_sign(power_of_ten(-300, -0.0001)), limits, moduli, lengths)
def test_thrust_inverts_slip(share, limit, modulus, length):
    assume(abs(share) * limit > 1e-290)
    force = share * limit
    slip = traction.slip_of_thrust(force, limit, modulus, length)
    assert traction.thrust(slip, limit, modulus, length) == pytest.approx(force, rel=1e-13)


@given(st.integers(1, 53))
def test_slip_is_found_however_close_to_the_limit(bits):
    """A share of 1 − 2^−bits: u tends to 1/(1 − q)."""
    gap = 2.0**-bits
    slip = traction.slip_of_thrust(1.0 - gap, 1.0, 1.0, 1.0)
    assert slip * gap == pytest.approx(1.0 - math.exp(-slip), rel=1e-12)


@given(between(-0.9999, 0.9999), between(-0.9999, 0.9999), limits, moduli, lengths)
def test_slip_grows_with_thrust(q1, q2, limit, modulus, length):
    for inverse in (traction.slip_of_thrust, traction.slip_of_thrust_approximate):
        low, high = (inverse(q * limit, limit, modulus, length) for q in (min(q1, q2), max(q1, q2)))
        assert low <= high + 1e-12 * abs(high)
        assert inverse(-q1 * limit, limit, modulus, length) == -inverse(q1 * limit, limit, modulus, length)
        assert inverse(0.0, limit, modulus, length) == 0.0


@given(power_of_ten(-4, 3), moduli, lengths)
def test_error_of_the_approximate_slip(u, modulus, length):
    """(3.12) is exact at u = 1, too large below, and at most 12.62 % too small above; Fig. 3.9."""
    slip = u * modulus / length
    found = traction.slip_of_thrust_approximate(
        traction.thrust(slip, 1.0, modulus, length), 1.0, modulus, length
    )
    if u <= 1.0:
        assert found >= slip * (1 - 1e-9)
    else:
        assert 0.8738 * slip < found <= slip * (1 + 1e-9)


@given(either_sign(slips), between(1.0, 1e5), st.integers(1, 40), moduli, lengths)
def test_equal_elements_are_a_uniform_pressure(slip, tau, elements, modulus, length):
    width = 0.23
    whole = traction.thrust_of_elements(slip, np.full(elements, tau), width, length, modulus)
    expected = traction.thrust(slip, tau * width * length, modulus, length)
    assert whole == pytest.approx(expected, rel=1e-12)


@given(slips, st.lists(between(0.0, 1e5), min_size=2, max_size=8), moduli, lengths)
def test_load_towards_the_trailing_end_pulls_more(slip, strengths, modulus, length):
    """Shear displacement grows rearward, so strength is mobilised there first."""
    fore, aft = (
        traction.thrust_of_elements(slip, sorted(strengths, reverse=reverse), 0.23, length, modulus)
        for reverse in (True, False)
    )
    assert fore <= aft + 1e-9 * max(strengths)
