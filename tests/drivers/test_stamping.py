# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Filtered stamps are never worse than raw ones, tolerate steps of the host's clock, and stay ordered."""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_drivers.stamping import HostTime, MonotonicStamps, PeriodicStamps, ReadMonitor
from trackslip_drivers.transports.host_clock import HostClock

MS = 1_000_000
S = 1_000_000_000
PERIOD = 10 * MS
TOLERANCE = 1e-3


def filtered(raw, cycles=None):
    stamps = PeriodicStamps(PERIOD, TOLERANCE, patience=200)
    counts = [None] * len(raw) if cycles is None else cycles
    return np.array([stamps.filter(int(r), c) for r, c in zip(raw, counts, strict=True)])


@given(
    delays=st.lists(st.integers(0, 200 * MS), min_size=2, max_size=80),
    lost=st.lists(st.integers(0, 20), min_size=80, max_size=80),
    drift=st.floats(-TOLERANCE, TOLERANCE),
)
def test_stamps_with_counted_cycles_are_never_later_than_raw_ones(delays, lost, drift):
    cycles = [0] + [1 + n for n in lost[: len(delays) - 1]]
    true = np.cumsum(np.array(cycles) * PERIOD * (1.0 + drift))
    raw = np.ceil(true) + delays
    stamps = filtered(raw, cycles)
    assert (stamps <= raw).all()
    assert (stamps >= true - 1.0).all()  # rounding: 1 ns


