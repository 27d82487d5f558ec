# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sources on another clock than the tracks.

Their stamps differ by more than ``LARGEST_DELAY``. Arrivals show that, or

    r(τ) = correlation of |v| by the tracks at t and |v| by the fixes at t + τ

with coarser steps than those of ``clocks``. Neither signs nor units change r.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check.clocks import LARGEST_DELAY, maximum_between_steps
from trackslip_estimation.setup_check.finding import LEAST_LOG, PRIOR, READ_OFF, Cause, OpenQuestion, odds_of
from trackslip_estimation.setup_check.log import TRACKS, Array, Fixes, Gyro, Log, Tracks

_LARGEST_SHIFT = 60.0  # s, largest delay that is tried
_OVERLAP = 0.75  # share of the readings that must overlap
_STEP, _WINDOW = 0.5, 2.0  # s, between delays; length of the window of a speed
_WIDTH = 4.0  # s about the maximum of r that belong to it
_LEAST_READINGS = 10
_EARLY, _LARGEST_JITTER = 0.1, 0.02  # s, of arrivals before their stamps; of clocks kept by NTP
_LEAST_SEPARATION = 150.0  # s without readings: longer than outages, and than the data of a running check
_LEAST_SPEED_CORRELATION = 0.9  # spinning tracks lower it for right stamps too
_MOST_SPEED_CORRELATION = 0.999


class _Shift(NamedTuple):
    """Delay of the fixes after the tracks."""

    value: float  # s
    correlation: float
    without: float  # correlation with the stamps as they are
    gain: float  # ln likelihood ratio over the stamps as they are


def with_common_clock(log: Log) -> tuple[Log, list[Cause]]:
    """The log on the clock of the tracks, and a cause for each source on another one."""
    log, arrival_causes = _judge_arrivals(log)
    causes = _judge_overlap(log)
    other_clock = {cause.source for cause in causes}
    shifts = {}
    for source in log.fixes:
        shift = None if source.name in other_clock else _fix_shift(log.tracks, log.machine.radius, source)
        if shift is not None:
            shifts[source.name] = shift.value
            causes.append(_shift_cause(source.name, shift))
    if not causes:
        return log, arrival_causes
    # the clock of all other compasses is unknown
    log = replace(log, compasses=tuple(source for source in log.compasses if source.name in shifts))
    log = log.with_stamps(lambda name, t: None if name in other_clock else t - shifts.get(name, 0.0))
    return log, [*arrival_causes, *causes]


def _judge_arrivals(log: Log) -> tuple[Log, list[Cause]]:
    """The log on the clock of the tracks, and a cause for each source that arrives at other times than most.

    Arrivals are logged by one clock: it shows how the clocks of the stamps differ.
    """
    delays = _arrival_delays(log)
    if TRACKS not in delays:
        return log, []

    def is_near(one: float, other: float) -> bool:
        return abs(one - other) < LARGEST_DELAY

    usual = max(delays.values(), key=lambda d: (sum(is_near(d, other) for other in delays.values()), -abs(d)))
    offsets = {name: delay - usual for name, delay in delays.items() if not is_near(delay, usual)}
    log = log.with_stamps(lambda name, t: t + offsets.get(name, 0.0) - offsets.get(TRACKS, 0.0))
    return log, [_arrival_cause(name, delays[name], usual) for name in offsets]


def judge_early_arrivals(log: Log) -> list[OpenQuestion]:
    """A question for each source that arrives before its stamps while the tracks do not.

    Transport makes arrivals late, never early.
    """
    delays = _arrival_delays(log)
    if delays.get(TRACKS, -_EARLY) < -_LARGEST_JITTER:
        return []  # the recorder's clock may be behind all others
    return [
        OpenQuestion(
            f"{name} arrives {-delay:.2f} s before its stamps, the sprockets after theirs: clocks differ",
            "compare the clock of its driver with the recorder's",
        )
        for name, delay in delays.items()
        if -LARGEST_DELAY < delay < -_EARLY
    ]


def _arrival_delays(log: Log) -> dict[str, float]:
    """Usual delays of the arrivals after their stamps, s, of the sources that are compared."""
    compared = {TRACKS, *(g.name for g in log.gyros), *(f.name for f in log.fixes)}
    compared |= {compass.name for compass in log.compasses}
    return {name: delay for name, delay in log.arrival_delays.items() if name in compared}


def _arrival_cause(name: str, delay: float, usual: float) -> Cause:
    own, other = (f"{abs(d):.1f} s {'after' if d >= 0.0 else 'before'}" for d in (delay, usual))
    evidence = f"{name} arrives {own} its stamps, other sources {other} theirs"
    return Cause("source_delay", name, evidence, READ_OFF, _clock_remedy(name, usual - delay))


def _clock_remedy(name: str, ahead: float) -> str:
    """Remedy for stamps that are ``ahead`` of those of the other sources, s."""
    gps = " (GPS time is 18 s ahead of UTC)" if abs(abs(ahead) - 18.0) < 1.0 else ""
    return f"In the mapping of {name}: time_offset: {-ahead:.1f}{gps}; or set the clock of its driver"


