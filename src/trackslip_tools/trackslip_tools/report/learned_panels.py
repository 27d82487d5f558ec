# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Learned quantities of the machine: a table of their final values, and plots over time."""

from collections.abc import Sequence

import numpy as np

from trackslip_estimation.slip.learned_text import NOT_OBSERVED, LearnedQuantity, decimals
from trackslip_tools.report.panel import BLUE, SIGMAS, Curve, Panel, curve_colour, curve_label, sigma_band
from trackslip_tools.report.run import Run

Row = tuple[str, ...]


def learned_rows(run: Run) -> list[Row]:
    """Quantity, value, interval of ±2σ, unit, description; only the description of unobserved quantities."""
    return [_row(finding) for finding in run.replay.findings]


def learned_panels(runs: Sequence[Run]) -> list[Panel]:
    """One panel for each quantity that some run has observed at its end."""
    observed: dict[str, LearnedQuantity] = {}
    for run in runs:
        observed |= {finding.name: finding for finding in run.replay.findings if finding.observed}
    panels = []
    for name, finding in observed.items():
        curves = [curve for run in runs if (curve := _learned_curve(runs, run, name)) is not None]
        label, axis = finding.form.label, f"{finding.form.label}, {finding.form.unit}"
        panels.append(Panel(label, axis, curves, limits=(_nominal_value(finding),)))
    return panels


def _row(finding: LearnedQuantity) -> Row:
    form = finding.form
    if not finding.observed:
        return (form.label, "–", "–", form.unit, NOT_OBSERVED)
    value, stddev = form.displayed_value(finding.value), form.scale * finding.stddev
    digits = decimals(stddev)
    low, high = max(value - SIGMAS * stddev, form.least), value + SIGMAS * stddev
    interval = f"{low:.{digits}f} … {high:.{digits}f}"
    return (form.label, f"{value:.{digits}f}", interval, form.unit, finding.sentence)


def _nominal_value(finding: LearnedQuantity) -> float:
    """The value that means no deviation from the parameters: 1 for factors, else 0."""
    return 1.0 if "factor" in finding.name else 0.0


def _learned_curve(runs: Sequence[Run], run: Run, name: str) -> Curve | None:
    """A quantity over time, as a curve."""
    course = [
        (learned.stamp_ns, finding)
        for learned in run.replay.learned
        for finding in learned.findings
        if finding.name == name
    ]
    if not course:
        return None
    form = course[0][1].form
    values = np.array([form.displayed_value(finding.value) for _, finding in course])
    sigmas = np.array([form.scale * finding.stddev for _, finding in course])
    times = run.recording.seconds(np.array([stamp_ns for stamp_ns, _ in course], np.int64))
    label, colour = curve_label(runs, run, "estimate"), curve_colour(runs, run, BLUE)
    low, high = sigma_band(values, sigmas)
    return Curve(label, colour, times, values, band=(np.maximum(low, form.least), high))
