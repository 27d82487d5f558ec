# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Rows as tables of Markdown, which are also what the terminal shows."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

NOTHING = "–"  # there was no such thing
Columns = Mapping[str, Callable[[Any], str]]
"""Head of a column → what it shows of a row. Spaces behind a head keep two of one name apart."""


def table(columns: Columns, rows: Sequence[Any], text_columns: int) -> list[str]:
    """The lines; text stands left in its columns, which are the first ones, numbers right."""
    lines = [[head.rstrip() for head in columns], *([show(row) for show in columns.values()] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    rule = ["-" * w if k < text_columns else "-" * (w - 1) + ":" for k, w in enumerate(widths)]
    first, *others = (
        [
            text.ljust(width) if k < text_columns else text.rjust(width)
            for k, (text, width) in enumerate(zip(line, widths, strict=True))
        ]
        for line in lines
    )
    return ["| " + " | ".join(line) + " |" for line in (first, rule, *others)]


def words(name: str) -> str:
    """A name of the configuration as text."""
    return name.replace("_", " ")
