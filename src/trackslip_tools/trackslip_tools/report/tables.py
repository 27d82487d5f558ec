# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of a report, as rows of text."""

import math
from collections.abc import Sequence
from datetime import datetime, timezone

from trackslip_common.parameters import Parameters, flat_fields, to_flat
from trackslip_estimation.slip.learned_text import NOT_OBSERVED, LearnedQuantity, decimals
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_tools.report.events import MAX_EVENTS, Event
from trackslip_tools.report.panel import SIGMAS
from trackslip_tools.report.run import Run
from trackslip_tools.terminal_text import NO_VALUE, number_text

Row = tuple[str, ...]


def event_rows(events: Sequence[Event]) -> list[Row]:
    """Level in lower case, time in s, text; only the first of very many events."""
    return [
        (event.level.name.lower(), f"{1e-3 * event.time_ms:.1f} s", event.text)
        for event in events[:MAX_EVENTS]
    ]


def topic_rows(run: Run) -> list[Row]:
    """Topic, messages, usual rate, mean rate, lost, gaps, longest silence."""
    rows: list[Row] = []
    for name, timing in run.recording.timings.items():
        usual = 1.0 / timing.period if timing.period else math.nan
        rates = (number_text(value, ".2f") for value in (usual, timing.rate, 100.0 * timing.lost_share))
        gaps = (str(len(timing.gaps)), number_text(timing.longest_interval, ".3f"))
        rows.append((name, str(len(timing.times)), *rates, *gaps))
    return rows


def rejection_rows(run: Run) -> list[Row]:
    """Source, reason, count, share of the source's messages, of the rejected measurements."""
    messages = run.replay.messages
    return [
        (source, reason, str(count), number_text(100.0 * count / max(messages.get(source, count), 1), ".2f"))
        for source, reasons in run.replay.rejected_by_source.items()
        for reason, count in reasons.items()
    ]


def learned_rows(run: Run) -> list[Row]:
    """Quantity, value, interval of ±2σ, unit, description; only the description of unobserved quantities."""
    return [_learned_row(finding) for finding in run.replay.findings]


def _learned_row(finding: LearnedQuantity) -> Row:
    form = finding.form
    if not finding.observed:
        return (form.label, NO_VALUE, NO_VALUE, form.unit, NOT_OBSERVED)
    value, stddev = form.displayed_value(finding.value), form.scale * finding.stddev
    digits = decimals(stddev)
    low, high = max(value - SIGMAS * stddev, form.least), value + SIGMAS * stddev
    interval = f"{low:.{digits}f} … {high:.{digits}f}"
    return (form.label, f"{value:.{digits}f}", interval, form.unit, finding.sentence)


def parameter_rows(runs: Sequence[Run]) -> list[Row]:
    """Name, description with unit, default, value in each run."""
    rows = _rows(load_slip_parameters(), [run.parameters for run in runs], "slip_estimator")
    soils = [run.replay.soil.parameters for run in runs if run.replay.soil is not None]
    if len(soils) == len(runs):
        rows += _rows(load_soil_parameters(), soils, "soil_estimator")
    return rows


def _rows(defaults: Parameters, of_runs: Sequence[Parameters], node: str) -> list[Row]:
    columns = [to_flat(parameters) for parameters in (defaults, *of_runs)]
    rows = []
    fields = {name: spec for p in (defaults, *of_runs) for name, _, spec in flat_fields(p)}
    for name, spec in fields.items():
        meaning = f"{spec.description}, {spec.unit}" if spec.unit else spec.description
        rows.append((f"{node}.{name}", meaning, *(_value(column.get(name, NO_VALUE)) for column in columns)))
    return rows


def differing_rows(rows: Sequence[Row]) -> list[Row]:
    """Rows of parameters whose values differ, the default included."""
    return [row for row in rows if len(set(row[2:])) > 1]


def run_facts(run: Run, colour: str) -> dict[str, str]:
    """Facts of a run for the head of the page."""
    recording, p = run.recording, run.parameters
    since_start_s = (recording.zero_ns - recording.stamp_origin_ns) * 1e-9
    begin, end = recording.start_s + since_start_s, recording.stop_s + since_start_s
    start = datetime.fromtimestamp(recording.start_ns * 1e-9, tz=timezone.utc)
    return {
        "label": run.label,
        "colour": colour,
        "bag": recording.path,
        "date": f"{start:%Y-%m-%d %H:%M:%S} UTC",
        "part": f"{begin:g} to {end:.1f} s",
        "duration": f"{recording.stop_s - recording.start_s:.1f} s",
        "vehicle": p.vehicle.name,
        "filter": f"{p.filter}, model {p.model}",
        "speed": f"{run.replay.duration_s / run.replay.elapsed_s:.0f} × real time",
    }


def _value(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return ", ".join(map(_value, value)) if isinstance(value, list) else str(value)
