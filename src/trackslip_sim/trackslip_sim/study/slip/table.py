# SPDX-License-Identifier: Apache-2.0
"""The rows of a study as a table of Markdown, which is also what the terminal shows."""

from collections.abc import Iterable, Sequence

from trackslip_sim.study.slip.results import Interval, Row

_HEAD = (
    *("truth", "soil", "filter", "σ_xy m", "σ_ω rad/s"),
    *("position mm", "heading mrad", "slip %", "in turns %", "α mrad"),
    *("NEES pose", "NEES slips", "NIS pose", "NIS yaw rate"),
)
_TEXT_COLUMNS = 3
LEGEND = (
    "RMSE and, in brackets, the posterior Cramér–Rao bound. NEES and NIS: means over runs and scored time, "
    "with ↑ above and ↓ below the bounds {bounds} (95 % of χ² for the mean of {seeds} runs)."
)


def markdown(rows: Sequence[Row]) -> str:
    """The table, its columns aligned, and what it means."""
    return "\n".join((*aligned(_HEAD, map(_cells, rows), _TEXT_COLUMNS), "", _legend(rows[0]))) + "\n"


def aligned(head: Sequence[str], cells: Iterable[Sequence[str]], text_columns: int) -> list[str]:
    """The lines of a table; text stands left in its columns, which are the first ones, numbers right."""
    lines = [head, *cells]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    rule = ["-" * w if k < text_columns else "-" * (w - 1) + ":" for k, w in enumerate(widths)]
    first, *others = (
        [
            text.ljust(width) if k < text_columns else text.rjust(width)
            for k, (text, width) in enumerate(zip(line, widths, strict=True))
        ]
        for line in lines
    )
    return ["| " + " | ".join(line) + " |" for line in (first, rule, *others)]


def _cells(row: Row) -> tuple[str, ...]:
    return (
        *(row.truth, row.soil.replace("_", " "), row.filter, f"{row.sigma_xy:g}", f"{row.sigma_omega:g}"),
        f"{1e3 * row.position_rmse:.2f} ({1e3 * row.position_bound:.2f})",
        f"{1e3 * row.heading_rmse:.2f} ({1e3 * row.heading_bound:.2f})",
        f"{1e2 * row.slip_rmse:.2f} ({1e2 * row.slip_bound:.2f})",
        f"{1e2 * row.turning_slip_rmse:.2f} ({1e2 * row.turning_slip_bound:.2f})",
        f"{1e3 * row.alpha_rmse:.1f} ({1e3 * row.alpha_bound:.1f})",
        _against(row.nees_pose, row.nees_pose_bounds),
        _against(row.nees_slip, row.nees_slip_bounds),
        _against(row.nis_pose, row.nis_pose_bounds),
        _against(row.nis_yaw_rate, row.nis_yaw_rate_bounds),
    )


def _against(value: float, bounds: Interval) -> str:
    low, high = bounds
    return f"{value:.2f}" + (" ↑" if value > high else " ↓" if value < low else "")


def _legend(row: Row) -> str:
    intervals = {3: row.nees_pose_bounds, 2: row.nees_slip_bounds, 1: row.nis_yaw_rate_bounds}
    bounds = ", ".join(f"{low:.2f}–{high:.2f} for {dof}" for dof, (low, high) in intervals.items())
    return LEGEND.format(bounds=bounds + " numbers", seeds=row.seeds)