def _judge_overlap(log: Log) -> list[Cause]:
    """A cause for each source whose readings all lie before the first of the tracks, or after the last."""
    begin, end = float(log.tracks.t[0]), float(log.tracks.t[-1])
    causes = []
    sources: tuple[Gyro | Fixes, ...] = (*log.gyros, *log.fixes)
    for source in sources:
        if len(source.t) < _LEAST_READINGS or len(log.tracks.t) < _LEAST_READINGS:
            continue
        late, early = float(source.t[0]) - end, begin - float(source.t[-1])
        if max(late, early) < _LEAST_SEPARATION:
            continue
        where = f"begins {late:.0f} s after the end" if late > 0.0 else f"ends {early:.0f} s before the begin"
        evidence = f"{source.name} {where} of the sprockets: the two have no time in common"
        of_clock = f"bring both to one clock (mapping of {source.name}: time_offset, or zone of its times)"
        remedy = f"Record both together, or {of_clock}"
        causes.append(Cause("source_delay", source.name, evidence, READ_OFF, remedy))
    return causes


def _shift_cause(name: str, shift: _Shift) -> Cause:
    order = "later" if shift.value > 0.0 else "earlier"
    evidence = (
        f"speeds by {name} follow those of the sprockets {abs(shift.value):.1f} s {order}: correlation "
        f"{shift.correlation:.2f}, with the stamps as they are {shift.without:.2f}"
    )
    return Cause("source_delay", name, evidence, odds_of(shift.gain), _clock_remedy(name, shift.value))


def _fix_shift(tracks: Tracks, radius: float, fixes: Fixes) -> _Shift | None:
    """Delay of the fixes beyond ``LARGEST_DELAY``; None where the drive shows none."""
    is_finite = np.isfinite(fixes.places).all(axis=1)
    if min(len(tracks.t), int(is_finite.sum())) < _LEAST_READINGS:
        return None
    first = min(float(tracks.t[0]), float(fixes.t[is_finite][0]))
    last = max(float(tracks.t[-1]), float(fixes.t[is_finite][-1]))
    period = float(np.median(np.diff(fixes.t[is_finite])))
    times = np.arange(first, last, _STEP)
    by_tracks = _window_speeds(tracks.t, tracks.angles.mean(axis=1) * radius, times)
    by_fixes = _window_speeds(fixes.t[is_finite], fixes.complex_places[is_finite], times)
    steps = min(round(_LARGEST_SHIFT / _STEP), len(times) - 1)
    shifts = _STEP * np.arange(-steps, steps + 1)
    r, counts = _correlations(by_tracks, by_fixes, steps)
    best = int(np.argmax(r))
    least = LARGEST_DELAY + max(period - _WINDOW, 0.0)
    if not least <= abs(shifts[best]) < steps * _STEP or r[best] < _LEAST_SPEED_CORRELATION:
        return None
    track_autocorrelation, fix_autocorrelation = (
        _correlations(speeds, speeds, steps)[0] for speeds in (by_tracks, by_fixes)
    )
    # readings per independent one (Bartlett)
    effective = max(float(np.sum(track_autocorrelation * fix_autocorrelation)), 1.0)
    without = float(r[np.abs(shifts) <= _STEP].max())
    second = float(r[np.abs(shifts - shifts[best]) > _WIDTH].max())
    gain, over_second = (
        0.5 * counts[best] / effective * np.log((1.0 - max(other, 0.0) ** 2) / (1.0 - r[best] ** 2))
        for other in (without, second)
    )
    gain -= PRIOR + np.log(len(shifts))
    if min(gain, over_second) < LEAST_LOG:
        return None
    shift = float(shifts[best]) + maximum_between_steps(r, best) * _STEP
    return _Shift(shift, float(r[best]), without, float(gain))


def _window_speeds(t: FloatArray, places: Array, times: FloatArray) -> FloatArray:
    """(k,) speeds by places (n,), m, in windows about the times; nan outside the readings."""
    begin, end = (np.interp(times + half, t, places, np.nan, np.nan) for half in (-_WINDOW / 2, _WINDOW / 2))
    speeds = np.abs(end - begin) / _WINDOW
    if not np.isfinite(speeds).any():
        return np.full(len(times), np.nan)
    return np.asarray(np.minimum(speeds, np.nanpercentile(speeds, 98)), np.float64)


def _correlations(a: FloatArray, b: FloatArray, steps: int) -> tuple[FloatArray, FloatArray]:
    """(2 steps + 1,) correlations of a at k and b at k + j, and sample counts; 0 where too few overlap."""
    least = _OVERLAP * min(np.isfinite(a).sum(), np.isfinite(b).sum())
    r, counts = np.zeros(2 * steps + 1), np.zeros(2 * steps + 1)
    for k, j in enumerate(range(-steps, steps + 1)):
        first, second = a[max(0, -j) : len(a) - max(0, j)], b[max(0, j) : len(b) + min(0, j)]
        both = np.isfinite(first) & np.isfinite(second)
        if both.sum() <= max(least, 2):
            continue
        x, y = first[both] - first[both].mean(), second[both] - second[both].mean()
        scale = float(np.sqrt((x @ x) * (y @ y)))
        if scale > 0.0:
            r[k], counts[k] = min(float(x @ y) / scale, _MOST_SPEED_CORRELATION), float(both.sum())
    return r, counts
