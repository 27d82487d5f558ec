# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Terrain files: valid ones, and each kind of error."""

import math
from typing import Any

import pytest

from trackslip_common.errors import InputError
from trackslip_sim.scenarios.scenario import load_scenario, parse_scenario
from trackslip_sim.scenarios.terrains import load_terrain, parse_terrain, terrain_names
from trackslip_sim.truth.terrain import FLAT, heights

PLANE = {"kind": "plane", "direction_deg": 0, "slope_deg": 10.0}
RAMP = {**PLANE, "kind": "ramp", "start": 3.0, "length": 5.0, "rounding": 2.0}
HILL = {"kind": "hill", "x": 5.0, "y": 0.0, "height": 1.0, "width": 4.0}


@pytest.mark.parametrize("name", terrain_names())
def test_each_terrain_is_named_after_its_file(name: str) -> None:
    terrain = load_terrain(name)
    assert terrain.name == name
    assert (terrain == FLAT) == (name == "flat")


def test_a_ramp_rises_by_its_slope() -> None:
    terrain = parse_terrain({"name": "mine", "features": [RAMP]})
    low, middle, further, high = heights(terrain, [3.0, 5.5, 6.5, 30.0], [0.0, 4.0, -4.0, 0.0])
    assert low == 0.0
    assert further - middle == pytest.approx(math.tan(math.radians(10.0)))
    assert high == pytest.approx(5.0 * math.tan(math.radians(10.0)))


def test_ramps_and_hill_have_their_stated_height_and_slope() -> None:
    assert heights(load_terrain("ramp_up"), [50.0], [0.0])[0] == pytest.approx(3.0, abs=0.01)
    assert heights(load_terrain("ramp_down"), [50.0], [0.0])[0] == pytest.approx(-3.0, abs=0.01)
    (hill,) = load_terrain("hill").features
    assert math.degrees(hill.slope) == pytest.approx(15.0, abs=0.1)


def test_a_scenario_names_its_terrain() -> None:
    assert load_scenario("hill").terrain == load_terrain("hill")
    assert load_scenario("slalom").terrain == FLAT


@pytest.mark.parametrize(
    ("feature", "message"),
    [
        ({**PLANE, "kind": "cliff"}, "kind: 'cliff' is not accepted; accepted: plane, ramp, hill"),
        ({**PLANE, "slope_deg": 46.0}, "a slope of 46° is refused; accepted: within ±45°"),
        ({**PLANE, "slope_deg": math.nan}, "slope_deg: nan is not accepted; accepted: a finite number"),
        ({**PLANE, "x": 1.0}, "unknown key 'x'; accepted: kind, direction_deg, slope_deg"),
        ({**RAMP, "rounding": 0.0}, "rounding = 0.0 is refused; accepted: at least 0.001 m"),
        ({**RAMP, "length": 1.0}, "length = 1.0 is refused; accepted: >= rounding"),
        ({**HILL, "width": 5e-324}, "width = 5e-324 is refused; accepted: at least 0.001 m"),
        ({**HILL, "width": 1e308}, "width = 1e+308 is refused; accepted: within ±1e+06"),
        ({"kind": "hill"}, "feature: key 'x' is missing; accepted: kind, x, y, height, width"),
    ],
)
def test_a_wrong_feature_is_refused(feature: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_terrain({"name": "mine", "features": [feature]})
    assert message in str(refused.value)


def test_an_unknown_terrain_is_refused_with_those_there_are() -> None:
    segment = {"duration": 1.0, "left": 1.0, "right": 1.0}
    with pytest.raises(InputError, match="terrain: 'moon' is unknown; accepted: flat, hill"):
        parse_scenario({"name": "mine", "soil": "sand", "terrain": "moon", "segments": [segment]})
