# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Which part of a bag was compared with the live estimates, and why not the rest: a line, and JSON."""

from typing import Any

from trackslip_tools.replay.comparison import LiveComparison

_MOST_NAMED = 3  # parts in a line


def compared_parts(live: LiveComparison, start_ns: int) -> dict[str, Any]:
    """For JSON: seconds from the bag's first message at ``start_ns``, as ``--start`` counts them."""

    def seconds(log_time_ns: int) -> float:
        return (log_time_ns - start_ns) * 1e-9

    found = live.comparability
    return {
        "estimates": live.compared,
        "parts": [{"start": seconds(p.begin_log_ns), "stop": seconds(p.end_log_ns)} for p in found.parts],
        "breaks": [{"time": seconds(one.log_time_ns), "reason": one.why} for one in found.breaks],
    }


def compared_lines(live: LiveComparison, start_ns: int) -> list[str]:
    """For a terminal: a line where not all was compared that follows the estimator's start."""
    found = live.comparability
    if not found.breaks or not found.parts:
        return []
    parts = [
        f"from {(p.begin_log_ns - start_ns) * 1e-9:.2f} to {(p.end_log_ns - start_ns) * 1e-9:.2f} s"
        for p in found.parts[:_MOST_NAMED]
    ]
    more = len(found.parts) - len(parts)
    parts += [f"and {more} more parts"] if more else []
    first = found.breaks[0]
    others = len(found.breaks) - 1
    further = f" ({others} more such places)" if others else ""
    at_s = (first.log_time_ns - start_ns) * 1e-9
    return [f"  compared {', '.join(parts)}; not from {at_s:.2f} s, where {first.why}{further}"]
