# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Terminal output of the demo: a status line during the drive, a table at the end."""

import math
from collections.abc import Mapping

from rich.table import Table

from trackslip_sim.demo.results import Counts

_MARGIN = " " * 9  # width of the time


def status(
    elapsed: float,
    pose: tuple[float, float, float],
    slips: tuple[float, float, float],
    rates: Mapping[str, float],
) -> str:
    """The status, two lines: time, pose and slips of the tracks; slip angle and rates in Hz."""
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


def counts_table(counts: Mapping[str, Counts]) -> Table:
    """Table of the sensors' messages: emitted, received and recorded."""
    table = Table(title="Messages", title_justify="left")
    table.add_column("topic")
    for column in ("emitted", "received", "recorded", "received %"):
        table.add_column(column, justify="right")
    for topic, n in counts.items():
        table.add_row(topic, str(n.emitted), str(n.received), str(n.recorded), f"{100 * n.share:.2f}")
    return table
