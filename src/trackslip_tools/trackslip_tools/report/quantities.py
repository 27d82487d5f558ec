# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Panels of reports and of the live page: titles, units, values and bands from columns.

The same description serves both: columns of a whole run give the curves of a report, those of one moment a
point on the live page. This module imports nothing that reads bags or estimates.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray, Rows
from trackslip_common.topics import FORCES, SOIL, TRUE_ODOMETRY, TRUE_SLIP, TRUE_SOIL
from trackslip_estimation.soil.classes import NONE
from trackslip_tools.report.panel import BLUE, ORANGE, Form, sigma_band

Columns = Mapping[str, Any]  # name → (…) or (…, k) or (…, k, k), of one or many moments
Band = tuple[FloatArray, FloatArray]  # (…) each, lower and upper

_FOUND = 0.6  # probability from which a class of soil counts as found
DEGREES = 180.0 / np.pi
PERCENT = 100.0


class Gauge(NamedTuple):
    """A bar of the live page that shows the newest value."""

    group: str
    label: str
    low: float | None = None  # lower end of its range; None: that of the panel
    high: float | None = None


class Quantity(NamedTuple):
    """A panel of one column of the estimates, and of the matching column of the truth."""

    title: str
    axis: str
    estimate: str  # field of ``ESTIMATE``, (…, k)
    covariance: str  # (…, k, k)
    column: int
    truth: str  # topic
    true_column: str
    scale: float = 1.0
    gauge: Gauge | None = None

    def values_with_band(self, columns: Columns | Rows, scale: float) -> tuple[FloatArray, Band]:
        """Values (…) and ±2σ."""
        values = scale * np.asarray(columns[self.estimate])[..., self.column]
        variances = np.asarray(columns[self.covariance])[..., self.column, self.column]
        return values, sigma_band(values, scale * np.sqrt(variances))


_SLIPS, _TWIST = ("slips", "slip_covariance"), ("twist", "twist_covariance")


def _slip(side: str, column: int) -> Quantity:
    gauge = Gauge("Slip", side, -0.2 * PERCENT, PERCENT)
    title, true_column = f"Slip of the {side} track", f"{side}_slip"
    return Quantity(title, "slip, %", *_SLIPS, column, TRUE_SLIP, true_column, PERCENT, gauge)


QUANTITIES = (
    *map(_slip, ("left", "right"), range(2)),
    Quantity("Slip angle", "angle, °", *_SLIPS, 2, TRUE_SLIP, "slip_angle", DEGREES),
    Quantity("Speed", "v_x, m/s", *_TWIST, 0, TRUE_ODOMETRY, "v_x"),
    Quantity("Yaw rate", "rate, °/s", *_TWIST, 2, TRUE_ODOMETRY, "yaw_rate", DEGREES),
)


def classes_of(message: Any) -> dict[str, float]:
    """Soil → probability, of a SoilEstimate; empty if names and probabilities differ in number."""
    names, chances = list(message.class_names), [float(p) for p in message.class_probabilities]
    return dict(zip(names, chances, strict=True)) if len(names) == len(chances) else {}


def found_soil(classes: Mapping[str, float], *, is_identifiable: bool) -> str:
    """The likeliest class, if soil is identifiable and the class known and probable enough; else empty."""
    name = max(classes, key=classes.__getitem__, default=NONE)
    return name if is_identifiable and name != NONE and classes[name] >= _FOUND else ""


class FieldCurve(NamedTuple):
    """A message field shown as a curve."""

    field: str
    label: str
    colour: str = BLUE  # in a report of one run
    form: Form = Form.LINE  # style where the colour identifies the run
    interval: bool = False  # bounds are the fields _lower, _upper; otherwise the variance field, if any
    gauge: Gauge | None = None

    def values_with_band(self, columns: Columns, scale: float) -> tuple[FloatArray, Band | None]:
        """Values (…), and their interval if the message has one."""
        values = scale * np.asarray(columns[self.field])
        if self.interval:
            lower, upper = (scale * np.asarray(columns[f"{self.field}_{end}"]) for end in ("lower", "upper"))
            return values, (lower, upper)
        variance = columns.get(f"{self.field}_variance")
        return values, None if variance is None else sigma_band(values, scale * np.sqrt(variance))


class FieldPanel(NamedTuple):
    """A panel of fields of one topic."""

    title: str
    axis: str
    topic: str
    fields: tuple[FieldCurve, ...]
    truth: str = ""  # topic
    scale: float = 1.0


def _force_curves(side: str) -> tuple[FieldCurve, ...]:
    return (
        FieldCurve(f"{side}_thrust", "thrust", gauge=Gauge("Thrust", side)),
        FieldCurve(f"{side}_resistance", "resistance", ORANGE, Form.DASHED),
    )


_RESERVES = tuple(
    FieldCurve(f"{side}_thrust_reserve", side, colour, form, gauge=Gauge("Reserve", side, 0.0, PERCENT))
    for side, colour, form in (("left", BLUE, Form.LINE), ("right", ORANGE, Form.DASHED))
)
_RESERVE_TITLE = "Thrust reserve: 100 % unloaded, 0 at the limit of the soil"
_RESISTANCES = (FieldCurve("mu_r", "μ_r rolling"), FieldCurve("mu_l", "μ_l lateral", ORANGE, Form.DASHED))
_SHEAR = (FieldCurve("shear_modulus", "K", interval=True, gauge=Gauge("Soil", "K")),)
_EFFORT = (FieldCurve("max_tractive_effort", "F_max", interval=True, gauge=Gauge("Soil", "F_max")),)
FIELD_PANELS = (
    FieldPanel("Forces on the left track", "force, kN", FORCES, _force_curves("left"), scale=1e-3),
    FieldPanel("Forces on the right track", "force, kN", FORCES, _force_curves("right"), scale=1e-3),
    FieldPanel(_RESERVE_TITLE, "reserve, %", FORCES, _RESERVES, scale=PERCENT),
    FieldPanel("Resistance coefficients, ±2σ", "μ", SOIL, _RESISTANCES, TRUE_SOIL),
    FieldPanel("Shear deformation modulus, 5–95 %", "K, cm", SOIL, _SHEAR, TRUE_SOIL, 100.0),
    FieldPanel("Largest tractive effort of one track, 5–95 %", "F_max, kN", SOIL, _EFFORT, TRUE_SOIL, 1e-3),
)
