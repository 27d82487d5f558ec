# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Commands while the estimator runs, and the watch over its sources."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from trackslip_common.errors import InputError
from trackslip_common.parameters import reloadable_names
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import (
    FREEZE,
    RELOAD,
    RESET,
    SET_POSE,
    UNFREEZE,
    Command,
    Fault,
    Measurement,
    Outcome,
    PoseFix,
    Reload,
    Report,
    Sprockets,
)
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.source_watch import SourceWatch

S = 1_000_000_000
EPOCH_NS = 1_800_000_000 * S


def manual_pose(stamp_ns: int = 0, variance: float = 1e-4) -> PoseFix:
    return PoseFix(SET_POSE, stamp_ns, np.array((5.0, -3.0, 1.0)), np.eye(3) * variance)


@pytest.fixture(scope="module")
def found(drive: Callable[..., Any]) -> list[Measurement]:
    driven: list[Measurement] = drive(
        [(6.0, 2.0, 2.0, 0.1, 0.1, 0.0), (6.0, 1.0, 2.0, 0.0, 0.2, 0.0)]
    ).measurements
    return driven


def running(found: list[Measurement], seconds: float = 8.0, **changes: Any) -> SlipEstimator:
    estimator = SlipEstimator(load_slip_parameters(changes))
    for m in found:
        if m.stamp_ns <= seconds * S:
            estimator.process(m)
    return estimator


def after(found: list[Measurement], seconds: float) -> list[Measurement]:
    return [m for m in found if m.stamp_ns > seconds * S]


def test_reset_restarts_the_estimate(found: list[Measurement]) -> None:
    estimator = running(found)
    fresh = SlipEstimator(load_slip_parameters(), learned=estimator.learned)  # the reset keeps learned states
    assert estimator.process(Command(RESET)) == (Report(RESET, 0, Outcome.ACCEPTED), None)
    assert not estimator.started
    assert estimator.restarts == 0
    for m in after(found, 8.0):
        (one, mine), (other, its) = estimator.process(m), fresh.process(m)
        assert one.outcome is other.outcome
        assert (mine is None) == (its is None)
        if mine is not None and its is not None:
            np.testing.assert_array_equal(mine.pose, its.pose)


def test_frozen_estimator_dead_reckons_and_ignores_poses(found: list[Measurement]) -> None:
    estimator = running(found)
    estimator.process(Command(FREEZE))
    steps = [estimator.process(m) for m in after(found, 8.0)]
    assert {r.outcome for r, _ in steps if r.source == "box_pose"} == {Outcome.FROZEN}
    assert {r.outcome for r, _ in steps if r.source != "box_pose"} == {Outcome.ACCEPTED}
    expected = running(found)
    for m in after(found, 8.0):
        if not isinstance(m, PoseFix):
            expected.process(m)
    np.testing.assert_array_equal(estimator.estimate().pose, expected.estimate().pose)
    estimator.process(Command(UNFREEZE))
    last = next(m for m in reversed(found) if isinstance(m, PoseFix))
    assert estimator.process(last)[0].outcome is Outcome.ACCEPTED


@pytest.mark.parametrize("stamp_s", [0.0, 7.5])
def test_set_pose_replaces_the_estimated_pose(found: list[Measurement], stamp_s: float) -> None:
    """The pose is set at its stamp, or at the newest time. Slips stay, also while fixes are frozen."""
    estimator = running(found, start="initial_pose")
    before = estimator.estimate()
    estimator.process(Command(FREEZE))
    report, _ = estimator.process(manual_pose(round(stamp_s * S)))
    used_ns = round((stamp_s or 8.0) * S)
    assert (report.source, report.stamp_ns, report.outcome) == (SET_POSE, used_ns, Outcome.ACCEPTED)
    assert report.dof == 0
    now = estimator.estimate()
    assert np.hypot(*(now.pose - manual_pose().pose)[:2]) < (1e-9 if stamp_s == 0.0 else 0.2)
    if stamp_s == 0.0:
        np.testing.assert_array_equal(now.pose_covariance, manual_pose().covariance)
        np.testing.assert_array_equal(now.outputs.slips, before.outputs.slips)


