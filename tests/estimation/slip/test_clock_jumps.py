# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Clock jumps: a single wrong stamp is rejected; another time is accepted once enough samples agree on it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from trackslip_common.errors import InputError
from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import load_slip_parameters

S = 1_000_000_000
HOUR_NS = 3600 * S


def run(found: list[Measurement], **changes: Any) -> tuple[SlipEstimator, list[Outcome], list[Estimate]]:
    estimator = SlipEstimator(load_slip_parameters({"jump_confirmations": 10}, changes))
    steps = estimator.process_all(found)
    return estimator, [r.outcome for r, _ in steps], [e for _, e in steps if e is not None]


def shifted(found: list[Measurement], by_ns: int) -> list[Measurement]:
    return [replace(m, stamp_ns=m.stamp_ns + by_ns) for m in found]


def same(one: list[Estimate], other: list[Estimate]) -> bool:
    return all(
        a.stamp_ns == b.stamp_ns and np.array_equal(a.pose, b.pose) for a, b in zip(one, other, strict=True)
    )


@pytest.fixture(scope="module")
def found(drive: Callable[..., Any]) -> list[Measurement]:
    measured: list[Measurement] = drive(
        [(6.0, 2.0, 2.0, 0.1, 0.1, 0.0), (4.0, 1.0, 2.0, 0.0, 0.2, 0.0)]
    ).measurements
    return measured


@pytest.mark.parametrize("start", ["first_fix", "initial_pose"])
def test_bag_loop_repeats_the_same_estimates(found: list[Measurement], start: str) -> None:
    """After the samples that confirm the restart, the estimates are those of a new node."""
    once = shifted(found, S)
    estimator, outcomes, twice = run([*once, *once], start=start)
    assert estimator.restarts == 1
    assert outcomes.count(Outcome.RESTARTED) == 1
    again = once[outcomes.index(Outcome.RESTARTED) - len(once) :]
    fresh = run(again, start=start)[2]
    assert same(twice[-len(fresh) :], fresh)
    first = run(once, start=start)[2]
    assert same(twice[: len(first)], first)
    assert len(twice) == len(first) + len(fresh)


def test_published_stamps_decrease_only_at_a_restart(found: list[Measurement]) -> None:
    _, _, published = run([*shifted(found, HOUR_NS), *shifted(found, S), *shifted(found, 2 * HOUR_NS)])
    steps = np.diff([e.stamp_ns for e in published])
    assert np.count_nonzero(steps < 0) == 1
    assert published[-1].stamp_ns > 2 * HOUR_NS


@pytest.mark.parametrize("back_ms", [203, 740, 1990])
def test_clock_set_back_by_less_than_the_window_is_detected(found: list[Measurement], back_ms: int) -> None:
    """Samples then look late, but with new positions; a few after the confirmations detect the jump."""
    at = next(k for k, m in enumerate(found) if m.stamp_ns > 4 * S)
    after = shifted(found[at:], -back_ms * 1_000_000)
    estimator, outcomes, published = run([*found[:at], *after])
    assert estimator.restarts == 1
    sprockets = [o for m, o in zip(after, outcomes[at:], strict=True) if isinstance(m, Sprockets)]
    assert sprockets.index(Outcome.RESTARTED) <= 15  # with 10 confirmations
    fresh = run(after[outcomes.index(Outcome.RESTARTED) - at :])[2]
    assert same(published[-len(fresh) :], fresh)


def test_late_burst_is_not_taken_for_another_clock(found: list[Measurement]) -> None:
    """A stalled link delivers 1.5 s of sprocket samples after those that follow them."""
    stalled = [m for m in found if isinstance(m, Sprockets) and 4 * S < m.stamp_ns < 5.5 * S]
    prompt = [m for m in found if m not in stalled]
    at = next(k for k, m in enumerate(prompt) if m.stamp_ns > 5.8 * S)
    estimator, outcomes, published = run([*prompt[:at], *stalled, *prompt[at:]])
    assert estimator.restarts == 0
    assert set(outcomes) <= {Outcome.ACCEPTED, Outcome.GATED, Outcome.WAITING}
    np.testing.assert_array_equal(published[-1].pose, run(found)[2][-1].pose)


