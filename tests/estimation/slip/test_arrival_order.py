# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The state depends on the set of measurements only: not on order, repeats or invalid ones."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fixtures.records import assert_same_bits, rubbish
from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.measurements import SET_POSE, Measurement, Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.records import to_records
from trackslip_estimation.slip.window import remove_settled_entries

MS = 1_000_000
WINDOW_MS = 1000
STEP_MS = 50

seeds = st.integers(0, 2**32 - 1)


def parameters(start: str, model: str = "turning") -> SlipEstimatorParameters:
    return load_slip_parameters({"start": start, "model": model, "history_window": WINDOW_MS * 1e-3})


def measurements(drive: Callable[..., Any], start: str, positions: bool = True) -> list[Measurement]:
    """3 s with a turn: the start first, and some fixes that are outliers.

    Gyro readings and fixes lie between the sprocket samples. The speed at their stamps is known only with
    the next sample.
    """
    segments = [
        (1.0, 2.0, 2.0, 0.05, 0.1, 0.0),
        (1.0, 1.0, 2.0, 0.0, 0.2, 0.1),
        (1.0, 2.0, 2.0, 0.1, 0.1, 0.0),
    ]
    found = drive(segments, step_ms=STEP_MS, gyro_every=2, fix_every=4, positions=positions).measurements
    for k, m in enumerate(found):
        if m.stamp_ns > 0 and not isinstance(m, Sprockets):
            found[k] = replace(m, stamp_ns=m.stamp_ns - 17 * MS)
    for k, m in enumerate(found):
        if isinstance(m, PoseFix) and k % 3 == 1:
            found[k] = replace(m, pose=m.pose + np.array((3.0, 0.0, 0.0)))
    kind = Sprockets if start == "initial_pose" else PoseFix
    found.sort(key=lambda m: (m.stamp_ns, not isinstance(m, kind)))
    return found


def processed(estimator: SlipEstimator, arrivals: list[Measurement]) -> list[tuple[Outcome, Estimate | None]]:
    return [(report.outcome, estimate) for report, estimate in estimator.process_all(arrivals)]


def assert_same(one: Estimate, other: Estimate) -> None:
    assert (one.stamp_ns, one.motion) == (other.stamp_ns, other.motion)
    for name in ("pose", "pose_covariance"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0.0, atol=1e-9)
    for name in ("twist", "twist_covariance", "slips", "slip_covariance"):
        mine, its = getattr(one.outputs, name), getattr(other.outputs, name)
        np.testing.assert_allclose(mine, its, rtol=0.0, atol=1e-9)


def delayed(found: list[Measurement], seed: int) -> list[Measurement]:
    """The start first; all others delayed by up to the window, samples that close an interval by less."""
    rng = np.random.default_rng(seed)
    late = rng.integers(0, WINDOW_MS - STEP_MS, len(found)) * MS * (rng.random(len(found)) < rng.random())
    late[0] = -1
    return [
        found[k]
        for k in np.argsort([m.stamp_ns + d for m, d in zip(found, late, strict=True)], kind="stable")
    ]


@pytest.mark.parametrize(
    ("model", "start", "positions"),
    [
        *(("turning", "initial_pose", True), ("turning", "first_fix", False)),
        *(("free_slips", "first_fix", True), ("free_slips", "initial_pose", False)),
    ],
)
@settings(max_examples=4)
@given(seed=seeds)
def test_final_state_does_not_depend_on_the_order_of_arrival(
    drive: Callable[..., Any], model: str, start: str, positions: bool, seed: int
) -> None:
    found = measurements(drive, start, positions)
    ordered, shuffled = SlipEstimator(parameters(start, model)), SlipEstimator(parameters(start, model))
    processed(ordered, found)
    outcomes = processed(shuffled, delayed(found, seed))
    assert {outcome for outcome, _ in outcomes} <= {Outcome.ACCEPTED, Outcome.GATED}
    assert_same(shuffled.estimate(), ordered.estimate())


