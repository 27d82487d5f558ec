# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Terramechanics against numbers of the thesis, its expanded formulas, and numerical integrals."""

import math

import numpy as np
import pytest

from trackslip_common.errors import InputError
from trackslip_common.soils import soil
from trackslip_common.units import GRAVITY
from trackslip_common.vehicle import Vehicle
from trackslip_common.vehicle_files import load_vehicle
from trackslip_estimation.terramechanics import hydraulics, resistance, sinkage, strength, traction, turning

FAST_TURN = 1.37  # rad/s, with one track braked: R = B/2
NORMAL_MU_L = np.linspace(0.5, 1.3, 81)


@pytest.fixture(scope="module")
def pc05() -> Vehicle:
    return load_vehicle().whole()


def integral(f, start, stop):
    """Simpson's rule with 4000 intervals."""
    x = np.linspace(start, stop, 4001)
    y = f(x)
    return (x[1] - x[0]) / 3.0 * (y[0] + y[-1] + 4.0 * y[1:-1:2].sum() + 2.0 * y[2:-1:2].sum())


def fast_turn_acceleration(pc05):
    return FAST_TURN**2 * pc05.tread / 2.0


# Strength, sinkage, resistance


def test_mohr_coulomb_by_hand():
    assert strength.shear_strength(20e3, 1e3, math.radians(45.0)) == pytest.approx(21e3)
    assert strength.shear_strength(20e3, 0.0, math.radians(45.0)) == pytest.approx(20e3)
    assert strength.shear_strength(20e3, 1e3, 0.0) == 1e3


def test_sinkage_by_hand():
    modulus = sinkage.bekker_modulus(1000.0, 4000.0, 0.5)
    assert modulus == 6000.0
    assert sinkage.bekker_pressure(0.25, modulus, 0.5) == pytest.approx(3000.0)
    assert sinkage.unloading_stiffness(0.02, 1e5, 2e6) == pytest.approx(1.4e5)
    assert sinkage.unloading_pressure(0.19, 0.2, 3000.0, 1.4e5) == pytest.approx(1600.0)
    assert sinkage.unloading_pressure(0.1, 0.2, 3000.0, 1.4e5) == 0.0
    bracket = sinkage.reece_modulus(100.0, 10.0, 2e4, 3.0, 0.5)
    assert bracket == pytest.approx(31e3)
    assert sinkage.reece_pressure(0.125, 0.5, bracket, 0.5) == pytest.approx(15.5e3)


def test_compaction_is_the_work_of_sinking_per_metre():
    work = integral(lambda z: sinkage.bekker_pressure(z, 2e6, 1.1), 0.0, 0.05)
    assert resistance.compaction_resistance(0.05, 0.23, 2e6, 1.1) == pytest.approx(2 * 0.23 * work, rel=1e-8)


def test_bulldozing_and_drag_by_hand():
    pressure = resistance.passive_earth_pressure(0.1, 2000.0, 15e3, 3.0, 8.0)
    assert pressure == pytest.approx(2 * 0.1 * 2000.0 * 3.0 + 15e3 * 0.01 * 8.0)
    upright = resistance.bulldozing_resistance(pressure, 0.23, math.pi / 2, math.radians(30.0))
    assert upright == pytest.approx(2 * 0.23 * pressure)  # sin(90° + ϕ) = cos ϕ
    half = resistance.bulldozing_resistance(pressure, 0.23, math.radians(30.0), math.radians(30.0))
    assert half == pytest.approx(2 * 0.23 * pressure * 2.0)
    assert resistance.drag_resistance(0.1, 1.264, 4140.0, 3.0) == pytest.approx(2 * 3 * 0.1 * 1.264 * 4140.0)


# Thrust and slip


