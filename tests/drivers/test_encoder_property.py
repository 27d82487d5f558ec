# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The unwrapped position follows a continuous truth for any motion and any lost frames."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_drivers.protocols.encoder import Motion, SprocketEncoder

COUNTS = 4096
CYCLE_S, CYCLE_NS = 0.01, 10_000_000
PER_COUNT = 2.0 * math.pi / (3 * COUNTS)
MAX_SPEED = 5.0
LONGEST_GAP = 20  # cycles; half an encoder turn takes 20.9 cycles at the maximum speed
seeded = settings(derandomize=True, max_examples=200, deadline=None)


@seeded
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


@seeded
@given(st.floats(-MAX_SPEED, MAX_SPEED), st.integers(2, 8), st.data())
def test_velocity_of_steady_motion(speed, window, data):
    unit = SprocketEncoder(PER_COUNT, COUNTS, MAX_SPEED, window)
    cycle = 0
    for _ in range(20):
        step = data.draw(st.integers(1, 5))
        cycle += step
        motion = unit.update(math.floor(speed * cycle * CYCLE_S / PER_COUNT) % COUNTS, step * CYCLE_NS)
    assert isinstance(motion, Motion)
    assert abs(motion.velocity - speed) <= 1.001 * PER_COUNT / CYCLE_S


@seeded
@given(st.lists(st.tuples(st.integers(0, COUNTS - 1), st.integers(1, 100)), max_size=100))
def test_any_counts_give_finite_motion(readings):
    unit = SprocketEncoder(PER_COUNT, COUNTS, MAX_SPEED, 5)
    for count, cycles in readings:
        motion = unit.update(count, cycles * CYCLE_NS)
        if isinstance(motion, Motion):
            assert not math.isinf(motion.position)
            assert math.isfinite(motion.velocity)
