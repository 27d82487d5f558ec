# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the demo says on the terminal: a status line while it drives, a table at the end."""

import math
from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from trackslip_sim.demo.results import DemoResult, SoilResult
from trackslip_tools.replay.scoring import Score

_MARGIN = " " * 9  # as wide as the time


def status(
    elapsed: float,
    pose: tuple[float, float, float],
    slips: tuple[float, float, float],
    rates: Mapping[str, float],
) -> str:
    """Two lines: time, pose and slips of the tracks; slip angle and rates in Hz."""
    hertz = f"Hz: {'  '.join(f'{topic} {rate:.0f}' for topic, rate in rates.items())}"
    if math.isnan(pose[0]):
        return f"{elapsed:5.1f} s  waiting for the first fix\n{_MARGIN}{hertz}"
    x, y, heading = pose
    left, right, angle = slips
    return (
        f"{elapsed:5.1f} s  x {x:+6.2f} m  y {y:+6.2f} m  heading {math.degrees(heading):+6.1f}°  "
        f"slip L {100 * left:+5.1f} % R {100 * right:+5.1f} %\n"
        f"{_MARGIN}α {math.degrees(angle):+5.1f}°  {hertz}"
    )


def report(console: Console, result: DemoResult) -> None:
    """Errors, counts, and whether replay gives live."""
    errors = Table(title="RMSE over the drive, live estimates against truth", title_justify="left")
    errors.add_column("")
    for column in ("position m", "heading rad", "slip"):
        errors.add_column(column, justify="right")
    rows = (
        ("encoders alone", result.dead_reckoning, result.dead_reckoning_slip_rmse),
        ("estimate (EKF)", result.filter, result.slip_rmse),
    )
    for name, found, slip in rows:
        errors.add_row(name, f"{found.position:.4f}", _heading(found), f"{slip:.4f}")
    console.print(errors)
    if result.of_bag is not None:
        heading = _heading(result.of_bag, " rad")
        console.print(
            f"trackslip replay scores the whole bag, {result.before_s:.1f} s of standing before the drive "
            f"included: position {result.of_bag.position:.4f} m, heading {heading}"
        )
    if result.soil is not None:
        console.print(_soil_table(result.soil))
    counts = Table(title="Messages", title_justify="left")
    counts.add_column("topic")
    for column in ("emitted", "received", "recorded", "received %"):
        counts.add_column(column, justify="right")
    for topic, n in result.topics.items():
        counts.add_row(topic, str(n.emitted), str(n.received), str(n.recorded), f"{100 * n.share:.2f}")
    console.print(counts)
    console.print(str(result.live))
    if result.soil is not None:
        console.print(str(result.soil.live))


def _heading(errors: Score, unit: str = "") -> str:
    return "unknown" if errors.heading is None else f"{errors.heading:.4f}{unit}"


def _soil_table(result: SoilResult) -> Table:
    """What was found of the soil, with the truth."""
    name, chance = result.likely
    title = f"Soil at the end: {name} ({100 * chance:.0f} %); thrust RMSE {result.thrust_rmse:.0f} N"
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for column in ("found", "5 %", "95 %", "true"):
        table.add_column(column, justify="right")
    for finding in result.findings:
        row = (finding.found, *finding.interval, finding.true)
        table.add_row(finding.name, *(f"{value:.4g}" for value in row))
    return table
