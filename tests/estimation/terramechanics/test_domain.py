# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Every public function of terramechanics: arrays equal loops of scalars; invalid arguments are rejected."""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_common.errors import InputError
from trackslip_common.vehicle_files import load_vehicle
from trackslip_estimation.terramechanics import hydraulics, resistance, sinkage, strength, traction, turning

MODULES = (strength, sinkage, resistance, traction, turning, hydraulics)
PC05 = load_vehicle().whole()


@dataclass(frozen=True)
class Argument:
    """A range to draw from, and values outside the domain."""

    field: str
    low: float
    high: float
    refused: tuple[float, ...] = ()


COHESION = Argument("cohesion", 0.0, 2e4, (-1.0,))
ANGLE = Argument("friction_angle", 0.0, 1.5, (-0.1, math.pi / 2, 2.0))
PRESSURE = Argument("pressure", 0.0, 1e5, (-1.0,))
WEIGHT = Argument("weight", 0.0, 2e4, (-1.0,))
AREA = Argument("area", 0.1, 2.0, (0.0, -1.0))
WIDTH = Argument("width", 0.1, 1.0, (0.0, -1.0))
LENGTH = Argument("length", 1.0, 3.0, (0.0, -1.0))
MODULUS = Argument("modulus", 1e4, 1e7, (0.0, -1.0))
EXPONENT = Argument("n", 0.1, 2.0, (0.0, -1.0))
SINKAGE = Argument("sinkage", 0.0, 0.1, (-0.01,))
DENSITY = Argument("weight_density", 0.0, 2e4, (-1.0,))
SHEAR = Argument("shear_modulus", 1e-4, 0.1, (0.0, -0.01))
MU_L = Argument("mu_l", 0.5, 1.5, (0.0, -0.5))
LATERAL = Argument("acceleration", 0.0, 9.0, (-1.0,))
YAW_RATE = Argument("yaw_rate", -2.0, 2.0)
SPEED = Argument("speed", -4.0, 4.0)
LIMIT = Argument("limit", 1.0, 1e4, (-1.0,))
FORCE = Argument("force", -0.999, 0.999)
DROP = Argument("pressure_drop", -2e7, 2e7)
FLOW = Argument("flow", -3e-4, 3e-4)
MOTOR = Argument("pressure", -2e7, 2e7)
OIL = Argument("density", 700.0, 1000.0, (0.0, -1.0))
DISCHARGE = Argument("discharge", 0.1, 1.0, (0.0, -0.5, 1.1))


def coefficient(field: str) -> Argument:
    return Argument(field, 0.0, 100.0, (-1.0,))


def over_elements(slip):
    return traction.thrust_of_elements(slip, [1e3, 5e3, 2e3], 0.23, 1.2, 0.01)


def with_vehicle(function):
    return lambda first, second: function(first, second, PC05)


