# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A run over a whole log ends as the live estimator does, for any number of runs at once."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from fixtures.fault_cases.injections import displaced
from fixtures.records import assert_same_bits

from trackslip_common.errors import InputError
from trackslip_estimation.slip import log as logs
from trackslip_estimation.slip import process as live
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.log import Log, best_branch_script, make_log, run_in_one_block, run_log
from trackslip_estimation.slip.measurements import SET_POSE, Measurement, Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.records import POSE, SPROCKETS, to_records
from trackslip_estimation.slip.source_faults import SourceFault
from trackslip_estimation.slip.window import Records

MS, S = 1_000_000, 1_000_000_000
SEGMENTS = [
    (1.0, 2.0, 2.0, 0.05, 0.1, 0.0),
    (2.0, 1.0, 2.0, 0.0, 0.2, 0.1),
    (1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (3.0, 2.0, 2.0, 0.1, 0.1, 0.0),
]


def parameters(**changes: Any) -> SlipEstimatorParameters:
    return load_slip_parameters(
        {"sources.box_pose.timeout": 0.3, "sources.imu_data_raw.timeout": 0.5}, changes
    )


def measurements(drive: Callable[..., Any], seed: int = 0) -> list[Measurement]:
    """Gyro readings with spikes; fixes between the sprocket samples, some of them consecutive outliers."""
    found: list[Measurement] = drive(SEGMENTS, seed=seed, gyro_every=2).measurements
    for k, m in enumerate(found):
        if isinstance(m, YawRate) and k % 10 == 0:
            found[k] = replace(m, rate=m.rate + 30.0)
        if isinstance(m, PoseFix) and m.stamp_ns > 0:
            wide = (3.0, 0.0, 0.0) if 5 * 10**8 < m.stamp_ns < 2 * 10**9 else (0.0, 0.0, 0.0)
            found[k] = replace(m, stamp_ns=m.stamp_ns - 7 * MS, pose=m.pose + np.array(wide))
    return in_order(found)


def with_faults(found: list[Measurement]) -> list[Measurement]:
    """Gaps of the sprockets, one of all, an outlier, a manual pose, a stamp far ahead, a repeat, a NaN."""
    silent = [(2.2, 3.1), (4.0, 4.9)]
    kept = [
        displaced(m, 5.0, 0.0) if isinstance(m, PoseFix) and abs(m.stamp_ns - 3.6 * S) < 0.1 * S else m
        for m in found
        if not (4.2 * S < m.stamp_ns < 4.8 * S)
        and not (isinstance(m, Sprockets) and any(a * S < m.stamp_ns < b * S for a, b in silent))
    ]
    manual = PoseFix(SET_POSE, round(5.505 * S), np.array((9.0, -4.0, 1.0)), np.diag((0.1, 0.1, 0.01)))
    ahead = Sprockets("sprockets", 60 * S, 1.0, 1.0)
    rubbish = YawRate("imu/data_raw", 12345, float("nan"), 1.0)
    return in_order([*kept, manual, ahead, kept[len(kept) // 2], rubbish])


def in_order(found: Sequence[Measurement]) -> list[Measurement]:
    """The measurements by stamp, then in the order of the estimator."""
    p = parameters()
    records = to_records(found, SlipEstimator(p).sources)
    return [found[k] for k in np.lexsort((records["source"], records["kind"], records["stamp_ns"]))]


def log_of(found: Sequence[Measurement], p: SlipEstimatorParameters) -> Log:
    return make_log(to_records(found, SlipEstimator(p).sources), p)


class RunResult(NamedTuple):
    """Measurements, states, updates and priors of a whole run."""

    measurements: Records
    states: Records
    updates: Records
    priors: Records  # empty without a script


def run_of(log: Log, p: SlipEstimatorParameters, script: Records | None = None) -> RunResult:
    parts = [
        [part.copy() for part in (b.measurements, b.states, b.updates, b.priors)]
        for b in run_log(log, p, script)
    ]
    return RunResult(*(np.concatenate(one) for one in zip(*parts, strict=True)))


def ended(found: Sequence[Measurement], p: SlipEstimatorParameters) -> tuple[Any, list[Outcome]]:
    """The last state of the live estimator, and the outcome of each measurement."""
    estimator = SlipEstimator(p)
    outcomes = [report.outcome for report, _ in map(estimator.process, found)]
    return estimator.window.best[estimator.window.count - 1], outcomes


@pytest.mark.parametrize(
    ("filter_", "model", "changes"),
    [
        ("daf", "turning", {}),
        ("daf", "turning", {"sources.box_pose.use_heading": False, "sources.box_pose.lever_arm_x": 0.4}),
        ("ekf", "free_slips", {}),
        ("ekf", "free_slips", {"sources.box_pose.lever_arm_x": 0.4}),
    ],
)
def test_log_run_ends_in_the_state_of_the_estimator(
    drive: Callable[..., Any], model: str, filter_: str, changes: dict[str, Any]
) -> None:
    """With rejected measurements, inflated gates, silences and all other cases of a log."""
    p = parameters(model=model, filter=filter_, **changes)
    found = with_faults(measurements(drive))
    state, outcomes = ended(found, p)
    run = run_of(log_of(found, p), p)
    assert_same_bits(run.states[-1], state)
    assert 5 < outcomes.count(Outcome.GATED) == np.count_nonzero(run.updates["outcome"] == Outcome.GATED)
    assert {Outcome.AHEAD, Outcome.INVALID, Outcome.DUPLICATE} <= set(outcomes)
    assert run.states["coasting"].any()
    breaks = run.measurements[~run.updates["follows"]]
    manual = breaks["kind"][breaks["stamp_ns"] == round(5.505 * S)]
    assert manual.tolist() == [POSE]
    assert 5 < len(breaks) < 0.3 * len(run.states)


@pytest.mark.parametrize("size", [16, 10_000])
def test_block_size_does_not_change_the_bits(
    drive: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    """Each block ends at a sprocket sample; otherwise intervals would close differently in blocks."""
    p = parameters()
    log = log_of(with_faults(measurements(drive)), p)
    estimator = SlipEstimator(p)
    estimator.process_records(log.begin)
    whole = run_in_one_block(log.rest, estimator.window, estimator.config)
    monkeypatch.setattr(logs, "_BLOCK", size)
    run = run_of(log, p)
    assert len(list(run_log(log, p))) >= len(log.rest) / size
    assert_same_bits(run.measurements, log.rest)
    assert_same_bits(run.states, whole.best[1 : whole.count])
    assert_same_bits(run.updates, whole.updates[1 : whole.count])


def test_a_sprocket_sample_only_propagates(drive: Callable[..., Any]) -> None:
    p = parameters()
    log = log_of(measurements(drive), p)
    run = run_of(log, p, best_branch_script(log, p))
    samples = run.measurements["kind"] == SPROCKETS
    for name in ("mean", "covariance"):
        np.testing.assert_array_equal(run.states[name][samples], run.priors[name][samples])
    for name in ("nis", "gate", "log_determinant"):
        assert np.isnan(run.updates[name][samples]).all()
        assert np.isfinite(run.updates[name][~samples]).all()
    assert (run.updates["dof"][samples] == 0).all()


def test_rejected_measurement_keeps_mean_and_covariance(drive: Callable[..., Any]) -> None:
    """Mean and covariance equal the prior bit for bit."""
    for filter_ in ("ekf", "daf"):
        p = parameters(filter=filter_, **{"sources.box_pose.lever_arm_x": 0.4})
        log = log_of(with_faults(measurements(drive)), p)
        run = run_of(log, p, best_branch_script(log, p))
        gated = (run.updates["outcome"] == Outcome.GATED) & (run.states["fault"][:, 0] != SourceFault.OFFSET)
        assert set(run.measurements["kind"][gated]) >= {POSE}
        assert np.count_nonzero(gated) > 10
        for name in ("mean", "covariance"):
            np.testing.assert_array_equal(run.states[name][gated], run.priors[name][gated])


def test_the_spread_of_an_innovation_follows_from_its_update(drive: Callable[..., Any]) -> None:
    """|S| = |H P Hᵀ + R| for a fix with the stamp and the noise factor of the entry before it."""
    p = parameters(**{"sources.box_pose.standing_share": 0.0, "sources.box_pose.stamp_error": 0.0})
    run = run_of(log_of(drive(SEGMENTS, gyro_every=1000).measurements, p), p)
    fixes = np.flatnonzero((run.measurements["kind"] == POSE) & (run.updates["outcome"] == Outcome.ACCEPTED))
    assert len(fixes) > 20
    for k in fixes:
        R = run.measurements["noise"][k] * run.states["adaptation"]["fix_factors"][k - 1, 0]
        expected = np.linalg.slogdet(run.states["covariance"][k - 1, :3, :3] + R)[1]
        assert run.updates["log_determinant"][k] == pytest.approx(expected, abs=1e-6)


@pytest.mark.slow
def test_parallel_runs_equal_single_runs(drive: Callable[..., Any]) -> None:
    """Sets of parameters over one log, and seeds of noise with one set, on threads."""
    sets = [parameters(model=m, gate_probability=g) for m in ("turning", "icr") for g in (0.5, 0.9999)]
    jobs = [(log_of(measurements(drive, seed), p), p) for p in sets for seed in range(3)]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda job: run_of(*job), jobs))
    assert len(together) == 12
    for one, job in zip(together, jobs, strict=True):
        for mine, its in zip(one, run_of(*job), strict=True):
            assert_same_bits(mine, its)
    assert len({one.states["mean"].tobytes() for one in together}) == 12


def test_order_and_repeats_do_not_matter(drive: Callable[..., Any]) -> None:
    p, found = parameters(), measurements(drive)
    rubbish = YawRate("imu/data_raw", 12345, float("nan"), 1.0)
    mixed = [found[k] for k in np.random.default_rng(0).permutation(len(found))] + [rubbish, *found[:40]]
    for mine, its in zip(log_of(mixed, p), log_of(found, p), strict=True):
        assert_same_bits(mine, its)


def test_infinite_gates_accept_every_measurement(drive: Callable[..., Any]) -> None:
    p = parameters()
    log = log_of(measurements(drive), p)
    estimator = SlipEstimator(p)
    estimator.process_records(log.begin)
    estimator.config["gate_limits"] = np.inf
    whole = run_in_one_block(log.rest, estimator.window, estimator.config)
    assert (whole.updates["outcome"][1:] == Outcome.ACCEPTED).all()
    assert np.isfinite(whole.best["mean"][: whole.count]).all()


def test_a_log_without_a_start_is_refused(drive: Callable[..., Any]) -> None:
    sprockets = [m for m in measurements(drive) if isinstance(m, Sprockets)]
    for found in (sprockets, []):
        with pytest.raises(InputError, match="to start from \\(start: first_fix\\)"):
            log_of(found, parameters())


@pytest.mark.parametrize("model", ["turning", "icr", "free_slips"])
def test_no_kernel_is_compiled_while_driving(drive: Callable[..., Any], model: str) -> None:
    """Compilation for another array layout would stop the estimator for seconds."""
    has_headings = model == "free_slips"  # which needs them
    p = parameters(
        model=model,
        **{"sources.box_pose.use_heading": has_headings, "sources.box_pose.lever_arm_x": 0.3},
    )
    estimator = SlipEstimator(p)
    before = list(live.process.signatures)  # type: ignore[attr-defined]  # numba's
    steps = [estimator.process(m) for m in measurements(drive)]
    assert any(r.outcome is Outcome.GATED for r, _ in steps)
    assert any(e is not None for _, e in steps)
    assert live.process.signatures == before  # type: ignore[attr-defined]
    assert len(before) == 1
