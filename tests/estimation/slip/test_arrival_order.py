# SPDX-License-Identifier: Apache-2.0
"""The state is a function of the set of measurements: order, repeats and rubbish change nothing."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trackslip_estimation.slip.timeline import Timeline

from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.sprockets import SprocketTrack

MS = 1_000_000
WINDOW_MS = 1000
STEP_MS = 50

seeds = st.integers(0, 2**32 - 1)


def parameters(start: str, model: str = "turning") -> SlipEstimatorParameters:
    return load_slip_parameters({"start": start, "model": model, "history_window": WINDOW_MS * 1e-3})


def measurements(drive: Callable[..., Any], start: str, positions: bool = True) -> list[Measurement]:
    """3 s with a turn, fixes of which some are wide of the mark, the start first.

    Gyro and fixes lie between the sprocket samples: what drives there is known only with the next one.
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


def taken(estimator: SlipEstimator, arrivals: list[Measurement]) -> list[tuple[Outcome, Estimate | None]]:
    return [(report.outcome, estimate) for report, estimate in map(estimator.advance, arrivals)]


def assert_same(one: Estimate, other: Estimate) -> None:
    assert (one.stamp_ns, one.motion) == (other.stamp_ns, other.motion)
    for name in ("pose", "pose_covariance"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0.0, atol=1e-9)
    for name in ("twist", "twist_covariance", "slips", "slip_covariance"):
        mine, its = getattr(one.outputs, name), getattr(other.outputs, name)
        np.testing.assert_allclose(mine, its, rtol=0.0, atol=1e-9)


def delayed(found: list[Measurement], seed: int) -> list[Measurement]:
    """The start first, all else late by up to the window (a sample that closes a stretch: less that)."""
    rng = np.random.default_rng(seed)
    late = rng.integers(0, WINDOW_MS - STEP_MS, len(found)) * MS * (rng.random(len(found)) < rng.random())
    late[0] = -1
    return [
        found[k]
        for k in np.argsort([m.stamp_ns + d for m, d in zip(found, late, strict=True)], kind="stable")
    ]


@pytest.mark.parametrize("positions", [True, False])
@pytest.mark.parametrize("start", ["initial_pose", "first_fix"])
@pytest.mark.parametrize("model", ["turning", "free_slips"])
@settings(max_examples=8)
@given(seed=seeds)
def test_any_order_within_the_window_ends_in_the_same_state(
    drive: Callable[..., Any], model: str, start: str, positions: bool, seed: int
) -> None:
    found = measurements(drive, start, positions)
    ordered, shuffled = SlipEstimator(parameters(start, model)), SlipEstimator(parameters(start, model))
    taken(ordered, found)
    outcomes = taken(shuffled, delayed(found, seed))
    assert {outcome for outcome, _ in outcomes} <= {Outcome.ACCEPTED, Outcome.GATED}
    assert_same(shuffled.estimate(), ordered.estimate())


@pytest.mark.parametrize("model", ["turning", "icr", "free_slips"])
@settings(max_examples=6)
@given(seed=seeds)
def test_silence_and_jumping_positions_depend_on_no_order_either(
    drive: Callable[..., Any], model: str, seed: int
) -> None:
    """Stretches of up to 250 ms without sprockets, 120 ms of them silence; what closes one comes in time."""
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
    assert Outcome.JUMPED in {outcome for outcome, _ in taken(ordered, found)}
    assert Outcome.TOO_LATE not in {outcome for outcome, _ in taken(shuffled, arrivals)}
    assert_same(shuffled.estimate(), ordered.estimate())


@settings(max_examples=20)
@given(seed=seeds)
def test_published_stamps_increase(drive: Callable[..., Any], seed: int) -> None:
    found = measurements(drive, "initial_pose")
    published = [
        e.stamp_ns for _, e in taken(SlipEstimator(parameters("initial_pose")), delayed(found, seed)) if e
    ]
    assert published == sorted(set(published))
    assert set(published) <= {m.stamp_ns for m in found if isinstance(m, Sprockets)}
    assert max(m.stamp_ns for m in found) == published[-1]


def test_in_order_every_sprocket_sample_gives_an_estimate_at_its_stamp(drive: Callable[..., Any]) -> None:
    found = measurements(drive, "initial_pose")
    outcomes = taken(SlipEstimator(parameters("initial_pose")), found)
    for m, (_, estimate) in zip(found, outcomes, strict=True):
        assert (estimate.stamp_ns if estimate else None) == (m.stamp_ns if isinstance(m, Sprockets) else None)