@pytest.mark.parametrize("model", ["turning", "icr", "free_slips"])
@settings(max_examples=3)
@given(seed=seeds)
def test_silence_and_jumps_do_not_depend_on_the_order_of_arrival(
    drive: Callable[..., Any], model: str, seed: int
) -> None:
    """Gaps of up to 250 ms between sprockets, 120 ms past the timeout; samples that end one are in time."""
    rng = np.random.default_rng(seed)
    found = []
    for m in measurements(drive, "initial_pose"):
        if isinstance(m, Sprockets) and m.positions is not None:
            if m.stamp_ns % (500 * MS) > 300 * MS and m.stamp_ns > 0:
                continue
            if m.stamp_ns > 1_200 * MS:
                m = replace(m, positions=(m.positions[0] + 90.0, m.positions[1]))
        found.append(m)
    late = rng.integers(0, WINDOW_MS - 300, len(found)) * MS
    late[0] = -1
    arrivals = [found[k] for k in np.argsort([m.stamp_ns + d for m, d in zip(found, late, strict=True)])]
    short = {"sprocket_timeout": 0.13, "model": model, "start": "initial_pose", "history_window": 1.0}
    ordered, shuffled = (SlipEstimator(load_slip_parameters(short)) for _ in range(2))
    assert Outcome.JUMPED in {outcome for outcome, _ in processed(ordered, found)}
    assert Outcome.TOO_LATE not in {outcome for outcome, _ in processed(shuffled, arrivals)}
    assert_same(shuffled.estimate(), ordered.estimate())


def test_every_sprocket_sample_in_order_gives_an_estimate_at_its_stamp(drive: Callable[..., Any]) -> None:
    found = measurements(drive, "initial_pose")
    outcomes = processed(SlipEstimator(parameters("initial_pose")), found)
    for m, (_, estimate) in zip(found, outcomes, strict=True):
        assert (estimate.stamp_ns if estimate else None) == (m.stamp_ns if isinstance(m, Sprockets) else None)


@pytest.mark.parametrize("start", ["initial_pose", "first_fix"])
def test_every_repeat_is_refused_and_changes_nothing(drive: Callable[..., Any], start: str) -> None:
    found = measurements(drive, start)[:30]  # all inside the window
    once, twice = SlipEstimator(parameters(start)), SlipEstimator(parameters(start))
    processed(once, found)
    for m in found:
        assert twice.process(m)[0].outcome in (Outcome.ACCEPTED, Outcome.GATED)
        assert twice.process(m)[0].outcome is Outcome.DUPLICATE
    assert {twice.process(m)[0].outcome for m in found} == {Outcome.DUPLICATE}
    assert_same(twice.estimate(), once.estimate())


def test_repeats_before_the_start_have_no_effect(drive: Callable[..., Any]) -> None:
    found = measurements(drive, "first_fix")
    waiting = [m for m in found if isinstance(m, Sprockets)][:3]
    rest = [m for m in found if m.stamp_ns > waiting[-1].stamp_ns]
    start = next(m for m in rest if isinstance(m, PoseFix))
    rest = [start, *(m for m in rest if m is not start and m.stamp_ns >= start.stamp_ns)]
    once, twice = SlipEstimator(parameters("first_fix")), SlipEstimator(parameters("first_fix"))
    assert {o for o, _ in processed(once, waiting)} == {Outcome.WAITING}
    outcomes = [o for o, _ in processed(twice, [m for m in waiting for _ in range(3)])]
    assert outcomes == [Outcome.WAITING, Outcome.DUPLICATE, Outcome.DUPLICATE] * 3
    for estimator in (once, twice):
        assert Outcome.WAITING not in {o for o, _ in processed(estimator, rest)}
    assert_same(twice.estimate(), once.estimate())


