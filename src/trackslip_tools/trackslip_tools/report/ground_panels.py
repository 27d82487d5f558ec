# SPDX-License-Identifier: Apache-2.0
"""Plots of the ground: forces on the tracks, and the soil with its intervals, as the bag has them."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_tools.report.numbers import Numbers
from trackslip_tools.report.panel import (
    BLUE,
    COLOURS,
    INK,
    ORANGE,
    Curve,
    Form,
    Panel,
    colour_in,
    within,
)
from trackslip_tools.report.recording import FORCES, SOIL, TRUE_SOIL
from trackslip_tools.report.run import Run, recordings

FloatArray = NDArray[np.float64]


class _Shown(NamedTuple):
    """A field of a message as a curve."""

    field: str
    label: str
    colour: str = BLUE  # in a report of one run
    form: Form = Form.LINE  # where the colour stands for the run
    interval: bool = False  # bounds are fields of their own: _lower, _upper; else a variance


class _Shape(NamedTuple):
    """A panel made of fields of one topic."""

    title: str
    axis: str
    topic: str
    fields: tuple[_Shown, ...]
    truth: str = ""  # topic
    scale: float = 1.0


def _sided(side: str) -> tuple[_Shown, ...]:
    return (
        _Shown(f"{side}_thrust", "thrust"),
        _Shown(f"{side}_resistance", "resistance", ORANGE, Form.DASHED),
    )


_RESERVES = (
    _Shown("left_thrust_reserve", "left"),
    _Shown("right_thrust_reserve", "right", ORANGE, Form.DASHED),
)
_RESISTANCES = (_Shown("mu_r", "μ_r rolling"), _Shown("mu_l", "μ_l lateral", ORANGE, Form.DASHED))
_SHEAR = (_Shown("shear_modulus", "K", interval=True),)
_EFFORT = (_Shown("max_tractive_effort", "F_max", interval=True),)
_SHAPES = (
    _Shape("Forces on the left track", "force, kN", FORCES, _sided("left"), scale=1e-3),
    _Shape("Forces on the right track", "force, kN", FORCES, _sided("right"), scale=1e-3),
    _Shape("Thrust reserve: 1 unloaded, 0 at the limit of the soil", "reserve, 1", FORCES, _RESERVES),
    _Shape("Resistance coefficients, ±2σ", "μ, 1", SOIL, _RESISTANCES, TRUE_SOIL),
    _Shape("Shear deformation modulus, 5–95 %", "K, cm", SOIL, _SHEAR, TRUE_SOIL, 100.0),
    _Shape("Largest tractive effort of one track, 5–95 %", "F_max, kN", SOIL, _EFFORT, TRUE_SOIL, 1e-3),
)


def ground_panels(runs: Sequence[Run]) -> list[Panel]:
    """Those for which there are numbers."""
    panels = []
    for shape in _SHAPES:
        curves = [*_curves(runs, shape)]
        if curves:
            panels.append(Panel(shape.title, shape.axis, [*_truths(runs, shape), *curves], limits=(0.0,)))
    return [*panels, *_class_panels(runs)]


def _curves(runs: Sequence[Run], shape: _Shape) -> Iterator[Curve]:
    for run in (run for run in runs if shape.topic in run.numbers):
        for shown in shape.fields:
            label = shown.label if len(runs) == 1 else f"{run.label}, {shown.label}"
            colour = colour_in(runs, run, shown.colour)
            form = shown.form if len(runs) > 1 else Form.LINE
            yield _curve(run.numbers[shape.topic], shown, shape.scale, label, colour, form)


def _curve(numbers: Numbers, shown: _Shown, scale: float, label: str, colour: str, form: Form) -> Curve:
    values = scale * numbers.rows[shown.field]
    band = None
    if shown.interval:
        lower, upper = (scale * numbers.rows[f"{shown.field}_{end}"] for end in ("lower", "upper"))
        band = (lower, upper)
    elif f"{shown.field}_variance" in (numbers.rows.dtype.names or ()):
        band = within(values, scale * np.sqrt(numbers.rows[f"{shown.field}_variance"]))
    return Curve(label, colour, numbers.times, values, form, band)


def _truths(runs: Sequence[Run], shape: _Shape) -> Iterator[Curve]:
    """One of each bag."""
    bags = [run for run in recordings(runs) if shape.truth in run.numbers]
    for run in bags:
        numbers = run.numbers[shape.truth]
        colour = INK if len(bags) == 1 else colour_in(runs, run, INK)
        for shown in shape.fields:
            label = f"true {shown.label}" if len(bags) == 1 else f"{run.label}, true {shown.label}"
            yield Curve(label, colour, numbers.times, shape.scale * numbers.rows[shown.field], Form.DOTTED)


def _class_panels(runs: Sequence[Run]) -> list[Panel]:
    """Probabilities of the soils compared with: the most likely ones at the end."""
    panels = []
    for run in (run for run in runs if SOIL in run.numbers):
        numbers = run.numbers[SOIL]
        at_end = {name: p[-1] for name, p in numbers.classes.items() if np.isfinite(p[-1])}
        likely = sorted(at_end, key=lambda name: -at_end[name])
        curves = [
            Curve(name, colour, numbers.times, numbers.classes[name])
            for name, colour in zip(likely, COLOURS, strict=False)
        ]
        if not curves:
            continue
        title = "Class of soil" if len(runs) == 1 else f"Class of soil, {run.label}"
        panels.append(Panel(title, "probability, 1", curves, from_zero=True))
    return panels
