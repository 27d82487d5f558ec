# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Columns with placeholders of missing values, or with wrong units of time."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_estimation.setup_check.equal_runs import equal_runs
from trackslip_estimation.setup_check.grid import continuous_angles
from trackslip_estimation.setup_check.log import ComplexArray, Log, Tracks

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
_TIME_FACTORS = (1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9)
_PERIODS = {"tracks": (5e-4, 2.0), "gyro": (2e-4, 2.0), "fixes": (2e-3, 30.0)}  # s, of any such sensor
_FIX_STEP = 30.0  # m from both neighbours; a place farther away is no fix of the machine


@dataclass(frozen=True)
class MissingValue:
    """A value that marks missing readings."""

    source: str
    column: str
    value: float
    count: int
    share: float
    numbers: int = 1  # components of each reading that repeat


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
    found = _find_jumps(
        values, max(_QUANTA * step, _LARGE_SHARE * level, _JITTER_COUNTS * count), _RETURN_SHARE, _LONGEST_RUN
    )
    if found is None or found.where.sum() < _LEAST_SHARE * len(values):
        return None
    least = _LEAST_BEYOND if _is_beyond(values, found) else _LEAST_MISSING
    return (float(found.value.real), found.where) if found.visits >= least else None


def _is_beyond(values: FloatArray, found: _Jumps) -> bool:
    """Whether a value lies far outside the range of all others."""
    others = values[~found.where]
    usual = float(np.median(others))
    return abs(found.value - usual) > _LEAST_DEVIATION * float(np.abs(others - usual).max())


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
    found, counts = np.unique(heads[jumps], return_counts=True)
    top = found[np.argmax(counts)]
    there = jumps & (heads == top)
    similar = jumps & (size > 0.5 * np.median(size[there]))  # jumps of similar size
    if there.sum() < 0.5 * similar.sum():
        return None
    return _Jumps(top, np.repeat(there, lengths), int(there.sum()))


def remove_missing(log: Log) -> tuple[Log, list[MissingValue]]:
    """The log without missing readings, and the values that mark them."""
    found: list[MissingValue] = []
    tracks = log.tracks
    lost = np.zeros(len(tracks.t), np.bool_)
    count = log.counts.shown / max(float(np.median(np.diff(tracks.t))), 1e-9) if len(tracks.t) > 1 else 0.0
    for side, name in enumerate(("left", "right")):
        speeds, gaps = tracks.speeds[:, side], _readings_after_gap(tracks.t)
        lost |= _mark_missing(found, "sprockets", f"{name} speed", speeds, gaps, count)
    if lost.any():
        kept = ~lost
        none = np.full((int(kept.sum()), 2), np.nan)
        t, speeds = tracks.t[kept], tracks.speeds[kept]
        log = replace(log, tracks=Tracks(t, speeds, continuous_angles(t, speeds, none)))
    gyros, fixes = [], []
    for gyro in log.gyros:
        lost = np.zeros(len(gyro.t), np.bool_)
        for axis, name in enumerate("xyz"):
            lost |= _mark_missing(
                found, gyro.name, f"rate about {name}", gyro.rates[:, axis], _readings_after_gap(gyro.t)
            )
        kept = ~lost
        gyros.append(
            replace(gyro, t=gyro.t[kept], rates=gyro.rates[kept], accelerations=gyro.accelerations[kept])
        )
    for one in log.fixes:
        lost = _mark_missing_fixes(found, one.name, one.places)
        kept = ~lost
        fixes.append(replace(one, t=one.t[kept], places=one.places[kept], stddevs=one.stddevs[kept]))
    return replace(log, gyros=tuple(gyros), fixes=tuple(fixes)), found


def _readings_after_gap(t: FloatArray) -> BoolArray:
    """(n,) readings after a gap: an increment is twice as large there."""
    intervals = np.diff(t, prepend=t[:1])
    return np.asarray(intervals > 1.5 * np.median(intervals))


def _mark_missing(
    found: list[MissingValue],
    source: str,
    column: str,
    values: FloatArray,
    after_gap: BoolArray,
    count: float = 0.0,
) -> BoolArray:
    missing = find_missing_value(values, count)
    if missing is None or after_gap[missing[1]].mean() > 0.5:
        return np.zeros(len(values), np.bool_)
    value, where = missing
    found.append(MissingValue(source, column, value, int(where.sum()), float(where.mean())))
    return where


def _mark_missing_fixes(found: list[MissingValue], source: str, places: FloatArray) -> BoolArray:
    """(n,) missing fixes: at one exact place far from others that recurs, or is held at the start or end."""
    nothing = np.zeros(len(places), np.bool_)
    if len(places) < _LEAST_READINGS:
        return nothing
    spread = float(np.median(np.hypot(*(places - np.median(places, axis=0)).T)))
    one = _find_jumps(places @ np.array((1.0, 1.0j)), max(_FIX_STEP, spread), 1.0, len(places) // 2)
    if one is None:
        return nothing
    is_held_first = one.where[:_LEAST_HELD].all() or one.where[-_LEAST_HELD:].all()
    if one.visits < _LEAST_PLACES and not is_held_first:
        return nothing
    count, share = int(one.where.sum()), float(one.where.mean())
    found.append(MissingValue(source, "place", float(one.value.real), count, share, 2))
    return one.where


def time_factor(t: FloatArray, kind: str) -> float:
    """Factor that gives stamps a plausible period of such a sensor; 1 where they have one, or none fits."""
    if len(t) < 10:
        return 1.0
    period = float(np.median(np.diff(t)))
    low, high = _PERIODS[kind]
    if low <= period <= high or period <= 0.0:
        return 1.0
    usual = float(np.sqrt(low * high))
    fitting = [f for f in _TIME_FACTORS if low <= period * f <= high]
    return min(fitting, key=lambda f: abs(np.log(period * f / usual)), default=1.0)
