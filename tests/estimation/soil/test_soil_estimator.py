# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The soil estimator as a whole: faults are named and held, restarts, warnings, independence of the order."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from typing import Any, TypeVar

import numpy as np
import pytest

from trackslip_common.parameters import reloadable_names
from trackslip_common.soils import soil
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil.classes import soil_thrust_limit
from trackslip_estimation.soil.pressure_watch import PressureFault, UnusedReason
from trackslip_estimation.soil.records import (
    SOIL_INPUT,
    SOURCES,
    Hydraulics,
    MachineState,
    SoilInput,
    TrackForces,
)
from trackslip_estimation.soil.soil_estimator import SoilEstimator, SoilOutput, SoilState
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters, load_soil_parameters
from trackslip_sim.machine.hydraulics import START_NS, InputErrors, soil_inputs
from trackslip_sim.scenarios.scenario import Scenario, Segment
from trackslip_sim.truth.simulate import simulate

P = load_soil_parameters()
CAB = load_soil_parameters({"vehicle": "pc05_cab"})
SEGMENTS = ((3.0, 0.0, 0.0), (5.0, 2.0, 2.0), (5.0, 1.0, 2.2), (5.0, 2.0, 2.0))
SPINNING = ((3.0, 0.0, 0.0), (5.0, 2.0, 2.0), (8.0, 0.2, 2.2))  # the right track, on clayey soil
BEFORE, FAULT_ENDS = 10.0, 16.0  # s: turning, straight
Corrupt = Callable[[Hydraulics], Hydraulics | None]
Output = TypeVar("Output", SoilState, TrackForces)
Segments = tuple[tuple[float, float, float], ...]

# A PC05 with a cab: to and fro with turns to both sides, at a constant swing angle
TO_AND_FRO = (
    *((14.0, 2.0, 2.0), (6.0, 1.0, 2.2), (12.0, -2.0, -2.0), (6.0, -2.2, -1.0), (10.0, 2.0, 2.0)),
    *((6.0, 2.2, 1.0), (12.0, -2.0, -2.0), (6.0, 2.1, 0.9), (10.0, 2.0, 2.0)),
)


@cache
def swung(angle: float, stddev: float | None) -> tuple[SoilInput, ...]:
    """Inputs from a machine on sand with its cab at ``angle``; ``stddev`` of the swing angle."""
    segments = (Segment(8.0, 0.0, 0.0, swing_to=angle), *(Segment(*row) for row in TO_AND_FRO))
    whole, upper = CAB.vehicle.whole(), CAB.vehicle.upper_structure
    truth = simulate(Scenario(name="test", soil="sand", segments=segments), vehicle=whole, upper=upper)
    sensing = InputErrors(speed_stddev=0.001, yaw_rate_stddev=0.001, swing_stddev=stddev)
    return tuple(soil_inputs(truth, whole, load_slip_parameters().motion, sensing))


def sensed(soil: str, segments: Segments, errors: InputErrors, **fields: Any) -> list[SoilInput]:
    rows = tuple(Segment(*row) for row in segments)
    truth = simulate(Scenario(name="test", soil=soil, segments=rows, **fields))
    return list(soil_inputs(truth, P.vehicle.whole(), load_slip_parameters().motion, errors))


@cache
def inputs_of(soil: str = "sand", segments: Segments = SEGMENTS) -> list[SoilInput]:
    return sensed(soil, segments, InputErrors())


def run(inputs: Iterable[SoilInput], estimator: SoilEstimator) -> list[SoilOutput]:
    return [output for one in inputs for output in estimator.advance(one)]


@cache
def ordinary() -> tuple[SoilEstimator, list[SoilOutput]]:
    """An estimator after the drive on sand without a fault, and its outputs."""
    estimator = SoilEstimator(P)
    return estimator, run(inputs_of(), estimator)


def at(outputs: list[SoilOutput], kind: type[Output], t: float) -> Output:
    """The last output of a kind up to a time, s."""
    return [o for o in outputs if isinstance(o, kind) and o.stamp_ns <= START_NS + t * 1e9][-1]


def corrupted(corrupt: Corrupt) -> list[SoilInput]:
    """The drive with readings changed by ``corrupt`` from BEFORE to FAULT_ENDS."""
    inputs: list[SoilInput] = []
    for one in inputs_of():
        t = (one.stamp_ns - START_NS) * 1e-9
        changed = corrupt(one) if isinstance(one, Hydraulics) and BEFORE <= t < FAULT_ENDS else one
        inputs += [] if changed is None else [changed]
    return inputs