@pytest.mark.parametrize("kind", [Sprockets, YawRate, PoseFix])
@pytest.mark.parametrize("k", [0, 200])
def test_one_stamp_far_ahead_has_no_effect(found: list[Measurement], kind: type, k: int) -> None:
    """The stamp comes during the drive or before all others."""
    once = shifted(found, S)
    bad = replace(next(m for m in once[k:] if isinstance(m, kind)), stamp_ns=HOUR_NS)
    estimator, outcomes, published = run([*once[:k], bad, *once[k:]])
    clean = run(once)[2]
    assert same(published[-100:], clean[-100:]) or k == 0
    assert outcomes[-1] in (Outcome.ACCEPTED, Outcome.GATED)
    assert published[-1].stamp_ns == clean[-1].stamp_ns
    np.testing.assert_allclose(published[-1].pose, clean[-1].pose, atol=0.05)
    assert estimator.restarts == (1 if k == 0 and kind is not YawRate else 0)


@pytest.mark.parametrize("kind", [PoseFix, YawRate, Sprockets])
@pytest.mark.parametrize(("hours", "outcome"), [(1, Outcome.AHEAD), (-1, Outcome.TOO_LATE)])
def test_publisher_with_stamps_an_hour_off_changes_nothing(
    found: list[Measurement], kind: type, hours: int, outcome: Outcome
) -> None:
    """Each measurement of a kind is followed by a copy with a stamp an hour off."""
    once, both = shifted(found, 1_700_000_000 * S), list[Measurement]()
    for m in once:
        both += [m, *(shifted([m], hours * HOUR_NS) if isinstance(m, kind) else [])]
    _, outcomes, published = run(both)
    off = [abs(m.stamp_ns - once[0].stamp_ns) > HOUR_NS // 2 for m in both]
    assert {o for o, is_off in zip(outcomes, off, strict=True) if is_off} - {Outcome.WAITING} == {outcome}
    assert same(published, run(once)[2])


def test_clock_set_forward_keeps_the_learned_states(found: list[Measurement]) -> None:
    """The clock jumps from 1970 to now when the network connects: no restart; the next fix sets the pose."""
    before, after = shifted(found, S), shifted(found, 1_700_000_000 * S)
    estimator, outcomes, published = run([*before, *after[: len(after) // 2]])
    assert estimator.restarts == 0
    assert outcomes.count(Outcome.AHEAD) >= 9
    assert all(np.isfinite(e.pose_covariance).all() for e in published)
    by_stamp = {e.stamp_ns: e for e in run(before)[2]}
    for e in published[-50:]:
        reference = by_stamp[e.stamp_ns - 1_700_000_000 * S + S]
        np.testing.assert_allclose(e.pose, reference.pose, atol=0.1)


@pytest.mark.parametrize("kind", [YawRate, PoseFix])
@pytest.mark.parametrize("ahead", [2.2, 3.5, 5.0])
def test_one_stamp_of_another_source_ahead_makes_no_sprocket_sample_too_late(
    found: list[Measurement], kind: type, ahead: float
) -> None:
    """Stamps 2.2 to 5 s ahead are beyond the window but within the gap; only sprockets set the horizon."""
    k = next(k for k, m in enumerate(found) if isinstance(m, kind) and m.stamp_ns > 3 * S)
    wrong = [*found[:k], replace(found[k], stamp_ns=found[k].stamp_ns + round(ahead * S)), *found[k + 1 :]]
    estimator, outcomes, published = run(wrong)
    assert {Outcome.TOO_LATE, Outcome.RESTARTED, Outcome.AHEAD}.isdisjoint(outcomes)
    assert estimator.restarts == 0
    clean = run(found)[2]
    assert [e.stamp_ns for e in published] == [e.stamp_ns for e in clean]
    np.testing.assert_allclose(published[-1].pose, clean[-1].pose, atol=0.05)


def test_a_gap_smaller_than_the_window_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"max_gap: 1 is out of range; accepted: at least history_window, 2 s"
    ):
        load_slip_parameters({"max_gap": 1.0})
