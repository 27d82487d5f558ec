# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Odometry without jumps: the integral of the twist, however often fixes correct the estimate."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fixtures.changes import changed
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from trackslip_bags.messages import make
from trackslip_estimation.slip.conversions import Frames
from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.local_odometry import TWIST, LocalOdometry
from trackslip_estimation.slip.measurements import PoseFix
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.transforms import blank_transforms, fill_transforms

STEP_NS = 10_000_000


def twists(*values: tuple[float, float, float], step_ns: int = STEP_NS) -> NDArray[np.void]:
    records = np.zeros(len(values), TWIST)
    records["stamp_ns"] = 1 + step_ns * np.arange(len(values))
    records["horizontal"] = values
    records["twist_covariance"] = np.diag((1e-4, 1e-6, 1e-5))
    return records


def test_full_circle_ends_at_its_start_with_a_turn_of_2_pi() -> None:
    n = 1000
    found = LocalOdometry().advance(twists(*[(0.5, 0.0, 2.0 * np.pi / (n * 0.01))] * (n + 1)))
    np.testing.assert_allclose(found["pose"][-1], (0.0, 0.0, 2.0 * np.pi), atol=1e-4)
    radius = 0.5 * n * 0.01 / (2.0 * np.pi)
    np.testing.assert_allclose(found["pose"][n // 2], (0.0, 2.0 * radius, np.pi), atol=1e-3)
    sizes = np.linalg.det(found["pose_covariance"])
    assert sizes[0] == 0.0
    assert sizes[-1] > sizes[n // 2] > 0.0


@given(st.lists(st.integers(0, 40), max_size=4))
def test_batches_give_the_same_bits_as_the_whole(cuts: list[int]) -> None:
    random = np.random.default_rng(0)
    records = twists(*map(tuple, random.normal(size=(40, 3)).tolist()))
    whole, pieces = LocalOdometry().advance(records), LocalOdometry()
    parts = np.split(records, sorted(cuts))
    assert np.concatenate([pieces.advance(part) for part in parts]).tobytes() == whole.tobytes()


@pytest.mark.parametrize("gap_ns", [-5_000_000_000, 0, 60_000_000_000])
def test_time_gap_does_not_move_the_local_pose(gap_ns: int) -> None:
    records = twists(*[(0.5, 0.0, 0.1)] * 20)
    records["stamp_ns"][10:] += gap_ns - STEP_NS
    pose = LocalOdometry().advance(records)["pose"]
    np.testing.assert_array_equal(pose[10], pose[9])
    assert pose[19][0] > pose[10][0]


def test_fix_far_off_moves_only_the_map_frame(drive: Callable[..., Any]) -> None:
    driven = drive([(10.0, 2.0, 2.0, 0.0, 0.0, 0.0)]).measurements
    moved = changed(driven, PoseFix, lambda m: replace(m, pose=m.pose + np.array((3.0, 1.0, 0.0))), 5.001)
    estimator, local = SlipEstimator(load_slip_parameters()), LocalOdometry()
    published = [e for m in moved if (e := estimator.process(m)[1]) is not None]
    located = [local.estimate_in_odom(estimate) for estimate in published]
    assert longest_step(published) > 1.0
    assert longest_step(located) < 0.02
    message = blank_transforms(make, Frames("map", "odom", "base_link"))
    fill_transforms(message, published[-1], located[-1])
    map_odom, odom_base = message.transforms
    assert (map_odom.header.frame_id, map_odom.child_frame_id) == ("map", "odom")
    assert (odom_base.header.frame_id, odom_base.child_frame_id) == ("odom", "base_link")
    np.testing.assert_allclose(chained(map_odom, odom_base), published[-1].pose, atol=1e-9)


def longest_step(estimates: list[Estimate]) -> float:
    return float(np.abs(np.diff([e.pose[:2] for e in estimates], axis=0)).max())


def chained(first: Any, second: Any) -> list[float]:
    (x, y, a), (u, v, b) = (
        (t.translation.x, t.translation.y, 2.0 * np.arctan2(t.rotation.z, t.rotation.w))
        for t in (first.transform, second.transform)
    )
    return [x + np.cos(a) * u - np.sin(a) * v, y + np.sin(a) * u + np.cos(a) * v, a + b]
