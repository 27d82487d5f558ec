# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What belongs to one stamp comes together in the order of stamps, whatever came first."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.parameter_record import record_of
from trackslip_estimation.soil.records import (
    ACCEPTED,
    SOIL_INPUT,
    Hydraulics,
    Odometry,
    PoseWithCovariance,
    Rejection,
    Slips,
    SoilInput,
    Swing,
)
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_estimation.soil.time_synchronizer import SAMPLE, add, is_ready, new_synchronizer, pop_oldest

P = load_soil_parameters().moments
NUMBERS = record_of(P)
MS = 1_000_000


HERE = PoseWithCovariance(np.zeros(3), 1e-6 * np.eye(3))


def odometry(ms: int, v_x: float = 0.3) -> Odometry:
    return Odometry(ms * MS, np.array((v_x, 0.0, 0.0)), 1e-6 * np.eye(3), HERE)


def slips(ms: int) -> Slips:
    return Slips(ms * MS, np.zeros(3), Motion.STRAIGHT)


def hydraulics(ms: int, pressure: float = 0.0) -> Hydraulics:
    return Hydraulics(ms * MS, pressure, -pressure, 0.1, 0.2)


def swing(ms: int, angle: float = 0.5) -> Swing:
    return Swing(ms * MS, angle, 0.01)


class Inbox:
    """A synchronizer, and what has come of it."""

    def __init__(self, awaits_swings: bool = False) -> None:
        self._synchronizer = new_synchronizer(awaits_swings)

    @property
    def rejected(self) -> dict[tuple[str, Rejection], int]:
        return {(source, why): n for source, why, n in self._synchronizer.rejected() if n}

    def add(self, given: SoilInput) -> Rejection | None:
        record = np.zeros(1, SOIL_INPUT)
        given.write_to(record[0])
        found = add(self._synchronizer, record[0], NUMBERS[0])
        return None if found == ACCEPTED else tuple(Rejection)[found]

    def ready(self) -> list[np.void]:
        found = []
        while is_ready(self._synchronizer, NUMBERS[0]):
            sample = np.zeros(1, SAMPLE)
            pop_oldest(self._synchronizer, NUMBERS[0], sample[0])
            found.append(sample[0])
        return found


def run(*inputs: SoilInput, awaits_swings: bool = False) -> list[np.void]:
    inbox = Inbox(awaits_swings)
    return [sample for given in inputs if inbox.add(given) is None for sample in inbox.ready()]


