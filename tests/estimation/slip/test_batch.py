# SPDX-License-Identifier: Apache-2.0
"""The batch gives what the estimator ends with, for any number of runs at once."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from trackslip_estimation.slip.batch import EVERYTHING, Run, run, run_all
from trackslip_estimation.slip.gating import Gates
from trackslip_estimation.slip.measurement_log import MeasurementLog, read_measurements, run_log
from trackslip_estimation.slip.timeline import key_of

from trackslip_common.errors import InputError
from trackslip_estimation.slip import filter as kernels
from trackslip_estimation.slip import gating
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import SET_POSE, Measurement, Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.models.model import FULL_POSE, SPROCKETS, Gaussian
from trackslip_estimation.slip.parameters import (
    SlipEstimatorParameters,
    load_slip_parameters,
    make_filter,
    make_gates,
)

MS, S = 1_000_000, 1_000_000_000
BOTH = (EVERYTHING, Gates(np.array((np.inf, 6.0, 9.0, 11.0)), 1.0, np.ones(2, np.int64), np.zeros((2, 2))))
SEGMENTS = [
    (1.0, 2.0, 2.0, 0.05, 0.1, 0.0),
    (2.0, 1.0, 2.0, 0.0, 0.2, 0.1),
    (1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (3.0, 2.0, 2.0, 0.1, 0.1, 0.0),
]


def parameters(**changes: Any) -> SlipEstimatorParameters:
    return load_slip_parameters({"pose_timeouts": [0.3], "yaw_rate_timeouts": [0.5]}, changes)


def measurements(drive: Callable[..., Any], seed: int = 0) -> list[Measurement]:
    """Gyro readings with spikes; fixes between the sprocket samples, some wide of the mark in a row."""
    found: list[Measurement] = drive(SEGMENTS, seed=seed, gyro_every=2).measurements
    for k, m in enumerate(found):
        if isinstance(m, YawRate) and k % 10 == 0:
            found[k] = replace(m, rate=m.rate + 30.0)
        if isinstance(m, PoseFix) and m.stamp_ns > 0:
            wide = (3.0, 0.0, 0.0) if 5 * 10**8 < m.stamp_ns < 2 * 10**9 else (0.0, 0.0, 0.0)
            found[k] = replace(m, stamp_ns=m.stamp_ns - 7 * MS, pose=m.pose + np.array(wide))
    return sorted(found, key=key_of)


def with_faults(found: list[Measurement]) -> list[Measurement]:
    """Two silences of the sprockets, one of all, a user's word, a stamp far ahead, a repeat, and rubbish."""
    silent = [(2.2, 3.1), (4.0, 4.9)]
    kept = [
        m
        for m in found
        if not (4.2 * S < m.stamp_ns < 4.8 * S)
        and not (isinstance(m, Sprockets) and any(a * S < m.stamp_ns < b * S for a, b in silent))
    ]
    word = PoseFix(SET_POSE, round(5.505 * S), np.array((9.0, -4.0, 1.0)), np.diag((0.1, 0.1, 0.01)))
    ahead = Sprockets("sprockets", 60 * S, 1.0, 1.0)
    rubbish = YawRate("imu/data_raw", 12345, float("nan"), 1.0)
    return sorted([*kept, word, ahead, kept[len(kept) // 2], rubbish], key=key_of)


def start_of(log: MeasurementLog, p: SlipEstimatorParameters) -> Gaussian:
    assert isinstance(log.start, PoseFix)
    return make_filter(p).initial(log.start.pose, log.start.covariance)


def ended(found: list[Measurement], p: SlipEstimatorParameters) -> tuple[Gaussian, list[Outcome]]:
    """Where the live estimator ends, and what it made of each."""
    estimator = SlipEstimator(p)
    outcomes = [estimator.take(m).outcome for m in found]
    return estimator.history()[-1].gaussian, outcomes


@pytest.mark.parametrize("filter_", ["ekf", "daf"])
@pytest.mark.parametrize("model", ["turning", "icr", "free_slips"])
@pytest.mark.parametrize("changes", [{}, {"use_heading": False, "pose_lever_arms_x": [0.4]}])
def test_it_ends_as_the_estimator_does(
    drive: Callable[..., Any], model: str, filter_: str, changes: dict[str, Any]
) -> None:
    """With gated measurements, gates that widen, silences and all that a log may hold."""
    p = parameters(model=model, filter=filter_, **changes)
    found = with_faults(measurements(drive))
    state, outcomes = ended(found, p)
    log = read_measurements(found, p)
    result = run_log(log, p)
    np.testing.assert_allclose(result.means[-1], state.mean, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(result.covariances[-1], state.covariance, rtol=1e-9, atol=1e-9)
    assert 5 < outcomes.count(Outcome.GATED) == np.count_nonzero(~result.accepted)
    assert {Outcome.AHEAD, Outcome.INVALID, Outcome.DUPLICATE} <= set(outcomes)
    assert len(log.asides) == 20


def test_an_outage_opens_the_gate_as_it_does_live(drive: Callable[..., Any]) -> None:
    """Fixes far off, after none for 3 s, are believed: where gates do not widen they never are."""
    found = [
        replace(m, pose=m.pose + np.array((2.0, 2.0, 0.0)))
        if isinstance(m, PoseFix) and m.stamp_ns > 4 * S
        else m
        for m in drive(SEGMENTS).measurements
        if not (isinstance(m, PoseFix) and 1 * S < m.stamp_ns <= 4 * S)
    ]
    rejected = []
    for relaxation in (10.0, 1.0):
        p = parameters(gate_relaxation=relaxation)
        state, outcomes = ended(sorted(found, key=key_of), p)
        result = run_log(read_measurements(found, p), p)
        np.testing.assert_allclose(result.means[-1], state.mean, rtol=0.0, atol=1e-9)
        assert np.count_nonzero(~result.accepted) == outcomes.count(Outcome.GATED)
        rejected.append(outcomes.count(Outcome.GATED))
    assert rejected[0] < rejected[1] / 2


def test_only_the_rows_that_are_asked_for_are_kept(drive: Callable[..., Any]) -> None:
    p = parameters()
    log = read_measurements(with_faults(measurements(drive)), p)
    whole = run_log(log, p)
    keep = np.zeros(len(log.log.times), dtype=np.bool_)
    keep[[3, 50, *log.asides, -1]] = True
    lean = run_log(log, p, keep)
    np.testing.assert_array_equal(lean.means, whole.means[keep])
    np.testing.assert_array_equal(lean.covariances, whole.covariances[keep])
    np.testing.assert_array_equal(lean.nis, whole.nis)
    assert log.published.sum() == np.count_nonzero(log.log.flags[:, 0] == SPROCKETS)


def test_the_spread_of_an_innovation_follows_from_its_update(drive: Callable[..., Any]) -> None:
    """|S| = |R| |P| / |P'|: of a fix at the stamp of the row before it, which predicts nothing."""
    p = parameters()
    log = read_measurements(drive(SEGMENTS, gyro_every=1000).measurements, p)
    result = run_log(log, p)
    kinds, dt = log.log.flags[:, 0], log.log.times[:, 0]
    fixes = [k for k in np.flatnonzero((kinds == FULL_POSE) & (dt == 0.0)) if k > 0 and result.accepted[k]]
    assert len(fixes) > 20
    for k in fixes:
        before, after, R = result.covariances[k - 1], result.covariances[k], log.log.noises[k]
        expected = sum(sign * np.linalg.slogdet(M)[1] for sign, M in ((1, R), (1, before), (-1, after)))
        assert result.log_dets[k] == pytest.approx(expected, abs=1e-6)
    assert np.isnan(result.log_dets[log.published]).all()


def test_many_runs_are_each_that_one_run(drive: Callable[..., Any]) -> None:
    """Sets of parameters over one log, and noise seeds under one set, on threads."""
    sets = [parameters(model=m) for m in ("turning", "icr")]
    logs = [read_measurements(measurements(drive, seed), sets[0]) for seed in range(3)]
    jobs = [
        (log.log, make_filter(p), start_of(log, p), gates) for p in sets for log in logs for gates in BOTH
    ]
    together = list(run_all(jobs, threads=2))
    assert len(together) == 12
    for one, job in zip(together, jobs, strict=True):
        assert_same(one, run(*job))
    assert len({one.means.tobytes() for one in together}) == 12


def assert_same(one: Run, other: Run) -> None:
    for mine, its in zip(one, other, strict=True):
        np.testing.assert_array_equal(mine, its)


def test_order_and_repeats_do_not_matter(drive: Callable[..., Any]) -> None:
    p, found = parameters(), measurements(drive)
    rubbish = YawRate("imu/data_raw", 12345, float("nan"), 1.0)
    mixed = [found[k] for k in np.random.default_rng(0).permutation(len(found))] + [rubbish, *found[:40]]
    ordered, other = read_measurements(found, p), read_measurements(mixed, p)
    np.testing.assert_array_equal(ordered.stamps_ns, other.stamps_ns)
    for mine, its in zip(ordered.log, other.log, strict=True):
        np.testing.assert_array_equal(mine, its)


def test_everything_is_taken_where_nothing_is_gated(drive: Callable[..., Any]) -> None:
    p = parameters()
    log = read_measurements(measurements(drive), p)
    result = run(log.log, make_filter(p), start_of(log, p))
    assert result.accepted.all()
    assert np.isfinite(result.means).all()


def test_a_log_without_a_start_is_refused(drive: Callable[..., Any]) -> None:
    sprockets = [m for m in measurements(drive) if isinstance(m, Sprockets)]
    with pytest.raises(InputError, match="to start from \\(start: first_fix\\)"):
        read_measurements(sprockets, parameters())


def test_gates_of_other_sources_and_rows_that_nobody_does_are_refused(drive: Callable[..., Any]) -> None:
    p = parameters()
    log = read_measurements(with_faults(measurements(drive)), p)
    arguments = log.log, make_filter(p), start_of(log, p)
    with pytest.raises(ValueError, match="nobody to ask"):
        run(*arguments, make_gates(p))
    two = make_gates(parameters(yaw_rate_sources=["imu/data_raw", "b", "c"]))
    three_of = log.log._replace(flags=log.log.flags + np.array((0, 4, 0, 0, 0)))
    with pytest.raises(ValueError, match="gates of 4 sources for a log of 6"):
        run(three_of, *arguments[1:], two)


@pytest.mark.parametrize("model", ["turning", "icr", "free_slips"])
def test_nothing_is_compiled_while_driving(drive: Callable[..., Any], model: str) -> None:
    """Arrays of another layout would stop the estimator for seconds."""
    p = parameters(model=model, use_heading=False, pose_lever_arms_x=[0.3])
    estimator = SlipEstimator(p)
    compiled = kernels._step, kernels._outputs, gating._take, gating.shifted
    before = [list(kernel.signatures) for kernel in compiled]
    steps = [estimator.advance(m) for m in measurements(drive)]
    assert any(r.outcome is Outcome.GATED for r, _ in steps)
    assert [list(kernel.signatures) for kernel in compiled] == before
    assert {len(signatures) for signatures in before[:3]} == {1}
