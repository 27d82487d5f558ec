# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Describe learned values in words and numbers, for /diagnostics, reports, replays and the state file.

A state counts as not observed if it is still close to its prior: standard deviation above 0.9 of the prior's,
and mean within 3 of the prior's standard deviations. So does noise whose weights differ by at most 0.1.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.adaptation import unknown_fix_factor
from trackslip_estimation.slip.learned import Learned, LearnedContext, weights_of

NOT_OBSERVED = "not observed yet"
_OBSERVED_STDDEV, _OBSERVED_MEAN, _OBSERVED_WEIGHTS = 0.9, 3.0, 0.1
_DEGREES = 180.0 / math.pi


class DisplayForm(NamedTuple):
    """Display of a quantity: (value − zero) · scale, in ``unit``."""

    label: str
    text: str  # {v}: displayed value, {a}: its size, {direction}: its direction, {s}: ±, {of}: its source
    unit: str = "1"
    scale: float = 1.0
    zero: float = 0.0
    directions: tuple[str, str] = ("", "")  # above zero, below
    least: float = -math.inf  # lower bound of the displayed value

    def displayed_value(self, value: float) -> float:
        """Displayed value, in ``unit``."""
        return (value - self.zero) * self.scale


_FORMS = {
    "gyro_scale": DisplayForm(
        "gyro scale", "gyro reads {a} % {direction} ± {s}", "%", 100.0, 1.0, ("high", "low")
    ),
    "gyro_bias": DisplayForm("gyro bias", "gyro shows {v} °/s at rest ± {s}", "°/s", _DEGREES),
    "gyro_noise_factor": DisplayForm("gyro noise", "gyro variance {v} times what it states ± {s}", least=0.0),
    "asymmetry": DisplayForm(
        "side asymmetry ε", "turns {a} rad/m to the {direction} ± {s}", "rad/m", directions=("left", "right")
    ),
    "fix_delay": DisplayForm(
        "delay of {of}", "{of} fixes {a} s {direction} ± {s}", "s", directions=("late", "early")
    ),
    "fix_noise_factor": DisplayForm(
        "noise of {of}", "{of} variance {v} times what it states ± {s}", least=0.0
    ),
    "track_error": DisplayForm(
        "track error", "tracks err by {v} % of their speed ± {s}", "%", 100.0, least=0.0
    ),
    "efficiency": DisplayForm("turning efficiency κ", "turning efficiency κ {v} ± {s}"),
    "loss": DisplayForm("speed lost in turns η", "speed lost in turns η {v} ± {s}"),
    "common_slip": DisplayForm("common slip i₀", "both tracks slip {v} % ± {s}", "%", 100.0),
    "rotation_offset": DisplayForm(
        "centre of rotation x_I",
        "turns about {a} m {direction} its middle ± {s}",
        "m",
        directions=("ahead of", "behind"),
    ),
}


class LearnedQuantity(NamedTuple):
    """One quantity; value and standard deviation in SI units."""

    name: str  # with ``.`` and the source if it belongs to one
    value: float
    stddev: float
    observed: bool

    @property
    def form(self) -> DisplayForm:
        """Display form; a state without an entry in ``_FORMS`` is displayed by its name."""
        kind, _, source = self.name.partition(".")
        plain = kind.replace("_", " ")
        form = _FORMS.get(kind, DisplayForm(plain, f"{plain} {{v}} ± {{s}}"))
        return form._replace(label=form.label.format(of=source))

    @property
    def sentence(self) -> str:
        """Text with one standard deviation: "gyro reads 1.9 % low ± 0.5"."""
        if not self.observed:
            return NOT_OBSERVED
        form = self.form
        value, stddev = form.displayed_value(self.value), form.scale * self.stddev
        digits = decimals(stddev)
        return form.text.format(
            v=f"{round(value, digits) + 0.0:.{digits}f}",  # no −0
            a=f"{abs(value):.{digits}f}",
            of=self.name.partition(".")[2],
            direction=form.directions[int(value < 0.0)],
            s=f"{stddev:.{digits}f}",
        )


def decimals(stddev: float) -> int:
    """Number of decimals for one digit of a standard deviation, or for two if it begins with 1."""
    return min(max(-math.floor(math.log10(max(stddev, 1e-9) / 2.0)), 0), 9)


