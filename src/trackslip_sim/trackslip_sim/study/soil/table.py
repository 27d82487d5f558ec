# SPDX-License-Identifier: Apache-2.0
"""The rows of the soil estimator's study as tables of Markdown, which are also what the terminal shows."""

import math
from collections.abc import Iterator, Sequence

from trackslip_sim.study.slip.table import aligned
from trackslip_sim.study.soil.results import AnyRow, ChangeRow, SoilRow
from trackslip_sim.study.soil.score import RECOGNISED

_SOIL_HEAD = (
    *("soil", "machine", "σ_xy m", "F_max %", "in", "K %", "in", "K high/low", "known", "P(class)"),
    *("μ_r %", "in", "M_r %", "in", "F driving %", "F braking %", "offset kPa"),
)
_CHANGE_HEAD = ("from", "to", "machine", "σ_xy m", "recognised", "after s", "P(wrong) before")
_DASH = "–"  # there was no such thing
_SOIL_LEGEND = (
    "Errors over the truth, the median of the runs and, in brackets, the worst: F_max, K and μ_r at the end "
    "of `{scenario}`, M_r in steady turns and F, the thrust, as RMS over that of the truth. in: runs whose "
    "interval from 5 to 95 % holds the truth, nine of ten if it is honest. known: runs in which K and F_max "
    "are identifiable. offset: what is left of a transducer's after standing."
)
_CHANGE_LEGEND = (
    "`{scenario}`: seconds from the border between two soils to a probability of more than {certain:.0%} for "
    "the right one, and the probability of all others as the border was crossed; medians and, in brackets, "
    "the worst."
)


def markdown(rows: Sequence[AnyRow]) -> str:
    """A table of each scenario, its columns aligned, and what it means."""
    return "\n".join(_table([row for row in rows if row.scenario == name]) for name in _scenarios(rows))


def _scenarios(rows: Sequence[AnyRow]) -> Iterator[str]:
    yield from dict.fromkeys(row.scenario for row in rows)


def _table(rows: Sequence[AnyRow]) -> str:
    """Of one scenario."""
    soils = [_soil_cells(row) for row in rows if isinstance(row, SoilRow)]
    changes = [_change_cells(row) for row in rows if isinstance(row, ChangeRow)]
    scenario = rows[0].scenario
    lines: list[str] = []
    if soils:
        lines += [*aligned(_SOIL_HEAD, soils, text_columns=2), "", _SOIL_LEGEND.format(scenario=scenario)]
    if changes:
        legend = _CHANGE_LEGEND.format(scenario=scenario, certain=RECOGNISED)
        lines += [*aligned(_CHANGE_HEAD, changes, text_columns=3), "", legend]
    return "\n".join(lines) + "\n"


def _soil_cells(row: SoilRow) -> tuple[str, ...]:
    def count(number: int) -> str:
        return f"{number}/{row.seeds}"

    return (
        *(row.soil.replace("_", " "), _machine(row), f"{row.sigma_xy:g}"),
        *(_spread(row.F_max_error, row.F_max_worst), count(row.F_max_inside)),
        *(_spread(row.K_error, row.K_worst), count(row.K_inside), f"{row.K_ratio:.2f}"),
        *(count(row.identifiable), f"{row.class_probability:.2f}"),
        *(_spread(row.mu_r_error, row.mu_r_worst), count(row.mu_r_inside)),
        *(
            _spread(row.M_r_error, row.M_r_worst),
            _DASH if math.isnan(row.M_r_error) else count(row.M_r_inside),
        ),
        _spread(row.driving_thrust_error, row.driving_thrust_worst),
        _spread(row.braking_thrust_error, row.braking_thrust_worst),
        _spread(row.offset_residue, row.offset_residue_worst, 1e-3),
    )


def _change_cells(row: ChangeRow) -> tuple[str, ...]:
    return (
        *(row.soil.replace("_", " "), row.into.replace("_", " "), _machine(row), f"{row.sigma_xy:g}"),
        f"{row.recognised}/{row.seeds}",
        _spread(row.recognised_after, row.recognised_after_worst, 1.0),
        f"{row.wrong_before:.2f} ({row.wrong_before_worst:.2f})",
    )


def _machine(row: AnyRow) -> str:
    return "drawn" if row.drawn else "nominal"


def _spread(median: float, worst: float, scale: float = 100.0) -> str:
    """Median and worst; – for what there was not."""
    if math.isnan(median):
        return _DASH
    return f"{scale * median:.1f} ({scale * worst:.1f})".replace("inf", "never")