def pressure_faults(estimator: SoilEstimator) -> set[str]:
    """Faults of the pressures. The first sample has none, because readings follow the slips."""
    before = {*(unused.value for unused in UnusedReason), PressureFault.DROPPED.value}
    return {reason for _, reason in estimator.tally.total} - before


def test_pressure_from_digging_at_standstill_is_counted_as_unused() -> None:
    """Digging at standstill: 3 bar, below the limit of an offset."""
    inputs = inputs_of(segments=((10.0, 0.0, 0.0),))
    digging = [
        replace(one, left_pressure=one.left_pressure + 3e5)
        if isinstance(one, Hydraulics) and one.stamp_ns > START_NS + 6e9
        else one
        for one in inputs
    ]
    at_rest, disturbed = SoilEstimator(P), SoilEstimator(P)
    run(inputs, at_rest)
    run(digging, disturbed)
    assert at_rest.tally.total["hydraulics", UnusedReason.AT_REST.value] == 0
    assert disturbed.tally.total["hydraulics", UnusedReason.AT_REST.value] == pytest.approx(400, abs=5)


FAULTS: dict[PressureFault, Corrupt] = {
    PressureFault.LEFT_STUCK: lambda h: replace(h, left_pressure=-16e5),
    PressureFault.DROPPED: lambda h: None,
    PressureFault.SWAPPED: lambda h: replace(
        h, left_pressure=h.right_pressure, right_pressure=h.left_pressure
    ),
    PressureFault.IN_BAR: lambda h: replace(
        h, left_pressure=h.left_pressure / 1e5, right_pressure=h.right_pressure / 1e5
    ),
    PressureFault.BEYOND_RELIEF: lambda h: replace(h, right_pressure=h.right_pressure + 250e5),
}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_pressure_fault_is_named_and_holds_estimates_with_growing_variance_until_it_ends(
    fault: PressureFault,
) -> None:
    estimator = SoilEstimator(P)
    inputs = corrupted(FAULTS[fault])
    end = sum(one.stamp_ns < START_NS + (FAULT_ENDS - 0.1) * 1e9 for one in inputs)
    outputs = run(inputs[:end], estimator)
    assert estimator.faults == (fault,)
    assert estimator.tally.total["hydraulics", fault.value] > 400
    before, after = (at(outputs, SoilState, t) for t in (BEFORE, FAULT_ENDS))
    assert after.mu_r == pytest.approx(before.mu_r, rel=0.03)
    assert after.mu_l == pytest.approx(before.mu_l, rel=0.10)
    assert after.strength.thrust_limit == pytest.approx(before.strength.thrust_limit, rel=0.10)
    assert after.mu_r_variance > 4.0 * before.mu_r_variance
    assert after.mu_l_variance > before.mu_l_variance
    assert after.strength.effective_samples < before.strength.effective_samples + 0.1  # 0.25 s of a stuck one
    begin, final = (at(outputs, TrackForces, t) for t in (BEFORE + 1.0, FAULT_ENDS - 1.0))
    assert begin.thrust == final.thrust
    assert all(b > 2.0 * a for a, b in zip(begin.thrust_variance, final.thrust_variance, strict=True))
    recovered = at(run(inputs[end:], estimator), SoilState, 18.0)
    if fault is not PressureFault.SWAPPED:  # which only another turn refutes
        assert estimator.faults == ()
        assert recovered.mu_r == pytest.approx(0.2, rel=0.05)


def test_resistance_is_known_no_better_than_the_slope_where_nothing_measures_the_tilt() -> None:
    def without_tilt(one: SoilInput) -> SoilInput:
        return replace(one, tilt_variance=(math.inf, math.inf)) if isinstance(one, MachineState) else one

    outputs = run([without_tilt(one) for one in inputs_of()], SoilEstimator(P))
    stddevs = [math.sqrt(one.mu_r_variance) for one in outputs if isinstance(one, SoilState)]
    assert min(stddevs) > P.load.unknown_slope
    assert math.sqrt(at(ordinary()[1], SoilState, 9.0).mu_r_variance) < P.load.unknown_slope / 3.0


