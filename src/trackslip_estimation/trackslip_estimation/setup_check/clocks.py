# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps: a unit of time that no sensor has, and delays of the sources against each other.

Delays of turn rates come from cross-correlations; that of fixes without headings from the shape of the
path. The
source that is late against two others, which agree, is the late one.
"""

from dataclasses import dataclass, replace

import numpy as np

from trackslip_estimation.setup_check.delay import delay_of
from trackslip_estimation.setup_check.faults import time_factor
from trackslip_estimation.setup_check.finding import LEAST_LOG, PRIOR, Cause, Undetermined, odds_of
from trackslip_estimation.setup_check.fit import path_delay
from trackslip_estimation.setup_check.grid import Grid, angles_of
from trackslip_estimation.setup_check.heading import heading_at
from trackslip_estimation.setup_check.log import Compass, Fixes, FloatArray, Gyro, Log, Tracks
from trackslip_estimation.setup_check.path import dead_reckoning, thinned

LEAST_DELAY = 0.15  # s, below which it may be the ground's answer, filters of sensors, held values
_SURE, _CERTAIN = 2.0, 4.0  # standard deviations, by which a delay is longer than that, and than none
_FINE = 0.15  # s, of a delay by turn rates
_LATES = np.arange(-2.0, 2.01, 0.1)  # s
_LENGTHS = (10.0, 20.0)  # s
_LEAST_SEGMENTS, _SHOWN = 5, 2.0  # of which each shows a delay by so much of ln likelihood
_EFFICIENCY = 0.75  # κ of turns by tracks alone
_NAMES = {1e-9: "ns, declared s", 1e-6: "µs, declared s", 1e-3: "ms, declared s"}
_NAMES |= {1e3: "s, declared ms", 1e6: "s, declared µs", 1e9: "s, declared ns"}


@dataclass(frozen=True)
class Late:
    """By how much the stamps of the second are later than those of the first."""

    first: str
    second: str
    value: float  # s
    stddev: float  # s
    gain: float | None = None  # ln likelihood over no delay, of one by the shape of the path


def with_right_times(log: Log) -> tuple[Log, list[Cause]]:
    """The log in s, and the sources whose stamps were in another unit.

    One that is alone in that is left out: where its stamps begin is unknown.
    """
    series: list[tuple[str, str, FloatArray]] = [("sprockets", "tracks", log.tracks.t)]
    series += [(g.name, "gyro", g.t) for g in log.gyros]
    series += [(f.name, "fixes", f.t) for f in log.fixes]
    factors = {name: time_factor(t, kind) for name, kind, t in series}
    if all(factor == 1.0 for factor in factors.values()):
        return log, []
    common = set(factors.values())
    if len(common) > 1 and 1.0 in common:  # one that may still be within reason, beside others that are not
        other = (common - {1.0}).pop()
        spans = {name: float(t[-1] - t[0]) for name, _, t in series if len(t) > 1}
        longest = max(spans[n] for n in spans if factors[n] == other)
        alike = [n for n in spans if factors[n] == 1.0 and 0.2 < spans[n] / longest < 5.0]
        factors |= dict.fromkeys(alike, other)
    causes = []
    whole = len(set(factors.values())) == 1
    for name, _, t in series:
        factor = factors[name]
        if factor == 1.0 or (whole and name != "sprockets"):
            continue
        period = float(np.median(np.diff(t)))
        who = "all sources" if whole else name
        evidence = f"stamps of {who} are {period:.3g} s apart; as {_NAMES[factor]}, {period * factor:.3g} s"
        remedy = f"State the unit in the mapping: time: {{column: …, unit: {_NAMES[factor].split(',')[0]}}}"
        causes.append(Cause("time_unit", "all" if whole else name, evidence, odds_of(12.0), remedy))
    return _scaled(log, factors), causes


def _scaled(log: Log, factors: dict[str, float]) -> Log:
    start, common = float(log.tracks.t[0]), factors["sprockets"]

    def right(t: FloatArray) -> FloatArray:
        return start + (t - start) * common

    t = right(log.tracks.t)
    angles, speeds = log.tracks.angles, log.tracks.speeds
    if common != 1.0 and np.isfinite(speeds).all():
        angles = angles_of(t, speeds, np.full(speeds.shape, np.nan))
    alike = {name for name, factor in factors.items() if factor == common}
    gyros = tuple(replace(g, t=right(g.t)) for g in log.gyros if g.name in alike)
    fixes = tuple(replace(f, t=right(f.t)) for f in log.fixes if f.name in alike)
    known = alike | ({c.name for c in log.compasses} - factors.keys())
    compasses = tuple(replace(c, t=right(c.t)) for c in log.compasses if c.name in known)
    return replace(log, tracks=Tracks(t, speeds, angles), gyros=gyros, fixes=fixes, compasses=compasses)


def lates_of(
    grid: Grid, log: Log, gyro: Gyro | None, fixes: Fixes | None, compass: Compass | None, bias: float
) -> list[Late]:
    """Of each pair of tracks, gyro, headings and fixes of which the drive shows one."""
    found: list[Late] = []
    by_tracks = (grid.tracks[:, 1] - grid.tracks[:, 0]) / log.machine.tread / grid.cell
    rates = {"tracks": by_tracks}
    if gyro is not None:
        rates["gyro"] = grid.turns[:, 2] / grid.cell - bias
    if compass is not None:
        with np.errstate(invalid="ignore"):
            rates["heading"] = np.clip(np.diff(heading_at(compass, grid.edges)) / grid.cell, -5.0, 5.0)
    names = list(rates)
    for k, first in enumerate(names):
        for second in names[k + 1 :]:
            delay = delay_of(rates[first], rates[second], grid.cell)
            if delay is not None:
                found.append(Late(first, second, delay.value, delay.stddev))
    if fixes is not None:
        found += _of_path(grid, log, fixes, found, rates)
    return found


def _of_path(
    grid: Grid, log: Log, fixes: Fixes, found: list[Late], rates: dict[str, FloatArray]
) -> list[Late]:
    """Fixes against dead reckoning by tracks; by tracks and gyro where these agree."""
    apart = next((one for one in found if (one.first, one.second) == ("tracks", "gyro")), None)
    with_gyro = "gyro" in rates and apart is not None and abs(apart.value) < LEAST_DELAY
    turn = (rates["gyro"] if with_gyro else _EFFICIENCY * rates["tracks"]) * grid.cell
    path, thin = dead_reckoning(grid, grid.tracks.mean(axis=1), turn), thinned(fixes, 0.3)
    best: Late | None = None
    for length in _LENGTHS:
        of_segments = path_delay(path, thin, length, _LATES)
        logs = of_segments.sum(axis=1)
        k = int(np.argmax(logs))
        near = np.flatnonzero(logs > logs[k] - 2.0)
        stddev = float(_LATES[near[-1]] - _LATES[near[0]]) / 4.0 + 0.03
        stddev = max(stddev, _jackknife(of_segments, k))
        inside = 0 < k < len(_LATES) - 1  # else the top lies beyond
        if inside and _is_shown_alike(of_segments, k) and (best is None or stddev < best.stddev):
            gain = float(logs[k] - logs[int(np.argmin(np.abs(_LATES)))])
            best = Late("tracks", "fixes", float(_LATES[k]), stddev, gain)
    if best is None or (abs(best.value) > LEAST_DELAY and (best.gain or 0.0) < LEAST_LOG + PRIOR):
        return []
    if apart is None:
        return [best]
    both = float(np.hypot(best.stddev, apart.stddev))
    return [best, Late("gyro", "fixes", best.value - apart.value, both, best.gain)]


def _is_shown_alike(of_segments: FloatArray, best: int) -> bool:
    """Whether segments of (d, s) likelihoods show a delay, and half of them this one: stamps have but one."""
    shown = of_segments[:, np.ptp(of_segments, axis=0) > _SHOWN]
    if shown.shape[1] < _LEAST_SEGMENTS:
        return False
    own = _LATES[np.argmax(shown, axis=0)]
    return bool((np.abs(own - _LATES[best]) < LEAST_DELAY).mean() >= 0.5)


def _jackknife(of_segments: FloatArray, best: int) -> float:
    """Standard deviation, s, of the delay of (d, s) likelihoods, by leaving out one segment at a time."""
    without = of_segments.sum(axis=1)[:, np.newaxis] - of_segments
    moved = _LATES[np.argmax(without, axis=0)] - _LATES[best]
    count = len(moved)
    return float(np.sqrt((count - 1) / count * np.sum(moved**2))) if count > 1 else float(_LATES[-1])


def judge(lates: list[Late], names: dict[str, str]) -> tuple[list[Cause], list[Undetermined]]:
    """The source that is late against the others; ``names``: topic of tracks, gyro, heading, fixes."""
    parties = sorted({one for late in lates for one in (late.first, late.second)})
    if len(parties) < 2:
        return [], []
    groups = {"tracks": "tracks", "gyro": "gyro", "heading": "fixes", "fixes": "fixes"}
    if names.get("heading") != names.get("fixes"):
        groups["heading"] = "heading"
    values: dict[tuple[str, str], tuple[float, float]] = {}
    for late in sorted(lates, key=lambda one: (not (one.gain is None and one.stddev < _FINE), one.stddev)):
        values.setdefault((groups[late.first], groups[late.second]), (late.value, late.stddev))
    off = {
        key: (value, stddev)
        for key, (value, stddev) in values.items()
        if abs(value) > max(LEAST_DELAY + _SURE * stddev, _CERTAIN * stddev)
    }
    if not off:
        return [], []
    scores = {}
    for party in {one for key in values for one in key}:
        with_it = [key for key in values if party in key]
        without = [key for key in values if party not in key]
        if all(key in off for key in with_it) and not any(key in off for key in without):
            scores[party] = len(with_it) + len(without)
    (best, *others) = sorted(scores, key=lambda p: -scores[p]) or [""]
    if not best:
        return [], []
    pairs = [key for key in values if best in key]
    if len(values) == 1:
        (a, b), (value, _) = next(iter(values.items()))
        what = (
            f"{b} is {abs(value):.2f} s "
            f"{'later' if value > 0.0 else 'earlier'} than {a}: which of them is off"
        )
        return [], [Undetermined(what, "record a third source (gyro or fixes) while turning left and right")]
    signed = [(values[key][0] if key[1] == best else -values[key][0], values[key][1]) for key in pairs]
    value, stddev = min(signed, key=lambda v: v[1])
    if others and scores[others[0]] == scores[best] and len(values) < 3:
        what = f"{best} is off by {abs(value):.2f} s against one other source only"
        return [], [Undetermined(what, "turn left and right by 90° once each with all sources recorded")]
    topic = names.get(best, best)
    evidence = (
        f"stamps of {topic} are {abs(value):.2f} ± {2.0 * stddev:.2f} s "
        f"{'later' if value > 0.0 else 'earlier'} than "
        "those of the other sources, which agree"
    )
    remedy = (
        f"In the mapping of {topic}: time_offset: {-value:.2f}; of a driver "
        f"the parameter time_offset less {value:.2f} s"
    )
    cause = Cause("source_delay", topic, evidence, odds_of(0.5 * ((abs(value) - 0.05) / stddev) ** 2), remedy)
    return [cause], []


def undelayed(log: Log, cause: Cause, value: float) -> Log:
    """The log with the stamps of a source made earlier by ``value`` s."""
    if cause.source == "sprockets":
        return replace(log, tracks=replace(log.tracks, t=log.tracks.t - value))
    gyros = tuple(replace(g, t=g.t - value) if g.name == cause.source else g for g in log.gyros)
    fixes = tuple(replace(f, t=f.t - value) if f.name == cause.source else f for f in log.fixes)
    compasses = tuple(replace(c, t=c.t - value) if c.name == cause.source else c for c in log.compasses)
    return replace(log, gyros=gyros, fixes=fixes, compasses=compasses)


def value_of(cause: Cause, lates: list[Late], names: dict[str, str]) -> Late:
    """The pair that shows a late source best, with the delay of that source."""
    party = {topic: name for name, topic in names.items() if topic}.get(cause.source, "")
    same = {"heading", "fixes"} if party in ("heading", "fixes") else {party}
    own = [late for late in lates if (late.first in same) != (late.second in same)]
    best = min(own, key=lambda late: (late.gain is not None and len(own) > 1, late.stddev))
    return best if best.second in same else replace(best, value=-best.value)
