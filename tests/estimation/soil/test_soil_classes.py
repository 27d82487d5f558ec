# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Soil classes, the line in (c, ϕ), and the reserve of thrust."""

import math
from dataclasses import replace

import numpy as np
import pytest

from trackslip_common.arrays import FloatArray
from trackslip_common.soils import Soil, load_soils, soil
from trackslip_estimation.soil.classes import NONE, ClassesParameters, SoilClasses, soil_thrust_limit
from trackslip_estimation.soil.reserve import thrust_reserve
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_estimation.soil.strength_grid import StrengthGrid

P = load_soil_parameters()
SOILS = load_soils()
# Without time-correlated errors: the tests examine the cells of the grid
VEHICLE = P.vehicle.whole()
GRID = StrengthGrid(replace(P.strength, slip_bias_stddev=0.0, thrust_scale_stddev=0.0), VEHICLE)
AXES = (GRID.log_moduli, GRID.log_limits)
CLASSES = SoilClasses(P.classes, SOILS.values(), VEHICLE, GRID)


def posterior_about(modulus: float, limit: float) -> FloatArray:
    """A narrow posterior about one soil."""
    k, f = ((a - math.log(v)) / 0.03 for a, v in zip(AXES, (modulus, limit), strict=True))
    grid = np.exp(-0.5 * (k[:, None] ** 2 + f[None, :] ** 2))
    return np.asarray(grid / grid.sum())


@pytest.mark.parametrize("name", [name for name, s in SOILS.items() if s.shear_modulus is not None])
def test_each_soil_is_found_at_its_own_strength(name: str) -> None:
    probabilities = CLASSES.probabilities(
        posterior_about(SOILS[name].value("shear_modulus"), soil_thrust_limit(SOILS[name], VEHICLE))
    )
    assert max(probabilities, key=lambda other: probabilities[other]) == name
    assert sum(probabilities.values()) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(("modulus", "limit"), [(0.06, 2000.0), (0.002, 8000.0), (0.05, 1500.0)])
def test_unknown_soil_is_classified_as_none_of_these(modulus: float, limit: float) -> None:
    assert CLASSES.probabilities(posterior_about(modulus, limit))[NONE] > 0.8


def test_flat_posterior_gives_the_priors() -> None:
    flat = np.full((AXES[0].size, AXES[1].size), 1.0 / (AXES[0].size * AXES[1].size))
    probabilities = CLASSES.probabilities(flat)
    assert probabilities[NONE] == pytest.approx(P.classes.none_prior, abs=0.01)
    assert probabilities["sand"] == pytest.approx((1.0 - P.classes.none_prior) / len(SOILS), rel=0.05)


def test_soil_without_modulus_matches_any_modulus() -> None:
    snow = soil_thrust_limit(SOILS["petawawa_snow"], VEHICLE)
    both = [CLASSES.probabilities(posterior_about(k, snow))["petawawa_snow"] for k in (0.002, 0.05)]
    assert min(both) > 0.2


def test_none_of_these_is_certain_without_known_soils() -> None:
    parameters = ClassesParameters(modulus_spread=0.3, limit_spread=0.05, none_prior=0.1)
    alone = SoilClasses(parameters, [], VEHICLE, GRID)
    assert alone.probabilities(posterior_about(0.01, 3000.0)) == {NONE: pytest.approx(1.0)}


def test_soils_of_equal_strength_line_have_the_same_limit() -> None:
    limit = soil_thrust_limit(soil("sand"), VEHICLE)
    area = 2.0 * VEHICLE.track_width * VEHICLE.contact_length
    cohesion, angle = 2.0 * limit / area, math.atan(2.0 * limit / VEHICLE.weight)
    half = math.atan(0.5 * math.tan(angle))
    for c, phi in ((cohesion, 0.0), (0.0, angle), (0.5 * cohesion, half)):
        other = Soil(name="other", cohesion=c, friction_angle=phi)
        assert soil_thrust_limit(other, VEHICLE) == pytest.approx(limit)


def test_constant_errors_equal_a_spread_of_the_cells() -> None:
    grid = StrengthGrid(P.strength, VEHICLE)
    certain = posterior_about(0.01, 3600.0)
    spread = SoilClasses(P.classes, SOILS.values(), VEHICLE, grid).probabilities(certain)
    cells = grid.add_errors(certain)
    assert spread == pytest.approx(CLASSES.probabilities(cells), rel=1e-9)
    assert grid.moduli_probabilities(certain) == pytest.approx(cells.sum(axis=1), abs=1e-12)
    assert grid.limit_probabilities(certain) == pytest.approx(cells.sum(axis=0), abs=1e-12)


def test_the_reserve_falls_to_nothing_at_the_limit() -> None:
    marginal = posterior_about(0.01, 3000.0).sum(axis=0)
    unloaded, half, spent = (
        thrust_reserve(f, 900.0, GRID.limits, marginal, 0.9) for f in (0.0, -1500.0, 2990.0)
    )
    assert unloaded == (1.0, pytest.approx(0.0, abs=1e-12))
    assert half.share == pytest.approx(0.5, abs=0.01)
    assert half.exhausted < 1e-6
    assert spent.share == pytest.approx(0.0, abs=0.01)
    assert spent.exhausted > 0.95


def test_warning_probability_is_undecided_for_unknown_strength() -> None:
    flat = np.full(AXES[1].size, 1.0 / AXES[1].size)
    assert 0.2 < thrust_reserve(3000.0, 900.0, GRID.limits, flat, 0.9).exhausted < 0.8