@given(
    delays=st.lists(st.integers(0, PERIOD // 2 - MS), min_size=2, max_size=80),
    lost=st.lists(st.integers(0, 9), min_size=80, max_size=80),
)
def test_stamps_with_short_delays_are_never_worse_than_raw_ones(delays, lost):
    true = np.cumsum([(1 + n) * PERIOD for n in lost[: len(delays)]])
    raw = true + delays
    stamps = filtered(raw)
    assert ((true <= stamps) & (stamps <= raw)).all()


def recorded_like(rng, count):
    """Delays on a busy host, ns: short, with occasional stalls that end in a burst."""
    delays = rng.exponential(0.4 * MS, count)
    for begin in rng.integers(0, count, count // 100):
        stall = rng.uniform(5, 60) * MS
        for k in range(begin, min(count, begin + int(stall // PERIOD) + 1)):
            delays[k] = max(delays[k], stall - (k - begin) * PERIOD)
    return delays.astype(np.int64)


def test_recorded_jitter_is_removed():
    rng, drift = np.random.default_rng(1), 1e-4
    true = (np.arange(3000) * PERIOD * (1.0 + drift)).astype(np.int64)
    delays = recorded_like(rng, len(true))
    assert np.percentile(delays, 99) > 20 * MS
    errors = filtered(true + delays, [0] + [1] * (len(true) - 1)) - true
    assert (errors <= delays).all()
    assert np.percentile(errors, 99) < 0.5 * MS


def test_wrong_period_is_detected():
    """At a period 1 % longer than configured the filter runs ahead for at most 200 periods (patience)."""
    true = (np.arange(3000) * PERIOD * 1.01).astype(np.int64)
    errors = filtered(true) - true
    assert errors.min() >= -200 * PERIOD * 0.01
    assert (errors == 0).sum() >= 3000 // 201


def test_a_sender_that_restarts_is_followed():
    stamps = PeriodicStamps(PERIOD, TOLERANCE, patience=200)
    for k in range(100):
        stamps.filter(k * PERIOD, 1)
    assert stamps.filter(100 * PERIOD + 3 * MS, 0) == 100 * PERIOD + 3 * MS  # 0: the count restarted
    assert stamps.filter(120 * PERIOD + 4 * MS, 20) == 120 * PERIOD + 4 * MS  # too long after the last stamp
    stamps.restart()
    assert stamps.filter(121 * PERIOD + 9 * MS, 1) == 121 * PERIOD + 9 * MS


class Clocks:
    """A host clock, a steady clock, and the driver's ``HostTime`` of both."""

    def __init__(self):
        self.steady_ns = 5 * S
        self.offset_ns = 1_700_000_000 * S
        self.time = HostTime(self.offset_ns, self.steady_ns)
        self.order = MonotonicStamps()
        self.stamps = []
        self.jumps = 0

    def run(self, seconds, slew=0.0):
        for _ in range(round(seconds * 100)):
            self.steady_ns += PERIOD
            self.offset_ns += round(slew * PERIOD)
            self.jumps += self.time.update_offset(self.steady_ns + self.offset_ns, self.steady_ns)
            arrival = self.time.steady_time(
                self.steady_ns + self.offset_ns - MS, (self.steady_ns - PERIOD, self.steady_ns)
            )
            assert arrival == self.steady_ns - MS
            self.stamps.append(self.order.next_stamp(self.time.stamp(arrival)))

    def ahead(self):
        """Last stamp minus the host's time at that arrival, ns."""
        return self.stamps[-1] - (self.steady_ns - MS + self.offset_ns)


@pytest.mark.parametrize("jump_s", [-3600.0, -0.03, 0.03, 86400.0])
def test_clock_jump_is_detected_and_stamps_stay_in_order(jump_s):
    clocks = Clocks()
    clocks.run(1.0)
    clocks.offset_ns += round(jump_s * S)
    clocks.run(1.0)
    assert clocks.jumps == 1
    steps = np.diff(clocks.stamps)
    assert (steps > 0).all()
    assert (np.delete(steps, 99) == PERIOD).all()  # all steps except the one across the clock jump
    assert clocks.ahead() == max(0, round(-jump_s * S))
    clocks.offset_ns -= round(jump_s * S)
    clocks.run(1.0)
    assert (np.diff(clocks.stamps) > 0).all()
    assert clocks.ahead() == max(0, round(jump_s * S))


def test_slewed_clock_is_followed_without_a_jump():
    for slew in (-5e-4, 5e-4):
        clocks = Clocks()
        clocks.run(20.0, slew)
        assert clocks.jumps == 0
        assert clocks.ahead() == 0


def test_arrival_from_before_a_jump_is_stamped_now():
    clocks = Clocks()
    clocks.run(0.1)
    for jump in (-10 * S, 20 * S):
        stale_ns = clocks.steady_ns + clocks.offset_ns - MS
        clocks.offset_ns += jump
        clocks.time.update_offset(clocks.steady_ns + clocks.offset_ns, clocks.steady_ns)
        between_ns = clocks.steady_ns - 5 * PERIOD, clocks.steady_ns
        assert clocks.time.steady_time(stale_ns, between_ns) == clocks.steady_ns


@pytest.mark.parametrize(
    ("stated_age_ns", "empty_since_ns", "age_ns"), [(5 * S, 6 * S, 5 * S), (900 * MS, PERIOD, 0)]
)
def test_arrival_keeps_its_time_only_if_the_port_was_empty_before(stated_age_ns, empty_since_ns, age_ns):
    """A reader may be seconds late. An earlier stamp is replaced by now."""
    clocks = Clocks()
    clocks.run(10.0)
    stated_ns = clocks.steady_ns - stated_age_ns + clocks.offset_ns
    between_ns = clocks.steady_ns - empty_since_ns, clocks.steady_ns
    assert clocks.time.steady_time(stated_ns, between_ns) == clocks.steady_ns - age_ns


def test_data_count_as_delayed_until_a_suspended_reader_empties_the_port():
    monitor = ReadMonitor(0)
    for step_ns in (10 * S, 10 * S + 90 * MS):  # duration of an opening; a wait without data
        monitor.record_step(step_ns)
    monitor.record_empty_port()
    assert monitor.emptied_ns == 10 * S + 90 * MS
    assert not monitor.was_suspended
    for read_ns in (12 * S, 12 * S + MS):
        monitor.record_step(read_ns)
        assert monitor.emptied_ns == 10 * S + 90 * MS
        assert monitor.can_be_delayed(read_ns - MS, read_ns)  # apparently new data
        assert not monitor.can_be_delayed(read_ns - S, read_ns)  # data with an arrival time of their own
    monitor.record_empty_port()
    assert not monitor.can_be_delayed(12 * S, 12 * S + MS)


def test_stamps_are_ordered_by_the_smallest_shift():
    order = MonotonicStamps()
    assert [order.next_stamp(stamp) for stamp in (5, 3, 6, 6, 10)] == [5, 6, 7, 8, 10]


def test_host_clock_sees_the_host_set_back(monkeypatch):
    clock, before_ns = HostClock(), time.monotonic_ns()
    real = time.time_ns
    steady, jumped = zip(*(clock.arrival(real(), before_ns) for _ in range(3)), strict=True)
    assert not any(jumped)
    before = clock.stamp(steady[-1])
    monkeypatch.setattr(time, "time_ns", lambda: real() - 60 * S)
    steady, jumped = zip(*(clock.arrival(time.time_ns(), before_ns) for _ in range(20)), strict=True)
    assert sum(jumped) == 1
    after = clock.stamp(steady[-1])
    assert 0 < after - before < 20 * S
    assert clock.lead_ns == pytest.approx(60 * S, abs=S)


@pytest.mark.parametrize("silence_ms", [10, 400])
def test_interrupted_clock_reading_keeps_the_arrival_time(monkeypatch, silence_ms):
    """The process is interrupted between two clock readings, after a while without data."""
    now = {"steady": 5 * S, "busy": 0}

    def monotonic_ns():
        now["steady"] += now["busy"]
        return now["steady"]

    monkeypatch.setattr(time, "monotonic_ns", monotonic_ns)
    monkeypatch.setattr(time, "time_ns", lambda: now["steady"] + 1_700_000_000 * S)
    clock = HostClock()
    arrived_ns = now["steady"] = now["steady"] + silence_ms * MS
    host_ns = time.time_ns()
    now["busy"] = 3 * MS
    assert clock.arrival(host_ns, 5 * S) == (arrived_ns, False)
