# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Text for a terminal: no line exceeds 80 columns, and no word is lost."""

from hypothesis import given
from hypothesis import strategies as st

from trackslip_tools.terminal_text import WIDTH, format_for_terminal, table, wrap_line

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