@pytest.mark.parametrize("kind", [Sprockets, YawRate, PoseFix])
def test_too_late_is_refused_and_changes_nothing(drive: Callable[..., Any], kind: type) -> None:
    found = measurements(drive, "initial_pose")
    newest_ns = found[-1].stamp_ns
    edge_ns = newest_ns - WINDOW_MS * MS
    estimator = SlipEstimator(parameters("initial_pose"))
    processed(estimator, found)
    before = estimator.estimate()
    late = next(m for m in found if isinstance(m, kind))
    for stamp_ns in (edge_ns - 1, edge_ns - 500 * MS, 0, -5):
        assert estimator.process(replace(late, stamp_ns=stamp_ns))[0].outcome is Outcome.TOO_LATE
    assert_same(estimator.estimate(), before)
    assert estimator.process(replace(late, stamp_ns=edge_ns + 1))[0].outcome is not Outcome.TOO_LATE


@pytest.mark.parametrize("start", ["initial_pose", "first_fix"])
def test_measurement_before_the_start_is_too_late(drive: Callable[..., Any], start: str) -> None:
    begin = measurements(drive, start)[0]
    estimator = SlipEstimator(parameters(start))
    assert estimator.process(begin)[0].outcome is Outcome.ACCEPTED
    assert (
        estimator.process(YawRate("imu/data_raw", begin.stamp_ns - 1, 0.0, 1.0))[0].outcome
        is Outcome.TOO_LATE
    )


@pytest.mark.parametrize("start", ["initial_pose", "first_fix"])
def test_invalid_measurements_never_change_the_state(drive: Callable[..., Any], start: str) -> None:
    found = measurements(drive, start)
    clean, dirty = SlipEstimator(parameters(start)), SlipEstimator(parameters(start))
    processed(clean, found)
    for k, m in enumerate(found):
        if k % 20 == 0:
            for bad in rubbish(m.stamp_ns + 7):
                assert dirty.process(bad)[0].outcome is Outcome.INVALID
        dirty.process(m)
    assert_same(dirty.estimate(), clean.estimate())


@pytest.mark.parametrize("other", [0.0, 0.5, -0.9])
def test_a_first_fix_with_an_asymmetric_covariance_is_invalid(
    drive: Callable[..., Any], other: float
) -> None:
    """An asymmetric first fix is invalid by either triangle; the next fix starts the estimate."""
    found = measurements(drive, "first_fix")
    first = found[0]
    assert isinstance(first, PoseFix)
    for row, column in ((0, 1), (1, 0)):
        R = np.diag((0.01, 0.01, 0.01))
        R[row, column], R[column, row] = other * 0.01, 0.3 * 0.01
        estimator = SlipEstimator(parameters("first_fix"))
        assert estimator.process(replace(first, covariance=R))[0].outcome is Outcome.INVALID
        assert not estimator.started
        outcomes = [outcome for outcome, _ in processed(estimator, found)]
        assert Outcome.INVALID not in outcomes
        clean = SlipEstimator(parameters("first_fix"))
        processed(clean, found)
        assert_same(estimator.estimate(), clean.estimate())


def test_sample_with_the_stamp_of_the_start_may_arrive_after_it(drive: Callable[..., Any]) -> None:
    """A sample and a fix with one stamp give the same bits in either order."""
    found = measurements(drive, "first_fix")
    fix, sample = found[0], found[1]
    assert isinstance(fix, PoseFix)
    assert isinstance(sample, Sprockets)
    assert fix.stamp_ns == sample.stamp_ns
    one, other = SlipEstimator(parameters("first_fix")), SlipEstimator(parameters("first_fix"))
    assert [o for o, _ in processed(one, [fix, sample])] == [Outcome.ACCEPTED] * 2
    assert [o for o, _ in processed(one, [fix, sample])] == [Outcome.DUPLICATE] * 2
    assert [o for o, _ in processed(other, [sample, fix])] == [Outcome.WAITING, Outcome.ACCEPTED]
    for estimator in (one, other):
        processed(estimator, found[2:])
    ends = [e.window.best[e.window.count - 1] for e in (one, other)]
    assert_same_bits(*ends)


