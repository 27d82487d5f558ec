# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Each fault of the pressures is detected at once and named soon; true pressures cause no fault."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from fixtures.soil_samples import Sample

from trackslip_common.parameter_record import record_of
from trackslip_common.record_types import dtype_of
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.pressure_watch import (
    NO_FAULT,
    PressureFault,
    PressureWatch,
    WatchParameters,
    evaluate_pressures,
    reported_faults,
)
from trackslip_estimation.soil.soil_parameters import load_soil_parameters

P = load_soil_parameters()
NUMBERS = record_of(WatchParameters, P.watch)
STEP = 0.01  # s
STRAIGHT = (45e5, 45e5, 0.3, 0.3, Motion.STRAIGHT)  # Pa, Pa, track speeds m/s
LEFT_TURN = (-17e5, 120e5, 0.16, 0.35, Motion.TURNING)
SPOT_TURN = (-80e5, 80e5, -0.2, 0.2, Motion.TURNING)
REVERSE = (-45e5, -45e5, -0.3, -0.3, Motion.STRAIGHT)
RIGHT_IN_REVERSE = (17e5, -120e5, -0.16, -0.35, Motion.TURNING)
STANDING = (0.0, 0.0, 0.0, 0.0, Motion.STANDING)
Phase = tuple[float, float, float, float, Motion]
Corrupt = Callable[[np.ndarray], np.ndarray]


class Bench:
    """A watch, and a transducer with noise."""

    def __init__(self) -> None:
        self._watch = np.zeros(1, dtype_of(PressureWatch))
        self._rng, self.is_downhill, self.is_even = np.random.default_rng(3), False, True

    @property
    def faults(self) -> tuple[PressureFault, ...]:
        return reported_faults(self._watch[0])

    def _evaluate(self, sample: np.ndarray) -> PressureFault | None:
        relief, load = P.vehicle.whole().relief_pressure, (self.is_downhill, self.is_even)
        code = evaluate_pressures(self._watch[0], sample[0], NUMBERS[0], relief, *load)
        return None if code == NO_FAULT else tuple(PressureFault)[code]

    def drive(
        self, phase: Phase, seconds: float, corrupt: Corrupt = lambda p: p
    ) -> list[PressureFault | None]:
        """The fault after each sample, or None."""
        return list(self._moments(phase, seconds, corrupt))

    def _moments(self, phase: Phase, seconds: float, corrupt: Corrupt) -> Iterator[PressureFault | None]:
        left, right, u_left, u_right, motion = phase
        for _ in range(round(seconds / STEP)):
            p = corrupt(np.array((left, right)) + 3e4 * self._rng.standard_normal(2))
            sample, _ = Sample(STEP, np.array((u_left, u_right)), motion=motion).records()
            sample["has_pressures"] = True
            sample["pressures"] = sample["reading"] = p
            yield self._evaluate(sample)

    def silence(self, seconds: float) -> None:
        """Motion without pressure readings."""
        for _ in range(round(seconds / STEP)):
            sample, _ = Sample(STEP, np.array((0.3, 0.3))).records()
            assert self._evaluate(sample) is PressureFault.DROPPED


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_true_pressures_cause_no_fault(bench: Bench) -> None:
    for phase in (STANDING, STRAIGHT, LEFT_TURN, RIGHT_IN_REVERSE, SPOT_TURN, REVERSE, STRAIGHT, STANDING):
        assert set(bench.drive(phase, 5.0)) == {None}
    assert bench.faults == ()


def test_missing_pressures_are_named_until_they_return(bench: Bench) -> None:
    bench.silence(0.5 * P.watch.report_time)
    assert bench.faults == ()
    bench.silence(P.watch.report_time)
    assert bench.faults == (PressureFault.DROPPED,)
    output = bench.drive(STRAIGHT, 2.0 * P.watch.report_time)
    assert output[0] is PressureFault.DROPPED
    assert output[-1] is None
    assert bench.faults == ()


@pytest.mark.parametrize(
    ("side", "fault"), [(0, PressureFault.LEFT_STUCK), (1, PressureFault.RIGHT_STUCK)], ids=str
)
def test_a_stuck_pressure_is_named_while_moving_and_cleared_by_its_first_change(
    bench: Bench, side: int, fault: PressureFault
) -> None:
    def stuck(p: np.ndarray) -> np.ndarray:
        p[side] = 44.4e5
        return p

    assert set(bench.drive(STANDING, 5.0, stuck)) == {None}  # readings at rest may be constant
    output = bench.drive(STRAIGHT, 2.0, stuck)
    assert set(output[:20]) == {None}
    assert set(output[30:]) == {fault}
    assert bench.faults == (fault,)
    bench.drive(STRAIGHT, 0.1)
    assert bench.faults == ()


def test_pressures_in_steps_of_1_bar_are_used(bench: Bench) -> None:
    output = bench.drive(STRAIGHT, 20.0, lambda p: 1e5 * np.round(p / 1e5))
    assert output.count(None) > 0.9 * len(output)
    assert bench.faults == ()


def test_pressures_that_a_gateway_repeats_are_used(bench: Bench) -> None:
    held = iter(np.repeat(np.random.default_rng(1).normal(45e5, 3e4, (50, 2)), 20, axis=0))  # 5 Hz
    assert set(bench.drive(STRAIGHT, 10.0, lambda p: next(held))) == {None}


SIDES = pytest.mark.parametrize(
    ("side", "fault"), [(0, PressureFault.LEFT_LOW), (1, PressureFault.RIGHT_LOW)], ids=str
)


