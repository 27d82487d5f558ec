# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Every public function of terramechanics: arrays equal loops of scalars; invalid arguments are rejected."""

import inspect
import math
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_common.errors import InputError
from trackslip_common.vehicle_files import load_vehicle
from trackslip_estimation.terramechanics import hydraulics, resistance, sinkage, strength, traction, turning


class Domain(NamedTuple):
    """A range to draw an argument from, and values outside its domain."""

    low: float
    high: float
    refused: tuple[float, ...] = ()
    field: str = ""  # in messages, where it is not the name of the argument


COEFFICIENT = Domain(0.0, 100.0, (-1.0,))
DOMAINS = {  # by the names of the arguments
    **dict.fromkeys(("k_c", "k_phi", "k_gamma", "k_0", "a_u", "mu_r", "coefficient"), COEFFICIENT),
    "acceleration": Domain(0.0, 9.0, (-1.0,)),
    "approach_angle": Domain(0.1, 1.5, (0.0, -0.1, math.pi)),
    "area": Domain(0.1, 2.0, (0.0, -1.0)),
    "cohesion": Domain(0.0, 2e4, (-1.0,)),
    "density": Domain(700.0, 1000.0, (0.0, -1.0)),
    "discharge": Domain(0.1, 1.0, (0.0, -0.5, 1.1)),
    "displacement": Domain(-0.3, 0.3),
    "earth_pressure": Domain(0.0, 1e4, (-1.0,)),
    "flow": Domain(-3e-4, 3e-4),
    "force": Domain(-0.999, 0.999),
    "friction_angle": Domain(0.0, 1.5, (-0.1, math.pi / 2, 2.0)),
    "length": Domain(1.0, 3.0, (0.0, -1.0)),
    "limit": Domain(1.0, 1e4, (-1.0,)),
    "modulus": Domain(1e4, 1e7, (0.0, -1.0)),
    "moment": Domain(-800.0, 800.0, field="torque"),
    "mu_l": Domain(0.5, 1.5, (0.0, -0.5)),
    "n": Domain(0.1, 2.0, (0.0, -1.0)),
    "pressure": Domain(0.0, 1e5, (-1.0,)),
    "pressure_drop": Domain(-2e7, 2e7),
    "shear_modulus": Domain(1e-4, 0.1, (0.0, -0.01)),
    "sinkage": Domain(0.0, 0.1, (-0.01,)),
    "slip": Domain(-2.0, 1.0),
    "speed": Domain(-4.0, 4.0),
    "stiffness": Domain(0.0, 1e7, (-1.0,)),
    "strength": Domain(0.0, 1e5, (-1.0,)),
    "unloading_pressure": Domain(0.0, 1e5, (-1.0,)),
    "unloading_sinkage": Domain(0.1, 0.3, (-0.1,)),
    "weight": Domain(0.0, 2e4, (-1.0,)),
    "weight_density": Domain(0.0, 2e4, (-1.0,)),
    "width": Domain(0.1, 1.0, (0.0, -1.0)),
    "x": Domain(0.0, 1.0, (-0.1, 9.0)),
    "yaw_rate": Domain(-2.0, 2.0),
}
OTHER_DOMAINS = {  # of single functions
    **{(name, "pressure"): Domain(-4e7, 4e7) for name in vars(hydraulics)},
    ("orifice_flow", "area"): Domain(0.0, 2.0, (-1.0,)),
    ("moment_with_centrifugal_force", "acceleration"): Domain(0.0, 9.0, (-1.0, 60.0)),
}
GIVEN = {"vehicle": load_vehicle().whole()}  # arguments that are no numbers
ELEMENTS = {"strength": [1e3, 5e3, 2e3], "width": 0.23, "length": 1.2, "shear_modulus": 0.01}


def functions_of(*modules):
    """Each public function, with the domains of its arguments."""
    functions = {}
    for module in modules:
        for name, function in inspect.getmembers(module, inspect.isfunction):
            if function.__module__ != module.__name__ or name.startswith("_"):
                continue
            known = ELEMENTS if name == "thrust_of_elements" else GIVEN  # the strength is an array
            names = inspect.signature(function).parameters
            domains = {n: OTHER_DOMAINS.get((name, n), DOMAINS.get(n)) for n in names if n not in known}
            functions[name] = partial(function, **{n: known[n] for n in names if n in known}), domains
    return functions


FUNCTIONS = functions_of(strength, sinkage, resistance, traction, turning, hydraulics)


@pytest.mark.parametrize("name", FUNCTIONS)
@settings(max_examples=20)  # of each function
@given(data=st.data())
def test_arguments_broadcast_and_an_array_is_a_loop_of_scalars(name, data):
    function, domains = FUNCTIONS[name]
    first, *others = (
        data.draw(st.tuples(*[st.floats(d.low, d.high, allow_subnormal=False)] * (3 if k == 0 else 2)))
        for k, d in enumerate(domains.values())
    )
    table = function(np.array(first)[:, np.newaxis], *map(np.array, others))
    rows = list(zip(*others, strict=True)) or [()]
    one_by_one = [[function(value, *row) for row in rows] for value in first]
    assert table.shape == (3, len(rows))
    assert all(np.ndim(value) == 0 and math.isfinite(value) for row in one_by_one for value in row)
    np.testing.assert_allclose(table, one_by_one, rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arguments_outside_the_domain_are_refused(name):
    function, domains = FUNCTIONS[name]
    middle = [0.5 * (d.low + d.high) for d in domains.values()]
    for index, (argument, domain) in enumerate(domains.items()):
        field = domain.field or argument
        for bad in (*domain.refused, math.nan, math.inf, -math.inf):
            for value in (bad, [middle[index], bad]):
                with pytest.raises(InputError, match=rf"{field}.* = .* is refused; accepted: \S") as e:
                    function(*middle[:index], value, *middle[index + 1 :])
                assert "\n" not in str(e.value)
        with pytest.raises(InputError, match="'much' is refused; accepted: numbers"):
            function(*middle[:index], "much", *middle[index + 1 :])
