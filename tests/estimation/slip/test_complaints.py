# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Common problems of localization filters, one test each; the numbers are those of the field notes.

Late data (1), the output rate (5), bad input (8) and replay (9) have files of their own.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import load_slip_parameters

S, MS = 1_000_000_000, 1_000_000
Log = Any  # a type of conftest.py


def run(given: list[Measurement], **changes: Any) -> tuple[list[Outcome], list[Estimate], SlipEstimator]:
    estimator = SlipEstimator(load_slip_parameters(changes))
    steps = [estimator.process(m) for m in given]
    return [r.outcome for r, _ in steps], [e for _, e in steps if e is not None], estimator


def test_complaint_2_nan_or_covariance_blow_up(log: Log) -> None:
    """Extreme values of message fields, between good messages: no NaN is published, and P stays bounded."""
    worst = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300)
    given: list[Measurement] = []
    for k, m in enumerate(log.measurements):
        given.append(m)
        value = worst[k % len(worst)]
        if k % 7 == 0 and isinstance(m, Sprockets):
            given.append(replace(m, stamp_ns=m.stamp_ns + MS, left_speed=value, positions=(value, 0.0)))
        if k % 7 == 1:
            given.append(YawRate("imu/data_raw", m.stamp_ns + MS, value, abs(value)))
        if k % 7 == 2:
            given.append(
                PoseFix("box_pose", m.stamp_ns + MS, np.full(3, value), np.diag(np.full(3, abs(value))))
            )
    outcomes, published, _ = run(given)
    assert {Outcome.INVALID, Outcome.GATED, Outcome.JUMPED} <= set(outcomes)
    for e in published:
        assert np.isfinite(e.pose).all()
        eigenvalues = np.linalg.eigvalsh(e.pose_covariance)
        assert eigenvalues[0] > 0.0
        assert eigenvalues[-1] < 100.0
    last = published[-1]
    assert np.hypot(*(last.pose - log.true_pose(last.stamp_ns))[:2]) < 0.1


def test_complaint_3_the_gate_is_a_probability_and_lets_the_filter_recover(log: Log) -> None:
    """With a gate of 0.99 about one in a hundred consistent innovations is rejected; jumps are followed."""
    outcomes, _, _ = run(log.measurements, gate_probability=0.99)
    rejected = sum(o is Outcome.GATED for o in outcomes) / sum(
        not isinstance(m, Sprockets) for m in log.measurements
    )
    assert rejected < 0.05
    middle = log.measurements[len(log.measurements) // 2].stamp_ns
    carried = [
        replace(m, pose=m.pose + np.array((2.0, 0.0, 0.0)))
        if isinstance(m, PoseFix) and m.stamp_ns > middle
        else m
        for m in log.measurements
    ]
    outcomes, published, _ = run(carried)
    assert 0 < sum(o is Outcome.GATED for o in outcomes) < 30
    for e in published:
        if e.stamp_ns > middle + 6 * S:
            assert (e.pose - log.true_pose(e.stamp_ns))[0] == pytest.approx(2.0, abs=0.1)


def test_complaint_4_bag_loop_and_clock_jump(log: Log) -> None:
    """The log is played twice: one restart, and the same accuracy the second time."""
    outcomes, published, estimator = run([*log.measurements, *log.measurements])
    assert estimator.restarts == outcomes.count(Outcome.RESTARTED) == 1
    back = int(np.argmin(np.diff([e.stamp_ns for e in published]))) + 1
    assert 0.9 * back < len(published) - back < back
    np.testing.assert_allclose(published[-1].pose, published[back - 1].pose, atol=0.01)


def test_complaint_6_pose_jumps_and_duplicate_stamps(log: Log) -> None:
    """Fixes of two sources with one stamp are both used, repeats are not, and estimates do not jump."""
    other = [replace(m, source="gnss") for m in log.measurements if isinstance(m, PoseFix)]
    given = sorted([*log.measurements, *other, *other], key=lambda m: m.stamp_ns)
    outcomes, published, _ = run(given, pose_sources=["box_pose", "gnss"])
    assert outcomes.count(Outcome.DUPLICATE) == len(other)
    steps = np.diff([e.pose[:2] for e in published[200:]], axis=0)
    assert np.hypot(*steps.T).max() < 0.05  # 4 mm of motion in 10 ms, the rest is the correction by a fix


@pytest.mark.parametrize(("model", "filter_"), [("turning", "ekf"), ("free_slips", "daf")])
def test_complaint_7_angle_wrap_inside_the_gate(drive: Callable[..., Any], model: str, filter_: str) -> None:
    """Four turns on the spot: fixes on the other side of ±π are no outliers, and the error stays small."""
    driven = drive([(42.0, -2.0, 2.0, 0.3, 0.3, 0.0)])
    wrapped = [
        replace(m, pose=np.array((*m.pose[:2], np.angle(np.exp(1j * m.pose[2])))))
        if isinstance(m, PoseFix)
        else m
        for m in driven.measurements
    ]
    outcomes, published, _ = run(wrapped, model=model, filter=filter_)
    assert driven.truth[max(driven.truth)][2] > 8.0 * np.pi * 0.9
    poses = [outcome for outcome, m in zip(outcomes, wrapped, strict=True) if isinstance(m, PoseFix)]
    assert poses.count(Outcome.GATED) <= 1
    for e in published[100:]:
        assert -np.pi < e.pose[2] <= np.pi
        assert np.cos(e.pose[2] - driven.truth[e.stamp_ns][2]) > np.cos(0.1)