@SIDES
@pytest.mark.parametrize("factor", [0.0, 0.1, 6.895e-2 * 1.5, -1.0], ids=["dead", "tenth", "psi", "sign"])
def test_a_transducer_far_below_the_other_is_named_and_stays_so_in_turns(
    bench: Bench, side: int, fault: PressureFault, factor: float
) -> None:
    def low(p: np.ndarray) -> np.ndarray:
        p[side] *= factor
        p[side] += p[1 - side] % 5e4 - 2.5e4
        return p

    output = bench.drive(STRAIGHT, 4.0, low)
    assert set(output[200:]) == {fault}
    assert set(bench.drive(LEFT_TURN, 2.0, low)) <= {fault, PressureFault.SWAPPED}
    assert fault in bench.faults
    assert set(bench.drive(STRAIGHT, 1.0, low)) == {fault}


@SIDES
def test_a_load_across_the_tracks_is_no_fault(bench: Bench, side: int, fault: PressureFault) -> None:
    def across(p: np.ndarray) -> np.ndarray:
        p[side] /= 3.0
        return p

    assert set(bench.drive(STRAIGHT, 5.0, across)) == {None}


@SIDES
@pytest.mark.parametrize(("factor", "is_fault"), [(0.1, False), (-0.1, False), (0.0, True)])
def test_across_a_slope_only_a_dead_transducer_is_named(
    bench: Bench, side: int, fault: PressureFault, factor: float, is_fault: bool
) -> None:
    """The upper track bears a tenth of the lower one at 15° on sandy loam, and brakes on steeper ground."""

    def shared(p: np.ndarray) -> np.ndarray:
        p[side] = factor * p[1 - side] + p[1 - side] % 2e4 - 1e4
        return p

    bench.is_even = False
    assert set(bench.drive(STRAIGHT, 5.0, shared)[50:]) == {fault if is_fault else None}


def test_transducers_without_sign_are_named_in_the_first_reverse_until_another_refutes_it(
    bench: Bench,
) -> None:
    assert set(bench.drive(STRAIGHT, 2.0, np.abs)) == {None}
    assert set(bench.drive(REVERSE, 2.0, np.abs)) == {PressureFault.WRONG_SIGN}
    assert set(bench.drive(SPOT_TURN, 2.0, np.abs)) == {PressureFault.WRONG_SIGN}
    assert set(bench.drive(STRAIGHT, 2.0, np.abs)) == {PressureFault.WRONG_SIGN}
    assert bench.faults == (PressureFault.WRONG_SIGN,)
    bench.drive(REVERSE, 2.0)
    assert bench.faults == ()


@pytest.mark.parametrize(
    "phase", [STRAIGHT, LEFT_TURN, RIGHT_IN_REVERSE], ids=["straight", "left", "reverse"]
)
def test_pressures_of_the_wrong_sign_are_named_and_not_called_swapped(bench: Bench, phase: Phase) -> None:
    assert set(bench.drive(phase, 2.0, lambda p: -p)) == {PressureFault.WRONG_SIGN}
    assert bench.faults == (PressureFault.WRONG_SIGN,)
    bench.drive(phase, 2.0)
    assert bench.faults == ()


def test_motors_that_brake_downhill_are_no_fault(bench: Bench) -> None:
    bench.is_downhill = True
    for pressure in (-45e5, 0.0):
        assert set(bench.drive((pressure, pressure, 0.3, 0.3, Motion.STRAIGHT), 5.0)) == {None}


@pytest.mark.parametrize("turn", [LEFT_TURN, RIGHT_IN_REVERSE], ids=("left", "right in reverse"))
def test_swapped_pressures_are_detected_in_the_first_turn(bench: Bench, turn: Phase) -> None:
    def swapped(p: np.ndarray) -> np.ndarray:
        return p[::-1]

    assert set(bench.drive(STRAIGHT, 5.0, swapped)) == {None}  # undetectable, and without effect
    assert set(bench.drive(turn, 2.0, swapped)) == {PressureFault.SWAPPED}
    assert bench.faults == (PressureFault.SWAPPED,)
    assert set(bench.drive(STRAIGHT, 5.0, swapped)) == {PressureFault.SWAPPED}  # kept
    bench.drive(turn, 2.0)
    assert bench.faults == ()


@pytest.mark.parametrize(
    ("unit", "fault"),
    [
        (1e3, PressureFault.IN_KPA),
        (6894.757, PressureFault.IN_PSI),
        (1e5, PressureFault.IN_BAR),
        (1e6, PressureFault.IN_MPA),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
@pytest.mark.parametrize("sum_bar", [45.0, 90.0, 135.0])  # dry clay, sand, clayey soil
def test_another_unit_is_named(bench: Bench, unit: float, fault: PressureFault, sum_bar: float) -> None:
    phase = (sum_bar * 0.5e5, sum_bar * 0.5e5, 0.3, 0.3, Motion.STRAIGHT)
    for at_work in (phase, LEFT_TURN):
        assert set(bench.drive(at_work, 2.0, lambda p: p / unit)) == {fault}
        assert bench.faults == (fault,)
    assert set(bench.drive(STANDING, 2.0, lambda p: p / unit)) == {fault}
    bench.drive(phase, 2.0 * P.watch.report_time)
    assert bench.faults == ()


def test_too_little_for_any_unit_and_too_much_for_the_relief_valve_are_named(bench: Bench) -> None:
    bench.drive(STRAIGHT, 2.0, lambda p: p * 1e-9)
    assert bench.faults == (PressureFault.TOO_LOW,)
    other = Bench()
    assert set(other.drive(STRAIGHT, 2.0, lambda p: p * 10.0)) == {PressureFault.BEYOND_RELIEF}
    assert other.faults == (PressureFault.BEYOND_RELIEF,)
