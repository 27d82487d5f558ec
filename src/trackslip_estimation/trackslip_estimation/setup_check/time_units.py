# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps in an implausible unit of time, or without their fractions of a second."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check.finding import READ_OFF, Cause, odds_of
from trackslip_estimation.setup_check.grid import tracks_of_speeds
from trackslip_estimation.setup_check.log import TRACKS, Log

_LEAST_STAMPS, _SEVERAL, _EXACT = 10, 1.5, 1e-6  # stamps, readings per stamp, s
_PERIODS = {"tracks": (5e-4, 2.0), "gyro": (2e-4, 2.0), "fixes": (2e-3, 30.0)}  # s, of any such sensor
_UNITS = {  # factor that gives s: true and declared unit
    1e-9: "ns, declared s",
    1e-6: "µs, declared s",
    1e-3: "ms, declared s",
    1e3: "s, declared ms",
    86400.0: "d, declared s",
    1e6: "s, declared µs",
    1e9: "s, declared ns",
}


def correct_time_units(log: Log) -> tuple[Log, list[Cause]]:
    """The log in s, and the sources whose stamps were in another unit.

    A source in another unit than the tracks is left out: the origin of its stamps is unknown.
    """
    series = source_stamps(log)
    factors = _time_factors(series)
    if all(factor == 1.0 for factor in factors.values()):
        return log, []
    causes = []
    is_same_unit = len(set(factors.values())) == 1
    for name, _, t in series:
        factor = factors[name]
        if factor == 1.0 or (is_same_unit and name != TRACKS):
            continue
        period = float(np.median(np.diff(t)))
        subject = "all sources" if is_same_unit else name
        evidence = (
            f"stamps of {subject} are {period:.3g} s apart; as {_UNITS[factor]}, {period * factor:.3g} s"
        )
        remedy = f"State the unit in the mapping: time: {{column: …, unit: {_UNITS[factor].split(',')[0]}}}"
        causes.append(Cause("time_unit", "all" if is_same_unit else name, evidence, READ_OFF, remedy))
    return _scale_stamps(log, factors), causes


def _time_factors(series: Sequence[tuple[str, str, FloatArray]]) -> dict[str, float]:
    """The factor of each source; those that last equally long have one, which suits the period of each."""
    factors = {name: _time_factor(t, *_PERIODS[kind]) for name, kind, t in series}
    other = next((factor for factor in factors.values() if factor != 1.0), 1.0)
    long = {name: float(t[-1] - t[0]) for name, _, t in series if len(t) > 1}
    longest = max((long[name] for name in long if factors[name] == other), default=0.0)
    similar = {name for name in long if factors[name] == 1.0 and 0.2 < long[name] / longest < 5.0}
    if other == 1.0 or not similar:
        return factors
    suits = all(
        _time_factor(other * t, *_PERIODS[kind]) == 1.0 for name, kind, t in series if name in similar
    )
    changed = similar if suits else {name for name in factors if factors[name] == other}
    return factors | dict.fromkeys(changed, other if suits else 1.0)


def _time_factor(t: FloatArray, low: float, high: float) -> float:
    """Factor that brings the period of stamps (n,) into ``low`` to ``high``, s; 1 without need, or none."""
    if len(t) < _LEAST_STAMPS:
        return 1.0
    period = float(np.median(np.diff(t)))
    if low <= period <= high or period <= 0.0:
        return 1.0
    usual = float(np.sqrt(low * high))
    fitting = [factor for factor in _UNITS if low <= period * factor <= high]
    return min(fitting, key=lambda factor: abs(np.log(period * factor / usual)), default=1.0)


def source_stamps(log: Log) -> list[tuple[str, str, FloatArray]]:
    """Topic, kind and stamps (n,), s, of each source."""
    series: list[tuple[str, str, FloatArray]] = [(TRACKS, "tracks", log.tracks.t)]
    series += [(g.name, "gyro", g.t) for g in log.gyros]
    return series + [(f.name, "fixes", f.t) for f in log.fixes]


def judge_fractions(log: Log) -> list[Cause]:
    """A cause for each source with several readings per stamp, where all stamps are whole seconds."""
    causes = []
    for name, _, t in source_stamps(log):
        steps, per_stamp = np.diff(t), log.per_stamp.get(name, 1.0)
        is_whole = bool((np.abs(steps - np.round(steps)) < _EXACT).all())
        if per_stamp * len(t) < _LEAST_STAMPS or per_stamp < _SEVERAL or not is_whole:
            continue
        unit = "minutes" if (np.round(steps) % 60 == 0).all() else "seconds"
        evidence = f"stamps of {name} are whole {unit}, of {per_stamp:.0f} readings each: the rest is cut off"
        if not len(steps):
            evidence = f"all {per_stamp:.0f} readings of {name} have one stamp"
        remedy = (
            "Record the fractions too (mapping: time: {column: [secs, nsecs], unit: [s, ns]}), or stamp "
            "readings on arrival (stamp: log, or received)"
        )
        causes.append(Cause("time_unit", name, evidence, odds_of(per_stamp * len(t)), remedy))
    return causes


def _scale_stamps(log: Log, factors: dict[str, float]) -> Log:
    start, common = float(log.tracks.t[0]), factors[TRACKS]

    def scale(t: FloatArray) -> FloatArray:
        return start + (t - start) * common

    tracks = replace(log.tracks, t=scale(log.tracks.t))
    if common != 1.0 and np.isfinite(tracks.speeds).all():
        tracks = tracks_of_speeds(tracks.t, tracks.speeds)
    return replace(log, tracks=tracks).with_stamps(
        lambda name, t: scale(t) if factors.get(name, common) == common else None
    )
