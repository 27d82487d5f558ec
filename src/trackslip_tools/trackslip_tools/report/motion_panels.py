# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Plots of the motion: errors against the reference, slips, slip angle, speeds."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.orientations import is_heading_known
from trackslip_common.topics import TRUE_ODOMETRY, TRUE_SLIP
from trackslip_tools.replay import scoring
from trackslip_tools.replay.scoring import is_covered_by, moving_slips
from trackslip_tools.replay.series import Series
from trackslip_tools.report.panel import (
    INK,
    SIGMAS,
    Curve,
    DrawnStates,
    Form,
    Panel,
    curve_colour,
    curve_label,
    drawn_states,
    sigma_band,
)
from trackslip_tools.report.quantities import DEGREES, QUANTITIES, Quantity
from trackslip_tools.report.run import Run, States, first_runs_of_bags


def error_panels(runs: Sequence[Run]) -> list[Panel]:
    """Errors of position and heading against the reference, with their 2σ in the estimate."""
    distance, heading = [], []
    for run, drawn in _drawn_states(runs):
        errors = errors_of(run, drawn.states)
        if errors is None:
            continue
        label, colour = curve_label(runs, run, drawn.name), curve_colour(runs, run, drawn.colour)
        variances = np.diagonal(errors.covariances, axis1=1, axis2=2)
        distances = 100.0 * np.hypot(errors.values[:, 0], errors.values[:, 1])
        bounds = 100.0 * SIGMAS * np.sqrt(variances[:, 0] + variances[:, 1])
        band = (np.zeros_like(distances), bounds)
        distance.append(Curve(label, colour, errors.times, distances, drawn.form, band))
        heading_errors = DEGREES * errors.values[:, 2]
        if not np.isfinite(heading_errors).any():  # a reference without headings
            continue
        known_variances = np.where(is_heading_known(variances[:, 2]), variances[:, 2], np.nan)
        band = sigma_band(np.zeros_like(heading_errors), DEGREES * np.sqrt(known_variances))
        heading.append(Curve(label, colour, errors.times, heading_errors, drawn.form, band))
    if not distance:
        return []
    panels = [Panel("Position: distance from the reference", "error, cm", distance, from_zero=True)]
    if heading:
        panels.append(Panel("Heading: difference from the reference", "error, °", heading, limits=(0.0,)))
    return panels


def motion_panels(runs: Sequence[Run]) -> list[Panel]:
    """Slips, slip angle, speed and yaw rate, each with ±2σ, and the truth if the bag has it."""
    panels = []
    for quantity in QUANTITIES:
        curves = [*_true_curves(runs, quantity), *_estimated_curves(runs, quantity)]
        if curves:
            panels.append(Panel(quantity.title, quantity.axis, curves, limits=(0.0,)))
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


def true_slips(run: Run) -> Series | None:
    """True slips while the machine moves and the track turns: slip is undefined otherwise."""
    slips, odometry = (run.replay.series.get(topic) for topic in (TRUE_SLIP, TRUE_ODOMETRY))
    if slips is None or odometry is None:
        return None
    return moving_slips(odometry, slips, run.parameters.vehicle.kinematics.tread)


def _true_curves(runs: Sequence[Run], quantity: Quantity) -> Iterator[Curve]:
    """One true curve for each bag that has it."""
    bags = first_runs_of_bags(runs)
    for run in bags:
        series = run.replay.series.get(quantity.truth)
        if series is not None:
            label = "truth" if len(bags) == 1 else f"truth, {run.label}"
            colour = INK if len(bags) == 1 else curve_colour(runs, run, INK)
            form = Form.LINE if len(bags) == 1 else Form.DOTTED
            values = quantity.scale * series[quantity.true_column]
            moving = true_slips(run) if quantity.truth == TRUE_SLIP else None
            if moving is not None:  # slips are undefined elsewhere
                moving_values = quantity.scale * moving[quantity.true_column]
                values = np.full(len(series), np.nan)
                values[np.searchsorted(series.stamps_ns, moving.stamps_ns)] = moving_values
            yield Curve(label, colour, run.recording.seconds(series.stamps_ns), values, form)


def _estimated_curves(runs: Sequence[Run], quantity: Quantity) -> Iterator[Curve]:
    for run, drawn in _drawn_states(runs):
        states = drawn.states
        values, (lower, upper) = quantity.values_with_band(states.rows, quantity.scale)
        if quantity.estimate == "slips":
            values, lower, upper = (
                np.where(states.is_moving, column, np.nan) for column in (values, lower, upper)
            )
        label, colour = curve_label(runs, run, drawn.name), curve_colour(runs, run, drawn.colour)
        times = run.recording.seconds(states.path.stamps_ns)
        yield Curve(label, colour, times, values, drawn.form, (lower, upper))


def _drawn_states(runs: Sequence[Run]) -> Iterator[tuple[Run, DrawnStates]]:
    return ((run, drawn) for run in runs for drawn in drawn_states(run))
