# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Columns with placeholders of missing values."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_estimation.setup_check.equal_runs import equal_runs
from trackslip_estimation.setup_check.finding import Cause, odds_of
from trackslip_estimation.setup_check.grid import tracks_of_speeds
from trackslip_estimation.setup_check.log import ComplexArray, Log

_LEAST_READINGS = 10
_LEAST_MISSING, _LEAST_BEYOND = 5, 3  # jumps to one value, within the range of the others or far beyond it
_LEAST_DEVIATION = 3.0  # times the largest deviation of the others from their median
_LEAST_PLACES, _LEAST_HELD = 2, 3  # jumps to one exact place; fixes at it at the start or end
_LEAST_SHARE = 0.002  # of all readings
_LONGEST_RUN = 3  # readings of the same value in a row
_RETURN_SHARE = 0.3  # of a jump, largest difference of the readings before and after it
_QUANTA = 5.0  # times the smallest changes of readings
_JITTER_COUNTS = 2.5  # counts: one forward and one back in a row, and half of one by jitter of stamps
_LARGE_SHARE = 0.3  # of the size of large readings; smaller jumps may be motion or noise
_FIX_STEP = 30.0  # m from both neighbours; a place farther away is no fix of the machine


class _Jumps(NamedTuple):
    """Jumps to one value and immediately back."""

    value: float | complex
    where: BoolArray  # (n,) readings
    visits: int  # runs of such readings


def find_missing_value(values: FloatArray, count: float = 0.0) -> tuple[float, BoolArray] | None:
    """The value to which readings (n,) jump and from which they return at once, and where; None without one.

    ``count``: change of a reading by one encoder count; jumps are larger.
    """
    change = np.abs(np.diff(values))
    change = change[change > 0.0]
    if len(values) < _LEAST_READINGS or not len(change):
        return None
    step = float(np.percentile(change, 5))  # the quantum of a quantised signal
    level = float(np.percentile(np.abs(values[values != 0.0]), 95))
    jumps = _find_jumps(
        values, max(_QUANTA * step, _LARGE_SHARE * level, _JITTER_COUNTS * count), _RETURN_SHARE, _LONGEST_RUN
    )
    if jumps is None or jumps.where.sum() < _LEAST_SHARE * len(values):
        return None
    least = _LEAST_BEYOND if _is_beyond(values, jumps) else _LEAST_MISSING
    return (float(jumps.value.real), jumps.where) if jumps.visits >= least else None


def _is_beyond(values: FloatArray, jumps: _Jumps) -> bool:
    """Whether a value lies far outside the range of all others."""
    others = values[~jumps.where]
    usual = float(np.median(others))
    return abs(jumps.value - usual) > _LEAST_DEVIATION * float(np.abs(others - usual).max())


def _find_jumps(values: FloatArray | ComplexArray, least: float, back: float, longest: int) -> _Jumps | None:
    """The value to which most jumps of more than ``least`` go, in runs of at most ``longest`` readings.

    ``back``: share of a jump, by which the readings before and after it differ at most.
    """
    runs = equal_runs(values)
    heads, lengths = values[runs.first], runs.lengths
    if len(heads) < 3:
        return None
    before, after = np.append(heads[1], heads[:-1]), np.append(heads[1:], heads[-2])
    size = np.minimum(np.abs(before - heads), np.abs(after - heads))
    jumps = (size > least) & (np.abs(before - after) < back * size) & (lengths <= longest)
    if not jumps.any():
        return None
    candidates, counts = np.unique(heads[jumps], return_counts=True)
    most_frequent = candidates[np.argmax(counts)]
    is_most_frequent = jumps & (heads == most_frequent)
    similar = jumps & (size > 0.5 * np.median(size[is_most_frequent]))  # jumps of similar size
    if is_most_frequent.sum() < 0.5 * similar.sum():
        return None
    return _Jumps(most_frequent, np.repeat(is_most_frequent, lengths), int(is_most_frequent.sum()))


def remove_missing(log: Log) -> tuple[Log, list[Cause]]:
    """The log without missing readings, and a cause for each value that marks them."""
    causes: list[Cause] = []
    tracks = log.tracks
    is_missing = np.zeros(len(tracks.t), np.bool_)
    count = log.counts.measured / max(float(np.median(np.diff(tracks.t))), 1e-9) if len(tracks.t) > 1 else 0.0
    for side, name in enumerate(("left", "right")):
        speeds = tracks.speeds[:, side]
        is_missing |= _mark_missing(causes, "sprockets", f"{name} speed", tracks.t, speeds, count)
    if is_missing.any():
        log = replace(log, tracks=tracks_of_speeds(tracks.t[~is_missing], tracks.speeds[~is_missing]))
    gyros, fixes = [], []
    for gyro in log.gyros:
        is_missing = np.zeros(len(gyro.t), np.bool_)
        for axis, name in enumerate("xyz"):
            rates = gyro.rates[:, axis]
            is_missing |= _mark_missing(causes, gyro.name, f"rate about {name}", gyro.t, rates)
        gyros.append(gyro.select(~is_missing))
    for source in log.fixes:
        fixes.append(source.select(~_mark_missing_fixes(causes, source.name, source.places)))
    return replace(log, gyros=tuple(gyros), fixes=tuple(fixes)), causes


def _mark_missing(
    causes: list[Cause],
    source: str,
    column: str,
    t: FloatArray,
    values: FloatArray,
    count: float = 0.0,
) -> BoolArray:
    """(n,) missing readings of one column, whose cause is added to ``causes``.

    Most of them follow no gap: an increment is twice as large after a gap.
    """
    intervals = np.diff(t, prepend=t[:1])
    missing = find_missing_value(values, count)
    if missing is None or (intervals > 1.5 * np.median(intervals))[missing[1]].mean() > 0.5:
        return np.zeros(len(values), np.bool_)
    value, where = missing
    causes.append(_missing_cause(source, column, value, where))
    return where


def _mark_missing_fixes(causes: list[Cause], source: str, places: FloatArray) -> BoolArray:
    """(n,) missing fixes: at one exact place far from others that recurs, or is held at the start or end."""
    nothing = np.zeros(len(places), np.bool_)
    if len(places) < _LEAST_READINGS:
        return nothing
    spread = float(np.median(np.hypot(*(places - np.median(places, axis=0)).T)))
    jumps = _find_jumps(places @ np.array((1.0, 1.0j)), max(_FIX_STEP, spread), 1.0, len(places) // 2)
    if jumps is None:
        return nothing
    is_held_at_an_end = jumps.where[:_LEAST_HELD].all() or jumps.where[-_LEAST_HELD:].all()
    if jumps.visits < _LEAST_PLACES and not is_held_at_an_end:
        return nothing
    causes.append(_missing_cause(source, "place", float(jumps.value.real), jumps.where, numbers=2))
    return jumps.where


def _missing_cause(source: str, column: str, value: float, where: BoolArray, *, numbers: int = 1) -> Cause:
    """The cause for a value that marks the readings ``where`` (n,); ``numbers`` of each reading repeat."""
    count = int(where.sum())
    unit, share = "m" if column == "place" else "rad/s", f"{where.mean():.1%} of the readings"
    evidence = f"{column} jumps to {value:g} {unit} and back {count} times ({share})"
    remedy = (
        "Leave out what stands for a missing value: blank cells, or in the mapping 'missing: …' at that "
        "column, with the number that it holds there"
    )
    return Cause("missing_value", source, evidence, odds_of(min(count * numbers, 20) * 2.0), remedy)
