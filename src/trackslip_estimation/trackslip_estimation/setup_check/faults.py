# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Columns that no machine gives: missing values, frozen gyros, wrong units of time."""

from dataclasses import dataclass, replace

import numpy as np

from trackslip_estimation.setup_check.grid import angles_of
from trackslip_estimation.setup_check.log import BoolArray, FloatArray, Gyro, Log, Tracks

_LEAST_MISSING = 5  # readings
_LEAST_PLACES = 3  # fixes at one place to the last digit, far from all others
_LEAST_SHARE = 0.002  # of all
_LONGEST_RUN = 3  # readings of the same value in a row
_RETURN = 0.3  # of a jump, by which the readings before and after it differ at most
_QUANTA = 5.0  # times the least changes of readings
_LARGE = 0.3  # of the size of large readings, below which a jump may be motion or noise
_LEAST_FROZEN = 50  # readings
_TIME_FACTORS = (1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9)
_PERIODS = {"tracks": (5e-4, 2.0), "gyro": (2e-4, 2.0), "fixes": (2e-3, 30.0)}  # s, of any such sensor
_FIX_STEP = 30.0  # m from both neighbours, beyond which a place is no fix of the machine


@dataclass(frozen=True)
class Missing:
    """A value that stands for none."""

    source: str
    column: str
    value: float
    count: int
    share: float


def missing_in(values: FloatArray) -> tuple[float, BoolArray] | None:
    """The value of (n,) to which readings jump and from which they return at once, and where."""
    count = len(values)
    if count < 10:
        return None
    previous, following = _neighbours(values)
    with np.errstate(invalid="ignore", over="ignore"):
        change = np.abs(np.diff(values))
        change = change[change > 0.0]
        if not len(change):
            return None
        step = float(np.percentile(change, 5))  # of a quantised signal its quantum
        size = np.minimum(np.abs(previous - values), np.abs(following - values))
        level = float(np.percentile(np.abs(values[values != 0.0]), 95))
        returns = np.abs(previous - following) < _RETURN * size
        jumps = (size > max(_QUANTA * step, _LARGE * level)) & returns
    if jumps.sum() < _LEAST_MISSING:
        return None
    found, counts = np.unique(values[jumps], return_counts=True)
    top = int(np.argmax(counts))
    where = jumps & (values == found[top])
    alike = jumps & (size > 0.5 * np.median(size[where]))  # what jumps as far
    if counts[top] < max(_LEAST_MISSING, 0.5 * alike.sum(), _LEAST_SHARE * count):
        return None
    return float(found[top]), np.asarray(where)


def _neighbours(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) last other value before, and first one after, each reading; nan in long runs and at ends."""
    new = np.concatenate(([True], np.diff(values) != 0.0))
    run = np.cumsum(new) - 1
    first = np.flatnonzero(new)
    lengths = np.diff(np.append(first, len(values)))
    heads = values[first]
    before = np.concatenate(([np.nan], heads[:-1]))
    after = np.concatenate((heads[1:], [np.nan]))
    short = lengths <= _LONGEST_RUN
    return np.where(short, before, np.nan)[run], np.where(short, after, np.nan)[run]


def without_missing(log: Log) -> tuple[Log, list[Missing]]:
    """The log without such readings, and what they were."""
    found: list[Missing] = []
    tracks = log.tracks
    lost = np.zeros(len(tracks.t), np.bool_)
    for side, name in enumerate(("left", "right")):
        lost |= _note(found, "sprockets", f"{name} speed", tracks.speeds[:, side])
    if lost.any():
        kept = ~lost
        none = np.full((int(kept.sum()), 2), np.nan)
        t, speeds = tracks.t[kept], tracks.speeds[kept]
        log = replace(log, tracks=Tracks(t, speeds, angles_of(t, speeds, none)))
    gyros, fixes = [], []
    for gyro in log.gyros:
        lost = np.zeros(len(gyro.t), np.bool_)
        for axis, name in enumerate("xyz"):
            lost |= _note(found, gyro.name, f"rate about {name}", gyro.rates[:, axis])
        kept = ~lost
        gyros.append(
            replace(gyro, t=gyro.t[kept], rates=gyro.rates[kept], accelerations=gyro.accelerations[kept])
        )
    for one in log.fixes:
        lost = _missing_fixes(found, one.name, one.places)
        kept = ~lost
        fixes.append(replace(one, t=one.t[kept], places=one.places[kept], stddevs=one.stddevs[kept]))
    return replace(log, gyros=tuple(gyros), fixes=tuple(fixes)), found


def _note(found: list[Missing], source: str, column: str, values: FloatArray) -> BoolArray:
    missing = missing_in(values)
    if missing is None:
        return np.zeros(len(values), np.bool_)
    value, where = missing
    found.append(Missing(source, column, value, int(where.sum()), float(where.mean())))
    return where


def _missing_fixes(found: list[Missing], source: str, places: FloatArray) -> BoolArray:
    """(n,) places that stand for none: one exact place far from all others that comes back."""
    nothing = np.zeros(len(places), np.bool_)
    if len(places) < 10:
        return nothing
    usual = np.median(places, axis=0)
    spread = float(np.median(np.hypot(*(places - usual).T)))
    unique, index, counts = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    for k in np.argsort(-counts)[:3]:
        if counts[k] < _LEAST_PLACES or counts[k] > 0.5 * len(places):
            continue
        where = index.ravel() == k
        gaps = np.hypot(*(places[~where] - unique[k]).T)
        if float(np.percentile(gaps, 2)) > max(_FIX_STEP, spread):
            found.append(Missing(source, "place", float(unique[k][0]), int(counts[k]), float(where.mean())))
            return np.asarray(where)
    return nothing


def frozen_span(gyro: Gyro) -> tuple[float, float] | None:
    """The longest time in which all readings about z are bit for bit the same, s; None: none worth a word."""
    z = gyro.rates[:, 2]
    if len(z) < _LEAST_FROZEN:
        return None
    changes = np.flatnonzero(np.diff(z) != 0.0)
    edges = np.concatenate(([0], changes + 1, [len(z)]))
    lengths = np.diff(edges)
    k = int(np.argmax(lengths))
    if lengths[k] < _LEAST_FROZEN:
        return None
    return float(gyro.t[edges[k]]), float(gyro.t[edges[k + 1] - 1])


def frozen_share(gyro: Gyro) -> float:
    """Share of its time in the longest frozen span."""
    span = frozen_span(gyro)
    return 0.0 if span is None else (span[1] - span[0]) / max(float(gyro.t[-1] - gyro.t[0]), 1e-9)


def time_factor(t: FloatArray, kind: str) -> float:
    """What stamps must be multiplied by for a rate that such a sensor has; 1 where theirs is one."""
    if len(t) < 10:
        return 1.0
    period = float(np.median(np.diff(t)))
    low, high = _PERIODS[kind]
    if low <= period <= high or period <= 0.0:
        return 1.0
    usual = float(np.sqrt(low * high))
    fitting = [f for f in _TIME_FACTORS if low <= period * f <= high]
    return min(fitting, key=lambda f: abs(np.log(period * f / usual)), default=1.0)
