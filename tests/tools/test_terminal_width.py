# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Commands of the README on a terminal of 80 columns: no wider line, and no traceback."""

from pathlib import Path

import pytest
from fixtures.commands import TRACKSLIP
from fixtures.terminal import COLUMNS, on_terminal

ROOT = Path(__file__).parents[2]
BAGS = ROOT / "bags"


@pytest.mark.parametrize(
    "words",
    [
        "--help",
        "replay --help",
        "info {bags}/slalom_sand",
        "replay {bags}/slalom_sand --stop 12 --withhold box_pose:6:9 --json {out}.json",
        "replay {bags} --stop 5 --workers 1",
        pytest.param("smooth {bags}/slalom_sand --output {out}", marks=pytest.mark.slow),
        pytest.param(
            "calibrate {bags}/slalom_sand {bags}/outage_sandy_loam --output {out}", marks=pytest.mark.slow
        ),
        "recover {bags}/power_cut --output {out}",
        pytest.param("simulate --scenario straight --duration 5 --output {out}", marks=pytest.mark.slow),
        "report {bags}/slalom_sand --output {out}/no/page.html",
    ],
)
def test_a_command_keeps_to_the_terminal(words: str, tmp_path: Path) -> None:
    arguments = [word.format(bags=BAGS, out=tmp_path / "out") for word in words.split()]
    shown = on_terminal([*TRACKSLIP, *arguments])
    assert shown.code == (2 if "/no/" in words else 0), shown.text
    paths = (str(BAGS), str(tmp_path))  # never wrapped
    assert [s for s in shown.lines if len(s) > COLUMNS and not any(path in s for path in paths)] == []
    assert "Traceback" not in shown.text


def test_list_of_make_targets_fits_the_terminal() -> None:
    shown = on_terminal(["make", "-C", str(ROOT), "--no-print-directory"])
    assert shown.code == 0
    assert {line.split()[1] for line in shown.lines if line.startswith("make ")} >= {"demo", "test", "clean"}
    assert [line for line in shown.lines if len(line) > COLUMNS] == []
