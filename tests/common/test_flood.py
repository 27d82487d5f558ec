# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A publisher at an excessive rate uses only its share of a node's time, and none of other topics."""

import itertools

import pytest

from trackslip_common.flood import BURST, MOST, FloodGuard


@pytest.mark.parametrize("rate", [2000.0, 10_000.0, 1e6])
def test_flood_is_limited_to_its_allowed_rate(rate: float) -> None:
    sent = 400_000
    guard = FloodGuard(clock=(k / rate for k in itertools.count()).__next__)
    passed = sum(guard.lets_pass("scan") for _ in range(sent))
    assert passed == pytest.approx(min(BURST + sent / rate * MOST, sent), abs=2)
    assert guard.dropped["scan"] == sent - passed


@pytest.mark.parametrize("rate", [0.5, 100.0, 1000.0])
def test_sensor_at_up_to_1_khz_is_never_dropped(rate: float) -> None:
    times = iter([*(k / rate for k in range(3000)), *(3000 / rate + 1.0 for _ in range(1000))])
    guard = FloodGuard(clock=times.__next__)
    assert all(guard.lets_pass("sprockets") for _ in range(4000))
    assert guard.news() == {}


def test_flooded_topic_does_not_block_other_topics() -> None:
    guard = FloodGuard(clock=lambda: 0.0)
    for _ in range(round(BURST)):
        assert guard.lets_pass("fix")
    assert not guard.lets_pass("fix")
    assert guard.lets_pass("heading")
    assert guard.news() == {"fix": 1}
    assert guard.news() == {}
    assert not guard.lets_pass("fix")
    assert guard.news() == {"fix": 1}
