# SPDX-License-Identifier: Apache-2.0
"""The batch gives what the estimator ends with, for any number of runs at once."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from trackslip_common.errors import InputError
from trackslip_estimation.filters import filter as kernels
from trackslip_estimation.filters.batch import EVERYTHING, Gates, Run, run, run_all
from trackslip_estimation.filters.model import Gaussian
from trackslip_estimation.measurement_log import MeasurementLog, read_measurements
from trackslip_estimation.measurements import Measurement, Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip_estimator import SlipEstimator
from trackslip_estimation.slip_parameters import SlipEstimatorParameters, load_slip_parameters, make_filter

SEGMENTS = [
    (1.0, 2.0, 2.0, 0.05, 0.1, 0.0),
    (2.0, 1.0, 2.0, 0.0, 0.2, 0.1),
    (1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (1.0, 2.0, 2.0, 0.1, 0.1, 0.0),
]


def parameters(**changes: Any) -> SlipEstimatorParameters:
    return load_slip_parameters(
        {"start": "first_fix", "gate_relaxation": 1.0, "history_window": 60.0, "max_gap": 60.0}, changes
    )


def measurements(drive: Callable[..., Any], seed: int = 0) -> list[Measurement]:
    """Gyro readings with spikes; fixes between the sprocket samples, some wide of the mark in a row."""
    found: list[Measurement] = drive(SEGMENTS, seed=seed, gyro_every=2).measurements
    for k, m in enumerate(found):
        if isinstance(m, YawRate) and k % 10 == 0:
            found[k] = replace(m, rate=m.rate + 30.0)
        if isinstance(m, PoseFix) and m.stamp_ns > 0:
            wide = (3.0, 0.0, 0.0) if 5 * 10**8 < m.stamp_ns < 2 * 10**9 else (0.0, 0.0, 0.0)
            found[k] = replace(m, stamp_ns=m.stamp_ns - 7_000_000, pose=m.pose + np.array(wide))
    return found


def gates(p: SlipEstimatorParameters) -> Gates:
    limits = [np.inf, *(float(chi2.ppf(p.gate_probability, dof)) for dof in (1, 2, 3))]
    return Gates(np.array(limits), 2**31)


def start_of(prepared: MeasurementLog, p: SlipEstimatorParameters) -> Gaussian:
    assert isinstance(prepared.start, PoseFix)
    return make_filter(p).initial(prepared.start.pose, prepared.start.covariance)


def prepare(found: list[Measurement], p: SlipEstimatorParameters) -> MeasurementLog:
    return read_measurements(found, p.motion, p.use_heading, PoseFix)


@pytest.mark.parametrize("filter_", ["ekf", "daf"])
@pytest.mark.parametrize("model", ["turning", "icr", "free_slips"])
@pytest.mark.parametrize("use_heading", [True, False])
def test_it_ends_as_the_estimator_does(
    drive: Callable[..., Any], model: str, filter_: str, use_heading: bool
) -> None:
    """Bit for bit, with gated measurements."""
    p = parameters(model=model, filter=filter_, use_heading=use_heading)
    found = measurements(drive)
    estimator = SlipEstimator(p)
    reports = [r for r in map(estimator.take, found) if r.outcome is not Outcome.WAITING]
    prepared = prepare(found, p)
    result = run(prepared.log, make_filter(p), start_of(prepared, p), gates(p))
    end = estimator.estimate()
    assert prepared.stamps_ns[-1] == end.stamp_ns
    np.testing.assert_array_equal(result.means[-1][:3], end.pose)
    np.testing.assert_array_equal(result.covariances[-1][:3, :3], end.pose_covariance)
    gated = sum(r.outcome is Outcome.GATED for r in reports)
    assert 5 < gated == np.count_nonzero(~result.accepted)


def test_many_runs_are_each_that_one_run(drive: Callable[..., Any]) -> None:
    """Sets of parameters over one log, and noise seeds under one set, on threads."""
    sets = [parameters(model=m) for m in ("turning", "icr")]
    logs = [prepare(measurements(drive, seed), sets[0]) for seed in range(3)]
    jobs = [(log.log, make_filter(p), start_of(log, p), EVERYTHING) for p in sets for log in logs]
    together = list(run_all(jobs, threads=2))
    assert len(together) == 6
    for one, job in zip(together, jobs, strict=True):
        assert_same(one, run(*job))
    assert len({one.means.tobytes() for one in together}) == 6


def assert_same(one: Run, other: Run) -> None:
    for mine, its in zip(one, other, strict=True):
        np.testing.assert_array_equal(mine, its)


def test_order_and_repeats_do_not_matter(drive: Callable[..., Any]) -> None:
    p, found = parameters(), measurements(drive)
    rubbish = YawRate("imu/data_raw", 12345, float("nan"), 1.0)
    mixed = [found[k] for k in np.random.default_rng(0).permutation(len(found))] + [rubbish, *found[:40]]
    ordered, other = prepare(found, p), prepare(mixed, p)
    assert ordered.stamps_ns == other.stamps_ns
    for mine, its in zip(ordered.log, other.log, strict=True):
        np.testing.assert_array_equal(mine, its)


def test_everything_is_taken_where_nothing_is_gated(drive: Callable[..., Any]) -> None:
    p = parameters()
    prepared = prepare(measurements(drive), p)
    result = run(prepared.log, make_filter(p), start_of(prepared, p))
    assert result.accepted.all()
    assert np.isfinite(result.means).all()


def test_a_log_without_a_start_is_refused(drive: Callable[..., Any]) -> None:
    p = parameters()
    sprockets = [m for m in measurements(drive) if isinstance(m, Sprockets)]
    with pytest.raises(InputError, match="no PoseFix to start from"):
        prepare(sprockets, p)


@pytest.mark.parametrize("model", ["turning", "icr", "free_slips"])
def test_nothing_is_compiled_while_driving(drive: Callable[..., Any], model: str) -> None:
    """Arrays of another layout would stop the estimator for seconds."""
    p = parameters(model=model, use_heading=False, pose_lever_arms_x=[0.3])
    estimator = SlipEstimator(p)
    before = list(kernels._step.signatures), list(kernels._outputs.signatures)
    steps = [estimator.advance(m) for m in measurements(drive)]
    assert any(r.outcome is Outcome.GATED for r, _ in steps)
    assert (list(kernels._step.signatures), list(kernels._outputs.signatures)) == before
    assert len(before[0]) == len(before[1]) == 1
