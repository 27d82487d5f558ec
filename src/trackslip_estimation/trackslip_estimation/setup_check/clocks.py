# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Delays of the sources against each other, and clocks that are fast or slow.

Cross-correlation gives the delays of turn rates; the shape of the path gives that of fixes without headings.
If two sources agree and a third is delayed against both, the third is the cause.
"""

import itertools
from collections.abc import Collection, Mapping
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
from trackslip_estimation.setup_check.log import TRACKS, Fixes
from trackslip_estimation.setup_check.path import thin_fixes

LARGEST_DELAY = 2.0  # s, largest delay that is tried by the shape of the path
_LARGEST_RATE_DELAY = 3.0  # s, and by turn rates; those beyond it show as unrelated turns
_PIECE = 15.0  # s, length of a piece
_LEAST_PIECES = 3
_LEAST_CORRELATION = 0.5
LEAST_DELAY = 0.15  # s; shorter ones may come from the ground's response, sensor filters or held values
_LONGER, _CERTAIN = 2.0, 4.0  # standard deviations: margin of a delay over LEAST_DELAY, and over zero
_FINE_STDDEV = 0.15  # s, standard deviation below which a delay by turn rates is preferred
_TRIED_DELAYS = np.arange(-2.0, 2.01, 0.1)  # s, delays that are tried by the shape of the path
_LENGTHS = (10.0, 20.0)  # s, of segments
_LEAST_SEGMENTS, _LEAST_LOG_RANGE = 5, 2.0  # segments that show a delay; least range of ln likelihood in each
_LONGEST_LAG = 0.5  # s, of a machine behind its tracks, on ground that yields
_LONGEST_LATENCY = 1.0  # s, of any receiver; segments that show more agree that a clock is off
_PART, _MOST_PARTS, _LEAST_PARTS = 30.0, 60, 5  # s of the drive per delay; numbers of such parts
_LARGEST_PART_DELAY = 0.8 * LARGEST_DELAY  # s; beyond it the next part may show that of another turn, or none


@dataclass(frozen=True)
class SourceDelay:
    """Delay of the stamps of the second source after those of the first."""

    first: str  # topic
    second: str
    value: float  # s
    stddev: float  # s
    gain: float | None = None  # ln likelihood ratio over no delay; None: by turn rates


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
        is_apart = all(key in significant for key in values if not {*key} <= {*receiver})
        return ([_disagreement(significant)] if is_apart else []), ()
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


def _disagreement(delays: Mapping[tuple[str, str], tuple[float, float]]) -> OpenQuestion:
    """Delays, s ± s, between sources of which no two agree."""
    pairs = [f"{b} {value:+.2f} s after {a}" for (a, b), (value, _) in delays.items()]
    is_wrong = max(abs(value) for value, _ in delays.values()) > _LONGEST_LAG
    needed = "set time_offset of each source, or give all one clock"
    return OpenQuestion(f"stamps of which no two sources agree: {', '.join(pairs)}", needed, is_wrong)


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
    steps = round(_LARGEST_RATE_DELAY / cell)
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
    if total is None or total[1] < _LEAST_CORRELATION or abs(total[0]) >= _LARGEST_RATE_DELAY:
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
    stddev = float(np.sqrt((n - 1) / n * np.sum(np.square(deviations)))) if n > 1 else _LARGEST_RATE_DELAY
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
