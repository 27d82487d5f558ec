# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps: implausible units of time, and delays of the sources against each other.

Cross-correlation gives the delays of turn rates; the shape of the path gives that of fixes without headings.
If two sources agree and a third is delayed against both, the third is the cause.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.setup_check.delay import LARGEST_DELAY, correlate_rates
from trackslip_estimation.setup_check.drive import Drive
from trackslip_estimation.setup_check.finding import LEAST_LOG, PRIOR, READ_OFF, Cause, OpenQuestion, odds_of
from trackslip_estimation.setup_check.fit import path_delay_logs
from trackslip_estimation.setup_check.grid import tracks_of_speeds
from trackslip_estimation.setup_check.log import Fixes, Log
from trackslip_estimation.setup_check.path import thin_fixes

LEAST_DELAY = 0.15  # s; shorter ones may come from the ground's response, sensor filters or held values
_LONGER, _CERTAIN = 2.0, 4.0  # standard deviations: margin of a delay over LEAST_DELAY, and over zero
_FINE_STDDEV = 0.15  # s, standard deviation below which a delay by turn rates is preferred
_TRIED_DELAYS = np.arange(-2.0, 2.01, 0.1)  # s, delays that are tried by the shape of the path
_LENGTHS = (10.0, 20.0)  # s, of segments
_LEAST_SEGMENTS, _LEAST_LOG_RANGE = 5, 2.0  # segments that show a delay; least range of ln likelihood in each
TRACKS = "sprockets"
_LEAST_STAMPS, _SEVERAL, _EXACT = 10, 1.5, 1e-6  # stamps, readings per stamp, s
_PART, _MOST_PARTS, _LEAST_PARTS = 30.0, 60, 5  # s of the drive per delay; numbers of such parts
_LARGEST_PART_DELAY = 0.8 * LARGEST_DELAY  # s; beyond it the next part may show that of another turn, or none
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


@dataclass(frozen=True)
class SourceDelay:
    """Delay of the stamps of the second source after those of the first."""

    first: str  # topic
    second: str
    value: float  # s
    stddev: float  # s
    gain: float | None = None  # ln likelihood ratio over no delay; None: by turn rates


def correct_time_units(log: Log) -> tuple[Log, list[Cause]]:
    """The log in s, and the sources whose stamps were in another unit.

    A source in another unit than the tracks is left out: the origin of its stamps is unknown.
    """
    series = _source_stamps(log)
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


def _source_stamps(log: Log) -> list[tuple[str, str, FloatArray]]:
    """Topic, kind and stamps (n,), s, of each source."""
    series: list[tuple[str, str, FloatArray]] = [(TRACKS, "tracks", log.tracks.t)]
    series += [(g.name, "gyro", g.t) for g in log.gyros]
    return series + [(f.name, "fixes", f.t) for f in log.fixes]


def judge_fractions(log: Log) -> list[Cause]:
    """A cause for each source with several readings per stamp, where all stamps are whole seconds."""
    causes = []
    for name, _, t in _source_stamps(log):
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
    similar = {name for name, factor in factors.items() if factor == common}
    gyros = tuple(replace(g, t=scale(g.t)) for g in log.gyros if g.name in similar)
    fixes = tuple(replace(f, t=scale(f.t)) for f in log.fixes if f.name in similar)
    same_unit = similar | ({c.name for c in log.compasses} - factors.keys())
    compasses = tuple(replace(c, t=scale(c.t)) for c in log.compasses if c.name in same_unit)
    return replace(log, tracks=tracks, gyros=gyros, fixes=fixes, compasses=compasses)


def measure_delays(drive: Drive) -> list[SourceDelay]:
    """Delays between pairs of tracks, gyro, headings and fixes, as far as the drive shows them."""
    delays: list[SourceDelay] = []
    rates = _turn_rates(drive)
    for first, second in itertools.combinations(rates, 2):
        delay = correlate_rates(rates[first], rates[second], drive.grid.cell)
        if delay is not None:
            delays.append(SourceDelay(first, second, delay.value, delay.stddev))
    return delays + ([] if drive.fixes is None else _fix_delays(drive, drive.fixes, delays))


def _turn_rates(drive: Drive) -> dict[str, FloatArray]:
    """(m,) turn rates of tracks, gyro and headings, by topic, rad/s."""
    cell, (left, right) = drive.grid.cell, drive.grid.tracks.T
    rates = {TRACKS: (right - left) / drive.machine.tread / cell}
    if drive.gyro is not None:
        rates[drive.gyro.name] = drive.gyro_turn / cell
    if drive.compass is not None:
        rates.setdefault(drive.compass.name, np.clip(np.diff(drive.headings) / cell, -5.0, 5.0))
    return rates