@pytest.mark.parametrize("start", ["initial_pose", "first_fix"])
def test_every_repeat_is_refused_and_changes_nothing(drive: Callable[..., Any], start: str) -> None:
    found = measurements(drive, start)[:30]  # all inside the window
    once, twice = SlipEstimator(parameters(start)), SlipEstimator(parameters(start))
    taken(once, found)
    for m in found:
        assert twice.take(m).outcome in (Outcome.ACCEPTED, Outcome.GATED)
        assert twice.advance(m)[0].outcome is Outcome.DUPLICATE
    assert {twice.take(m).outcome for m in found} == {Outcome.DUPLICATE}
    assert_same(twice.estimate(), once.estimate())


def test_repeats_before_the_start_do_no_harm(drive: Callable[..., Any]) -> None:
    found = measurements(drive, "first_fix")
    waiting = [m for m in found if isinstance(m, Sprockets)][:3]
    rest = [m for m in found if m.stamp_ns > waiting[-1].stamp_ns]
    start = next(m for m in rest if isinstance(m, PoseFix))
    rest = [start, *(m for m in rest if m is not start and m.stamp_ns >= start.stamp_ns)]
    once, twice = SlipEstimator(parameters("first_fix")), SlipEstimator(parameters("first_fix"))
    assert {o for o, _ in taken(once, waiting)} == {Outcome.WAITING}
    assert {o for o, _ in taken(twice, [m for m in waiting for _ in range(3)])} == {Outcome.WAITING}
    for estimator in (once, twice):
        assert Outcome.WAITING not in {o for o, _ in taken(estimator, rest)}
    assert_same(twice.estimate(), once.estimate())


@pytest.mark.parametrize("kind", [Sprockets, YawRate, PoseFix])
def test_too_late_is_refused_and_changes_nothing(drive: Callable[..., Any], kind: type) -> None:
    found = measurements(drive, "initial_pose")
    newest_ns = found[-1].stamp_ns
    edge_ns = newest_ns - WINDOW_MS * MS
    estimator = SlipEstimator(parameters("initial_pose"))
    taken(estimator, found)
    before = estimator.estimate()
    late = next(m for m in found if isinstance(m, kind))
    for stamp_ns in (edge_ns - 1, edge_ns - 500 * MS, 0, -5):
        assert estimator.take(replace(late, stamp_ns=stamp_ns)).outcome is Outcome.TOO_LATE
    assert_same(estimator.estimate(), before)
    assert estimator.take(replace(late, stamp_ns=edge_ns + 1)).outcome is not Outcome.TOO_LATE


@pytest.mark.parametrize("start", ["initial_pose", "first_fix"])
def test_what_lies_before_the_start_is_too_late(drive: Callable[..., Any], start: str) -> None:
    begin = measurements(drive, start)[0]
    estimator = SlipEstimator(parameters(start))
    assert estimator.take(begin).outcome is Outcome.ACCEPTED
    assert estimator.take(YawRate("imu/data_raw", begin.stamp_ns - 1, 0.0, 1.0)).outcome is Outcome.TOO_LATE


def rubbish(stamp_ns: int) -> list[Measurement]:
    """One of each kind that cannot be used."""
    bad = (math.nan, math.inf, -math.inf)
    pose, covariance = np.zeros(3), np.eye(3) * 1e-2
    poses = [(np.where(np.arange(3) == k, b, 0.0), covariance) for k in range(3) for b in bad]
    for k, m in ((0, 0), (1, 1), (2, 2), (0, 1)):
        spoilt = np.repeat(covariance[np.newaxis], 2, axis=0)
        spoilt[:, k, m] = spoilt[:, m, k] = (math.nan, math.inf)
        poses += [(pose, c) for c in spoilt]
    poses += [(pose, np.diag(d)) for d in ((0.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, 0.0))]
    crossed = np.array(((1.0, 2.0, 0.0), (2.0, 1.0, 0.0), (0.0, 0.0, 1.0)))  # a correlation of 2
    return [
        *(Sprockets("sprockets", stamp_ns, b, 1.0) for b in bad),
        *(Sprockets("sprockets", stamp_ns, 1.0, b, (0.0, 0.0)) for b in bad),
        *(Sprockets("sprockets", stamp_ns, 1.0, 1.0, (b, 0.0)) for b in bad),
        *(Sprockets("sprockets", stamp_ns, 1.0, 1.0, (0.0, b)) for b in bad),
        *(YawRate("imu/data_raw", stamp_ns, b, 1e-4) for b in bad),
        *(YawRate("imu/data_raw", stamp_ns, 0.0, v) for v in (*bad, 0.0, -1.0)),
        *(PoseFix("box_pose", stamp_ns, *p) for p in (*poses, (pose, crossed))),
    ]


