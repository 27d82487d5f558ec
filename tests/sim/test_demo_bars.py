# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The estimate on drives like the demo's stays within its error limits, on firm and soft soils."""

from pathlib import Path

import pytest
from fixtures.demo_bars import SOILS, TRIALS, Trial, main, measure


@pytest.mark.slow
@pytest.mark.parametrize("soil", SOILS)
@pytest.mark.parametrize("trial", TRIALS, ids=lambda trial: trial.scenario)
def test_no_bar_is_exceeded(trial: Trial, soil: str, tmp_path: Path) -> None:
    bars = measure(trial, soil, seed=1, directory=tmp_path)
    assert not bars.exceeded(), bars


def test_help_is_printed_without_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    assert capsys.readouterr().out.startswith("usage: make bars")