def judge_drift(drive: Drive) -> tuple[list[Cause], list[OpenQuestion]]:
    """A clock that is fast or slow: the delay of one source against all others grows with time."""
    rates = _turn_rates(drive)
    drifts = {
        pair: drift
        for pair in itertools.combinations(rates, 2)
        if (drift := _drift(rates[pair[0]], rates[pair[1]], drive.grid.cell)) is not None
    }
    drifting = {pair: value for pair, (value, is_off) in drifts.items() if is_off}
    if not drifting:
        return [], []
    suspects = [source for source in rates if all((source in pair) == (pair in drifting) for pair in drifts)]
    (first, second), value = next(iter(drifting.items()))
    rate_text = f"by {abs(value) * 1e3:.1f} ms in each second, evenly"
    remedy = (
        "stamp its readings on arrival (mapping: stamp: log, or received), or set its clock by NTP or PTP"
    )
    if len(suspects) != 1:
        return [], [
            OpenQuestion(f"stamps of {first} and {second} drift apart {rate_text}", remedy, is_wrong=True)
        ]
    (name,) = suspects
    evidence = (
        f"stamps of {name} drift from those of the other sources {rate_text}: its clock is fast or slow"
    )
    return [Cause("source_delay", name, evidence, READ_OFF, remedy[0].upper() + remedy[1:])], []


def _drift(first: FloatArray, second: FloatArray, cell: float) -> tuple[float, bool] | None:
    """Drift of the second of two rates (m,) after the first, s/s, by delays of parts; its significance."""
    count = min(int(len(first) * cell / _PART), _MOST_PARTS)
    if count < _LEAST_PARTS:
        return None
    size = len(first) // count
    parts = [slice(k * size, (k + 1) * size) for k in range(count)]
    delays = [correlate_rates(first[part], second[part], cell) for part in parts]
    measured = [(k * size * cell, delay.value) for k, delay in enumerate(delays) if delay is not None]
    end = next(
        (k for k, (_, value) in enumerate(measured) if abs(value) > _LARGEST_PART_DELAY), len(measured)
    )
    if end < _LEAST_PARTS:
        return None
    t, values = np.array(measured[:end]).T
    centred = t - t.mean()
    slope = float(centred @ values / (centred @ centred))
    residual = np.hypot(np.std(values - slope * centred, ddof=2), 0.02)
    span, stddev = float(np.ptp(t)), float(residual / np.sqrt(centred @ centred))
    least = max(LEAST_DELAY + _LONGER * stddev * span, 2.0 * _CERTAIN * stddev * span)
    return slope, abs(slope) * span > least


def _fix_delays(drive: Drive, fixes: Fixes, delays: list[SourceDelay]) -> list[SourceDelay]:
    """Delays of fixes after dead reckoning by tracks; by tracks and gyro if these have no mutual delay."""
    gyro = drive.gyro.name if drive.gyro is not None else ""
    gyro_delay = next((delay for delay in delays if (delay.first, delay.second) == (TRACKS, gyro)), None)
    is_common = gyro_delay is not None and abs(gyro_delay.value) < LEAST_DELAY
    path, thin = drive.path if is_common else drive.track_path, thin_fixes(fixes, 0.3)
    candidates = [
        _delay_by_segments(path_delay_logs(path, thin, length, _TRIED_DELAYS), fixes) for length in _LENGTHS
    ]
    best = min(
        (delay for delay in candidates if delay is not None), key=lambda delay: delay.stddev, default=None
    )
    if best is None:
        return []
    if gyro_delay is None:
        return [best]
    stddev = float(np.hypot(best.stddev, gyro_delay.stddev))
    return [best, SourceDelay(gyro, fixes.name, best.value - gyro_delay.value, stddev, best.gain)]


def _delay_by_segments(segment_logs: FloatArray, fixes: Fixes) -> SourceDelay | None:
    """Delay by (d, s) likelihoods; None where the maximum is at an end of the search, or not significant."""
    logs = segment_logs.sum(axis=1)
    k = int(np.argmax(logs))
    if k in (0, len(_TRIED_DELAYS) - 1) or not _is_consistent(segment_logs, k):
        return None
    gain = float(logs[k] - logs[int(np.argmin(np.abs(_TRIED_DELAYS)))])
    if abs(_TRIED_DELAYS[k]) > LEAST_DELAY and gain < LEAST_LOG + PRIOR:
        return None
    near = np.flatnonzero(logs > logs[k] - 2.0)
    stddev = float(_TRIED_DELAYS[near[-1]] - _TRIED_DELAYS[near[0]]) / 4.0 + 0.03
    return SourceDelay(
        TRACKS, fixes.name, float(_TRIED_DELAYS[k]), max(stddev, _jackknife(segment_logs, k)), gain
    )


