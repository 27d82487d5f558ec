# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How the demo scores a bag, and what it calls a miss."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from trackslip_bags.reader import open_bag
from trackslip_sim.demo.results import DemoResult, evaluate
from trackslip_sim.demo.show import report
from trackslip_tools.cli.live_command import with_estimates

BAG = Path(__file__).parents[2] / "bags" / "slalom_sand"


@pytest.mark.parametrize(
    ("error", "stated", "missed"),
    [(0.1, 0.01, False), (0.2, 0.01, True), (0.3, 0.3, False), (0.7, 0.3, True)],
)
def test_a_drive_out_of_sight_of_the_laser_failed_where_its_error_was_as_stated(error, stated, missed):
    """420 s of the thesis' scenario: 0.31 m, of 250 s without a fix, for which 0.31 m were stated."""
    of_position = np.diag((stated**2, stated**2, 1e-4)) / 2.0
    matching = SimpleNamespace(matches=True)
    result = DemoResult(
        vehicle="pc05",
        filter=SimpleNamespace(position=error),
        odometry={"covariance": np.tile(of_position, (5, 1, 1))},
        topics={},
        live=matching,
        soil=None,
        **dict.fromkeys(("dead_reckoning", "slip_rmse", "dead_reckoning_slip_rmse", "truth", "paths")),
        **dict.fromkeys(("slips", "true_slips", "of_bag", "before_s")),
    )
    (*lines,) = result.misses
    assert [line.split(":")[0] for line in lines] == ["position RMSE over the drive"] * missed


@pytest.fixture(scope="module")
def driven():
    """A bag as the demo leaves it, with what was estimated meanwhile."""
    with open_bag(BAG) as bag, with_estimates(bag) as both:
        yield both


@pytest.mark.parametrize("always", [True, False], ids=["all_the_way", "at_first"])
def test_a_drive_with_an_unknown_heading_ended_the_demo_with_a_traceback(driven, monkeypatch, capsys, always):
    """As where fixes without a heading, or hardly any, are all that the estimator gets."""
    known = evaluate(driven, {}, {}, driven.start_ns)
    stated = np.sqrt(known.odometry["covariance"][:, 2, 2])
    limit = 0.0 if always else (stated[0] + stated[-1]) / 2.0
    monkeypatch.setattr("trackslip_tools.replay.series.UNKNOWN_HEADING", limit)
    found = evaluate(driven, {}, {}, driven.start_ns)
    assert (found.filter.heading is None) == always
    assert found.filter.position == known.filter.position
    report(Console(), found)
    assert ("unknown" in capsys.readouterr().out) == always


def test_a_drive_without_an_estimate_ended_the_demo_with_a_traceback(driven):
    assert evaluate(driven, {}, {}, driven.end_ns + 1) is None
