# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Plots of forces on the tracks, and of the soil with its intervals."""

from collections.abc import Iterator, Sequence

from trackslip_common.topics import SOIL
from trackslip_tools.report.panel import (
    COLOURS,
    INK,
    Curve,
    Form,
    Panel,
    curve_colour,
    curve_label,
    plot_title,
)
from trackslip_tools.report.quantities import FIELD_PANELS, PERCENT, FieldCurve, FieldPanel
from trackslip_tools.report.recording import Numbers
from trackslip_tools.report.run import Run, first_runs_of_bags


def ground_panels(runs: Sequence[Run]) -> list[Panel]:
    """The panels for which there are numbers."""
    panels = []
    for panel in FIELD_PANELS:
        curves = [*_curves(runs, panel)]
        if curves:
            panels.append(
                Panel(panel.title, panel.axis, [*_true_curves(runs, panel), *curves], limits=(0.0,))
            )
    return [*panels, *_class_panels(runs)]


def _curves(runs: Sequence[Run], panel: FieldPanel) -> Iterator[Curve]:
    for run in (run for run in runs if panel.topic in run.numbers):
        for field in panel.fields:
            label = curve_label(runs, run, field.label)
            colour = curve_colour(runs, run, field.colour)
            form = field.form if len(runs) > 1 else Form.LINE
            yield _curve(run.numbers[panel.topic], field, panel.scale, label, colour, form)


def _curve(numbers: Numbers, field: FieldCurve, scale: float, label: str, colour: str, form: Form) -> Curve:
    values, band = field.values_with_band(
        {name: numbers.rows[name] for name in numbers.rows.dtype.names or ()}, scale
    )
    return Curve(label, colour, numbers.times, values, form, band)


def _true_curves(runs: Sequence[Run], panel: FieldPanel) -> Iterator[Curve]:
    """The true curve of each bag."""
    bags = [run for run in first_runs_of_bags(runs) if panel.truth in run.numbers]
    for run in bags:
        numbers = run.numbers[panel.truth]
        colour = INK if len(bags) == 1 else curve_colour(runs, run, INK)
        for field in panel.fields:
            label = curve_label(bags, run, f"true {field.label}")
            yield Curve(label, colour, numbers.times, panel.scale * numbers.rows[field.field], Form.DOTTED)


def _class_panels(runs: Sequence[Run]) -> list[Panel]:
    """Probabilities of the soil classes, of the most likely ones at the end."""
    panels = []
    for run in (run for run in runs if SOIL in run.numbers):
        numbers = run.numbers[SOIL]
        at_end = numbers.classes_at(-1)
        likely = sorted(at_end, key=lambda name: -at_end[name])
        curves = [
            Curve(name, colour, numbers.times, PERCENT * numbers.classes[name])
            for name, colour in zip(likely, COLOURS, strict=False)
        ]
        if not curves:
            continue
        panels.append(Panel(plot_title(runs, run, "Class of soil"), "probability, %", curves, from_zero=True))
    return panels
