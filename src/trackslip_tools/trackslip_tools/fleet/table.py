# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One table of many bags, followed by errors, notes and vehicles."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from trackslip_common.errors import ExitCode
from trackslip_tools.fleet.entry import Entry
from trackslip_tools.fleet.find import short_names
from trackslip_tools.replay.no_estimate import count_since_start
from trackslip_tools.report.quantities import found_soil
from trackslip_tools.terminal_text import NO_VALUE, number_text, table, wrap_line


def _rmse(summary: Mapping[str, Any]) -> str:
    error = summary["rmse"]["filter"] if summary else None
    return NO_VALUE if error is None else f"{100.0 * error:.1f}"


def _nees(summary: Mapping[str, Any]) -> str:
    """NEES over its degrees of freedom (1 if consistent), of the pose or, without headings, the position."""
    if summary.get("nees") is not None:
        return f"{summary['nees'] / 3.0:.2f}"
    return NO_VALUE if summary.get("nees_position") is None else f"{summary['nees_position'] / 2.0:.2f}"


def _rejected_count(summary: Mapping[str, Any]) -> str:
    """Number of measurements rejected since the start."""
    if not summary:
        return NO_VALUE
    return str(sum(map(count_since_start, summary["rejected"].values())))


def _soil(summary: Mapping[str, Any]) -> str:
    """The likeliest class, marked if it is uncertain."""
    soil = summary.get("soil") or {}
    classes = soil.get("classes")
    if not classes:
        return NO_VALUE
    name = max(classes, key=classes.__getitem__)
    text = f"{name.replace('_', ' ')} {100.0 * classes[name]:.0f} %"
    return text if found_soil(classes, is_identifiable=soil["identifiable"]) else f"undetermined ({text})"


_EXIT_TEXTS = {ExitCode.DONE: "0 done", ExitCode.FAILED: "1 failed", ExitCode.BAD_INPUT: "2 bad input"}
COLUMNS: Mapping[str, Callable[[Entry], str]] = {
    "s": lambda entry: number_text(entry.summary.get("duration_s"), ".0f"),
    "m": lambda entry: number_text(entry.distance, ".1f"),
    "RMSE cm": lambda entry: _rmse(entry.summary),
    "NEES/dof": lambda entry: _nees(entry.summary),
    "rejected": lambda entry: _rejected_count(entry.summary),
    "soil": lambda entry: _soil(entry.summary),
    "exit": lambda entry: _EXIT_TEXTS[ExitCode(entry.exit_code)],
}
_TEXT_COLUMNS = {"soil", "exit"}


def text(entries: Sequence[Entry]) -> str:
    """The table, and below it the errors of bags, and the vehicles."""
    heading = ("bag", *COLUMNS)
    rows = [(name, *(show(entry) for show in COLUMNS.values())) for name, entry in named_entries(entries)]
    right = [False, *(name not in _TEXT_COLUMNS for name in COLUMNS)]
    lines = [table(heading, rows, right)]
    lines += [wrap_line(f"{name}: {entry.error}") for name, entry in named_entries(entries) if entry.error]
    vehicles = Counter(entry.vehicle for entry in entries if entry.vehicle)
    counts = ", ".join(f"{name} ({count})" for name, count in sorted(vehicles.items()))
    return "\n".join([*lines, *([wrap_line(f"vehicles: {counts}")] if vehicles else [])])


def notes(entries: Sequence[Entry]) -> Iterator[str]:
    """Notes on the bags, one line each."""
    for name, entry in named_entries(entries):
        for note in entry.notes:
            yield f"{name}: {note}"


def named_entries(entries: Sequence[Entry]) -> Iterator[tuple[str, Entry]]:
    """Short name and entry of each bag."""
    yield from zip(short_names([Path(entry.bag) for entry in entries]), entries, strict=True)
