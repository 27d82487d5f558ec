# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario files: valid ones, and each kind of error."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trackslip_common.errors import InputError
from trackslip_common.vehicle_files import load_vehicle
from trackslip_sim.scenarios.scenario import Scenario, Segment, load_scenario, parse_scenario, scenario_names
from trackslip_sim.truth.settings import load_settings
from trackslip_sim.truth.simulate import simulate

COARSE = dataclasses.replace(load_settings(), step=0.005, sample_period=0.05)
NAMES = {
    *("thesis", "straight", "turn_left", "turn_right", "slalom"),
    *("start_stop", "spot_turn", "field_trial", "patches", "soil_change", "dig_cycles"),
    *("hill", "ramp_up", "ramp_down", "side_slope", "load_and_haul"),
}
SEGMENT = {"duration": 2.0, "left": 1, "right": 2.5}
PATCH = {"soil": "sand", "from_x": 0, "to_x": 1, "from_y": 0, "to_y": 1}
GOOD: dict[str, Any] = {"name": "mine", "soil": "sand", "segments": [SEGMENT]}


def test_the_promised_scenarios_are_there() -> None:
    assert set(scenario_names()) == NAMES


@pytest.mark.parametrize("name", sorted(NAMES))
def test_each_scenario_moves_the_machine(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    truth = simulate(scenario, settings=COARSE, upper=load_vehicle(scenario.vehicle).upper_structure)
    assert truth.duration == pytest.approx(scenario.duration, abs=0.1)
    assert np.hypot(truth.x, truth.y).max() > 1.0


def test_durations_and_shapes() -> None:
    thesis = load_scenario("thesis")
    assert thesis.duration == pytest.approx(35.0)
    senses = [np.sign(s.right - s.left) for s in thesis.segments if s.right != s.left]
    assert senses == [-1, -1, -1, 1]
    assert thesis.segments[0] == Segment(10.0, thesis.segments[0].left, thesis.segments[0].left)
    assert load_scenario("field_trial").duration == pytest.approx(180.0)
    assert load_scenario("spot_turn").relief_pressure is not None
    left, right = load_scenario("turn_left"), load_scenario("turn_right")
    assert [(s.duration, s.right, s.left) for s in left.segments] == [
        (s.duration, s.left, s.right) for s in right.segments
    ]


def test_patches_cover_all_four_soils() -> None:
    truth = simulate(load_scenario("patches"), settings=COARSE)
    assert set(truth.soil_names) == {"sand", "sandy_loam", "clayey_soil", "dry_clay"}
    assert set(truth.soil_index.tolist()) == {0, 1, 2, 3}


def test_scenario_is_loaded_from_a_users_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\nsoil: dry_clay\nsegments:\n  - {duration: 1, left: 2, right: 2}\n")
    assert load_scenario(str(path)).segments == (Segment(1.0, 2.0, 2.0),)


def test_stretching_repeats_or_cuts() -> None:
    scenario = Scenario(name="a", soil="sand", segments=(Segment(2.0, 1.0, 1.0), Segment(1.0, 0.0, 0.0)))
    longer = scenario.with_duration(7.5)
    assert [s.duration for s in longer.segments] == [2.0, 1.0, 2.0, 1.0, 1.5]
    assert scenario.with_duration(0.5).segments == (Segment(0.5, 1.0, 1.0),)
    assert longer.duration == pytest.approx(7.5)
    with pytest.raises(InputError, match=r"duration: -1.0 is refused; accepted: > 0 s"):
        scenario.with_duration(-1.0)


def test_commands_change_at_the_segments_ends() -> None:
    scenario = Scenario(name="a", soil="sand", segments=(Segment(0.3, 1.0, 2.0), Segment(0.1, 3.0, 4.0)))
    commands = scenario.commands(0.1)
    assert commands.tolist() == [[1, 2], [1, 2], [1, 2], [3, 4]]
    with pytest.raises(InputError, match="shorter than a step"):
        scenario.commands(1.0)


def test_patches_alone_need_no_soil() -> None:
    tree = {"name": "a", "patches": [{**PATCH, "soil": "dry_clay"}], "segments": [SEGMENT]}
    assert parse_scenario(tree).soil == "dry_clay"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"segments": []}, r"segments = \[\] is refused; accepted: one or more"),
        ({"segments": 3}, r"segments = 3 is refused; accepted: a list"),
        ({"segments": [4]}, r"segments\[0\]: entry: 4 is not accepted; accepted: names and values"),
        ({"segments": [{**SEGMENT, "duration": -2}]}, r"segments\[0\]: .*duration = -2.0 .*accepted: > 0 s"),
        ({"segments": [SEGMENT, {"duration": 1, "left": 1}]}, r"segments\[1\]: .*key 'right' is missing"),
        ({"segments": [{**SEGMENT, "left": float("nan")}]}, r"segment: left: nan is not accepted; accepted:"),
        ({"segments": [{**SEGMENT, "load": -1}]}, r"segment: load = -1.0 is refused; accepted: >= 0 kg"),
        ({"segments": [{**SEGMENT, "speed": 1}]}, r"unknown key 'speed'; accepted: duration, left, right"),
        ({"colour": "red"}, r"scenario: unknown key 'colour'; accepted: name, soil"),
        ({"soil": 7}, r"soil: 7 is not accepted; accepted: text"),
        ({"relief_pressure": -1.0}, r"relief_pressure = -1.0 is refused; accepted: > 0 Pa"),
        ({"patches": [{**PATCH, "to_x": 0}]}, r"patches\[0\]: .*empty: to_x = 0.0; accepted: > from_x = 0.0"),
        ({"patches": [{**PATCH, "to_y": -1}]}, r"empty: to_y = -1.0; accepted: > from_y"),
        ({"patches": [{"soil": "sand"}]}, r"patches\[0\]: patch: key 'from_x' is missing"),
    ],
)
def test_bad_scenarios_are_refused_in_one_line(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        parse_scenario({**GOOD, **change})
    assert "\n" not in str(caught.value)


def test_missing_soil_and_unknown_names() -> None:
    with pytest.raises(InputError, match=r"soil is missing; accepted"):
        parse_scenario({"name": "a", "segments": [SEGMENT]})
    with pytest.raises(InputError, match=r"scenario: 'moon' is unknown; accepted: dig_cycles, field_trial"):
        load_scenario("moon")
    with pytest.raises(InputError, match=r"soil: 'cheese' is unknown; accepted: sand"):
        simulate(load_scenario("straight"), soil="cheese")
    tree = {**GOOD, "patches": [{**PATCH, "soil": "cheese"}]}
    with pytest.raises(InputError, match=r"patch: soil 'cheese' is unknown; accepted: sand"):
        simulate(parse_scenario(tree))


def test_the_files_name_opens_the_message(tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text("name: bad\nsoil: sand\nsegments: []\n")
    with pytest.raises(InputError, match=r"bad\.yaml: .*segments"):
        load_scenario(str(path))
