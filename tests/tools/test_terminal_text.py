# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Text and commands on a terminal: no line exceeds 80 columns, and no word is lost."""

from pathlib import Path

import pytest
from fixtures.commands import TRACKSLIP
from fixtures.terminal import COLUMNS, on_terminal
from hypothesis import given
from hypothesis import strategies as st

from trackslip_tools.terminal_text import WIDTH, format_for_terminal, table, wrap_line

ROOT = Path(__file__).parents[2]
BAGS = ROOT / "bags"
WORDS = st.lists(st.text("abcxyz0.9", min_size=1, max_size=20), min_size=1, max_size=40)


@given(WORDS)
def test_a_wrapped_line_fits_and_keeps_its_words(words: list[str]) -> None:
    line = "  " + " ".join(words)
    lines = wrap_line(line).split("\n")
    assert max(map(len, lines)) <= WIDTH
    assert " ".join(lines).split() == words
    assert all(one.startswith("    ") for one in lines[1:])


@given(st.integers(1, 12), st.integers(1, 4), st.integers(1, 25))
def test_a_folded_table_fits_and_keeps_its_cells(columns: int, rows: int, width: int) -> None:
    heading = ["key", *(f"h{k}".ljust(width, "_") for k in range(columns))]
    cells = [[f"row{r}", *(f"c{r}.{k}" for k in range(columns))] for r in range(rows)]
    text = table(heading, cells, [False, *[True] * columns])
    assert max(map(len, text.split("\n"))) <= WIDTH
    assert {word for line in [heading, *cells] for word in line} <= set(text.replace(",", " ").split())


def test_wide_table_is_folded_with_its_keys_and_constant_columns_above() -> None:
    names = [f"number {k} of {'x' * 15}" for k in range(5)]
    heading = f"| soil | σ m | {' | '.join(names)} |"
    rules = f"| --- | ---: | {' | '.join(['---:'] * 5)} |"
    rows = [f"| sand | 0.0{r} | {' | '.join(str(k * 10 + r) for k in range(5))} |" for r in (1, 5)]
    text = format_for_terminal("\n".join(["Before.", "", heading, rules, *rows, "", "word " * 40]))
    lines = text.split("\n")
    assert max(map(len, lines)) <= WIDTH
    assert "soil sand" in lines
    folded = [line.split()[0] for line in lines if line.startswith((" 0.0", "0.0"))]
    assert folded == ["0.01", "0.05"] * (len(folded) // 2)
    assert len(folded) >= 4


# Commands of the README


@pytest.mark.parametrize(
    "words",
    [
        "--help",
        "info {bags}/slalom_sand",
        "replay {bags}/slalom_sand --stop 12 --withhold box_pose:6:9 --json {out}.json",
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