def learned_quantities(learned: Learned | None, context: LearnedContext) -> list[LearnedQuantity]:
    """All learned quantities of an estimator; the priors if nothing was learned."""
    values = context.prior if learned is None else learned
    quantities = [
        quantity for name in context.state_indices for quantity in _state_quantities(name, values, context)
    ]
    if context.has_track_error:
        quantities += _noise_quantities(values, context)
    order = {kind: k for k, kind in enumerate(_FORMS)}
    return sorted(quantities, key=lambda quantity: order.get(quantity.name.partition(".")[0], len(order)))


def quantity_lines(quantities: list[LearnedQuantity]) -> list[str]:
    """One line for each observed quantity, and one for all others."""
    lines = [quantity.sentence for quantity in quantities if quantity.observed]
    unobserved = [quantity.form.label for quantity in quantities if not quantity.observed]
    return lines + ([f"{NOT_OBSERVED}: {', '.join(unobserved)}"] if unobserved else [])


def _state_quantities(name: str, learned: Learned, context: LearnedContext) -> list[LearnedQuantity]:
    """Quantities of one state: of the delay one for each source, none if the parameters fix the state."""
    k = list(context.state_indices).index(name)
    value, stddev, prior_stddev = learned.mean[k], learned.stddev[k], context.prior.stddev[k]
    if prior_stddev == 0.0:
        return []
    difference = abs(value - context.prior.mean[k])
    observed = bool(stddev < _OBSERVED_STDDEV * prior_stddev or difference > _OBSERVED_MEAN * prior_stddev)
    if name == "fix_delay":
        return [
            LearnedQuantity(f"{name}.{source}", float(value * error), float(stddev * error), observed)
            for source, error in context.stamp_errors.items()
            if error > 0.0
        ]
    zero = _FORMS[name].zero if name in _FORMS else 0.0  # the state is the difference from it
    return [LearnedQuantity(name, float(value) + zero, float(stddev), observed)]


def _noise_quantities(learned: Learned, context: LearnedContext) -> list[LearnedQuantity]:
    """Quantities of the track error, and of the factors of the variances stated by gyro and fixes."""
    n, joint, prior = (
        context.constants,
        weights_of(learned.track_weights),
        weights_of(context.prior.track_weights),
    )
    masses, variances = (joint.sum(axis=1), prior.sum(axis=1)), n["track_variances"]
    squared = _point_mass_quantity("", variances, *masses)
    error = math.sqrt(squared.value)
    quantities = [
        LearnedQuantity("track_error", error, squared.stddev / (2.0 * error), squared.observed),
        _point_mass_quantity("gyro_noise_factor", n["rate_factors"], joint.sum(axis=0), prior.sum(axis=0)),
    ]
    unknown = unknown_fix_factor()
    for source in context.stamp_errors:
        name, log_weights = f"fix_noise_factor.{source}", learned.fix_weights.get(source)
        fix_masses = unknown if log_weights is None else weights_of(log_weights)
        quantity = _point_mass_quantity(name, n["fix_factors"], fix_masses, unknown)
        quantities.append(quantity if log_weights is not None else quantity._replace(value=1.0))  # as stated
    return quantities


def _point_mass_quantity(
    name: str, points: FloatArray, masses: FloatArray, prior: FloatArray
) -> LearnedQuantity:
    """Mean and standard deviation of point masses, each spread uniformly to the next point."""
    mean = float(masses @ points)
    between = mean * math.log(points[1] / points[0]) / math.sqrt(12.0)
    variance = float(masses @ np.square(points - mean)) + between**2
    return LearnedQuantity(name, mean, math.sqrt(variance), _have_weights_changed(masses, prior))


def _have_weights_changed(masses: FloatArray, prior: FloatArray) -> bool:
    """Whether the total variation between the weights exceeds ``_OBSERVED_WEIGHTS``."""
    return bool(np.abs(masses - prior).sum() / 2.0 > _OBSERVED_WEIGHTS)


def to_json(quantities: list[LearnedQuantity]) -> dict[str, dict[str, Any]]:
    """Convert to name → value, stddev, observed."""
    return {
        quantity.name: {"value": quantity.value, "stddev": quantity.stddev, "observed": quantity.observed}
        for quantity in quantities
    }
