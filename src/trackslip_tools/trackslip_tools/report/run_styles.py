# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Titles, labels and colours of curves in a report of one or several runs."""

from collections.abc import Sequence

from trackslip_tools.report.panel import COLOURS
from trackslip_tools.report.run import Run


def curve_label(runs: Sequence[Run], run: Run, what: str) -> str:
    """Label of a curve: its quantity, and its run if there are several."""
    if len(runs) == 1:
        return what
    return run.label if what == "estimate" else f"{run.label}, {what}"


def curve_style(runs: Sequence[Run], run: Run, what: str, own: str) -> tuple[str, str]:
    """Label and colour of a curve; ``own``: its colour in a report of one run."""
    return curve_label(runs, run, what), curve_colour(runs, run, own)


def plot_title(runs: Sequence[Run], run: Run, what: str) -> str:
    """Title of a plot: its quantity, and its run if there are several."""
    return what if len(runs) == 1 else f"{what}, {run.label}"


def curve_colour(runs: Sequence[Run], run: Run, own: str) -> str:
    """The run's colour if there are several runs, else the curve's own."""
    return own if len(runs) == 1 else COLOURS[runs.index(run)]