def stamps(found: list[np.void]) -> list[int]:
    return [int(sample["stamp_ns"]) // MS for sample in found]


def test_pressures_are_those_at_the_stamp_of_the_slips() -> None:
    found = run(hydraulics(100, 1e6), odometry(105), slips(105), hydraulics(110, 2e6))
    assert stamps(found) == [105]
    assert found[0]["has_pressures"]
    np.testing.assert_allclose(found[0]["pressures"], (1.5e6, -1.5e6))
    np.testing.assert_allclose(found[0]["spools"], (0.1, 0.2))


def test_every_order_of_arrival_gives_the_same_samples() -> None:
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
        results.add(tuple((int(s["stamp_ns"]), bool(s["has_pressures"]), *s["pressures"]) for s in found))
    assert len(results) == 1
    assert len(results.pop()) == 2


def test_a_swing_is_waited_for_and_is_that_of_the_stamp() -> None:
    """Whatever comes first; without it the angle may be any."""
    topics = (
        [hydraulics(t) for t in (96, 106, 116)],
        [odometry(t) for t in (100, 110)],
        [slips(t) for t in (100, 110)],
        [swing(90, 9.0), swing(100, 0.1), swing(111, 9.0)],
    )
    order = [k for k, topic in enumerate(topics) for _ in topic]
    results = set()
    rng = np.random.default_rng(3)
    for _ in range(500):
        queues, arrangement = [iter(topic) for topic in topics], rng.permutation(order)
        found = run(*(next(queues[k]) for k in arrangement), awaits_swings=True)
        results.add(tuple((int(s["stamp_ns"]), s["swing"], s["swing_stddev"]) for s in found))
    assert results == {((100 * MS, 0.1, 0.01), (110 * MS, 0.0, np.inf))}


def test_where_nothing_swings_no_swing_is_waited_for() -> None:
    found = run(hydraulics(96), odometry(100), slips(100), hydraulics(106))
    assert stamps(found) == [100]


def test_silent_swings_hold_nothing_up_for_longer_than_the_patience() -> None:
    ticks = [one for t in range(0, 1000, 10) for one in (hydraulics(t), odometry(t), slips(t))]
    found = run(*ticks, awaits_swings=True)
    assert stamps(found) == list(range(0, 1000 - round(P.patience * 1e3), 10))
    assert all(s["has_pressures"] and s["swing_stddev"] == np.inf for s in found)


def test_silent_pressures_hold_nothing_up_for_longer_than_the_patience() -> None:
    pairs = [half for t in range(0, 1000, 10) for half in (odometry(t), slips(t))]
    found = run(hydraulics(-10), hydraulics(0), *pairs)
    assert stamps(found) == list(range(0, 1000 - round(P.patience * 1e3), 10))
    assert [bool(s["has_pressures"]) for s in found[:3]] == [True, False, False]


def test_a_gap_between_pressures_is_not_bridged() -> None:
    late = 100 + round(P.longest_gap * 1e3) + 1
    found = run(hydraulics(100), odometry(105), slips(105), hydraulics(late), odometry(late), slips(late))
    assert [bool(s["has_pressures"]) for s in found] == [False, True]


@pytest.mark.parametrize(
    ("inputs", "rejection"),
    [
        ([hydraulics(100), hydraulics(100)], Rejection.DUPLICATE),
        ([hydraulics(100), hydraulics(90)], Rejection.TOO_LATE),
        ([hydraulics(100), hydraulics(99_000)], Rejection.AHEAD),
        ([hydraulics(100, float("nan"))], Rejection.INVALID),
        ([Hydraulics(100, 0.0, 0.0, 0.1, float("nan"))], Rejection.INVALID),
        ([odometry(100), odometry(100)], Rejection.DUPLICATE),
        ([odometry(100), slips(100), slips(100)], Rejection.DUPLICATE),
        ([odometry(100), slips(100), slips(90), odometry(90)], Rejection.TOO_LATE),
        ([odometry(100, float("inf"))], Rejection.INVALID),
        ([Odometry(0, np.zeros(3), np.diag((1.0, 1.0, -1.0)), HERE)], Rejection.INVALID),
    ],
)
def test_what_has_no_place_is_rejected_and_counted(inputs: list[SoilInput], rejection: Rejection) -> None:
    inbox = Inbox()
    assert [inbox.add(given) for given in inputs] == [None] * (len(inputs) - 1) + [rejection]
    assert inbox.rejected == {(inputs[-1].source, rejection): 1}


def test_pressures_of_a_machine_without_spool_sensors_are_used() -> None:
    nan = float("nan")
    found = run(Hydraulics(100 * MS, 1e6, 2e6, nan, nan), odometry(100), slips(100))
    assert [bool(s["has_pressures"]) for s in found] == [True]
    assert np.isnan(found[0]["spools"]).all()


def test_one_wild_stamp_does_not_stop_the_pressures() -> None:
    pairs = [x for t in range(0, 100, 10) for x in (odometry(t), slips(t), hydraulics(t + 4))]
    found = run(hydraulics(-6), hydraulics(10_000_000), *pairs)
    assert len(found) == 10
    assert all(sample["has_pressures"] for sample in found)


def test_halves_without_the_other_are_given_up() -> None:
    inbox = Inbox()
    for t in range(0, 3000, 10):
        inbox.add(odometry(t))
    assert inbox.rejected == {("odometry", Rejection.UNPAIRED): 100}


def test_a_clock_set_back_begins_anew_once_it_is_believed() -> None:
    inbox = Inbox()
    times = [*range(1_000_000, 1_000_500, 10), *range(0, 1000, 10)]
    found = []
    for t in times:
        for given in (hydraulics(t), odometry(t), slips(t)):
            inbox.add(given)
            found += inbox.ready()
    assert inbox.rejected["track_slip", Rejection.RESTARTED] == 1
    after = [sample for sample in found if sample["stamp_ns"] < 1_000_000 * MS]
    assert stamps(after) == list(range(10 * (P.jump_confirmations - 1), 1000, 10))
    assert all(sample["has_pressures"] for sample in after[1:])


def test_pairs_that_wait_are_bounded_and_go_on_in_order() -> None:
    """Stamps 1 µs apart, all within the patience: the oldest are given out without pressures."""
    found = run(*(half for t in range(10_000) for half in (tiny(odometry(0), t), tiny(slips(0), t))))
    assert [int(sample["stamp_ns"]) for sample in found] == [1000 * t for t in range(len(found))]
    assert 5_000 < len(found) < 10_000
    assert not any(sample["has_pressures"] for sample in found)


def tiny(given: SoilInput, t: int) -> SoilInput:
    return replace(given, stamp_ns=1000 * t)


@pytest.mark.parametrize("twist", [(1000.0, 0.0, 0.0), (0.0, -30.0, 0.0), (0.0, 0.0, 11.0)])
def test_speed_of_no_tracked_vehicle_is_out_of_range(twist: tuple[float, float, float]) -> None:
    inbox = Inbox()
    assert inbox.add(Odometry(0, np.array(twist), np.eye(3) * 1e-4, HERE)) is Rejection.OUT_OF_RANGE
    assert inbox.rejected == {("odometry", Rejection.OUT_OF_RANGE): 1}