def test_outputs_come_on_the_grids_of_their_periods() -> None:
    _, outputs = ordinary()
    for kind, period in ((TrackForces, P.forces_period), (SoilState, P.soil_period)):
        stamps = [o.stamp_ns for o in outputs if isinstance(o, kind)]
        assert np.diff(stamps) == pytest.approx(period * 1e9)
        assert stamps[0] == START_NS
    assert len(outputs) > 180


@pytest.mark.parametrize("p", [P, CAB], ids=["pc05", "pc05_cab"])
def test_the_outputs_do_not_depend_on_how_the_topics_interleave(p: SoilEstimatorParameters) -> None:
    """Hydraulics are up to 0.2 s early or late."""
    inputs = inputs_of() if p is P else list(swung(1.5, 0.01)[:4000])
    rng = np.random.default_rng(5)
    delay = dict.fromkeys(range(len(SOURCES)), 0.0)
    keys = []
    for one in inputs:  # each topic stays in order
        topic = SOURCES.index(one.source)
        delay[topic] = max(delay[topic], one.stamp_ns * 1e-9 + 0.2 * rng.random())
        keys.append(delay[topic])
    shuffled = [inputs[k] for k in np.argsort(keys, kind="stable")]
    assert [one.source for one in shuffled] != [one.source for one in inputs]
    expected = ordinary()[1] if p is P else run(inputs, SoilEstimator(p))
    outputs = run(shuffled, SoilEstimator(p))
    assert len(expected) - len(outputs) in (0, 1, 2, 3)  # the last ones may still wait
    assert [repr(o) for o in outputs] == [repr(o) for o in expected[: len(outputs)]]


@pytest.mark.parametrize(
    "angle", [0.5 * math.pi, pytest.param(math.pi, marks=pytest.mark.slow)], ids=["across", "back"]
)
def test_swung_cab_does_not_change_the_soil_strength(angle: float) -> None:
    """Without the swing F_max is 20 % too small across and 4 % too large backward."""
    true = soil_thrust_limit(soil("sand"), CAB.vehicle.whole())
    known, unknown = (run(swung(angle, stddev), SoilEstimator(CAB)) for stddev in (0.01, None))
    precise, wide = (at(outputs, SoilState, 99.0) for outputs in (known, unknown))
    assert precise.strength.thrust_limit == pytest.approx(true, rel=0.02)
    for state in (precise, wide):
        low, high = state.strength.thrust_limit_interval
        assert low < true < high
    widths = [math.log(b / a) for a, b in (s.strength.thrust_limit_interval for s in (precise, wide))]
    assert widths[1] > 1.5 * widths[0]


def test_batches_of_inputs_give_the_same_bits_as_single_ones() -> None:
    """A replay processes thousands of records at once, the live node one by one."""
    inputs, live = corrupted(FAULTS[PressureFault.DROPPED]), SoilEstimator(P)
    records = np.zeros(len(inputs), SOIL_INPUT)
    for record, one in zip(records, inputs, strict=True):
        one.write_to(record)
    expected = run(inputs, live)
    for chunk in (7, 1000):
        replayed = SoilEstimator(P)
        parts = [p for k in range(0, len(records), chunk) for p in replayed.advance_all(records[k:][:chunk])]
        forces = np.concatenate([part.forces for part in parts])
        states = [state for part in parts for state in part.states]
        assert repr(states) == repr([o for o in expected if isinstance(o, SoilState)])
        for name in ("stamp_ns", "thrust", "thrust_variance", "resistance", "resistance_variance", "reserve"):
            column = [getattr(o, name) for o in expected if isinstance(o, TrackForces)]
            np.testing.assert_array_equal(forces[name], column)
        assert replayed.tally.total == live.tally.total
        assert replayed.stuck == live.stuck


def test_track_spinning_at_the_soil_limit_is_reported_as_getting_stuck() -> None:
    assert ordinary()[0].stuck == (False, False)
    spinning = SoilEstimator(P)
    outputs = run(inputs_of("clayey_soil", SPINNING), spinning)
    assert spinning.stuck == (False, True)
    last = at(outputs, TrackForces, 16.0)
    assert last.reserve[1] < 0.1 < last.reserve[0]
    patient = spinning.parameters.changed({"stuck_time": 1e6})
    spinning.set_parameters(patient)
    assert spinning.stuck == (False, False)
    stuck = {"high_slip", "stuck_time", "stuck_probability"}
    assert reloadable_names(SoilEstimatorParameters) == {"low_reserve"} | stuck


