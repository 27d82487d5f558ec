# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Contents of one plot over time: curves with their bands and colours, independent of the drawing.

The colours are those of Okabe and Ito, which people with any kind of colour blindness distinguish.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto

from trackslip_common.arrays import FloatArray

BLUE, ORANGE, GREEN, PURPLE, AMBER, SKY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"
COLOURS = (BLUE, ORANGE, GREEN, PURPLE, AMBER, SKY)  # of runs, or of similar curves of one run
MOST_RUNS = len(COLOURS)
PAPER, INK, GRID, GREY = "#ffffff", "#1f2933", "#d5dbe1", "#8a949e"  # INK: text and true values
DARK = {  # colours with which page.js replaces these on a dark page
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
SIGMAS = 2.0  # half-width of all bands


class Form(Enum):
    """Style of a curve."""

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
    """Contents of one plot over time."""

    title: str
    axis: str  # quantity with its unit
    curves: Sequence[Curve]
    limits: tuple[float, ...] = ()  # dashed horizontal lines
    logarithmic: bool = False
    from_zero: bool = False  # whether the axis begins at zero


def sigma_band(values: FloatArray, sigmas: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The band about values, ± ``SIGMAS`` ``sigmas`` (standard deviations)."""
    return values - SIGMAS * sigmas, values + SIGMAS * sigmas
