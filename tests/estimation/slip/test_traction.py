# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Tracks that spin while the machine stays where it is, and grip again."""

import numpy as np
import pytest
from fixtures.drawn_machine import Machine, Recording, drive, parameters

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Outcome, PoseFix
from trackslip_estimation.slip.records import REFUSED
from trackslip_estimation.slip.traction import shared_slip

SETTLED = 5.0  # s, ten fixes


def run(recorded: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[Outcome]]:
    """Times (k,) of what was published, errors (k, 2), NEES of the position (k,), what became of each fix."""
    steps = SlipEstimator(parameters()).process_all(recorded.measurements)
    published = [estimate for _, estimate in steps if estimate is not None]
    times = np.array([estimate.stamp_ns for estimate in published]) * 1e-9 - 1.0
    true = np.column_stack([np.interp(times, recorded.t, recorded.poses[:, k]) for k in range(2)])
    errors = np.array([estimate.pose[:2] for estimate in published]) - true
    covariances = np.array([estimate.pose_covariance[:2, :2] for estimate in published])
    nees = np.einsum("ki,kij,kj->k", errors, np.linalg.inv(covariances), errors)
    both = zip(recorded.measurements, steps, strict=True)
    return times, errors, nees, [result.outcome for m, (result, _) in both if isinstance(m, PoseFix)]


@pytest.mark.parametrize("stuck", [(0.0, 30.0), (20.0, 40.0)])
@pytest.mark.parametrize("track_error", [0.0, 0.05])
def test_a_machine_that_is_stuck_with_spinning_tracks_stays_where_its_fixes_are(
    stuck: tuple[float, float], track_error: float
) -> None:
    """The estimate drove on with the tracks, 14 m in 40 s, and refused every fix."""
    recorded = drive(Machine(duration=60.0, stuck=stuck, track_error=track_error))
    times, errors, nees, fixes = run(recorded)
    begins = max(stuck[0], 1.0)  # when the tracks turn
    settled = np.ones(len(times), bool)
    for change in (begins, stuck[1]):
        settled &= (times < change) | (times > change + SETTLED)
    assert np.abs(errors[settled]).max() < 0.15
    assert nees[settled].mean() < 4.0  # 2 if consistent
    assert nees[settled].max() < 25.0
    refused = "".join("x" if outcome is Outcome.GATED else "." for outcome in fixes)
    assert "xxxx" not in refused


@pytest.mark.parametrize("lasts", [4.0, 10.0])
def test_a_machine_that_loses_its_grip_by_and_by_stays_where_its_fixes_are(lasts: float) -> None:
    """No fix left its gate, their noise was believed large, i₀ followed late: 1.6 m off, 5 cm claimed."""
    machine = Machine(duration=40.0, fading=(10.0, 10.0 + lasts), fix_noise=0.05, fix_stated=0.05, fix_rate=5)
    _, errors, nees, fixes = run(drive(machine))
    assert np.abs(errors).max() < 0.25
    assert nees.mean() < 6.5  # 2 if consistent; 6.1 where it takes 10 s
    assert Outcome.GATED not in fixes


def test_another_slip_is_found_exactly() -> None:
    random = np.random.default_rng(2)
    ways, share = random.normal(0.0, 1.0, (5, 2)), 0.3
    refused = np.zeros(5, REFUSED)
    refused["way_x"], refused["way_y"] = ways.T
    refused["centre_x"], refused["centre_y"] = np.array(((0.3,), (-0.2,))) + share * ways.T
    refused["variance"] = 1e-4
    found = shared_slip(refused, 5, np.array((0.3, -0.2)), True)
    assert found.agrees
    assert found.share == pytest.approx(share)
    assert np.subtract(found.place, share * np.array(found.way)) == pytest.approx((0.3, -0.2))
    assert not shared_slip(refused, 5, np.array((0.3, 1.0)), True).agrees


def test_fixes_beside_the_way_show_no_slip() -> None:
    """As after a turn that nobody saw."""
    refused = np.zeros(4, REFUSED)
    refused["way_x"] = refused["centre_y"] = np.arange(4.0)
    refused["variance"] = 1e-4
    assert not shared_slip(refused, 4, np.zeros(2), True).agrees