@pytest.mark.parametrize(
    ("name", "slip"), [("sand", 0.0072), ("sandy_loam", 0.016), ("clayey_soil", 0.016), ("dry_clay", 0.0016)]
)
def test_straight_slip_of_the_pc05(pc05, name, slip):
    ground = soil(name)
    area = 2.0 * pc05.track_width * pc05.contact_length
    limit = strength.thrust_limit(ground.cohesion, ground.friction_angle, area, pc05.weight)
    needed = resistance.longitudinal_resistance(0.4, ground.value("mu_r"), pc05.weight)
    computed = traction.slip_of_thrust(needed, limit, ground.value("shear_modulus"), pc05.contact_length)
    assert computed == pytest.approx(slip, rel=0.04)  # printed to two digits


def test_thrust_is_the_integral_of_shear_stress(pc05):
    length, width, modulus = pc05.contact_length, pc05.track_width, 0.01
    for slip in (1e-4, 0.02, 0.5, -0.1):
        area = width * integral(lambda x, i=slip: traction.shear_stress(i * x, 9e3, modulus), 0.0, length)
        assert traction.thrust(slip, 9e3 * width * length, modulus, length) == pytest.approx(area, rel=1e-8)


def test_thrust_of_elements_accepts_any_pressure():
    tau = np.array([2e3, 8e3, 5e3])
    whole = traction.thrust_of_elements(0.05, tau, 0.23, 1.2, 0.01)
    ends = np.linspace(0.0, 1.2, 4)
    parts = [
        integral(lambda x, t=t: traction.shear_stress(0.05 * x, t, 0.01), ends[k], ends[k + 1])
        for k, t in enumerate(tau)
    ]
    assert whole == pytest.approx(0.23 * sum(parts), rel=1e-9)
    assert traction.thrust_of_elements([0.05, -0.05], tau, 0.23, 1.2, 0.01) == pytest.approx([whole, -whole])


@pytest.mark.parametrize(
    ("modulus", "worst", "under_ten_percent_above"),
    [(0.006, 0.0604, 0.04), (0.01, 0.0961, 0.04), (0.025, 0.1262, 0.095), (0.05, 0.1262, 0.190)],
)
def test_figure_3_9_error_of_the_approximate_slip(pc05, modulus, worst, under_ten_percent_above):
    """Under 10 % above 4 % slip for K = 0.6 and 1 cm; 12.6 % at worst for any K, whatever the vehicle."""
    slip = np.linspace(0.04, 1.0, 20001)
    forces = traction.thrust(slip, 4000.0, modulus, pc05.contact_length)
    error = traction.slip_of_thrust_approximate(forces, 4000.0, modulus, pc05.contact_length) / slip - 1.0
    assert np.abs(error).max() == pytest.approx(worst, abs=1e-4)
    assert np.abs(error[slip >= under_ten_percent_above]).max() < 0.1


def test_thrust_of_the_approximation_is_within_seven_percent(pc05):
    """The error of F = F_max exp(−K/(i l)) is 6.99 % at most above u = 1, so above 4 % slip."""
    slip = np.linspace(0.04, 1.0, 20001)
    for modulus in (0.006, 0.01, 0.025, 0.05):
        forces = np.exp(-modulus / (slip * pc05.contact_length))
        inverse = traction.slip_of_thrust_approximate(forces, 1.0, modulus, pc05.contact_length)
        assert inverse == pytest.approx(slip)
        error = forces / traction.thrust(slip, 1.0, modulus, pc05.contact_length) - 1.0
        assert np.abs(error).max() < 0.07


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        (sinkage.unloading_pressure, (0.3, 0.2, 1000.0, 1e5), "accepted: <= unloading_sinkage"),
        (
            resistance.bulldozing_resistance,
            (1.0, 0.23, 2.3, 1.0),
            r"approach_angle \+ friction_angle = 3\.3 .*accepted: <= 3.14159 rad",
        ),
        (traction.slip_of_thrust, (-100.0, 100.0, 0.01, 1.2), r"force/limit = .*accepted: > -1 and < 1"),
        (traction.slip_of_thrust_approximate, (250.0, 100.0, 0.01, 1.2), "force/limit"),
    ],
)
def test_arguments_that_contradict_each_other_are_refused(function, arguments, message):
    with pytest.raises(InputError, match=message):
        function(*arguments)


# Turning


