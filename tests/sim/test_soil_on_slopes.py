# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The soil estimator on slopes of the shear truth: weight is no resistance; the soil class stays the same."""

from typing import Any

import pytest

from trackslip_sim.study.soil.score import run_trial
from trackslip_sim.study.soil.study import SoilStudy
from trackslip_sim.study.soil.trial import Trial, load_setting


def trial(terrain: str) -> Trial:
    return Trial("sand", 0.01, 1, scenario="field_trial", duration=80.0, standstill=5.0, terrain=terrain)


@pytest.mark.parametrize("terrain", ["slope_15", "side_slope_15"])
def test_soil_is_the_same_on_a_slope(terrain: str) -> None:
    result = run_trial(trial(terrain))
    assert result.mu_r == pytest.approx(1.0, abs=0.08)
    assert result.limit == pytest.approx(1.0, abs=0.15)
    assert result.modulus == pytest.approx(1.0, abs=0.4)
    for low, high in (result.mu_r_interval, result.limit_interval, result.modulus_interval):
        assert low < 1.0 < high
    assert result.probability > 0.8


@pytest.mark.slow
def test_dragged_track_keeps_the_strength() -> None:
    """The last turn downhill drags one track."""
    result = run_trial(Trial("sand", 0.01, 1, scenario="field_trial", terrain="slope_down_15"))
    assert result.limit == pytest.approx(1.0, abs=0.05)
    low, high = result.limit_interval
    assert low < 1.0 < high < 1.3


def test_slope_without_attitude_is_taken_for_resistance() -> None:
    result = run_trial(trial("slope_15"), load_setting(slip={"use_attitude": False}))
    assert result.mu_r > 1.8


def test_a_study_has_cells_of_terrains() -> None:
    grid: dict[str, Any] = {"terrains": ["hill", ""], "scenarios": ["slalom"], "soils": ["sand"], "seeds": 1}
    study = SoilStudy({**grid, "sigma_xy": [0.01]}, [])
    cells = list(study.cells)
    assert [cell.terrain for cell in cells] == ["hill", ""]
    hill, level = (study.cells[cell][0] for cell in cells)
    assert (hill.terrain, level.terrain) == ("hill", "")
    assert study.depends_on(hill) != study.depends_on(level)