def _is_consistent(segment_logs: FloatArray, best: int) -> bool:
    """Whether enough segments of (d, s) likelihoods show a delay, and half of them the delay ``best``."""
    clear = segment_logs[:, np.ptp(segment_logs, axis=0) > _LEAST_LOG_RANGE]
    if clear.shape[1] < _LEAST_SEGMENTS:
        return False
    delays = _TRIED_DELAYS[np.argmax(clear, axis=0)]
    return bool((np.abs(delays - _TRIED_DELAYS[best]) < LEAST_DELAY).mean() >= 0.5)


def _jackknife(segment_logs: FloatArray, best: int) -> float:
    """Standard deviation, s, of the delay of (d, s) likelihoods, by leaving out one segment at a time."""
    without = segment_logs.sum(axis=1)[:, np.newaxis] - segment_logs
    deviations = _TRIED_DELAYS[np.argmax(without, axis=0)] - _TRIED_DELAYS[best]
    count = len(deviations)
    return (
        float(np.sqrt((count - 1) / count * np.sum(deviations**2))) if count > 1 else float(_TRIED_DELAYS[-1])
    )


def judge_delays(delays: list[SourceDelay]) -> tuple[list[Cause], list[OpenQuestion]]:
    """The source whose stamps are delayed against those of the others."""
    values: dict[tuple[str, str], tuple[float, float]] = {}
    for delay in sorted(
        delays, key=lambda delay: (not (delay.gain is None and delay.stddev < _FINE_STDDEV), delay.stddev)
    ):
        values.setdefault((delay.first, delay.second), (delay.value, delay.stddev))
    significant = {
        key: (value, stddev)
        for key, (value, stddev) in values.items()
        if abs(value) > max(LEAST_DELAY + _LONGER * stddev, _CERTAIN * stddev)
    }
    if not significant:
        return [], []
    topics = dict.fromkeys(topic for key in values for topic in key)
    suspects = [p for p in topics if all((p in key) == (key in significant) for key in values)]
    if not suspects:
        return [], []
    best = suspects[0]
    pairs = [key for key in values if best in key]
    if len(values) == 1:
        (a, b), (value, _) = next(iter(values.items()))
        what = (
            f"{b} is {abs(value):.2f} s "
            f"{'later' if value > 0.0 else 'earlier'} than {a}: which of them is off"
        )
        return [], [OpenQuestion(what, "record a third source (gyro or fixes) while turning left and right")]
    signed = [(values[key][0] if key[1] == best else -values[key][0], values[key][1]) for key in pairs]
    value, stddev = min(signed, key=lambda v: v[1])
    if len(suspects) > 1:
        what = f"{best} is off by {abs(value):.2f} s against one other source only"
        return [], [OpenQuestion(what, "turn left and right by 90° once each with all sources recorded")]
    evidence = (
        f"stamps of {best} are {abs(value):.2f} ± {2.0 * stddev:.2f} s "
        f"{'later' if value > 0.0 else 'earlier'} than those of the other sources, which agree"
    )
    remedy = (
        f"In the mapping of {best}: time_offset: {-value:.2f}; of a driver "
        f"the parameter time_offset less {value:.2f} s"
    )
    odds = odds_of(0.5 * ((abs(value) - 0.05) / stddev) ** 2)
    return [Cause("source_delay", best, evidence, odds, remedy)], []


def remove_delay(drive: Drive, delay: SourceDelay) -> Drive:
    """The drive with the delay taken off the stamps of the second source of a pair."""
    log, source, value = drive.log, delay.second, delay.value
    if source == TRACKS:
        return Drive(replace(log, tracks=replace(log.tracks, t=log.tracks.t - value)))
    gyros = tuple(replace(g, t=g.t - value) if g.name == source else g for g in log.gyros)
    fixes = tuple(replace(f, t=f.t - value) if f.name == source else f for f in log.fixes)
    compasses = tuple(replace(c, t=c.t - value) if c.name == source else c for c in log.compasses)
    return Drive(replace(log, gyros=gyros, fixes=fixes, compasses=compasses))


def most_precise_delay(source: str, delays: list[SourceDelay]) -> SourceDelay:
    """The pair with the most precise delay of a source, ordered with that source as its second."""
    of_source = [delay for delay in delays if source in (delay.first, delay.second)]
    best = min(of_source, key=lambda delay: (delay.gain is not None, delay.stddev))
    return (
        best
        if best.second == source
        else replace(best, first=best.second, second=best.first, value=-best.value)
    )
