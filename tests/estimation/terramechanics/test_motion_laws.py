# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Laws of turning and of the hydraulic drive: balances, signs, limits, power, inverses."""

import math

import pytest
from fixtures.number_strategies import between, either_sign, power_of_ten
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.units import GRAVITY
from trackslip_common.vehicle_files import load_vehicle
from trackslip_estimation.terramechanics import hydraulics, turning

PC05 = load_vehicle().whole()

lengths = between(0.5, 4.0)
mus = between(0.05, 2.0)
loads = between(0.0, 1.0)  # λ
speeds = either_sign(between(0.01, 4.0))


# Turning


@given(between(0.0, 2e4), lengths, mus, loads, between(0.0, 1.0))
def test_lateral_force_is_linear_and_balances_the_centrifugal_force(weight, length, mu, load, share):
    a = 2.0 * GRAVITY * mu * load
    first, last = (turning.lateral_force(x, weight, length, mu, a) for x in (0.0, length))
    here = turning.lateral_force(share * length, weight, length, mu, a)
    scale = 1e-9 * (mu * weight / length + 1.0)
    assert here == pytest.approx(first + share * (last - first), abs=scale)
    assert 2.0 * length * 0.5 * (first + last) == pytest.approx(-weight / GRAVITY * a, abs=scale * length)
    zero = turning.zero_force_point(length, mu, a)
    assert turning.lateral_force(max(zero, 0.0), weight, length, mu, a) == pytest.approx(0.0, abs=scale)


@given(lengths, mus, between(0.0, 50.0), between(0.0, 50.0))
def test_centre_point_stays_behind_seven_tenths(length, mu, a1, a2):
    """The middle without lateral acceleration; at most 0.697 l (λ² = √12 − 3); 2/3 l where the cases meet."""
    load = math.sqrt(math.sqrt(12.0) - 3.0)
    farthest = turning.centre_point(length, mu, 2.0 * GRAVITY * mu * load)
    assert farthest == pytest.approx(0.6967 * length, rel=1e-4)
    for a in (a1, a2):
        assert length / 2 <= turning.centre_point(length, mu, a) <= farthest * (1 + 1e-12)
        assert turning.centre_point(length, mu, a) <= turning.centre_point_approximate(length, mu, a) * (
            1 + 1e-12
        )
    assert turning.centre_point(length, mu, 0.0) == length / 2
    at_one = 2.0 * GRAVITY * mu
    assert turning.centre_point(length, mu, at_one) == pytest.approx(2.0 / 3.0 * length)
    below, above = (turning.centre_point(length, mu, at_one * (1.0 + d)) for d in (-1e-9, 1e-9))
    assert below == pytest.approx(above, rel=1e-8)


@given(lengths, mus, loads)
def test_centre_and_zero_of_force_are_symmetric_about_the_middle(length, mu, load):
    a = 2.0 * GRAVITY * mu * load
    together = turning.centre_point_approximate(length, mu, a) + turning.zero_force_point(length, mu, a)
    assert together == pytest.approx(length)


@given(between(1.0, 2e4), lengths, mus, loads, loads)
def test_published_moment_falls_with_lateral_acceleration(weight, length, mu, l1, l2):
    calm, fast = (
        turning.moment_with_centrifugal_force(weight, length, mu, 2.0 * GRAVITY * mu * load * (1 - 1e-15))
        for load in (min(l1, l2), max(l1, l2))
    )
    static = turning.triangular_moment(weight, length, mu)
    assert -1e-12 * static <= fast <= calm + 1e-12 * static
    assert calm <= static * (1 + 1e-12)
    assert turning.moment_with_centrifugal_force(weight, length, mu, 0.0) == static
    assert turning.uniform_moment(weight, length, mu) == pytest.approx(0.75 * static)


@given(either_sign(between(0.01, 3.0)), between(0.01, 3.0), lengths, mus, mus)
def test_slip_angle_points_out_of_the_turn(yaw_rate, speed, length, mu1, mu2):
    angle = turning.slip_angle(yaw_rate, length, mu1)
    assert angle * yaw_rate < 0.0
    assert angle == -turning.slip_angle(-yaw_rate, length, mu1)
    shift = turning.rotation_shift(speed, yaw_rate, length, mu1)
    assert shift > 0.0
    assert turning.rotation_shift(-speed, yaw_rate, length, mu1) == -shift
    assert math.tan(angle) == pytest.approx(-yaw_rate * shift / speed, rel=1e-9)
    approximate = turning.centre_point_approximate(length, mu1, speed * abs(yaw_rate))
    assert shift == pytest.approx(approximate - length / 2, rel=1e-9, abs=1e-12)
    slippery, firm = (abs(turning.slip_angle(yaw_rate, length, mu)) for mu in sorted((mu1, mu2)))
    assert slippery >= firm
    assert turning.slip_angle(0.0, length, mu1) == 0.0


# Hydraulics


@given(either_sign(between(0.0, 2e7)), st.one_of(st.just(0.0), speeds))
def test_torque_thrust_and_their_inverses(dp, omega):
    torque = hydraulics.torque(dp, omega, PC05)
    assert hydraulics.pressure_of_torque(torque, omega, PC05) == pytest.approx(dp, rel=1e-12)
    force = hydraulics.thrust_of_pressure(dp, omega, PC05)
    assert force * PC05.rolling_radius == pytest.approx(torque, rel=1e-12)
    assert hydraulics.pressure_of_thrust(force, omega, PC05) == pytest.approx(dp, rel=1e-12)
    assert torque == -hydraulics.torque(-dp, -omega, PC05)


@given(either_sign(between(0.0, 2e7)), speeds)
def test_motor_output_power_is_at_most_its_input(dp, omega):
    """T ω ≤ ΔP Q, when driving and when braking."""
    oil = dp * hydraulics.flow_of_speed(omega, dp, PC05)
    assert hydraulics.torque(dp, omega, PC05) * omega <= oil + 1e-12 * abs(oil)


@given(speeds, either_sign(between(0.0, 2e7)))
def test_speed_inverts_flow(omega, dp):
    flow = hydraulics.flow_of_speed(omega, dp, PC05)
    assert hydraulics.speed_of_flow(flow, dp, PC05) == pytest.approx(omega, rel=1e-12)
    assert flow * omega > 0.0
    assert hydraulics.flow_of_speed(0.0, dp, PC05) == 0.0


@given(either_sign(between(0.0, 2e7)), power_of_ten(-7, -4), between(700.0, 1000.0), between(0.3, 1.0))
def test_pressure_drop_inverts_orifice_flow(drop, area, density, discharge):
    flow = hydraulics.orifice_flow(drop, area, density, discharge)
    back = hydraulics.orifice_pressure_drop(flow, area, density, discharge)
    assert back == pytest.approx(drop, rel=1e-9, abs=1e-200)
    assert flow == -hydraulics.orifice_flow(-drop, area, density, discharge)
    assert abs(hydraulics.orifice_flow(4.0 * drop, area, density, discharge)) == pytest.approx(
        2.0 * abs(flow)
    )
