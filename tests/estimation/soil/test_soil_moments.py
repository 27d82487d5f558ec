# SPDX-License-Identifier: Apache-2.0
"""What belongs to one stamp comes together in the order of stamps, whatever came first."""

import itertools

import numpy as np
import pytest

from trackslip_common.tally import Tally
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.moments import Moment, Moments
from trackslip_estimation.soil.records import Hydraulics, Odometry, Place, Refusal, Slips, SoilInput
from trackslip_estimation.soil.soil_parameters import load_soil_parameters

P = load_soil_parameters().moments
MS = 1_000_000


HERE = Place(np.zeros(3), 1e-6 * np.eye(3))


def odometry(ms: int, v_x: float = 0.3) -> Odometry:
    return Odometry(ms * MS, np.array((v_x, 0.0, 0.0)), 1e-6 * np.eye(3), HERE)


def slips(ms: int) -> Slips:
    return Slips(ms * MS, np.zeros(3), Motion.STRAIGHT)


def hydraulics(ms: int, pressure: float = 0.0) -> Hydraulics:
    return Hydraulics(ms * MS, pressure, -pressure, 0.1, 0.2)


def run(*inputs: SoilInput, moments: Moments | None = None) -> list[Moment]:
    moments = moments or Moments(P, Tally())
    return [m for given in inputs if moments.add(given) is None for m in moments.ready()]


def stamps(found: list[Moment]) -> list[int]:
    return [moment.stamp_ns // MS for moment in found]


def test_pressures_are_those_at_the_stamp_of_the_slips() -> None:
    found = run(hydraulics(100, 1e6), odometry(105), slips(105), hydraulics(110, 2e6))
    assert stamps(found) == [105]
    assert found[0].pressures is not None
    np.testing.assert_allclose(found[0].pressures.values, (1.5e6, -1.5e6))
    np.testing.assert_allclose(found[0].pressures.spools, (0.1, 0.2))


def test_every_order_of_arrival_gives_the_same_moments() -> None:
    """Per topic in order, between topics as they like."""
    topics = (
        [hydraulics(t, 1e4 * t) for t in (96, 106, 116)],
        [odometry(t) for t in (100, 110)],
        [slips(t) for t in (100, 110)],
    )
    order = [k for k, topic in enumerate(topics) for _ in topic]
    results = set()
    for arrangement in set(itertools.permutations(order)):
        queues = [iter(topic) for topic in topics]
        found = run(*(next(queues[k]) for k in arrangement))
        results.add(tuple((m.stamp_ns, m.pressures and tuple(m.pressures.values)) for m in found))
    assert len(results) == 1
    assert len(results.pop()) == 2


def test_silent_pressures_hold_nothing_up_for_longer_than_the_patience() -> None:
    pairs = [half for t in range(0, 1000, 10) for half in (odometry(t), slips(t))]
    found = run(hydraulics(-10), hydraulics(0), *pairs)
    assert stamps(found) == list(range(0, 1000 - round(P.patience * 1e3), 10))
    assert [m.pressures is None for m in found[:3]] == [False, True, True]


def test_a_gap_between_pressures_is_not_bridged() -> None:
    late = 100 + round(P.longest_gap * 1e3) + 1
    found = run(hydraulics(100), odometry(105), slips(105), hydraulics(late), odometry(late), slips(late))
    assert [m.pressures is None for m in found] == [True, False]


@pytest.mark.parametrize(
    ("inputs", "refusal"),
    [
        ([hydraulics(100), hydraulics(100)], Refusal.DUPLICATE),
        ([hydraulics(100), hydraulics(90)], Refusal.TOO_LATE),
        ([hydraulics(100), hydraulics(99_000)], Refusal.AHEAD),
        ([hydraulics(100, float("nan"))], Refusal.INVALID),
        ([odometry(100), odometry(100)], Refusal.DUPLICATE),
        ([odometry(100), slips(100), slips(100)], Refusal.DUPLICATE),
        ([odometry(100), slips(100), slips(90), odometry(90)], Refusal.TOO_LATE),
        ([odometry(100, float("inf"))], Refusal.INVALID),
        ([Odometry(0, np.zeros(3), np.diag((1.0, 1.0, -1.0)), HERE)], Refusal.INVALID),
    ],
)
def test_what_has_no_place_is_refused_and_counted(inputs: list[SoilInput], refusal: Refusal) -> None:
    tally = Tally()
    moments = Moments(P, tally)
    assert [moments.add(given) for given in inputs] == [None] * (len(inputs) - 1) + [refusal]
    assert tally.total == {(inputs[-1].source, refusal.value): 1}


def test_one_wild_stamp_does_not_stop_the_pressures() -> None:
    pairs = [x for t in range(0, 100, 10) for x in (odometry(t), slips(t), hydraulics(t + 4))]
    found = run(hydraulics(-6), hydraulics(10_000_000), *pairs)
    assert len(found) == 10
    assert all(m.pressures is not None for m in found)


def test_halves_without_the_other_are_given_up() -> None:
    tally = Tally()
    moments = Moments(P, tally)
    for t in range(0, 3000, 10):
        moments.add(odometry(t))
    assert tally.total == {("odometry", Refusal.UNPAIRED.value): 100}


def test_a_clock_set_back_begins_anew_once_it_is_believed() -> None:
    tally = Tally()
    moments = Moments(P, tally)
    times = [*range(1_000_000, 1_000_500, 10), *range(0, 1000, 10)]
    found = []
    for t in times:
        for given in (hydraulics(t), odometry(t), slips(t)):
            moments.add(given)
            found += moments.ready()
    assert tally.total["track_slip", Refusal.RESTARTED.value] == 1
    after = [m for m in found if m.stamp_ns < 1_000_000 * MS]
    assert stamps(after) == list(range(10 * (P.jump_confirmations - 1), 1000, 10))
    assert all(m.pressures is not None for m in after[1:])
