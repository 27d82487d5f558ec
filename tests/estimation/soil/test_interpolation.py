# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Machine states get the pressures at their stamps, in the order of stamps, for any order of arrival."""

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from trackslip_common.parameter_record import record_of
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.interpolation import (
    SAMPLE,
    InterpolationParameters,
    add_input,
    is_ready,
    new_interpolator,
    pop_oldest,
)
from trackslip_estimation.soil.records import (
    ACCEPTED,
    SOIL_INPUT,
    Hydraulics,
    MachineState,
    PoseWithCovariance,
    Rejection,
    SoilInput,
)
from trackslip_estimation.soil.soil_parameters import load_soil_parameters

P = load_soil_parameters().moments
NUMBERS = record_of(InterpolationParameters, P)
MS = 1_000_000
HERE = PoseWithCovariance(np.zeros(3), 1e-6 * np.eye(3))


def state(ms: int, v_x: float = 0.3) -> MachineState:
    twist = np.array((v_x, 0.0, 0.0))
    return MachineState(ms * MS, twist, 1e-6 * np.eye(3), HERE, np.zeros(3), Motion.STRAIGHT)


def hydraulics(ms: int, pressure: float = 0.0) -> Hydraulics:
    return Hydraulics(ms * MS, pressure, -pressure, 0.1, 0.2)


class Inbox:
    """An interpolator, its samples and its rejections."""

    def __init__(self) -> None:
        self._interpolator = new_interpolator(P)

    @property
    def rejected(self) -> dict[tuple[str, Rejection], int]:
        return {(source, why): n for source, why, n in self._interpolator.counts() if n}

    def add(self, soil_input: SoilInput) -> Rejection | None:
        record = np.zeros(1, SOIL_INPUT)
        soil_input.write_to(record[0])
        code = add_input(self._interpolator, record[0])
        return None if code == ACCEPTED else tuple(Rejection)[code]

    def ready(self) -> list[np.void]:
        samples = []
        while is_ready(self._interpolator, NUMBERS[0]):
            sample = np.zeros(1, SAMPLE)
            pop_oldest(self._interpolator, NUMBERS[0], sample[0])
            samples.append(sample[0])
        return samples


def run(*inputs: SoilInput) -> list[np.void]:
    inbox = Inbox()
    return [sample for soil_input in inputs if inbox.add(soil_input) is None for sample in inbox.ready()]