def test_expanded_formulas_as_printed(pc05):
    """(3.6) case one, (3.7) with its g μ read as g μ_l, written term by term as the thesis does."""
    g, m, length = GRAVITY, pc05.mass, pc05.contact_length
    a = 0.9
    for mu in (0.1, 0.6, 1.3):
        first = a * length / (4 * g * mu)
        rest = a**3 * length / (24 * g**2 * mu**2 * (g * mu / 2 + a**2 / (8 * g * mu)))
        assert turning.centre_point(length, mu, a) == pytest.approx(length / 2 + first - rest, rel=1e-12)
        assert turning.centre_point_approximate(length, mu, a) == pytest.approx(length / 2 + first, rel=1e-12)
        moment = m * g * length * mu / 3 - m * a**2 * length / (4 * g * mu)
        moment += m * a**3 * length / (12 * g**2 * mu**2)
        computed = turning.moment_with_centrifugal_force(pc05.weight, length, mu, a)
        assert computed == pytest.approx(moment, rel=1e-12)


@pytest.mark.parametrize("load", [0.0, 0.3, 0.9, 1.0, 1.5])
def test_centre_point_is_the_centroid(load):
    """(3.5) integrated numerically, across both cases of (3.6)."""
    weight, length, mu = 12e3, 1.3, 0.4
    a = 2.0 * GRAVITY * mu * load
    moments = [
        integral(lambda x, k=k: x**k * np.abs(turning.lateral_force(x, weight, length, mu, a)), 0.0, length)
        for k in (0, 1)
    ]
    assert turning.centre_point(length, mu, a) == pytest.approx(moments[1] / moments[0], rel=1e-5)


@pytest.mark.parametrize("load", [0.0, 0.05, 0.5, 1.0])
def test_published_moment_is_four_times_that_of_the_tail(load):
    """(3.7) is four times the tail's moment; the moment about C of the whole f is (3.8) at any λ.

    About the zero of f the moment of the elements is (3.8) times 1 + 3 λ²: not (3.7) either.
    """
    weight, length, mu = 12e3, 1.3, 0.4
    a = 2.0 * GRAVITY * mu * load

    def force(x):
        return turning.lateral_force(x, weight, length, mu, a)

    static = turning.triangular_moment(weight, length, mu)
    x_s = turning.centre_point_approximate(length, mu, a)
    tail = 4.0 * integral(lambda x: -x * force(np.minimum(x + x_s, length)), 0.0, length - x_s)
    published = turning.moment_with_centrifugal_force(weight, length, mu, a)
    assert published == pytest.approx(tail, abs=1e-6 * static)
    about_c = -2.0 * integral(lambda x: (x - length / 2) * force(x), 0.0, length)
    assert about_c == pytest.approx(static, rel=1e-9)
    x_0 = turning.zero_force_point(length, mu, a)
    about_zero = 2.0 * integral(lambda x: np.abs((x - x_0) * force(x)), 0.0, length)
    assert about_zero == pytest.approx(static * (1.0 + 3.0 * load**2), rel=1e-5)


def test_figure_3_7_moment_without_centrifugal_force(pc05):
    """(3.8) against (3.7): under 2 % for normal soils at 1.37 rad/s with one track braked."""
    a = fast_turn_acceleration(pc05)
    static = turning.triangular_moment(pc05.weight, pc05.contact_length, NORMAL_MU_L)
    full = turning.moment_with_centrifugal_force(pc05.weight, pc05.contact_length, NORMAL_MU_L, a)
    error = (full - static) / full
    assert np.abs(error).max() < 0.02
    assert error[0] == pytest.approx(-0.0142, abs=1e-4)
    weakest = turning.moment_with_centrifugal_force(pc05.weight, pc05.contact_length, 0.1, a)
    ratio = turning.triangular_moment(pc05.weight, pc05.contact_length, 0.1) / weakest
    assert 1.0 - ratio == pytest.approx(-0.390, abs=1e-3)  # the left end of Fig. 3.7, −40 %


