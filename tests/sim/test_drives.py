# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Random drives of random machines: four of the forty of ``make drives``, and their generator."""

import numpy as np
import pytest
from fixtures.demo_bars import LIMITS, header
from fixtures.random_drives.drive import random_drive
from fixtures.random_drives.main import missed_bars, parameters, row, scored
from fixtures.random_drives.score import Score

from trackslip_sim.machine.drawn import DrawnMachine, MotionErrors, integrate_twists


@pytest.mark.slow
def test_an_untuned_estimator_is_consistent_on_drawn_machines() -> None:
    scores = [scored(seed)[2] for seed in range(4)]
    assert missed_bars(scores) == []
    assert sum(len(s.ends) for s in scores) >= 4  # minutes without fixes
    assert max(s.rejected_in_a_row for s in scores) <= 3


def test_tables_fit_a_terminal() -> None:
    """The tables of ``make bars`` and ``make drives``."""
    ends = np.array((10.21, 1.23, 0.27))
    score = Score(0.0123, 12.34, 10.1, np.array((10.4, 0.2, 1.7)), ends, ends, 3)
    lines = [
        *header(list(vars(LIMITS))).splitlines(),
        *row(39, "clayey_soil", DrawnMachine(), score).splitlines(),
    ]
    assert max(map(len, lines)) <= 80


def test_seed_reproduces_a_drive() -> None:
    p = parameters()
    one, same, other = (random_drive(seed, p, 8.0) for seed in (5, 5, 6))
    assert one.measurements.tobytes() == same.measurements.tobytes()
    assert one.machine == same.machine != other.machine
    assert one.poses.shape[1] == 3
    assert one.t[-1] == pytest.approx(8.0)


def test_machine_without_drawn_errors_moves_as_its_nominal_truth() -> None:
    errors = MotionErrors(DrawnMachine(), 0.73, 0.005, np.random.default_rng(0))
    twists = np.tile((0.4, -0.01, 0.1), (200, 1))
    assert np.array_equal(errors.apply(np.tile((0.4, 0.5), (200, 1)), twists), twists)


def test_velocity_errors_have_the_size_that_is_drawn() -> None:
    machine, V = DrawnMachine(velocity_errors=5.0), 0.4
    errors = MotionErrors(machine, 0.73, 0.005, np.random.default_rng(0))
    tracks = np.full((200_000, 2), V)
    drawn = errors.apply(tracks, np.zeros((200_000, 3)))[1000:]
    assert drawn[:, 0].std() == pytest.approx(np.sqrt(24.0) * 0.0024 * V, rel=0.1)
    assert drawn[:, 2].std() == pytest.approx(np.sqrt(24.0) * 0.001 * V / 0.73, rel=0.1)


def test_a_circle_closes() -> None:
    twists = np.tile((0.5, 0.0, 0.25), (1000, 1))
    poses = integrate_twists(twists, 2.0 * np.pi / 0.25 / 1000, np.array((1.0, 2.0, 0.0)))
    assert poses[-1] == pytest.approx((1.0, 2.0, 2.0 * np.pi), abs=1e-9)


def test_each_missed_bar_is_reported() -> None:
    bad = Score(0.1, 9.0, 6.0, np.array((3.5,)), np.array((20.0, 20.0)), np.array((1.0, 1.0)), 9)
    reported = missed_bars([bad])
    assert len(reported) == 4
    assert all("accepted" in text for text in reported)