def arrivals_of(drive: Callable[..., Any]) -> list[Measurement]:
    """Delayed, repeated and invalid measurements, a manual pose, a gap of the sprockets; then all again."""
    found = [
        m
        for m in delayed(measurements(drive, "first_fix"), 3)
        if not (isinstance(m, Sprockets) and 1_200 * MS < m.stamp_ns < 2_000 * MS)
    ]
    k = len(found) // 2
    bad = [*rubbish(found[k].stamp_ns), YawRate("imu/data_raw", 2**62, 0.0, 1e-4)]
    manual = PoseFix(SET_POSE, 0, np.array((1.0, 2.0, 0.5)), np.eye(3) * 1e-4)
    return [*found[:k], *bad, manual, *found[k - 10 :], *found]


@pytest.mark.parametrize(
    "changes",
    [
        {"model": "turning"},
        {"model": "icr", "sources.box_pose.lever_arm_x": 0.4, "sources.imu_data_raw.sign": -1},
        {"model": "free_slips", "filter": "daf"},
    ],
)
def test_batches_give_the_same_bits_as_single_measurements(
    drive: Callable[..., Any], changes: dict[str, Any]
) -> None:
    """A replay passes thousands of measurements at once, the live node one."""
    short = {"history_window": WINDOW_MS * 1e-3, "jump_confirmations": 5, **changes}
    p, given = load_slip_parameters(short), arrivals_of(drive)
    single = SlipEstimator(p)
    records = to_records(given, single.sources)
    one_by_one = np.concatenate([single.process_records(records[k : k + 1]) for k in range(len(records))])
    outcomes = {Outcome(o) for o in one_by_one["outcome"]}
    assert {
        Outcome.GATED,
        Outcome.DUPLICATE,
        Outcome.INVALID,
        Outcome.AHEAD,
        Outcome.RESTARTED,
        Outcome.ACCEPTED,
    } <= outcomes
    for size in (7, len(records)):
        estimator = SlipEstimator(p)
        parts = [records[k : k + size] for k in range(0, len(records), size)]
        results = np.concatenate([estimator.process_records(part) for part in parts])
        assert_same_bits(results, one_by_one)
        count = single.window.count
        assert estimator.window.count == count
        arrays: list[tuple[Any, Any]] = list(zip(estimator.window[1:], single.window[1:], strict=True))
        for mine, its in arrays:
            assert_same_bits(mine[:count], its[:count])


def test_full_window_is_enlarged_without_effect_on_the_estimate(drive: Callable[..., Any]) -> None:
    """At first, more measurements arrive within the history than the window has entries."""
    found = drive([(6.0, 1.0, 2.0, 0.0, 0.2, 0.0)], step_ms=5, gyro_every=1).measurements
    long = {"history_window": 4.5}
    estimator, single = SlipEstimator(load_slip_parameters(long)), SlipEstimator(load_slip_parameters(long))
    capacity = len(estimator.window.best)
    steps = estimator.process_all(found)
    assert len(estimator.window.best) > capacity < estimator.window.count
    for m, (report, _) in zip(found, steps, strict=True):
        assert single.process(m)[0].outcome is report.outcome
    assert_same(estimator.estimate(), single.estimate())


def test_states_older_than_the_window_are_trimmed_except_the_last(drive: Callable[..., Any]) -> None:
    found = measurements(drive, "first_fix")
    estimator = SlipEstimator(parameters("first_fix"))
    capacity = len(estimator.window.best)
    for _ in range(4):  # four drives one after the other
        processed(estimator, found)
        found = [replace(m, stamp_ns=m.stamp_ns + 3_100 * MS) for m in found]
    remove_settled_entries(estimator.window, estimator.config[0])
    stamps = estimator.window.measurements["stamp_ns"][: estimator.window.count]
    horizon = (estimator.newest_ns or 0) - WINDOW_MS * MS
    assert len(estimator.window.best) <= 4 * capacity
    assert (np.diff(stamps) >= 0).all()
    assert stamps[0] < horizon
    assert stamps[1] > horizon - 5_000 * MS