def test_outer_track_spinning_in_a_turn_is_not_getting_stuck() -> None:
    """The machine drives straight on at the speed of the inner track."""
    estimator = SoilEstimator(P)
    outputs = run(inputs_of("clayey_soil", ((3.0, 0.0, 0.0), (5.0, 2.0, 2.0), (8.0, 0.9, 2.28))), estimator)
    last = at(outputs, TrackForces, 16.0)
    assert last.reserve[1] < 0.1
    assert estimator.stuck == (False, False)


def test_track_dragged_faster_than_it_turns_is_not_getting_stuck() -> None:
    """On a slope that is too steep the motor brakes, and the machine slides."""

    def drag(one: SoilInput) -> SoilInput:
        if isinstance(one, MachineState):
            return replace(one, slips=one.slips * (1.0, -1.0, 1.0), tilt=(0.0, 0.02))
        return replace(one, right_pressure=-1.6 * one.right_pressure) if isinstance(one, Hydraulics) else one

    estimator = SoilEstimator(P)
    outputs = run(map(drag, inputs_of("clayey_soil", SPINNING)), estimator)
    last = at(outputs, TrackForces, 16.0)
    assert last.reserve[1] < 0.1
    assert estimator.stuck == (False, False)


def test_commanded_tracks_that_do_not_turn_are_stalled_within_a_second() -> None:
    """The relief pressure is too low for a turn on the spot; straights, a turn and stops are no stall."""
    on_the_spot = (4.0, -2, 2)
    segments = ((1.0, 0, 0), (4.0, 2, 2), (2.0, 0, 0), on_the_spot, (2.0, 0, 0), (3.0, 1.5, 2), (2.0, 0, 0))
    begins, ends = 7.0, 11.0  # s
    estimator, stalled = SoilEstimator(P), {}
    for one in sensed("sand", segments, InputErrors(), relief_pressure=8e6):
        estimator.advance(one)
        stalled[(one.stamp_ns - START_NS) * 1e-9] = estimator.stalled
    by_time = [(t, both) for t, both in stalled.items() if any(both)]
    assert {both for t, both in by_time if begins + 1.0 <= t < ends} == {(True, True)}
    assert begins < by_time[0][0] < begins + 1.0
    assert ends < by_time[-1][0] < ends + 1.0
    assert len([t for t in stalled if by_time[0][0] <= t <= by_time[-1][0]]) == len(by_time)  # continuously
    assert pressure_faults(estimator) == set()


@pytest.mark.parametrize("soil", ["sandy_loam", "dry_clay"])
def test_healthy_pressures_are_never_called_swapped_or_of_another_unit(soil: str) -> None:
    """Pressures as turns begin and end, and while braking, differ from those of steady driving."""
    turns = (
        (2.0, 0.1, 2.0),
        (1.0, 0, 0),
        (2.0, 2.0, 0.5),
        (2.0, 0.5, 2.0),
        (2.0, 2.0, 2.0),
        (1.0, -1.5, -2.2),
    )
    estimator = SoilEstimator(P)
    run(inputs_of(soil, ((1.0, 0.0, 0.0), (2.0, 2.2, 2.2), *turns, (1.0, 0.0, 0.0))), estimator)
    assert pressure_faults(estimator) == set()
    assert estimator.stalled == (False, False)


def test_a_clock_set_back_restarts_the_estimate() -> None:
    early = [replace(one, stamp_ns=one.stamp_ns - START_NS) for one in inputs_of()]
    late = [one for one in inputs_of() if one.stamp_ns < START_NS + 2e9]
    estimator = SoilEstimator(P)
    outputs = run([*late, *early], estimator)
    assert estimator.restarts == 1
    fresh = [o for o in outputs if o.stamp_ns < START_NS]
    assert at(fresh, SoilState, 0.0).mu_r == pytest.approx(0.2, rel=0.05)


def test_volumetric_efficiency_is_estimated_from_spools_and_speeds() -> None:
    estimator, _ = ordinary()
    assert estimator.volumetric_efficiency == pytest.approx(P.vehicle.whole().volumetric_efficiency, rel=0.02)


def test_transducer_offsets_do_not_change_the_resistance() -> None:
    outputs = run(sensed("sand", SEGMENTS, InputErrors(offsets=(2e5, 2e5))), SoilEstimator(P))
    last = at(outputs, SoilState, 18.0)
    assert last.mu_r == pytest.approx(0.2, rel=0.05)
