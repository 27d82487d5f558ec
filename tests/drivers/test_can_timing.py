# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The measured cycle of a sender is correct on busy hosts and for senders that stall."""

from typing import Any

import numpy as np
import pytest

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.can_cycle import CycleMeter
from trackslip_drivers.protocols.can_timing import CountedFrames, TimingEvent, UncountedFrames

MS = 1_000_000
SENDER = ("sprockets", 0)  # name and address


def measured(nominal_ms, arrivals_ms):
    meter = CycleMeter(nominal_ms * MS)
    cycles = []
    for interval in np.diff(np.round(np.asarray(arrivals_ms) * MS).astype(int)):
        meter.add(int(interval), 1)
        cycles.append(meter.cycle_ns)
    return cycles


def busy(cycle_ms, count, seed):
    """Arrival times, ms, on a host that repeatedly falls behind by up to 2.5 cycles and catches up."""
    rng = np.random.default_rng(seed)
    times = np.arange(count) * cycle_ms + rng.exponential(0.1 * cycle_ms, count)
    for at in rng.choice(count, count // 15, replace=False):
        times[at : at + 5] = np.maximum(times[at : at + 5], times[at] + rng.uniform(0.2, 2.5) * cycle_ms)
    return np.maximum.accumulate(times)


def stalled():
    """Arrival times of a sender that stalls without catching up."""
    times = np.arange(1000) * 10.0
    for at in (100, 500, 501, 700):
        times[at:] += 150.0
    return times


BLOCKS = np.repeat([10.0, 10.0, 12.0, 12.0, 10.0], 32)  # the median of four lies between their values
KEPT = {
    **{f"busy host {seed}": busy(10.0, 3000, seed) for seed in range(3)},
    "stalled": stalled(),
    "no block equals the median": np.cumsum([0.0, *np.full(8, 10.0), *BLOCKS]),
}


@pytest.mark.parametrize("arrivals_ms", KEPT.values(), ids=KEPT)
def test_cycle_of_the_dbc_is_kept(arrivals_ms):
    """A late frame and the burst after it average out."""
    assert {cycle for cycle in measured(10.0, arrivals_ms) if cycle is not None} == {10.0 * MS}


@pytest.mark.parametrize("nominal_ms", [0.0, 10.0, 40.0])
def test_another_cycle_is_measured(nominal_ms):
    cycles = measured(nominal_ms, busy(20.0, 2000, 7))
    assert cycles[25:].count(None) == 0  # after half a second
    assert cycles[-1] == pytest.approx(20.0 * MS, rel=0.005)
    assert cycles[25] == pytest.approx(20.0 * MS, rel=0.2)


def test_cycle_is_measured_after_a_burst_of_100_frames():
    times = np.concatenate((np.arange(9) * 10.0, np.full(100, 80.0), 90.0 + np.arange(200) * 10.0))
    assert measured(10.0, times)[-1] == 10.0 * MS


def test_a_sender_that_changes_its_cycle_is_followed():
    times = np.concatenate((np.arange(200) * 10.0, 2000.0 + np.arange(300) * 50.0))
    cycles = measured(10.0, times)
    assert cycles[190] == 10.0 * MS
    assert cycles[-1] == pytest.approx(50.0 * MS)
    assert cycles.index(None, 200) < 225  # within a second or so


def counted(cycle_ns):
    """A ``CountedFrames`` with a counter modulo 16, and its counts of each event."""
    tally = Tally()
    return CountedFrames(cycle_ns, 16, tally, *SENDER), tally


@pytest.mark.parametrize("at_once", [2, 12, 17, 300])
@pytest.mark.parametrize("nominal_ms", [0.0, 10.0])
def test_burst_at_the_start_is_not_taken_for_the_cycle(nominal_ms, at_once):
    """The first frames wait on a busy host and are read together."""
    timing, tally = counted(nominal_ms * MS)
    arrivals = np.arange(at_once + 600) * 10 * MS
    arrivals[:at_once] = arrivals[at_once - 1] + np.arange(at_once) * 39_000 - at_once * 39_000
    timed = [timing.add(k % 16, int(at), k) for k, at in enumerate(arrivals)]
    assert not tally.total
    assert [frame.values for each in timed for frame in each] == list(range(len(arrivals)))
    assert timing.cycle_ns == pytest.approx(10 * MS, rel=0.001)


def test_wrong_cycle_is_corrected():
    """Thousands of frames at once resemble a fast sender; a second of normal frames resets the cycle."""
    timing, tally = counted(0.0)
    first = np.arange(2000) * 39_000
    arrivals = np.concatenate((first, first[-1] + np.arange(1, 400) * 10 * MS))
    for k, at in enumerate(arrivals):
        timing.add(k % 16, int(at), k)
    assert timing.cycle_ns == pytest.approx(10 * MS, rel=0.001)
    assert tally.total["sprockets", "lost"] < 110 * 256


def stalling_host(count, seed, interval_ms, longest_run_ms, longest_stall_ms):
    """Arrival times, ns, of a 10 ms cycle on a host that repeatedly stalls for 100 to ``longest_stall_ms``.

    Between stalls it runs for 20 to ``longest_run_ms`` and reads the backlog at ``interval_ms``.
    """
    rng = np.random.default_rng(seed)
    arrivals, now, next_stall = [], 0.0, 1000.0
    for number in range(count):
        now = max(10.0 * number, now + interval_ms * rng.uniform(0.5, 1.5))
        while now > next_stall:
            now = next_stall + rng.uniform(100.0, longest_stall_ms)
            next_stall = now + rng.uniform(20.0, longest_run_ms)
        arrivals.append(round(now * MS))
    return arrivals


@pytest.mark.parametrize(
    ("host", "max_off", "max_lost"),
    [
        ((0.2, 120.0, 350.0), 20, 320),
        ((3.0, 400.0, 350.0), 20, 320),
        ((0.7, 60.0, 800.0), 600, 3000),  # stalled for 90 % of the time, longer than one wrap of the counter
        ((3.0, 300.0, 800.0), 600, 3000),
    ],
)
@pytest.mark.parametrize("seed", range(2))
def test_backlog_of_a_stalled_host_is_not_taken_for_the_cycle(seed, host, max_off, max_lost):
    """The backlog arrives every 0.7 to 3 ms; the cycle is 10 ms."""
    timing, tally = counted(10.0 * MS)
    arrivals = stalling_host(6000, seed, *host)
    timed = [frame for number, at in enumerate(arrivals) for frame in timing.add(number % 16, at, number)]
    elapsed = np.array([frame.elapsed_ns for frame in timed[1:]]) / np.diff([frame.values for frame in timed])
    off = np.count_nonzero(np.abs(elapsed / (10.0 * MS) - 1.0) > 0.5)
    assert off <= max_off  # where the next stall began before the backlog was read
    assert tally.total["sprockets", "lost"] <= max_lost


def number_of(frame: Any) -> int:
    """Number of a frame; these tests use it as the frame's values."""
    return int(frame.values)


def test_loss_followed_by_a_stall_counts_the_lost_frames():
    """76 frames are lost; the next ones are some cycles late and then catch up."""
    timing, tally = counted(10.0 * MS)
    timed = []
    for number in (*range(100), *range(176, 220)):
        late = 1825.0 + 0.2 * (number - 176) if 176 <= number < 183 else 0.0
        timed += timing.add(number % 16, round(max(10.0 * number, late) * MS), number)
    assert tally.by_source() == {"sprockets": {"lost": 76}}
    assert (
        max(abs(frame.stamp_ns // MS - 10 * number_of(frame)) for frame in timed if number_of(frame) > 183)
        == 0
    )


def test_faster_sender_after_a_silence_is_not_held_back():
    """Frames less than half a cycle apart count as a burst only until they make up for the silence."""
    timing, _ = counted(10.0 * MS)
    timed = [timing.add(number % 16, 10 * number * MS, number) for number in range(100)]
    timed += [timing.add(number % 16, (1500 + 4 * (number - 100)) * MS, number) for number in range(100, 500)]
    assert sum(map(len, timed)) == 500
    assert max(len(each) for each in timed) < 100


@pytest.mark.parametrize("has_counter", [False, True])
def test_frames_held_back_at_a_reopening_are_counted(has_counter):
    timing, tally = counted(10.0 * MS)
    if not has_counter:
        timing = UncountedFrames(10.0 * MS, tally, *SENDER)
    timed = [timing.add(number % 16, 10 * number * MS, number) for number in (*range(100), 176)]
    assert sum(map(len, timed)) == 100
    timing.resume()
    assert tally.by_source() == {"sprockets": {TimingEvent.CUT_OFF.value: 1}}
