# SPDX-License-Identifier: Apache-2.0
"""The estimate on drives like the demo's stays within its limits, on firm soils and soft."""

from pathlib import Path

import pytest

from trackslip_sim.demo.bars import SOILS, TRIALS, Trial, measure


@pytest.mark.slow
@pytest.mark.parametrize("soil", SOILS)
@pytest.mark.parametrize("trial", TRIALS, ids=lambda trial: trial.scenario)
def test_no_bar_is_exceeded(trial: Trial, soil: str, tmp_path: Path) -> None:
    bars = measure(trial, soil, seed=1, directory=tmp_path)
    assert not bars.exceeded(), bars
