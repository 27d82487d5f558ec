# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Plots over time: errors against the reference, motion, forces and soil, learned quantities."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.orientations import is_heading_known
from trackslip_common.topics import SOIL, TRUE_ODOMETRY, TRUE_SLIP
from trackslip_estimation.slip.learned_text import LearnedQuantity
from trackslip_tools.replay import scoring
from trackslip_tools.replay.scoring import is_covered_by, moving_slips
from trackslip_tools.replay.series import Series
from trackslip_tools.report.panel import (
    BLUE,
    COLOURS,
    INK,
    PURPLE,
    SIGMAS,
    Curve,
    Form,
    Panel,
    sigma_band,
)
from trackslip_tools.report.quantities import (
    DEGREES,
    FIELD_PANELS,
    PERCENT,
    QUANTITIES,
    FieldPanel,
    Quantity,
)
from trackslip_tools.report.run import Run, States, first_runs_of_bags
from trackslip_tools.report.run_styles import curve_colour, curve_label, curve_style, plot_title


def error_panels(runs: Sequence[Run]) -> list[Panel]:
    """Errors of position and heading against the reference, with their 2σ in the estimate."""
    distance, heading = [], []
    for drawn in _drawn_states(runs):
        errors = errors_of(drawn.run, drawn.states)
        if errors is None:
            continue
        variances = np.diagonal(errors.covariances, axis1=1, axis2=2)
        distances = 100.0 * np.hypot(errors.values[:, 0], errors.values[:, 1])
        bounds = 100.0 * SIGMAS * np.sqrt(variances[:, 0] + variances[:, 1])
        band = (np.zeros_like(distances), bounds)
        distance.append(Curve(*drawn.style, errors.times, distances, drawn.form, band))
        heading_errors = DEGREES * errors.values[:, 2]
        if not np.isfinite(heading_errors).any():  # a reference without headings
            continue
        known_variances = np.where(is_heading_known(variances[:, 2]), variances[:, 2], np.nan)
        band = sigma_band(np.zeros_like(heading_errors), DEGREES * np.sqrt(known_variances))
        heading.append(Curve(*drawn.style, errors.times, heading_errors, drawn.form, band))
    if not distance:
        return []
    panels = [Panel("Position: distance from the reference", "error, cm", distance, from_zero=True)]
    if heading:
        panels.append(Panel("Heading: difference from the reference", "error, °", heading, limits=(0.0,)))
    return panels


class Errors(NamedTuple):
    """Estimate less reference, at the samples of the reference that the estimate covers."""

    times: FloatArray  # (n,) s from the bag's first message
    values: FloatArray  # (n, 3) m, m, rad
    covariances: FloatArray  # (n, 3, 3) of the estimate that follows


def errors_of(run: Run, states: States) -> Errors | None:
    """Errors against the reference; None without a reference or an estimate of its time."""
    reference = run.replay.paths.get("reference")
    if reference is None:
        return None
    stamps_ns = reference.stamps_ns[is_covered_by(states.path, reference)]
    if not len(stamps_ns):
        return None
    following = np.searchsorted(states.path.stamps_ns, stamps_ns)
    covariances = states.rows["pose_covariance"][following]
    values = scoring.errors_of(states.path, reference)
    return Errors(run.recording.seconds(stamps_ns), values, covariances)


def motion_panels(runs: Sequence[Run]) -> list[Panel]:
    """Slips, slip angle, speed and yaw rate, each with ±2σ, and the truth if the bag has it."""
    panels = []
    for quantity in QUANTITIES:
        curves = [*_true_motion(runs, quantity), *_estimated_motion(runs, quantity)]
        if curves:
            panels.append(Panel(quantity.title, quantity.axis, curves, limits=(0.0,)))
    return panels


def _true_motion(runs: Sequence[Run], quantity: Quantity) -> Iterator[Curve]:
    """One true curve for each bag that has it."""
    bags = first_runs_of_bags(runs)
    for run in bags:
        series = run.replay.series.get(quantity.truth)
        if series is not None:
            label = "truth" if len(bags) == 1 else f"truth, {run.label}"
            colour = INK if len(bags) == 1 else curve_colour(runs, run, INK)
            form = Form.LINE if len(bags) == 1 else Form.DOTTED
            values = quantity.scale * series[quantity.true_column]
            moving = _true_slips(run) if quantity.truth == TRUE_SLIP else None
            if moving is not None:  # slips are undefined elsewhere
                moving_values = quantity.scale * moving[quantity.true_column]
                values = np.full(len(series), np.nan)
                values[np.searchsorted(series.stamps_ns, moving.stamps_ns)] = moving_values
            yield Curve(label, colour, run.recording.seconds(series.stamps_ns), values, form)