def test_set_pose_starts_the_estimate(found: list[Measurement]) -> None:
    estimator = SlipEstimator(load_slip_parameters())
    assert estimator.process(manual_pose())[0].outcome is Outcome.WAITING  # no newest time yet
    assert estimator.process(found[0])[0].outcome is Outcome.WAITING
    sprockets = next(m for m in found if isinstance(m, Sprockets) and m.stamp_ns > 0)
    assert estimator.process(sprockets)[0].outcome is Outcome.WAITING
    assert estimator.process(manual_pose())[0].outcome is Outcome.ACCEPTED
    np.testing.assert_array_equal(estimator.estimate().pose, manual_pose().pose)


def test_set_pose_without_a_stamp_counts_as_now_after_a_reset(found: list[Measurement]) -> None:
    """A reset keeps the clock: stamp 0 does not count as a silence of 1.8e9 s."""
    later = [replace(m, stamp_ns=m.stamp_ns + EPOCH_NS) for m in found]
    estimator = SlipEstimator(load_slip_parameters())
    watch = SourceWatch(estimator.parameters.timeouts_ns())
    before = [m for m in later if m.stamp_ns <= EPOCH_NS + 8 * S]
    for report, _ in map(estimator.process, before):
        watch.add(report)
    now_ns = estimator.newest_ns
    assert now_ns == EPOCH_NS + 8 * S
    reset, _ = estimator.process(Command(RESET))
    watch.clear()
    watch.add(reset)
    assert watch.lost_sources(now_ns) == {}
    assert not estimator.started
    given, estimate = estimator.process(manual_pose())
    watch.add(given)
    assert (given.outcome, given.stamp_ns) == (Outcome.ACCEPTED, now_ns)
    assert estimator.estimate().stamp_ns == now_ns
    np.testing.assert_array_equal(estimator.estimate().pose, manual_pose().pose)
    assert watch.lost_sources(now_ns + S // 10) == {}
    steps = [estimator.process(m) for m in later if m.stamp_ns > now_ns]
    published = [e.stamp_ns for _, e in steps if e is not None]
    assert published == sorted(published)
    assert published[0] == now_ns + 20_000_000
    assert estimate is None or estimate.stamp_ns == now_ns


def test_set_pose_without_a_covariance_is_refused(found: list[Measurement]) -> None:
    assert running(found).process(manual_pose(variance=0.0))[0].outcome is Outcome.INVALID


def test_the_gate_changes_while_it_runs(found: list[Measurement]) -> None:
    estimator = running(found)
    timeouts = {"sources.box_pose.timeout", "sources.imu_data_raw.timeout"}
    assert {"gate_probability", "gate_relaxation", *timeouts} == reloadable_names(estimator.parameters)
    estimator.process(Reload({"gate_probability": 0.5, "sources.box_pose.timeout": 3.0}))
    reports = [estimator.process(m)[0] for m in after(found, 8.0)]
    (gate,) = {r.gate for r in reports if r.source == "imu/data_raw"}
    assert gate == pytest.approx(chi2.ppf(0.5, 1))
    (gate,) = {r.gate for r in reports if r.source == "box_pose"}
    assert gate == pytest.approx(chi2.ppf(0.5, 3))
    with pytest.raises(InputError, match=r"gate_probability: 2\.0 is out of range"):
        estimator.process(Reload({"gate_probability": 2.0}))
    assert estimator.parameters.gate_probability == 0.5


# Watch over the sources


def processed(source: str, seconds: float, nis: float = 1.0, outcome: Outcome = Outcome.ACCEPTED) -> Report:
    return Report(source, round(seconds * S), outcome, nis, 10.0, 2)


def test_source_without_accepted_measurements_is_lost() -> None:
    watch = SourceWatch({"box_pose": S, "imu/data_raw": 5 * S})
    assert watch.lost_sources(100 * S) == {}  # no source is lost before the start
    for at_s in (10.0, 10.1):
        watch.add(processed("imu/data_raw", at_s))
    for k in range(10):
        watch.add(processed("box_pose", 10.0 + k / 2.0, outcome=Outcome.GATED))
    assert watch.lost_sources(12 * S) == {"box_pose": 2.0}
    watch.add(processed("box_pose", 15.0))
    assert watch.lost_sources(round(15.5 * S)) == {"imu/data_raw": 5.4}
    watch.clear()
    assert watch.lost_sources(99 * S) == {}


def test_a_source_slower_than_its_timeout_is_lost_after_three_periods() -> None:
    """A 1 Hz receiver: nearly every second fix arrives just after its timeout of 1 s."""
    watch, at_s = SourceWatch({"gnss_pose": S}), 10.0
    for k in range(240):
        outcome = Outcome.GATED if k % 100 == 50 else Outcome.ACCEPTED
        watch.add(processed("gnss_pose", at_s, outcome=outcome))
        at_s += 1.06 if k % 2 else 0.97
        assert watch.lost_sources(round(at_s * S)) == {}  # just before the next fix
    assert watch.lost_sources(round((at_s + 1.8) * S)) == {}
    assert list(watch.lost_sources(round((at_s + 2.2) * S))) == ["gnss_pose"]


def test_a_source_of_one_message_is_lost_after_three_timeouts() -> None:
    watch = SourceWatch({"gnss_pose": S})
    watch.add(processed("gnss_pose", 10.0))
    assert watch.lost_sources(13 * S) == {}
    assert watch.lost_sources(round(13.5 * S)) == {"gnss_pose": 3.5}


def test_the_mean_innovation_is_stated_with_its_bounds() -> None:
    watch = SourceWatch({"box_pose": S})
    for k in range(20):
        watch.add(processed("box_pose", k, nis=2.0 + (k % 2)))
    low, high = chi2.ppf((0.025, 0.975), 2 * 11) / 11  # of the last 10 s
    expected = f"2.55 ({low:.2f} to {high:.2f} if consistent), n 11"
    assert watch.innovations(19 * S) == {"box_pose": expected}


@pytest.mark.parametrize("name", [RESET, FREEZE, UNFREEZE, RELOAD])
def test_commands_are_no_source_of_measurements(name: str) -> None:
    watch = SourceWatch({"box_pose": S, "imu/data_raw": S})
    watch.add(Report(name, 0, Outcome.ACCEPTED))
    assert watch.lost_sources(EPOCH_NS) == {}  # no source is lost before the start
    watch.add(processed("box_pose", 1.8e9))
    watch.add(Report(name, 0, Outcome.ACCEPTED))
    assert watch.lost_sources(EPOCH_NS + S // 2) == {}
    assert watch.lost_sources(EPOCH_NS + 4 * S) == {"box_pose": 4.0, "imu/data_raw": 4.0}


def test_a_lost_source_is_named_with_why_its_latest_message_was_rejected() -> None:
    watch = SourceWatch({"box_pose": S, "imu/data_raw": S})
    watch.add(processed("box_pose", 1.0))
    watch.add(replace(processed("box_pose", 3.0), outcome=Outcome.INVALID, fault=Fault.NOT_FINITE))
    watch.add_rejection("imu/data_raw", "of another frame")
    lost = "box_pose for 7.0 s (not_finite), imu/data_raw for 7.0 s (of another frame)"
    assert watch.lost_sources_text(8 * S) == lost
    watch.add(processed("box_pose", 4.0))
    assert watch.lost_sources_text(9 * S).startswith("box_pose for 5.0 s, ")


def test_a_restart_clears_the_watch() -> None:
    watch = SourceWatch({"box_pose": S})
    watch.add(processed("box_pose", 100.0))
    watch.add(Report("sprockets", 2 * S, Outcome.RESTARTED))
    assert watch.innovations(2 * S) == {}
    assert watch.lost_sources(round(2.5 * S)) == {}
