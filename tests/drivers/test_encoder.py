# SPDX-License-Identifier: Apache-2.0
"""One encoder: wraps, silences, jumps, and the noise of its velocity."""

import math

import numpy as np
import pytest

from trackslip_drivers.protocols.encoder import COUNTS, EncoderEvent, Motion, SprocketEncoder

CYCLE_S = 0.01
PER_COUNT = 2.0 * math.pi / (3 * COUNTS)


def encoder(window=5, max_speed=5.0):
    return SprocketEncoder(3.0, max_speed, window, CYCLE_S)


def test_wraps_both_ways():
    unit = encoder()
    assert unit.update(4090, 0) is EncoderEvent.STARTED
    forward = unit.update(4, 1)
    assert isinstance(forward, Motion)
    assert forward.position == pytest.approx(4100 * PER_COUNT)
    assert forward.velocity == pytest.approx(10 * PER_COUNT / CYCLE_S)
    back = unit.update(4090, 1)
    assert isinstance(back, Motion)
    assert back.position == pytest.approx(4090 * PER_COUNT)


def test_one_sprocket_turn_is_three_of_the_encoder():
    unit = encoder()
    unit.update(0, 0)
    for k in range(1, 3 * 64 + 1):
        motion = unit.update(64 * k % COUNTS, 1)
    assert isinstance(motion, Motion)
    assert motion.position == pytest.approx(2.0 * math.pi)


def test_gap_shorter_than_half_a_turn_is_bridged():
    unit = encoder()
    unit.update(0, 0)
    motion = unit.update(1900, 20)  # 0.2 s at 4.86 rad/s
    assert isinstance(motion, Motion)
    assert motion.position == pytest.approx(1900 * PER_COUNT)
    assert motion.velocity == pytest.approx(1900 * PER_COUNT / 0.2)


def test_longer_gap_restarts_where_it_was():
    unit = encoder()
    unit.update(100, 0)
    unit.update(150, 1)
    assert unit.update(3000, 21) is EncoderEvent.RESTARTED
    motion = unit.update(3010, 1)
    assert isinstance(motion, Motion)
    assert motion.position == pytest.approx(160 * PER_COUNT)
    assert motion.velocity == pytest.approx(10 * PER_COUNT / CYCLE_S)  # nothing of before the gap


def test_jump_is_dropped_and_a_lasting_one_restarts():
    unit = encoder()
    unit.update(0, 0)
    assert unit.update(2000, 1) is EncoderEvent.JUMP
    motion = unit.update(4, 1)
    assert isinstance(motion, Motion)
    assert motion.position == pytest.approx(4 * PER_COUNT)
    events = [unit.update(2004, 1) for _ in range(25)]
    assert events[0] is EncoderEvent.JUMP
    assert EncoderEvent.RESTARTED in events
    assert isinstance(events[-1], Motion)
    assert events[-1].velocity == 0.0


@pytest.mark.parametrize("window", [2, 3, 5, 8])
def test_velocity_variance_is_as_stated(window):
    rng = np.random.default_rng(7)
    errors = []
    for _ in range(4000):
        speed = rng.uniform(-4.0, 4.0)
        position = rng.uniform(0.0, 1e3) + speed * CYCLE_S * np.arange(window)
        unit = encoder(window)
        for k, value in enumerate(position):
            motion = unit.update(math.floor(value / PER_COUNT) % COUNTS, min(k, 1))
        assert isinstance(motion, Motion)
        errors.append(motion.velocity - speed)
    stated = PER_COUNT**2 / (window * (window**2 - 1) * CYCLE_S**2)
    assert np.var(errors) == pytest.approx(stated, rel=0.1)
