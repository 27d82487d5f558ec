# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Formats text for terminals of 80 columns: wraps lines, and folds tables that are too wide."""

import math
import re
import textwrap
from collections.abc import Sequence

WIDTH = 80
NO_VALUE = "–"
_RULE = re.compile(r":?-+:?")
_GAP = "  "


def number_text(value: float | None, form: str) -> str:
    """A number in this format; a dash if there is none, or it is not finite."""
    return NO_VALUE if value is None or not math.isfinite(value) else format(value, form)


def wrap_line(line: str, indent: str = "  ") -> str:
    """The line, wrapped between words if longer than WIDTH; continuation lines are indented."""
    if len(line) <= WIDTH:
        return line
    margin = line[: len(line) - len(line.lstrip())] + indent
    return textwrap.fill(
        line, WIDTH, subsequent_indent=margin, break_long_words=False, break_on_hyphens=False
    )


def table(heading: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[bool], keys: int = 1) -> str:
    """Table with aligned columns; those of ``right`` are right-aligned.

    A table wider than WIDTH is folded into tables one below the other, each with the first ``keys`` columns.
    A key that is the same in all rows is stated once, above.
    """
    lines = [list(map(str, heading)), *(list(map(str, row)) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    constant = []
    if _total_width(widths, range(len(widths))) > WIDTH and len(rows) > 1:
        constant = [k for k in range(keys) if lines[0][k] and len({line[k] for line in lines[1:]}) == 1]
    columns = [k for k in range(keys) if k not in constant]
    heads = ", ".join(f"{lines[0][k]} {lines[1][k]}" for k in constant)
    parts, remaining = [heads] if heads else [], list(range(keys, len(widths)))
    while remaining or not parts:
        shown = list(columns)
        while remaining and (
            len(shown) == len(columns) or _total_width(widths, [*shown, remaining[0]]) <= WIDTH
        ):
            shown.append(remaining.pop(0))
        parts.append("\n".join(_align_cells(line, shown, widths, right) for line in lines))
    return "\n\n".join(parts)


def markdown_table(heading: Sequence[str], rows: Sequence[Sequence[str]], keys: int) -> list[str]:
    """Lines of a Markdown table, aligned as text too; ``keys`` columns are left-aligned, others right."""
    lines = [list(heading), *map(list, rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    rule = ["-" * w if k < keys else "-" * (w - 1) + ":" for k, w in enumerate(widths)]
    first, *others = (
        [
            cell.ljust(w) if k < keys else cell.rjust(w)
            for k, (cell, w) in enumerate(zip(line, widths, strict=True))
        ]
        for line in lines
    )
    return [f"| {' | '.join(line)} |" for line in (first, rule, *others)]


def format_for_terminal(markdown: str) -> str:
    """Markdown with folded tables and wrapped lines.

    Key columns of a table are the left-aligned ones (``---`` instead of ``---:``), and the noises σ that
    follow them.
    """
    parts: list[str] = []
    block: list[str] = []
    for line in [*markdown.split("\n"), ""]:
        if line.startswith("|"):
            block.append(line)
            continue
        if block:
            parts.append(_fold_table([_split_cells(one) for one in block]))
            block = []
        parts.append(wrap_line(line, ""))
    return "\n".join(parts[:-1])


def _fold_table(lines: list[list[str]]) -> str:
    heading, rules, *rows = lines
    if not all(_RULE.fullmatch(rule) for rule in rules):
        return "\n".join(" ".join(line) for line in lines)
    right = [rule.endswith(":") for rule in rules]
    keys = 0
    while keys < len(right) - 1 and (not right[keys] or heading[keys].startswith("σ")):
        keys += 1
    return table(heading, rows, right, max(keys, 1))


def _split_cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def _total_width(widths: Sequence[int], columns: Sequence[int]) -> int:
    return sum(widths[k] for k in columns) + len(_GAP) * (len(columns) - 1)


def _align_cells(
    line: Sequence[str], columns: Sequence[int], widths: Sequence[int], right: Sequence[bool]
) -> str:
    cells = (line[k].rjust(widths[k]) if right[k] else line[k].ljust(widths[k]) for k in columns)
    return _GAP.join(cells).rstrip()
