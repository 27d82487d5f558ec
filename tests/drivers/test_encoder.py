# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A single encoder: wraps, silences, jumps, the noise of its velocity; its position for any motion."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_drivers.protocols.encoder import EncoderEvent, Motion, SprocketEncoder

COUNTS = 4096
CYCLE_S, CYCLE_NS = 0.01, 10_000_000
PER_COUNT = 2.0 * math.pi / (3 * COUNTS)
MAX_SPEED = 5.0  # rad/s


class Encoder:
    """A ``SprocketEncoder`` whose time is given in cycles."""

    def __init__(self, window=5):
        self._unit = SprocketEncoder(PER_COUNT, COUNTS, MAX_SPEED, window)

    def update(self, count, cycles):
        return self._unit.update(count, round(cycles * CYCLE_S * 1e9))


def test_positions_wrap_in_both_directions():
    unit = Encoder()
    assert unit.update(4090, 0) is EncoderEvent.STARTED
    forward = unit.update(4, 1)
    assert isinstance(forward, Motion)
    assert forward.position == pytest.approx(4100 * PER_COUNT)
    assert forward.velocity == pytest.approx(10 * PER_COUNT / CYCLE_S)
    back = unit.update(4090, 1)
    assert isinstance(back, Motion)
    assert back.position == pytest.approx(4090 * PER_COUNT)


def test_longer_gap_that_does_not_fit_the_speeds_around_it_has_no_position():
    unit = Encoder()
    unit.update(100, 0)
    unit.update(150, 1)
    assert unit.update(3000, 21) is EncoderEvent.RESTARTED  # 2850 or -1246 counts; 630 expected
    motion = unit.update(3010, 1)
    assert isinstance(motion, Motion)
    assert math.isnan(motion.position)
    assert motion.velocity == pytest.approx(10 * PER_COUNT / CYCLE_S)  # samples after the gap only
    positions = [unit.update(3010 + 10 * k, 1).position for k in (1, 2)]
    assert positions[1] - positions[0] == pytest.approx(10 * PER_COUNT)


@pytest.mark.parametrize("speed", [-3.0, 0.0, 0.4, 3.14])
@pytest.mark.parametrize("gap", [25, 60])
def test_silence_neither_adds_nor_loses_motion(speed, gap):
    """At steadily decreasing speed; the position after the silence is the true one."""
    unit, position, cycle = Encoder(), 7.0, 0
    last = None
    for k in range(40):
        cycles = gap if k == 20 else 1
        cycle += cycles
        v = speed * (1.0 - 0.3 * k / 40)
        position += v * cycles * CYCLE_S
        motion = unit.update(math.floor(position / PER_COUNT) % COUNTS, cycles)
        if isinstance(motion, Motion):
            offset = motion.position - position
            assert last is None or abs(offset - last) < 2.0 * PER_COUNT
            last = offset
    assert last is not None


def test_a_silence_of_seconds_is_not_bridged():
    unit = Encoder()
    for k in range(10):
        unit.update(40 * k, 1)
    unit.update(2000, 200)
    assert math.isnan(unit.update(2040, 1).position)


def test_a_single_jump_is_dropped_and_a_persistent_one_restarts():
    unit = Encoder()
    unit.update(0, 0)
    assert unit.update(2000, 1) is EncoderEvent.JUMP
    motion = unit.update(4, 1)
    assert isinstance(motion, Motion)
    assert motion.position == pytest.approx(4 * PER_COUNT)
    events = [unit.update(2004, 1) for _ in range(25)]
    assert events[0] is EncoderEvent.JUMP
    assert events.count(EncoderEvent.RESTARTED) == 1
    after = events[events.index(EncoderEvent.RESTARTED) + 1 :]
    assert math.isnan(after[0].position)  # the rotation before the restart is unknown
    assert after[-1].velocity == 0.0
    assert not math.isnan(after[-1].position)


@pytest.mark.parametrize("window", [2, 5])
def test_velocity_variance_is_as_stated(window):
    rng = np.random.default_rng(7)
    errors = []
    for _ in range(2000):
        speed = rng.uniform(-4.0, 4.0)
        position = rng.uniform(0.0, 1e3) + speed * CYCLE_S * np.arange(window)
        unit = Encoder(window)
        for k, value in enumerate(position):
            motion = unit.update(math.floor(value / PER_COUNT) % COUNTS, min(k, 1))
        assert isinstance(motion, Motion)
        errors.append(motion.velocity - speed)
    stated = PER_COUNT**2 / (window * (window**2 - 1) * CYCLE_S**2)
    assert np.var(errors) == pytest.approx(stated, rel=0.15)


LONGEST_GAP = 20  # cycles; half an encoder turn takes 20.9 cycles at the maximum speed


@given(
    st.floats(-1e4, 1e4),
    st.lists(
        st.tuples(st.floats(-MAX_SPEED, MAX_SPEED), st.integers(1, LONGEST_GAP)), min_size=1, max_size=60
    ),
    st.integers(2, 8),
)
def test_position_follows_the_truth(start, legs, window):
    unit = SprocketEncoder(PER_COUNT, COUNTS, MAX_SPEED, window)
    unit.update(math.floor(start / PER_COUNT) % COUNTS, 0)
    truth = start
    origin = (math.floor(start / PER_COUNT) % COUNTS) * PER_COUNT
    for speed, cycles in legs:
        truth += speed * cycles * CYCLE_S
        motion = unit.update(math.floor(truth / PER_COUNT) % COUNTS, cycles * CYCLE_NS)
        assert isinstance(motion, Motion)
        assert abs((motion.position - origin) - (truth - start)) < 1.001 * PER_COUNT
        assert abs(motion.velocity) <= 1.5 * MAX_SPEED + PER_COUNT / CYCLE_S


@given(st.lists(st.tuples(st.integers(0, COUNTS - 1), st.integers(1, 100)), max_size=100))
def test_any_counts_give_finite_motion(readings):
    unit = SprocketEncoder(PER_COUNT, COUNTS, MAX_SPEED, 5)
    for count, cycles in readings:
        motion = unit.update(count, cycles * CYCLE_NS)
        if isinstance(motion, Motion):
            assert not math.isinf(motion.position)
            assert math.isfinite(motion.velocity)
