# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Results that the demo reports as a shortfall."""

import pytest

from trackslip_sim.demo.results import Counts, shortfalls

GOOD = {"replay_matches": True, "soil": {"replay_matches": True}, "nees_position": 2.0}


@pytest.mark.parametrize(
    ("error", "nees", "missed"),
    [(0.1, 50.0, False), (0.2, 50.0, True), (0.3, 2.0, False), (None, None, True)],
)
def test_position_error_within_its_covariance_is_no_shortfall(error, nees, missed):
    """An error of 0.31 m after 250 s without a fix is within its covariance."""
    lines = shortfalls({**GOOD, "nees_position": nees, "rmse": {"filter": error}}, {})
    assert [line.split(":")[0] for line in lines] == ["position RMSE"] * missed


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"replay_matches": False}, "estimates are not the live ones"),
        ({"replay_matches": None}, "estimates are not the live ones"),
        ({"soil": {"replay_matches": False}}, "soil are not the live ones"),
    ],
)
def test_a_replay_that_differs_from_live_is_a_shortfall(change, words):
    (line,) = shortfalls({**GOOD, "rmse": {"filter": 0.01}, **change}, {})
    assert words in line


def test_lost_messages_are_a_shortfall():
    counts = {"scan": Counts(100, 98, 98), "sprockets": Counts(1000, 995, 1000)}
    (line,) = shortfalls({**GOOD, "rmse": {"filter": 0.01}}, counts)
    assert line.startswith("scan: 98.00 % received")
