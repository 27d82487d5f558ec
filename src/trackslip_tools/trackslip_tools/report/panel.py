# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What one plot over time shows, before anything is drawn: curves with their bands, in colours.

The colours are those of Okabe and Ito, which people with any kind of colour blindness distinguish.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import TYPE_CHECKING, NamedTuple

from trackslip_common.arrays import FloatArray

if TYPE_CHECKING:  # the live page uses these panels without a replay
    from trackslip_tools.report.run import Run, States


BLUE, ORANGE, GREEN, PURPLE, AMBER, SKY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"
COLOURS = (BLUE, ORANGE, GREEN, PURPLE, AMBER, SKY)  # of runs, or of alike curves of one run
MOST_RUNS = len(COLOURS)
PAPER, INK, GRID, GREY = "#ffffff", "#1f2933", "#d5dbe1", "#8a949e"  # INK: text, and what is true
DARK = {  # what page.js puts in the place of each on a dark page
    BLUE: "#4aa8e0",
    ORANGE: "#f58a45",
    GREEN: "#3cc79a",
    PURPLE: "#e3a9c9",
    AMBER: "#f2c14e",
    SKY: "#9ad7f7",
    PAPER: "#14191e",
    INK: "#e4e9ee",
    GRID: "#3a444e",
}
SIGMAS = 2.0  # half the width of all bands


class Form(Enum):
    """How a curve is drawn."""

    LINE = auto()
    DASHED = auto()
    DOTTED = auto()
    POINTS = auto()
    CROSSES = auto()


@dataclass(frozen=True, eq=False)
class Curve:
    """Values over time."""

    label: str
    colour: str
    times: FloatArray  # (n,) s from the bag's first message
    values: FloatArray  # (n,)
    form: Form = Form.LINE
    band: tuple[FloatArray, FloatArray] | None = None  # (n,) each, lower and upper


@dataclass(frozen=True, eq=False)
class Panel:
    """One plot over time."""

    title: str
    axis: str  # what its values are, with the unit
    curves: Sequence[Curve]
    limits: tuple[float, ...] = ()  # dashed lines across
    logarithmic: bool = False
    from_zero: bool = False  # the axis begins there


def within(values: FloatArray, sigmas: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The band about values; ``sigmas`` are standard deviations."""
    return values - SIGMAS * sigmas, values + SIGMAS * sigmas


class Shown(NamedTuple):
    """States to draw, and how where there is one run."""

    name: str
    states: "States"
    colour: str
    form: Form


def shown_of(run: "Run") -> Iterator[Shown]:
    """The estimate and, where it is known, the smoothed one."""
    if run.states is not None:
        yield Shown("estimate", run.states, BLUE, Form.LINE)
    if run.smoothed_states is not None:
        yield Shown("smoothed", run.smoothed_states, PURPLE, Form.DASHED)


def name_in(runs: Sequence["Run"], run: "Run", what: str) -> str:
    """A curve's label: what it is; whose it is where there are several runs."""
    if len(runs) == 1:
        return what
    return run.label if what == "estimate" else f"{run.label}, {what}"


def title_in(runs: Sequence["Run"], run: "Run", what: str) -> str:
    """A plot's title, likewise."""
    return what if len(runs) == 1 else f"{what}, {run.label}"


def colour_in(runs: Sequence["Run"], run: "Run", own: str) -> str:
    """The run's colour where there are several, else the curve's own."""
    return own if len(runs) == 1 else COLOURS[runs.index(run)]
