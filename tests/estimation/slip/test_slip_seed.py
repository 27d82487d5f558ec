# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Seeds of slips as measurements."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fixtures.filter_steps import (
    Gaussian,
    config_of,
    differences,
    expected,
    filter_step,
    jacobian,
    observed,
    outputs_of,
    slips_measured,
    start_of,
    state_of,
)

from trackslip_common.errors import InputError
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.log import make_log, run_log
from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, SlipFix
from trackslip_estimation.slip.models.model import SIZE
from trackslip_estimation.slip.models.speed import COMMON_SLIP, TURN_STATE_1, TURN_STATE_2
from trackslip_estimation.slip.motion import Motion, MotionState, Speeds
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import SLIPS, to_records

MODELS = ("free_slips", "turning", "icr")
LIMIT = 18.5  # limit of a gate with two degrees of freedom that is not widened
SOURCE = {"slip_sources": ["slip_seed"]}


def seed_at(stamp_ns: int, slip: float, deviation: float = 0.003) -> SlipFix:
    """A seed of equal slips with highly correlated errors."""
    return SlipFix(
        "slip_seed", stamp_ns, np.full(2, slip), deviation**2 * (np.ones((2, 2)) + 0.01 * np.eye(2))
    )


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("left", "right"), [(2.0, 2.1), (-1.5, -1.4), (0.0, 1.0), (1.0, 2.2)])
def test_expected_seed_is_the_slips_and_its_jacobian_is_theirs(model: str, left: float, right: float) -> None:
    config, speeds = config_of(model=model), (left, right)
    x, c = start_of(config, np.zeros(3), np.eye(3)).mean, config[0]
    x[4 : c["active"]] += np.linspace(0.01, 0.05, c["active"] - 4)
    known = Gaussian(x, np.zeros((SIZE, SIZE)))
    slips = outputs_of(config, known, Speeds(left, right))["slips"][:2]
    np.testing.assert_allclose(expected(SLIPS, x, 2, speeds, c), slips, rtol=1e-12)
    by_differences = differences(lambda v: expected(SLIPS, v, 2, speeds, c), x)
    np.testing.assert_allclose(jacobian(SLIPS, x, 2, speeds, c), by_differences, atol=1e-7)


def test_slip_variance_includes_the_rounding_of_counts() -> None:
    config, x = config_of(), np.zeros(SIZE)
    x[TURN_STATE_1], x[TURN_STATE_2], x[COMMON_SLIP] = 0.5, 0.4, 0.02
    known, changing = Gaussian(x, np.zeros((SIZE, SIZE))), MotionState(Motion.STRAIGHT, departure=1.0)
    for variance in (4e-4, 0.0):
        speeds = Speeds(2.0, 2.0, variance)
        measured = slips_measured(np.zeros(2), 1e-12 * np.eye(2))
        R = observed(state_of(known, speeds, changing)[0], measured, config[0]).noise
        found = outputs_of(config, known, speeds, changing)["slip_covariance"][:2, :2]
        np.testing.assert_allclose(R, 1e-12 * np.eye(2) + found, rtol=1e-9)
        assert (np.diag(R) > 1e-9).all() == (variance > 0.0)


@pytest.mark.parametrize("filter_", ["ekf", "daf"])
@pytest.mark.parametrize("model", MODELS)
def test_seed_corrects_both_slips_equally_where_the_gyro_fixes_their_difference(
    model: str, filter_: str
) -> None:
    config = config_of(model=model, filter=filter_)
    state = start_of(config, np.zeros(3), 1e-4 * np.eye(3))
    measured = slips_measured(np.full(2, 0.03), 1e-6 * (np.ones((2, 2)) + 0.01 * np.eye(2)))
    straight = Speeds(2.0, 2.0)
    step = filter_step(config, state, straight, 0.0, MotionState(Motion.STRAIGHT, changing=False), measured)
    before, after = (outputs_of(config, known, straight) for known in (step.predicted, step.updated))
    np.testing.assert_allclose(after["slips"][:2], 0.03, atol=1e-3)
    together = np.ones(2)
    wide, narrow = (together @ o["slip_covariance"][:2, :2] @ together / 4.0 for o in (before, after))
    assert wide > 100.0 * narrow
    np.testing.assert_array_equal(step.updated.mean[:3], 0.0)  # the seed does not correct the pose