def stamps(samples: list[np.void]) -> list[int]:
    return [int(sample["stamp_ns"]) // MS for sample in samples]


def test_pressures_are_interpolated_to_the_stamp_of_the_state() -> None:
    samples = run(hydraulics(100, 1e6), state(105), hydraulics(110, 2e6))
    assert stamps(samples) == [105]
    assert samples[0]["has_pressures"]
    np.testing.assert_allclose(samples[0]["pressures"], (1.5e6, -1.5e6))
    np.testing.assert_allclose(samples[0]["spools"], (0.1, 0.2))


def test_sample_has_every_field_of_its_state() -> None:
    values = np.random.default_rng(2).uniform(0.1, 0.2, (3, 3))
    machine_state = MachineState(
        *(100 * MS, values[0], np.diag(values[1]), PoseWithCovariance(values[2], np.diag(values[0]))),
        *(values[1], Motion.TURNING, (0.01, 0.02), (1e-4, 2e-4), 0.5, 0.01),
    )
    (sample,) = run(machine_state, hydraulics(100))
    record = np.zeros(1, SOIL_INPUT)[0]
    machine_state.write_to(record)
    for name in set(SOIL_INPUT.names or ()) - {"source", "pressures", "spools"}:
        np.testing.assert_array_equal(sample[name], record[name], err_msg=name)
        assert np.any(record[name] != 0.0), name


def test_samples_do_not_depend_on_the_order_of_arrival() -> None:
    """Each topic is in order; topics interleave in any way."""
    topics: tuple[list[Any], ...] = (
        [hydraulics(t, 1e4 * t) for t in (96, 106, 116)],
        [state(t) for t in (100, 110)],
    )
    order = [k for k, topic in enumerate(topics) for _ in topic]
    results = set()
    for arrangement in set(itertools.permutations(order)):
        queues = [iter(topic) for topic in topics]
        samples = run(*(next(queues[k]) for k in arrangement))
        results.add(tuple((int(s["stamp_ns"]), bool(s["has_pressures"]), *s["pressures"]) for s in samples))
    assert len(results) == 1
    assert len(results.pop()) == 2


def test_silent_pressures_delay_samples_by_at_most_the_patience() -> None:
    samples = run(hydraulics(-10), hydraulics(0), *(state(t) for t in range(0, 1000, 10)))
    assert stamps(samples) == list(range(0, 1000 - round(P.patience * 1e3), 10))
    assert [bool(s["has_pressures"]) for s in samples[:3]] == [True, False, False]


def test_gap_between_pressures_is_not_interpolated() -> None:
    late = 100 + round(P.longest_gap * 1e3) + 1
    samples = run(hydraulics(100), state(105), hydraulics(late), state(late))
    assert [bool(s["has_pressures"]) for s in samples] == [False, True]


@pytest.mark.parametrize(
    ("inputs", "rejection"),
    [
        ([hydraulics(100), hydraulics(100)], Rejection.DUPLICATE),
        ([hydraulics(100), hydraulics(90)], Rejection.TOO_LATE),
        ([hydraulics(100), hydraulics(99_000)], Rejection.AHEAD),
        ([hydraulics(100, math.nan)], Rejection.INVALID),
        ([Hydraulics(100, 0.0, 0.0, 0.1, math.nan)], Rejection.INVALID),
        ([state(100), state(100)], Rejection.DUPLICATE),
        ([state(100), state(90)], Rejection.TOO_LATE),
        ([state(100), state(99_000)], Rejection.AHEAD),
        ([state(100, math.inf)], Rejection.INVALID),
        ([replace(state(0), twist_covariance=np.diag((1.0, 1.0, -1.0)))], Rejection.INVALID),
        ([replace(state(0), slips=np.array((0.0, math.nan, 0.0)))], Rejection.INVALID),
        ([replace(state(0), slips=np.array((0.0, 1e10, 0.0)))], Rejection.OUT_OF_RANGE),
        ([replace(state(0), swing=0.1, swing_variance=-2.0)], Rejection.INVALID),
        ([replace(state(0), swing=math.nan, swing_variance=0.01)], Rejection.INVALID),
        ([state(0, 1000.0)], Rejection.OUT_OF_RANGE),
        ([replace(state(0), twist=np.array((0.0, -30.0, 0.0)))], Rejection.OUT_OF_RANGE),
        ([replace(state(0), twist=np.array((0.0, 0.0, 11.0)))], Rejection.OUT_OF_RANGE),
    ],
)
def test_unusable_input_is_rejected_and_counted(inputs: list[SoilInput], rejection: Rejection) -> None:
    inbox = Inbox()
    assert [inbox.add(soil_input) for soil_input in inputs] == [None] * (len(inputs) - 1) + [rejection]
    assert inbox.rejected == {(inputs[-1].source, rejection): 1}


def test_pressures_of_a_machine_without_spool_sensors_are_used() -> None:
    samples = run(Hydraulics(100 * MS, 1e6, 2e6, math.nan, math.nan), state(100))
    assert [bool(s["has_pressures"]) for s in samples] == [True]
    assert np.isnan(samples[0]["spools"]).all()


def test_one_wild_stamp_does_not_stop_the_pressures() -> None:
    inputs = [x for t in range(0, 100, 10) for x in (state(t), hydraulics(t + 4))]
    samples = run(hydraulics(-6), hydraulics(10_000_000), *inputs)
    assert len(samples) == 10
    assert all(sample["has_pressures"] for sample in samples)


def test_clock_set_back_restarts_once_it_is_confirmed() -> None:
    inbox = Inbox()
    samples = []
    for t in [*range(1_000_000, 1_000_500, 10), *range(0, 1000, 10)]:
        for soil_input in (hydraulics(t), state(t)):
            inbox.add(soil_input)
            samples += inbox.ready()
    assert inbox.rejected["machine_state", Rejection.RESTARTED] == 1
    after = [sample for sample in samples if sample["stamp_ns"] < 1_000_000 * MS]
    assert stamps(after) == list(range(10 * (P.jump_confirmations - 1), 1000, 10))
    assert all(sample["has_pressures"] for sample in after[1:])


def test_waiting_states_are_bounded_and_stay_in_order() -> None:
    """Stamps are 1 µs apart, all within the patience: the oldest are released without pressures."""
    samples = run(*(replace(state(0), stamp_ns=1000 * t) for t in range(10_000)))
    assert [int(sample["stamp_ns"]) for sample in samples] == [1000 * t for t in range(len(samples))]
    assert 5_000 < len(samples) < 10_000
    assert not any(sample["has_pressures"] for sample in samples)
