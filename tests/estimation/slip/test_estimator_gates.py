# SPDX-License-Identifier: Apache-2.0
"""What the estimator makes of surprises: spikes are refused, what insists is believed, reports are honest."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, YawRate

S = 1_000_000_000
Run = Callable[..., Any]


def spiked(measurements: list[Measurement], which: range, jump: float = 5.0) -> list[Measurement]:
    """Fixes number ``which`` moved by ``jump`` m."""
    fixes = [m for m in measurements if isinstance(m, PoseFix)]
    moved = {id(fixes[k]) for k in which}
    return [
        replace(m, pose=m.pose + np.array((jump, 0.0, 0.0)))
        if isinstance(m, PoseFix) and id(m) in moved
        else m
        for m in measurements
    ]


def test_a_spike_is_gated_and_leaves_no_trace(drive: Callable[..., Any], thesis_run: Run) -> None:
    driven = drive([(8.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    steps = thesis_run(spiked(driven.measurements, range(20, 22)))
    gated = [r for r in steps.reports if r.outcome is Outcome.GATED]
    assert [r.source for r in gated] == ["box_pose", "box_pose"]
    assert all(r.nis > r.gate for r in gated)
    last = steps.estimates[-1]
    assert abs(last.pose - driven.truth[last.stamp_ns][:3])[0] < 0.08


@pytest.mark.parametrize("model", ["turning", "free_slips"])
@pytest.mark.parametrize(("jump", "seconds"), [(1.0, 4.0), (-5.0, 5.5), (50.0, 7.5)])
def test_a_source_that_insists_is_believed(
    drive: Callable[..., Any], model: str, jump: float, seconds: float, thesis_run: Run
) -> None:
    """A true jump: the gate widens tenfold a second after the first, and the filter goes there at once.

    What it learned of the slips stays, and its covariance is that of one that knows its place again.
    """
    driven = drive([(15.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    fixes = sum(isinstance(m, PoseFix) for m in driven.measurements)
    steps = thesis_run(spiked(driven.measurements, range(20, fixes), jump), model=model)
    outcomes = [r.outcome for r in steps.reports if r.source == "box_pose"]
    gated = [k for k, outcome in enumerate(outcomes) if outcome is Outcome.GATED]
    assert gated == list(range(20, 20 + len(gated)))  # in a row, and no more once it is believed
    assert 1.0 <= len(gated) / 5.0 <= seconds
    believed_ns = next(m.stamp_ns for m in driven.measurements if isinstance(m, PoseFix)) + int(
        (20 + len(gated)) * 0.2 * S
    )
    for e in steps.estimates:
        if e.stamp_ns > believed_ns + S:
            assert e.pose[0] - driven.truth[e.stamp_ns][0] == pytest.approx(jump, abs=0.1)
            assert np.sqrt(np.diag(e.pose_covariance)[:2]).max() < 0.05
            np.testing.assert_allclose(e.outputs.slips[:2], 0.1, atol=0.08)


def test_the_gate_widens_by_source_and_closes_again(drive: Callable[..., Any], thesis_run: Run) -> None:
    driven = drive([(12.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    outage = [m for m in driven.measurements if not isinstance(m, PoseFix) or not 4 * S < m.stamp_ns < 8 * S]
    reports = thesis_run(outage, gate_relaxation=7.0).reports
    closed = chi2.ppf(0.9999, 3)
    after = [r.gate for r in reports if r.source == "box_pose" and r.stamp_ns >= 8 * S]
    assert after[0] == pytest.approx(closed * 7.0 ** (4.0 - 1.0))
    assert set(after[1:]) == {closed}
    assert {r.gate for r in reports if r.source == "imu/data_raw" and r.dof} == {chi2.ppf(0.9999, 1)}


def test_a_gyro_that_insists_has_another_bias(drive: Callable[..., Any], thesis_run: Run) -> None:
    """A step of 0.3 rad/s: refused for the timeout and a little more, then learned in one go."""
    driven = drive([(20.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    stepped = [
        replace(m, rate=m.rate + 0.3) if isinstance(m, YawRate) and m.stamp_ns > 10 * S else m
        for m in driven.measurements
    ]
    steps = thesis_run(stepped, yaw_rate_timeouts=[2.0])
    gated = [r.stamp_ns for r in steps.reports if r.source == "imu/data_raw" and r.outcome is Outcome.GATED]
    assert 10 * S < min(gated) < 10.2 * S
    assert 12 * S < max(gated) < 16 * S
    for e in steps.estimates:
        assert abs(e.pose[2] - driven.truth[e.stamp_ns][2]) < 0.06


def test_reports_state_the_gate(drive: Callable[..., Any], thesis_run: Run) -> None:
    found = drive([(2.0, 2.0, 2.0, 0.1, 0.1, 0.0)]).measurements
    for use_heading, dof in ((True, 3), (False, 2)):
        reports = thesis_run(found, gate_probability=0.99, use_heading=use_heading).reports
        for source, expected in (("box_pose", dof), ("imu/data_raw", 1)):
            some = next(r for r in reports if r.source == source and np.isfinite(r.nis))
            assert (some.dof, some.gate) == (expected, pytest.approx(chi2.ppf(0.99, expected)))
            assert some.nis > 0.0


def test_nis_is_honest(drive: Callable[..., Any], thesis_run: Run) -> None:
    """300 fixes of three numbers, drawn with the noise they claim: the mean within 10⁻⁴ tails of χ²."""
    driven = drive([(60.0, 2.0, 2.0, 0.1, 0.1, 0.0)], seed=5)
    nis = np.array([r.nis for r in thesis_run(driven.measurements).reports if r.source == "box_pose"])
    nis = nis[np.isfinite(nis)]
    low, high = chi2.ppf((1e-4, 1.0 - 1e-4), 3 * nis.size) / nis.size
    assert low < nis.mean() < high


def test_rounding_to_counts_weakens_the_gyro_only_where_it_is_felt(
    drive: Callable[..., Any], thesis_run: Run
) -> None:
    """A coarser encoder makes the predicted yaw rate less sure, so the same surprise weighs less."""
    found = drive([(1.0, 2.0, 2.0, 0.0, 0.0, 0.0)]).measurements
    fine, coarse = (
        [r.nis for r in thesis_run(found, encoder_resolution=size).reports if r.source == "imu/data_raw"]
        for size in (0.0, 0.05)
    )
    assert (np.array(coarse[1:]) < 0.9 * np.array(fine[1:])).mean() > 0.8
    speeds = drive([(1.0, 2.0, 2.0, 0.0, 0.0, 0.0)], positions=False).measurements
    same = [
        [r.nis for r in thesis_run(speeds, encoder_resolution=size).reports if r.source == "imu/data_raw"]
        for size in (0.0, 0.05)
    ]
    assert same[0] == same[1]