@pytest.mark.parametrize("model", MODELS)
def test_seed_corrects_the_slip_unobservable_by_the_gyro(drive: Callable[..., Any], model: str) -> None:
    """No fixes after the start: equal slips of 4 % are observable by the seed only, which is 0.5 s late."""
    driven = drive([(12.0, 2.0, 2.0, 0.04, 0.04, 0.0)])
    given = [m for m in driven.measurements if not (isinstance(m, PoseFix) and m.stamp_ns > 0)]
    at = next(k for k, m in enumerate(given) if m.stamp_ns > 5_500_000_000)
    blind, mended = (SlipEstimator(load_slip_parameters(SOURCE | {"model": model})) for _ in range(2))
    for k, m in enumerate(given):
        if k == at:
            report = mended.process(seed_at(5_000_000_000, 0.04))[0]
            assert (report.outcome, report.dof, report.source) == (Outcome.ACCEPTED, 2, "slip_seed")
            assert report.nis < report.gate
        blind.process(m)
        mended.process(m)
    true = driven.truth[given[-1].stamp_ns]
    errors = [np.abs(e.estimate().outputs.slips[:2].mean() - 0.04) for e in (blind, mended)]
    assert errors[0] > 0.02
    assert errors[1] < 0.02  # the model attributes part of the slip to a velocity error, as on real tracks
    distances = [abs(e.estimate().pose[0] - true[0]) for e in (blind, mended)]
    assert distances[1] < 0.6 * distances[0]


@pytest.mark.parametrize("model", MODELS)
def test_seed_far_off_is_gated_until_its_timeout(drive: Callable[..., Any], model: str) -> None:
    given = drive([(8.0, 2.0, 2.0, 0.0, 0.0, 0.0)]).measurements
    for timeout, outcome in ((3600.0, Outcome.GATED), (0.1, Outcome.ACCEPTED)):
        p = load_slip_parameters(SOURCE | {"model": model, "sources.slip_seed.timeout": timeout})
        estimator = SlipEstimator(p)
        for m in given:
            estimator.process(m)
        before = estimator.estimate().outputs
        for k in range(10, -1, -1):  # a source that persists; a single seed is not accepted
            stamp_ns = given[-1].stamp_ns - k * 100_000_000
            report = estimator.process(seed_at(stamp_ns, 0.9, 0.001))[0]
            if report.outcome is Outcome.ACCEPTED:
                break
        after = estimator.estimate().outputs
        assert report.outcome is outcome
        assert report.nis > LIMIT
        assert (report.gate > LIMIT) == (outcome is Outcome.ACCEPTED)
        if outcome is Outcome.GATED:
            np.testing.assert_array_equal(after.slips, before.slips)
        else:  # accepted: the covariance of the slips is inflated until it contains the seed
            assert before.slips[0] + 9.0 * math.sqrt(before.slip_covariance[0, 0]) < 0.9
            assert after.slips[0] + 4.0 * math.sqrt(after.slip_covariance[0, 0]) > 0.9


def test_seeds_are_ignored_unless_requested(drive: Callable[..., Any]) -> None:
    p = load_slip_parameters()
    assert p.slip_sources == ("",)
    assert "slip_seed" not in p.timeouts_ns()
    assert list(load_slip_parameters(SOURCE).timeouts_ns()) == ["box_pose", "imu/data_raw", "slip_seed"]
    with pytest.raises(InputError, match=r"sources\.slip_seed\.timeout: \[1\.0\]"):
        load_slip_parameters(SOURCE | {"sources.slip_seed.timeout": [1.0]})


def with_seeds(measurements: list[Measurement]) -> list[Measurement]:
    """The measurements with two seeds, each half a second late."""
    seeds = {5_000_000_000: 0.03, 9_000_000_000: 0.9}
    given = list(measurements)
    for stamp_ns, slip in seeds.items():
        at = next(k for k, m in enumerate(given) if m.stamp_ns > stamp_ns + 500_000_000)
        given.insert(at, seed_at(stamp_ns, slip))
    return given


@pytest.mark.parametrize("model", MODELS)
def test_order_of_arrival_and_log_do_not_matter(drive: Callable[..., Any], model: str) -> None:
    given = with_seeds(drive([(10.0, 2.0, 2.0, 0.03, 0.03, 0.0)]).measurements)
    p = load_slip_parameters(SOURCE | {"model": model})
    late, in_order = SlipEstimator(p), SlipEstimator(p)
    late.process_all(given)
    in_order.process_all(sorted(given, key=lambda m: m.stamp_ns))
    end, other = (e.window.best[e.window.count - 1] for e in (late, in_order))
    np.testing.assert_array_equal(end["mean"], other["mean"])
    blocks = run_log(make_log(to_records(given, late.sources), p), p)
    seeds = []
    for block in blocks:
        seeds += block.updates["outcome"][block.measurements["kind"] == SLIPS].tolist()
        last = block.states[-1].copy()
    np.testing.assert_array_equal(last["mean"], end["mean"])
    assert seeds == [Outcome.ACCEPTED, Outcome.GATED]
