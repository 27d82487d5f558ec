# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A publisher at an excessive rate uses only its share of a node's time, and none of other topics."""

import itertools

import pytest

from trackslip_common.rate_limiter import MAX_BURST, MAX_RATE, RateLimiter


@pytest.mark.parametrize("rate", [2000.0, 1e6])
def test_flood_is_limited_to_its_allowed_rate(rate: float) -> None:
    sent = 20_000
    limiter = RateLimiter(clock=(k / rate for k in itertools.count()).__next__)
    passed = sum(limiter.accept_message("scan") for _ in range(sent))
    assert passed == pytest.approx(min(MAX_BURST + sent / rate * MAX_RATE, sent), abs=2)
    assert limiter.dropped["scan"] == sent - passed


@pytest.mark.parametrize("rate", [0.5, 100.0, 1000.0])
def test_sensor_at_up_to_1_khz_is_never_dropped(rate: float) -> None:
    times = iter([*(k / rate for k in range(3000)), *(3000 / rate + 1.0 for _ in range(1000))])
    limiter = RateLimiter(clock=times.__next__)
    assert all(limiter.accept_message("sprockets") for _ in range(4000))
    assert limiter.new_drops() == {}


def test_flooded_topic_does_not_block_other_topics() -> None:
    limiter = RateLimiter(clock=lambda: 0.0)
    for _ in range(round(MAX_BURST)):
        assert limiter.accept_message("fix")
    assert not limiter.accept_message("fix")
    assert limiter.accept_message("heading")
    assert limiter.new_drops() == {"fix": 1}
    assert limiter.new_drops() == {}
    assert not limiter.accept_message("fix")
    assert limiter.new_drops() == {"fix": 1}