def test_figure_3_8_centre_point(pc05):
    """First order of (3.6) against the complete form: under 0.1 % for normal soils, −3.9 % at μ_l = 0.1."""
    a = fast_turn_acceleration(pc05)
    mu = np.append(NORMAL_MU_L, 0.1)
    exact = turning.centre_point(pc05.contact_length, mu, a)
    error = (exact - turning.centre_point_approximate(pc05.contact_length, mu, a)) / exact
    assert np.abs(error[:-1]).max() < 1e-3
    assert error[-1] == pytest.approx(-0.039, abs=1e-3)


def test_uniform_moment_is_three_quarters():
    triangular = turning.triangular_moment(12e3, 1.3, 0.4)
    assert turning.uniform_moment(12e3, 1.3, 0.4) == pytest.approx(0.75 * triangular)


@pytest.mark.parametrize("speed", [0.5, -0.5])
@pytest.mark.parametrize("yaw_rate", [0.8, -0.8])
def test_slip_angle_and_shift_balance_the_centrifugal_force(pc05, speed, yaw_rate):
    """Friction −k (v_y + φ̇ x) with k of (3.9) balances m v_x φ̇ in each of the four senses of turning."""
    length, mu = pc05.contact_length, 0.7
    shift = turning.rotation_shift(speed, yaw_rate, length, mu)
    slope = 2.0 * mu * pc05.weight / length**2 * math.copysign(1.0, yaw_rate)
    lateral = 2.0 * integral(lambda x: -slope * (x - shift), -length / 2, length / 2)
    assert lateral == pytest.approx(pc05.mass * speed * yaw_rate, rel=1e-9)
    assert math.tan(turning.slip_angle(yaw_rate, length, mu)) == pytest.approx(-yaw_rate * shift / speed)


# Hydraulics


def test_drawbar_pull_at_relief_pressure(pc05):
    both = 2.0 * hydraulics.thrust_of_pressure(pc05.relief_pressure, 1.0, pc05)
    assert both == pytest.approx(10.3e3, rel=0.01)


def test_thrust_as_printed_in_litres_and_kgf(pc05):
    """(3.27): F = 5 g η₀ V ΔP/(π r η_V), V in litres, ΔP in kgf/cm²."""
    litres = pc05.motor_displacement * pc05.gear_ratio * 1e3
    kgf_per_cm2 = 5e6 / (GRAVITY * 1e4)
    printed = 5.0 * GRAVITY * pc05.motor_efficiency * litres * kgf_per_cm2 / (math.pi * pc05.rolling_radius)
    assert hydraulics.thrust_of_pressure(5e6, 1.0, pc05) == pytest.approx(printed, rel=1e-12)


def test_relief_valve_limits_both_signs(pc05):
    limit = pc05.relief_pressure
    limited = hydraulics.relieved_pressure([-2 * limit, 1e6, 2 * limit], pc05)
    assert limited == pytest.approx([-limit, 1e6, limit])


def test_top_speed_at_full_pump_flow(pc05):
    speed = hydraulics.speed_of_flow(pc05.pump_flow, 5e6, pc05) * pc05.rolling_radius
    assert speed == pytest.approx(0.5, rel=0.01)


def test_braking_torque_is_divided_by_the_efficiency_squared(pc05):
    """At the same pressure the torque is larger when the track drives the motor."""
    driving = hydraulics.torque(4e6, 1.0, pc05)
    braking = hydraulics.torque(-4e6, 1.0, pc05)
    assert braking == pytest.approx(-driving / pc05.motor_efficiency**2)
    assert hydraulics.torque(4e6, 0.0, pc05) == driving


def test_orifice_by_hand():
    flow = hydraulics.orifice_flow(5e6, 2e-6, 850.0, 0.62)
    assert flow == pytest.approx(0.62 * 2e-6 * math.sqrt(2 * 5e6 / 850.0))
    assert hydraulics.orifice_flow(5e6, 0.0, 850.0, 0.62) == 0.0
    with pytest.raises(InputError, match="area = 0 is refused; accepted: > 0 m²"):
        hydraulics.orifice_pressure_drop(flow, 0.0, 850.0, 0.62)