def _true_slips(run: Run) -> Series | None:
    """True slips while the machine moves and the track turns: slip is undefined otherwise."""
    slips, odometry = (run.replay.series.get(topic) for topic in (TRUE_SLIP, TRUE_ODOMETRY))
    if slips is None or odometry is None:
        return None
    return moving_slips(odometry, slips, run.parameters.vehicle.kinematics.tread)


def _estimated_motion(runs: Sequence[Run], quantity: Quantity) -> Iterator[Curve]:
    for drawn in _drawn_states(runs):
        states = drawn.states
        values, (lower, upper) = quantity.values_with_band(states.rows, quantity.scale)
        if quantity.estimate == "slips":
            values, lower, upper = (
                np.where(states.is_moving, column, np.nan) for column in (values, lower, upper)
            )
        times = drawn.run.recording.seconds(states.path.stamps_ns)
        yield Curve(*drawn.style, times, values, drawn.form, (lower, upper))


class _DrawnStates(NamedTuple):
    """States of a run to draw."""

    run: Run
    states: States
    style: tuple[str, str]  # label and colour
    form: Form


def _drawn_states(runs: Sequence[Run]) -> Iterator[_DrawnStates]:
    """The filters' states and, if computed, the smoothed ones."""
    for run in runs:
        if run.states is not None:
            yield _DrawnStates(run, run.states, curve_style(runs, run, "estimate", BLUE), Form.LINE)
        if run.smoothed_states is not None:
            style = curve_style(runs, run, "smoothed", PURPLE)
            yield _DrawnStates(run, run.smoothed_states, style, Form.DASHED)


def ground_panels(runs: Sequence[Run]) -> list[Panel]:
    """Forces on the tracks, and the soil with its intervals, as far as there are numbers."""
    panels = []
    for panel in FIELD_PANELS:
        curves = [*_estimated_fields(runs, panel)]
        if curves:
            curves = [*_true_fields(runs, panel), *curves]
            panels.append(Panel(panel.title, panel.axis, curves, limits=(0.0,)))
    return [*panels, *_class_panels(runs)]


def _estimated_fields(runs: Sequence[Run], panel: FieldPanel) -> Iterator[Curve]:
    for run in (run for run in runs if panel.topic in run.numbers):
        numbers = run.numbers[panel.topic]
        columns = {name: numbers.rows[name] for name in numbers.rows.dtype.names or ()}
        for field in panel.fields:
            values, band = field.values_with_band(columns, panel.scale)
            form = field.form if len(runs) > 1 else Form.LINE
            style = curve_style(runs, run, field.label, field.colour)
            yield Curve(*style, numbers.times, values, form, band)


def _true_fields(runs: Sequence[Run], panel: FieldPanel) -> Iterator[Curve]:
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
        if curves:
            title = plot_title(runs, run, "Class of soil")
            panels.append(Panel(title, "probability, %", curves, from_zero=True))
    return panels


def learned_panels(runs: Sequence[Run]) -> list[Panel]:
    """One panel for each learned quantity that some run has observed at its end."""
    observed: dict[str, LearnedQuantity] = {}
    for run in runs:
        observed |= {finding.name: finding for finding in run.replay.findings if finding.observed}
    panels = []
    for name, finding in observed.items():
        curves = [curve for run in runs if (curve := _learned_curve(runs, run, name)) is not None]
        label, axis = finding.form.label, f"{finding.form.label}, {finding.form.unit}"
        nominal = 1.0 if "factor" in finding.name else 0.0  # no deviation from the parameters
        panels.append(Panel(label, axis, curves, limits=(nominal,)))
    return panels


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
    low, high = sigma_band(values, sigmas)
    style = curve_style(runs, run, "estimate", BLUE)
    return Curve(*style, times, values, band=(np.maximum(low, form.least), high))
