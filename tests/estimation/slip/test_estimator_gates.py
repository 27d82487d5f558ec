# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Gates of the estimator: outliers are rejected, persistent changes are accepted, the NIS is consistent."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fixtures.changes import changed
from scipy.stats import chi2

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.gate import log_probability_of_rejection
from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, YawRate
from trackslip_estimation.slip.models.turning import EFFICIENCY
from trackslip_estimation.slip.parameters import load_slip_parameters

S = 1_000_000_000
Run = Callable[..., Any]


def spiked(measurements: list[Measurement], which: range, jump: float = 5.0) -> list[Measurement]:
    """The measurements with the fixes numbered ``which`` moved by ``jump`` m."""
    fixes = [m for m in measurements if isinstance(m, PoseFix)]
    moved = {id(fixes[k]) for k in which}
    return [
        replace(m, pose=m.pose + np.array((jump, 0.0, 0.0)))
        if isinstance(m, PoseFix) and id(m) in moved
        else m
        for m in measurements
    ]


@pytest.mark.parametrize("model", ["turning", "free_slips"])
@pytest.mark.parametrize("jump", [1.0, -5.0, 50.0])
def test_persistent_jump_of_fixes_moves_the_estimate_after_some_seconds(
    drive: Callable[..., Any], model: str, jump: float, thesis_run: Run
) -> None:
    """Until then the source is rejected; from the second fix the covariance spans both; the slip stays."""
    driven = drive([(15.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    fixes = sum(isinstance(m, PoseFix) for m in driven.measurements)
    steps = thesis_run(spiked(driven.measurements, range(20, fixes), jump), model=model)
    outcomes = [r.outcome for r in steps.reports if r.source == "box_pose"]
    gated = [k for k, outcome in enumerate(outcomes) if outcome is Outcome.GATED]
    assert gated == list(range(20, 20 + len(gated)))  # consecutive, and none after the first that is accepted
    assert 2 <= len(gated) <= 20
    first_ns = next(m.stamp_ns for m in driven.measurements if isinstance(m, PoseFix))
    moved_ns, accepted_ns = (first_ns + int(k * 0.2 * S) for k in (20, 20 + len(gated)))
    for e in steps.estimates:
        off = e.pose[0] - driven.truth[e.stamp_ns][0] - (jump if e.stamp_ns > moved_ns else 0.0)
        if e.stamp_ns > moved_ns + S // 4:  # after the second one
            assert abs(off) < 4.0 * np.sqrt(e.pose_covariance[0, 0])
        if e.stamp_ns > accepted_ns + S:
            assert abs(off) < 0.1
            np.testing.assert_allclose(e.outputs.slips[:2], 0.1, atol=0.08)


def test_one_wrong_reading_after_an_outage_is_refused(drive: Callable[..., Any], thesis_run: Run) -> None:
    driven = drive([(40.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    kept = [m for m in driven.measurements if not isinstance(m, YawRate) or not 4 * S < m.stamp_ns < 34 * S]
    back = next(k for k, m in enumerate(kept) if isinstance(m, YawRate) and m.stamp_ns > 30 * S)
    kept[back] = replace(kept[back], rate=kept[back].rate - 1.0)
    steps = thesis_run(kept)
    reports = [r for r in steps.reports if r.source == "imu/data_raw" and r.stamp_ns > 30 * S]
    assert [r.outcome for r in reports[:3]] == [Outcome.GATED, Outcome.ACCEPTED, Outcome.ACCEPTED]
    for e in steps.estimates:
        assert abs(e.pose[2] - driven.truth[e.stamp_ns][2]) < 0.06


def test_gyro_rejected_for_long_gets_a_new_bias(drive: Callable[..., Any], thesis_run: Run) -> None:
    """A bias step of 0.3 rad/s is rejected for the timeout and a little more, then the bias is reset once."""
    driven = drive([(20.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    stepped = changed(driven.measurements, YawRate, lambda m: replace(m, rate=m.rate + 0.3), 10.001)
    steps = thesis_run(stepped, **{"sources.imu_data_raw.timeout": 2.0})
    gated = [r.stamp_ns for r in steps.reports if r.source == "imu/data_raw" and r.outcome is Outcome.GATED]
    assert 10 * S < min(gated) < 10.2 * S
    assert 12 * S < max(gated) < 16 * S
    for e in steps.estimates:
        assert abs(e.pose[2] - driven.truth[e.stamp_ns][2]) < 0.06


KAPPA = 0.45
RATE = KAPPA * 0.159 * 1.0 / 0.73  # rad/s, yaw rate in the turn


def on_one_ground(drive: Callable[..., Any]) -> Any:
    """10 s straight on and 15 s of a turn with κ = 0.45; without slip the yaw rate would be 0.218 rad/s."""
    slips = (1.0 - (1.5 - 0.5 * KAPPA), 1.0 - (1.5 + 0.5 * KAPPA) / 2.0)
    return drive([(10.0, 2.0, 2.0, 0.0, 0.0, 0.0), (15.0, 1.0, 2.0, *slips, 0.0)])


def with_rates(found: list[Measurement], added: Sequence[float]) -> list[Measurement]:
    """The measurements with ``added`` rad/s on the gyro readings from 20 s on."""
    late = [k for k, m in enumerate(found) if isinstance(m, YawRate) and m.stamp_ns > 20 * S]
    of_reading = dict(zip(late, added, strict=False))
    return [
        replace(m, rate=m.rate + of_reading[k]) if isinstance(m, YawRate) and k in of_reading else m
        for k, m in enumerate(found)
    ]


def kappas(found: list[Measurement], **changes: Any) -> tuple[FloatArray, list[Outcome]]:
    """κ after each gyro reading from 20 s on, and the outcomes of the readings."""
    estimator = SlipEstimator(load_slip_parameters(changes))
    learned, outcomes = [], []
    for m in found:
        report, _ = estimator.process(m)
        if isinstance(m, YawRate) and m.stamp_ns > 20 * S:
            learned.append(estimator.window.best[estimator.window.count - 1]["mean"][EFFICIENCY])
            outcomes.append(report.outcome)
    return np.array(learned), outcomes


@pytest.mark.parametrize("spike", [0.10, -0.06])
def test_one_plausible_gyro_spike_in_a_turn_keeps_the_turning_efficiency(
    drive: Callable[..., Any], spike: float
) -> None:
    """A deviation of +0.10 rad/s is 20 σ; other ground would cause the same."""
    clean, _ = kappas(on_one_ground(drive).measurements)
    assert clean == pytest.approx(KAPPA, abs=0.03)
    found, outcomes = kappas(with_rates(on_one_ground(drive).measurements, [spike]))
    assert set(outcomes[1:]) == {Outcome.ACCEPTED}
    np.testing.assert_allclose(found, clean, atol=0.03)


@pytest.mark.parametrize(
    "added",
    [
        [0.10, 0.10, 0.0, 0.10, 0.10, 0.0, 0.10, 0.10],  # never enough consecutive ones
        [0.10, 0.06, 0.10, 0.06, 0.10, 0.06],  # mutually inconsistent
        [-0.30] * 6,  # opposite to the tracks
    ],
)
def test_inconsistent_gyro_readings_keep_the_turning_efficiency(
    drive: Callable[..., Any], added: list[float]
) -> None:
    clean, _ = kappas(on_one_ground(drive).measurements)
    found, outcomes = kappas(with_rates(on_one_ground(drive).measurements, added), gate_confirmations=3)
    for rate, outcome in zip(added, outcomes, strict=False):
        assert outcome is Outcome.ACCEPTED or rate
    np.testing.assert_allclose(found, clean, atol=0.05)


@pytest.mark.parametrize("confirmations", [2, 3, 5])
def test_confirmed_gyro_readings_change_the_turning_efficiency(
    drive: Callable[..., Any], confirmations: int
) -> None:
    """Readings before the last confirmation have little weight; after it κ is that of the new ground.

    Fixes, which would attribute the change to the gyro, end before it.
    """
    given = [
        m for m in on_one_ground(drive).measurements if not isinstance(m, PoseFix) or m.stamp_ns < 20 * S
    ]
    found, outcomes = kappas(with_rates(given, [0.10] * 20), gate_confirmations=confirmations)
    last = confirmations - 1
    assert set(outcomes[last:20]) == {Outcome.ACCEPTED}
    assert found[:last] == pytest.approx(KAPPA, abs=0.03)
    assert found[last + 6] == pytest.approx(KAPPA * (RATE + 0.10) / RATE, abs=0.1)


def test_reports_state_the_gate(drive: Callable[..., Any], thesis_run: Run) -> None:
    found = drive([(2.0, 2.0, 2.0, 0.1, 0.1, 0.0)]).measurements
    for use_heading, dof in ((True, 3), (False, 2)):
        reports = thesis_run(
            found, gate_probability=0.99, **{"sources.box_pose.use_heading": use_heading}
        ).reports
        for source, expected in (("box_pose", dof), ("imu/data_raw", 1)):
            some = next(r for r in reports if r.source == source and np.isfinite(r.nis))
            assert (some.dof, some.gate) == (expected, pytest.approx(chi2.ppf(0.99, expected)))
            assert some.nis > 0.0


def test_nis_is_consistent(drive: Callable[..., Any], thesis_run: Run) -> None:
    """300 fixes of three numbers with their stated noise: the mean NIS is within the 10⁻⁴ tails of χ²."""
    driven = drive([(60.0, 2.0, 2.0, 0.1, 0.1, 0.0)], seed=5)
    nis = np.array([r.nis for r in thesis_run(driven.measurements).reports if r.source == "box_pose"])
    nis = nis[np.isfinite(nis)]
    low, high = chi2.ppf((1e-4, 1.0 - 1e-4), 3 * nis.size) / nis.size
    assert low < nis.mean() < high


@pytest.mark.parametrize("rate", [10.0, 20.0, 100.0])  # Hz
def test_rejections_cost_a_branch_as_much_at_any_rate(rate: float) -> None:
    """All rejections within the correlation time of the velocity errors count as one outlier."""
    p = load_slip_parameters()
    c = SlipEstimator(p).config[0]
    cost_of_one = math.log(p.bank.initial_outlier_share)
    per_second = rate * float(log_probability_of_rejection(1.0 / rate, c))
    assert per_second == pytest.approx(cost_of_one / c["velocity_errors"]["time"])
