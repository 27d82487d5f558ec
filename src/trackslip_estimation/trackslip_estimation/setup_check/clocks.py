# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps: implausible units of time, and delays of the sources against each other.

Cross-correlation gives the delays of turn rates; the shape of the path gives that of fixes without headings.
If two sources agree and a third is delayed against both, the third is the cause.

A source on another clock than the tracks is delayed by more than ``LARGEST_DELAY``. Arrivals show that, or

    r(τ) = correlation of |v| by the tracks at t and |v| by the fixes at t + τ

with coarser steps. Neither signs nor units change r.
"""

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_estimation.setup_check.drive import Drive
from trackslip_estimation.setup_check.finding import (
    LEAST_LOG,
    PRIOR,
    READ_OFF,
    Cause,
    Finding,
    OpenQuestion,
    odds_of,
)
from trackslip_estimation.setup_check.fit import path_delay_logs
from trackslip_estimation.setup_check.grid import tracks_of_speeds
from trackslip_estimation.setup_check.log import Array, Fixes, Gyro, Log, Tracks
from trackslip_estimation.setup_check.path import thin_fixes

LARGEST_DELAY = 2.0  # s, largest delay that is tried
_PIECE = 15.0  # s, length of a piece
_LEAST_PIECES = 3
_LEAST_CORRELATION = 0.5
LEAST_DELAY = 0.15  # s; shorter ones may come from the ground's response, sensor filters or held values
_LONGER, _CERTAIN = 2.0, 4.0  # standard deviations: margin of a delay over LEAST_DELAY, and over zero
_FINE_STDDEV = 0.15  # s, standard deviation below which a delay by turn rates is preferred
_TRIED_DELAYS = np.arange(-2.0, 2.01, 0.1)  # s, delays that are tried by the shape of the path
_LENGTHS = (10.0, 20.0)  # s, of segments
_LEAST_SEGMENTS, _LEAST_LOG_RANGE = 5, 2.0  # segments that show a delay; least range of ln likelihood in each
TRACKS = "sprockets"
_LONGEST_LAG = 0.5  # s, of a machine behind its tracks, on ground that yields
_LONGEST_LATENCY = 1.0  # s, of any receiver; segments that show more agree that a clock is off
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
_LARGEST_SHIFT = 60.0  # s, largest delay that is tried
_OVERLAP = 0.75  # share of the readings that must overlap
_STEP, _WINDOW = 0.5, 2.0  # s, between delays; length of the window of a speed
_WIDTH = 4.0  # s about the maximum of r that belong to it
_LEAST_READINGS = 10
_LEAST_SEPARATION = 150.0  # s without readings: longer than outages, and than the data of a running check
_LEAST_SPEED_CORRELATION = 0.9  # spinning tracks lower it for right stamps too
_MOST_SPEED_CORRELATION = 0.999


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


def judge_drift(drive: Drive) -> list[Finding]:
    """A clock that is fast or slow: the delay of one source against all others grows with time."""
    rates = _turn_rates(drive)
    drifts = {
        pair: drift
        for pair in itertools.combinations(rates, 2)
        if (drift := _drift(rates[pair[0]], rates[pair[1]], drive.grid.cell)) is not None
    }
    drifting = {pair: value for pair, (value, is_off) in drifts.items() if is_off}
    if not drifting:
        return []
    suspects = [source for source in rates if all((source in pair) == (pair in drifting) for pair in drifts)]
    (first, second), value = next(iter(drifting.items()))
    rate_text = f"by {abs(value) * 1e3:.1f} ms in each second, evenly"
    remedy = (
        "stamp its readings on arrival (mapping: stamp: log, or received), or set its clock by NTP or PTP"
    )
    if len(suspects) != 1:
        what = f"stamps of {first} and {second} drift apart {rate_text}"
        return [OpenQuestion(what, remedy, is_wrong=True)]
    (name,) = suspects
    evidence = (
        f"stamps of {name} drift from those of the other sources {rate_text}: its clock is fast or slow"
    )
    return [Cause("source_delay", name, evidence, READ_OFF, remedy[0].upper() + remedy[1:])]


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
    """Whether enough segments of (d, s) likelihoods show a delay, and half of them the delay ``best``.

    A segment agrees with a delay beyond any latency if it shows one beyond any latency, to the same side.
    """
    clear = segment_logs[:, np.ptp(segment_logs, axis=0) > _LEAST_LOG_RANGE]
    if clear.shape[1] < _LEAST_SEGMENTS:
        return False
    delays, middle = _TRIED_DELAYS[np.argmax(clear, axis=0)], float(_TRIED_DELAYS[best])
    is_near = np.abs(delays - middle) < LEAST_DELAY
    if abs(middle) > _LONGEST_LATENCY:
        is_near |= delays * np.sign(middle) > _LONGEST_LATENCY
    return bool(is_near.mean() >= 0.5)


def _jackknife(segment_logs: FloatArray, best: int) -> float:
    """Standard deviation, s, of the delay of (d, s) likelihoods, by leaving out one segment at a time."""
    without = segment_logs.sum(axis=1)[:, np.newaxis] - segment_logs
    deviations = _TRIED_DELAYS[np.argmax(without, axis=0)] - _TRIED_DELAYS[best]
    count = len(deviations)
    return (
        float(np.sqrt((count - 1) / count * np.sum(deviations**2))) if count > 1 else float(_TRIED_DELAYS[-1])
    )


def judge_delays(
    delays: list[SourceDelay], receiver: Collection[str] = ()
) -> tuple[list[Finding], tuple[str, ...]]:
    """The source whose stamps are delayed against those of the others: finding, and its topics.

    ``receiver``: topics of one source, such as fixes and headings of two antennas. They have one clock.
    """
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
        return [], ()
    topics = dict.fromkeys(topic for key in values for topic in key)
    sources = dict.fromkeys([*((topic,) for topic in topics), tuple(t for t in receiver if t in topics)])
    suspects = [s for s in sources if all(_is_between(key, s) == (key in significant) for key in values)]
    if not suspects:
        return [], ()
    late, best = suspects[0], " and ".join(suspects[0])
    pairs = [key for key in values if _is_between(key, late)]
    if len(values) == 1:
        (a, b), (value, _) = next(iter(values.items()))
        what = (
            f"{b} is {abs(value):.2f} s "
            f"{'later' if value > 0.0 else 'earlier'} than {a}: which of them is off"
        )
        needed = "record a third source (gyro or fixes) while turning left and right"
        is_of_turns = any(delay.gain is None for delay in delays)  # not of a path, which errors of fixes bend
        return [OpenQuestion(what, needed, is_wrong=is_of_turns and _is_longer_than_lag(significant))], ()
    signed = [(values[key][0] if key[1] in late else -values[key][0], values[key][1]) for key in pairs]
    value, stddev = min(signed, key=lambda v: v[1])
    if len(suspects) > 1:
        what = f"{best} is off by {abs(value):.2f} s against one other source only"
        needed = "turn left and right by 90° once each with all sources recorded"
        return [OpenQuestion(what, needed, is_wrong=_is_longer_than_lag(significant))], ()
    evidence = (
        f"stamps of {best} are {abs(value):.2f} ± {2.0 * stddev:.2f} s "
        f"{'later' if value > 0.0 else 'earlier'} than those of the other sources, which agree"
    )
    remedy = (
        f"In the mapping of {best}: time_offset: {-value:.2f}; of a driver "
        f"the parameter time_offset less {value:.2f} s"
    )
    odds = odds_of(0.5 * ((abs(value) - 0.05) / stddev) ** 2)
    return [Cause("source_delay", late[0], evidence, odds, remedy)], late


def _is_longer_than_lag(delays: Mapping[tuple[str, str], tuple[float, float]]) -> bool:
    """Whether a machine that lags behind its tracks does not explain the delays, s ± s, of all pairs."""
    return any(TRACKS not in pair or abs(delay) > _LONGEST_LAG for pair, (delay, _) in delays.items())


def _is_between(pair: tuple[str, str], topics: Collection[str]) -> bool:
    """Whether a pair is of one of the topics and another one."""
    return (pair[0] in topics) != (pair[1] in topics)


def remove_delay(drive: Drive, value: float, topics: Collection[str]) -> Drive:
    """The drive with a delay, s, taken off the stamps of a source."""
    log = drive.log
    if TRACKS in topics:
        return Drive(replace(log, tracks=replace(log.tracks, t=log.tracks.t - value)))
    return Drive(log.with_stamps(lambda name, t: t - value if name in topics else t))


def most_precise_delay(topics: Collection[str], delays: list[SourceDelay]) -> SourceDelay:
    """The pair with the most precise delay of a source, ordered with that source as its second."""
    of_source = [delay for delay in delays if _is_between((delay.first, delay.second), topics)]
    best = min(of_source, key=lambda delay: (delay.gain is not None, delay.stddev))
    return (
        best
        if best.second in topics
        else replace(best, first=best.second, second=best.first, value=-best.value)
    )


class Delay(NamedTuple):
    """Delay of the second rate after the first."""

    value: float  # s
    stddev: float  # s


def correlate_rates(first: FloatArray, second: FloatArray, cell: float) -> Delay | None:
    """Delay between two rates (m,) on cells of ``cell`` s; None where they are not correlated."""
    steps = round(LARGEST_DELAY / cell)
    usable = np.isfinite(first) & np.isfinite(second)
    a, b = (_clip_spikes(np.where(usable, rates, 0.0)) for rates in (first, second))
    size = round(_PIECE / cell)
    count = (len(a) - 2 * steps) // size
    if count < _LEAST_PIECES:
        size = max((len(a) - 2 * steps) // _LEAST_PIECES, 1)
        count = _LEAST_PIECES if size * cell > 3.0 else 0
    if count < _LEAST_PIECES:
        return None
    shifts: IntArray = np.arange(-steps, steps + 1)
    cross = np.zeros((count, len(shifts)))
    energies = np.zeros((count, 2, len(shifts)))
    for k in range(count):
        at = steps + k * size + np.arange(size)
        reference = a[at] - a[at].mean()
        windows = b[at[:, np.newaxis] + shifts[np.newaxis, :]]
        windows = windows - windows.mean(axis=0)
        cross[k] = reference @ windows
        energies[k, 0], energies[k, 1] = reference @ reference, np.sum(windows**2, axis=0)
    total = _correlation_peak(cross.sum(axis=0), energies.sum(axis=0), shifts, cell)
    if total is None or total[1] < _LEAST_CORRELATION or abs(total[0]) >= LARGEST_DELAY:  # maximum at an end
        return None
    strong = energies[:, 0, 0] > 0.02 * energies[:, 0, 0].sum()
    if strong.sum() < 2:
        return None
    deviations: list[float] = []
    for k in np.flatnonzero(strong).tolist():
        others = np.arange(count) != k
        peak = _correlation_peak(cross[others].sum(axis=0), energies[others].sum(axis=0), shifts, cell)
        if peak is not None:
            deviations.append(peak[0] - total[0])
    n = len(deviations)
    stddev = float(np.sqrt((n - 1) / n * np.sum(np.square(deviations)))) if n > 1 else LARGEST_DELAY
    return Delay(total[0], max(stddev, 0.02))


def _clip_spikes(rates: FloatArray) -> FloatArray:
    """Rates, clipped so that jumps of poses do not dominate the correlation."""
    most = 1.5 * float(np.percentile(np.abs(rates), 98))
    return np.clip(rates, -most, most)


def _correlation_peak(
    cross: FloatArray, energy: FloatArray, shifts: IntArray, cell: float
) -> tuple[float, float] | None:
    """Shift of the maximum, s, interpolated between cells, and the correlation there; None without motion."""
    scale = np.sqrt(energy[0] * energy[1])
    if (scale <= 0.0).any():
        return None
    correlation = cross / scale
    k = int(np.argmax(correlation))
    part = 0.0 if k in (0, len(shifts) - 1) else maximum_between_steps(correlation, k)
    return (float(shifts[k]) + part) * cell, float(correlation[k])


def maximum_between_steps(values: FloatArray, k: int) -> float:
    """Offset, steps, from the largest of the values (n,), at ``k``, to the top of the parabola through it."""
    before, top, after = values[k - 1 : k + 2].tolist()
    curvature = before - 2.0 * top + after
    return float(0.5 * (before - after) / curvature) if curvature < 0.0 else 0.0


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
    compared = {TRACKS, *(g.name for g in log.gyros), *(f.name for f in log.fixes)}
    compared |= {compass.name for compass in log.compasses}
    delays = {name: delay for name, delay in log.arrival_delays.items() if name in compared}
    if TRACKS not in delays:
        return log, []

    def is_near(one: float, other: float) -> bool:
        return abs(one - other) < LARGEST_DELAY

    usual = max(delays.values(), key=lambda d: (sum(is_near(d, other) for other in delays.values()), -abs(d)))
    offsets = {name: delay - usual for name, delay in delays.items() if not is_near(delay, usual)}
    log = log.with_stamps(lambda name, t: t + offsets.get(name, 0.0) - offsets.get(TRACKS, 0.0))
    return log, [_arrival_cause(name, delays[name], usual) for name in offsets]


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