CASES: dict[str, tuple[Callable, list[Argument]]] = {
    "shear_strength": (strength.shear_strength, [PRESSURE, COHESION, ANGLE]),
    "thrust_limit": (strength.thrust_limit, [COHESION, ANGLE, AREA, WEIGHT]),
    "bekker_modulus": (sinkage.bekker_modulus, [coefficient("k_c"), coefficient("k_phi"), WIDTH]),
    "bekker_pressure": (sinkage.bekker_pressure, [SINKAGE, MODULUS, EXPONENT]),
    "bekker_sinkage": (sinkage.bekker_sinkage, [PRESSURE, MODULUS, EXPONENT]),
    "unloading_stiffness": (
        sinkage.unloading_stiffness,
        [Argument("unloading_sinkage", 0.0, 0.2, (-0.1,)), coefficient("k_0"), coefficient("a_u")],
    ),
    "unloading_pressure": (
        sinkage.unloading_pressure,
        [
            SINKAGE,
            Argument("unloading_sinkage", 0.1, 0.3, (-0.1,)),
            Argument("unloading_pressure", 0.0, 1e5, (-1.0,)),
            Argument("stiffness", 0.0, 1e7, (-1.0,)),
        ],
    ),
    "reece_modulus": (
        sinkage.reece_modulus,
        [COHESION, coefficient("k_c"), DENSITY, coefficient("k_phi"), WIDTH],
    ),
    "reece_pressure": (sinkage.reece_pressure, [SINKAGE, WIDTH, MODULUS, EXPONENT]),
    "compaction_resistance": (resistance.compaction_resistance, [SINKAGE, WIDTH, MODULUS, EXPONENT]),
    "passive_earth_pressure": (
        resistance.passive_earth_pressure,
        [SINKAGE, COHESION, DENSITY, coefficient("k_c"), coefficient("k_gamma")],
    ),
    "bulldozing_resistance": (
        resistance.bulldozing_resistance,
        [
            Argument("earth_pressure", 0.0, 1e4, (-1.0,)),
            WIDTH,
            Argument("approach_angle", 0.1, 1.5, (0.0, -0.1, math.pi)),
            ANGLE,
        ],
    ),
    "drag_resistance": (resistance.drag_resistance, [SINKAGE, LENGTH, COHESION, coefficient("coefficient")]),
    "longitudinal_resistance": (resistance.longitudinal_resistance, [SPEED, coefficient("mu_r"), WEIGHT]),
    "shear_stress": (
        traction.shear_stress,
        [Argument("displacement", -0.3, 0.3), Argument("strength", 0.0, 1e5, (-1.0,)), SHEAR],
    ),
    "thrust_of_elements": (over_elements, [Argument("slip", -1.0, 1.0)]),
    "thrust": (traction.thrust, [Argument("slip", -2.0, 1.0), LIMIT, SHEAR, LENGTH]),
    "slip_of_thrust": (traction.slip_of_thrust, [FORCE, LIMIT, SHEAR, LENGTH]),
    "slip_of_thrust_approximate": (traction.slip_of_thrust_approximate, [FORCE, LIMIT, SHEAR, LENGTH]),
    "lateral_force": (
        turning.lateral_force,
        [Argument("x", 0.0, 1.0, (-0.1, 9.0)), WEIGHT, LENGTH, MU_L, LATERAL],
    ),
    "zero_force_point": (turning.zero_force_point, [LENGTH, MU_L, LATERAL]),
    "centre_point": (turning.centre_point, [LENGTH, MU_L, LATERAL]),
    "centre_point_approximate": (turning.centre_point_approximate, [LENGTH, MU_L, LATERAL]),
    "moment_with_centrifugal_force": (
        turning.moment_with_centrifugal_force,
        [WEIGHT, LENGTH, MU_L, Argument("acceleration", 0.0, 9.0, (-1.0, 60.0))],
    ),
    "triangular_moment": (turning.triangular_moment, [WEIGHT, LENGTH, MU_L]),
    "uniform_moment": (turning.uniform_moment, [WEIGHT, LENGTH, MU_L]),
    "rotation_shift": (turning.rotation_shift, [SPEED, YAW_RATE, LENGTH, MU_L]),
    "slip_angle": (turning.slip_angle, [YAW_RATE, LENGTH, MU_L]),
    "torque": (with_vehicle(hydraulics.torque), [MOTOR, SPEED]),
    "pressure_of_torque": (
        with_vehicle(hydraulics.pressure_of_torque),
        [Argument("torque", -800.0, 800.0), SPEED],
    ),
    "thrust_of_pressure": (with_vehicle(hydraulics.thrust_of_pressure), [MOTOR, SPEED]),
    "pressure_of_thrust": (
        with_vehicle(hydraulics.pressure_of_thrust),
        [Argument("force", -5e3, 5e3), SPEED],
    ),
    "speed_of_flow": (with_vehicle(hydraulics.speed_of_flow), [FLOW, MOTOR]),
    "flow_of_speed": (with_vehicle(hydraulics.flow_of_speed), [SPEED, MOTOR]),
    "orifice_flow": (
        hydraulics.orifice_flow,
        [DROP, Argument("area", 0.0, 1e-5, (-1e-6,)), OIL, DISCHARGE],
    ),
    "orifice_pressure_drop": (
        hydraulics.orifice_pressure_drop,
        [FLOW, Argument("area", 1e-7, 1e-5, (0.0, -1e-6)), OIL, DISCHARGE],
    ),
    "relieved_pressure": (
        lambda dp: hydraulics.relieved_pressure(dp, PC05),
        [Argument("pressure", -4e7, 4e7)],
    ),
}


def test_every_public_function_has_a_case():
    public = {
        name
        for module in MODULES
        for name, member in inspect.getmembers(module, inspect.isfunction)
        if member.__module__ == module.__name__ and not name.startswith("_")
    }
    assert public == set(CASES)


@pytest.mark.parametrize("name", CASES)
@settings(max_examples=40)  # of each function
@given(data=st.data())
def test_an_array_is_a_loop_of_scalars(name, data):
    function, arguments = CASES[name]
    row = st.tuples(*(st.floats(a.low, a.high, allow_subnormal=False) for a in arguments))
    rows = np.array(data.draw(st.lists(row, min_size=1, max_size=4)))
    together = function(*rows.T)
    one_by_one = [function(*values) for values in rows]
    assert together.shape == (len(rows),)
    assert all(np.ndim(value) == 0 and math.isfinite(value) for value in one_by_one)
    np.testing.assert_allclose(together, one_by_one, rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("name", CASES)
@settings(max_examples=40)  # of each function
@given(data=st.data())
def test_arguments_broadcast(name, data):
    function, arguments = CASES[name]
    values = [data.draw(st.floats(a.low, a.high, allow_subnormal=False)) for a in arguments]
    first = np.linspace(arguments[0].low, arguments[0].high, 3)
    table = function(first[:, np.newaxis], *(np.full(2, value) for value in values[1:]))
    assert table.shape == ((3, 2) if values[1:] else (3, 1))
    np.testing.assert_allclose(table[:, 0], function(first, *values[1:]), rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("name", CASES)
def test_arguments_outside_the_domain_are_refused(name):
    function, arguments = CASES[name]
    middle = [0.5 * (a.low + a.high) for a in arguments]
    for index, argument in enumerate(arguments):
        for bad in (*argument.refused, math.nan, math.inf, -math.inf):
            for value in (bad, [middle[index], bad]):
                with pytest.raises(
                    InputError, match=rf"{argument.field}.* = .* is refused; accepted: \S"
                ) as e:
                    function(*middle[:index], value, *middle[index + 1 :])
                assert "\n" not in str(e.value)
        with pytest.raises(InputError, match="'much' is refused; accepted: numbers"):
            function(*middle[:index], "much", *middle[index + 1 :])