@pytest.mark.parametrize("start", ["initial_pose", "first_fix"])
def test_rubbish_is_invalid_and_never_touches_the_state(drive: Callable[..., Any], start: str) -> None:
    found = measurements(drive, start)
    clean, dirty = SlipEstimator(parameters(start)), SlipEstimator(parameters(start))
    taken(clean, found)
    for k, m in enumerate(found):
        if k % 20 == 0:
            for bad in rubbish(m.stamp_ns + 7):
                assert dirty.take(bad).outcome is Outcome.INVALID
        dirty.advance(m)
    assert_same(dirty.estimate(), clean.estimate())


# The pieces on their own. A state is here the stamps that made it, so that nothing can hide.


@settings(max_examples=60)
@given(st.lists(st.integers(0, 60), max_size=40))
def test_timeline_orders_what_comes_and_leaves_what_is_settled(stamps: list[int]) -> None:
    window, steps = 20, []

    def step(state: tuple[int, ...], m: Measurement) -> tuple[int, ...]:
        steps.append(m.stamp_ns)
        return (*state, m.stamp_ns)

    timeline = Timeline(window, (), YawRate("start", 0, 0.0, 1.0), step)
    kept: list[int] = []
    for stamp in stamps:
        newest = max(kept, default=0)
        m = YawRate("gyro", stamp, 0.0, 1.0)
        expected: Outcome | None = (
            Outcome.TOO_LATE if stamp < newest - window else Outcome.DUPLICATE if stamp in kept else None
        )
        assert timeline.refusal(m) is expected
        if expected is not None:
            continue
        steps.clear()
        kept = sorted([*kept, stamp])
        assert timeline.insert(m) == tuple(kept[: kept.index(stamp) + 1])
        assert timeline.newest == tuple(kept)
        assert steps == kept[kept.index(stamp) :]
        assert min(steps) >= timeline.oldest_ns or stamp == max(kept)


@settings(max_examples=60)
@given(
    st.lists(st.integers(0, 50), min_size=2, max_size=20, unique=True),
    st.integers(0, 60),
    st.booleans(),
    st.randoms(use_true_random=False),
)
def test_forgetting_samples_does_not_change_later_speeds(
    stamps: list[int], horizon: int, positions: bool, random: Any
) -> None:
    whole, short = SprocketTrack(10**9, 1e12), SprocketTrack(10**9, 1e12)
    for stamp in stamps:
        p = (random.random(), random.random()) if positions else None
        sample = Sprockets("sprockets", stamp, random.random(), random.random(), p)
        whole.add(sample)
        short.add(sample)
    short.forget_before(horizon)
    for end in range(horizon, 70):
        assert short.stretch(end)[0] == whole.stretch(end)[0]
        assert short.last_before(end) == whole.last_before(end) or end == horizon


def test_speeds_are_those_of_the_stretch_around_the_time() -> None:
    track = SprocketTrack(10**9, 1e12)
    assert tuple(track.stretch(5)[0][:2]) == (0.0, 0.0)
    for ms, angles in ((200, (3.0, 0.2)), (0, (1.0, 0.0)), (100, (2.0, 0.4))):  # in no order
        track.add(Sprockets("sprockets", ms * MS, 9.0, 9.0, angles))
    assert track.stretch(0)[0][:2] == (9.0, 9.0)  # nothing before it to difference from
    for ms in (1, 50, 100):
        assert track.stretch(ms * MS)[0][:2] == pytest.approx((10.0, 4.0))
    for ms in (101, 200, 300):  # and beyond the last, as before it
        assert track.stretch(ms * MS)[0][:2] == pytest.approx((10.0, -2.0))
    track.add(Sprockets("sprockets", 200 * MS, 9.0, 9.0, (7.0, 7.0)))  # a repeat changes nothing
    assert track.stretch(300 * MS)[0][:2] == pytest.approx((10.0, -2.0))
    assert track.last_before(100 * MS) == 0
    assert track.last_before(0) is None


def test_without_positions_the_closing_sample_tells_the_speed() -> None:
    track = SprocketTrack(10**9, 1e12)
    for ms, speed in ((0, 1.0), (100, 2.0)):
        track.add(Sprockets("sprockets", ms * MS, speed, -speed))
    assert [track.stretch(ms * MS)[0][:2] for ms in (0, 50, 100, 200)] == [(1.0, -1.0), *[(2.0, -2.0)] * 3]
