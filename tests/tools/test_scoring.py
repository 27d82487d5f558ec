# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Scores of constructed paths."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray, Rows
from trackslip_estimation.slip.records import ESTIMATE
from trackslip_tools.replay.scoring import PathErrors, Score, moving_slips, path_of, slip_errors
from trackslip_tools.replay.series import Path, Series, series_of

EPOCH_NS = 1_700_000_000_000_000_000
MS = 1_000_000


def stamps(*ms: int) -> NDArray[np.int64]:
    return np.array([EPOCH_NS + t * MS for t in ms], dtype=np.int64)


def path(times: tuple[int, ...], *poses: tuple[float, float, float]) -> Path:
    return Path(stamps(*times), np.array(poses))


def score(estimated: Path, reference: Path) -> Score | None:
    errors = PathErrors()
    errors.compare(estimated, reference)
    return errors.score


def estimates(*samples: tuple[int, tuple[float, float, float], FloatArray]) -> Rows:
    """Estimates from times in ms, poses and covariances."""
    rows = np.zeros(len(samples), ESTIMATE)
    for record, (ms, pose, covariance) in zip(rows, samples, strict=True):
        record["stamp_ns"], record["pose"] = EPOCH_NS + ms * MS, pose
        record["pose_covariance"] = covariance
    return rows


def mean_nees(estimated: Rows, reference: Path) -> float | None:
    return errors_against(estimated, reference).nees


def errors_against(estimated: Rows, reference: Path, R: np.ndarray | None = None) -> PathErrors:
    x, y, heading = reference.poses.T
    errors, columns = PathErrors(), {} if R is None else {"covariance": R}
    rows = series_of(stamp_ns=reference.stamps_ns, x=x, y=y, heading=heading, **columns).rows
    errors.add_estimates(estimated, rows)
    return errors


def test_root_mean_square_by_hand() -> None:
    """Errors 5 m and 0, 0.1 and 0.3 rad, and 0.5 m and 0.2 rad between these two samples."""
    estimated = path((0, 100), (3, 4, 0.1), (1, 1, 0.3))
    result = score(estimated, path((0, 50, 100), (0, 0, 0), (2, 2, 0), (1, 1, 0)))
    assert result == Score(3, pytest.approx(math.sqrt(25.25 / 3)), pytest.approx(math.sqrt(0.14 / 3)))


def test_only_what_the_path_covers_is_scored() -> None:
    estimated = path((100, 200), (0, 0, 0), (0, 0, 0))
    result = score(estimated, path((0, 100, 200, 300), (9, 9, 9), (0, 0, 0), (0, 0, 0), (9, 9, 9)))
    assert result == Score(2, 0.0, 0.0)
    assert score(estimated, path((0, 300), (0, 0, 0), (0, 0, 0))) is None


def test_heading_error_is_the_shorter_angle() -> None:
    estimated = path((0, 100), (0, 0, 3.1), (0, 0, 3.1 + 4 * math.pi))
    result = score(estimated, path((0, 100), (0, 0, -3.1), (0, 0, -3.1)))
    assert result is not None
    assert result.heading == pytest.approx(2 * math.pi - 6.2)


def test_the_path_of_estimates_turns_on_through_pi() -> None:
    P = np.eye(3)
    unwrapped = path_of(estimates((0, (0, 0, 3.1), P), (100, (1, 0, -3.1), P)))
    assert unwrapped.poses[1, 2] == pytest.approx(2 * math.pi - 3.1)
    assert unwrapped.poses_at(stamps(50))[0, 2] == pytest.approx(math.pi)


def test_nees_by_hand() -> None:
    """(0.2, 0, 0) with σ = 0.1 is 4; the second error has correlated x and y."""
    P = np.diag((0.01, 0.01, 0.01))
    R = np.array(((0.01, 0.005, 0.0), (0.005, 0.01, 0.0), (0.0, 0.0, 0.04)))
    estimated = estimates((0, (0.2, 0, 0), P), (100, (0.1, 0.1, 0.2), R))
    reference = path((0, 100), (0, 0, 0), (0, 0, 0))
    second = 2 * 0.01 / 0.015 + 1.0  # along (1, 1) the variance is 0.015
    assert mean_nees(estimated, reference) == pytest.approx((4.0 + second) / 2.0)


def test_nees_uses_the_covariance_nearest_in_time() -> None:
    estimated = estimates(*((t, (1, 0, 0), np.eye(3) * v) for t, v in ((0, 1.0), (100, 4.0), (300, 16.0))))
    for ms, variance in ((10, 1.0), (49, 1.0), (51, 4.0), (190, 4.0), (210, 16.0), (300, 16.0)):
        assert mean_nees(estimated, path((ms,), (0, 0, 0))) == pytest.approx(1.0 / variance)


def test_nees_is_none_without_overlap() -> None:
    estimated = estimates((0, (0, 0, 0), np.eye(3)))
    assert mean_nees(estimated, path((50,), (0, 0, 0))) is None
    assert mean_nees(estimated, path((0,), (0, 0, 0))) == 0.0


def test_a_reference_of_positions_is_scored_as_such() -> None:
    """Its headings are ignored, even NaN: 0.1 m with σ = 0.1 m is 1 of 2."""
    estimated = estimates(*((t, (0.1, 0, 3.0), np.diag((0.01, 0.01, 1e-9))) for t in (0, 100)))
    reference = path((0, 100), (0, 0, math.nan), (0, 0, math.nan))
    errors = errors_against(estimated, reference)
    assert errors.score == score(path_of(estimated), reference) == Score(2, pytest.approx(0.1), None)
    assert (errors.nees, errors.nees_position) == (None, pytest.approx(1.0))


def test_headings_count_where_the_reference_has_them() -> None:
    estimated = estimates(*((t, (0.1, 0, 0.2), np.eye(3) * 0.01) for t in (0, 100)))
    reference = path((0, 100), (0, 0, math.nan), (0, 0, 0))
    errors = errors_against(estimated, reference)
    assert errors.score == Score(2, pytest.approx(0.1), pytest.approx(0.2))
    assert (errors.nees, errors.nees_position) == (pytest.approx(5.0), pytest.approx(1.0))


def slips(stamps_ns: Any, left: Any, right: Any) -> Series:
    return series_of(stamp_ns=stamps_ns, left_slip=left, right_slip=right)


def test_slip_errors_are_interpolated_for_both_tracks() -> None:
    estimated = slips(stamps(0, 100), (0.0, 0.2), (0.0, 0.1))
    true = slips(stamps(-50, 50, 100), (9.0, 0.1, 0.5), (9.0, 0.05, 0.5))
    np.testing.assert_allclose(slip_errors(estimated, true), (0.0, -0.3, 0.0, -0.4), atol=1e-12)
    assert not slip_errors(estimated, slips(stamps(200), (0.0,), (0.0,))).size


def test_slips_are_scored_only_where_a_track_moves() -> None:
    """Tread 0.73 m: standstill, creeping at 0.04 m/s, driving, reversing, a pivot turn."""
    times = (0, 100, 200, 300, 400)
    twists = ((0.0, 0.0), (0.04, 0.0), (0.3, 0.0), (-0.3, 0.0), (0.0, -0.2))
    v_x, rates = zip(*twists, strict=True)
    odometry = series_of(stamp_ns=stamps(*times), v_x=v_x, yaw_rate=rates)
    true = slips(stamps(*times, 500), np.arange(6.0) / 100.0, np.arange(6.0) / 50.0)
    moving = moving_slips(odometry, true, 0.73)
    np.testing.assert_array_equal(moving.stamps_ns, stamps(200, 300, 400))
    np.testing.assert_array_equal(moving.rows, true.rows[2:5])


def test_the_slip_of_a_track_that_hardly_turns_is_not_scored() -> None:
    """A turn whose inner track creeps at 0.02 m/s, spinning tracks at standstill, and both tracks driving."""
    times, speeds = (0, 100, 200), np.array(((0.02, 0.5), (0.5, 0.5), (0.3, 0.5)))  # left, right r ω
    ground = np.array(((0.08, 0.4), (1e-6, 1e-6), (0.29, 0.4)))
    left, right = (1.0 - ground / speeds).T
    v_x, rates = ground.mean(axis=1), np.diff(ground)[:, 0] / 0.73
    odometry = series_of(stamp_ns=stamps(*times), v_x=v_x, yaw_rate=rates)
    moving = moving_slips(odometry, slips(stamps(*times), left, right), 0.73)
    np.testing.assert_array_equal(moving.stamps_ns, stamps(0, 200))
    np.testing.assert_array_equal(moving["left_slip"], (np.nan, left[2]))
    np.testing.assert_array_equal(moving["right_slip"], right[[0, 2]])
    estimated = slips(stamps(0, 200), (0.0, left[2] + 0.03), (right[0] + 0.03, right[2]))
    np.testing.assert_allclose(slip_errors(estimated, moving), (0.03, 0.03, 0.0), atol=1e-12)


# Covariance of the reference


def test_invalid_reference_covariance_counts_as_zero() -> None:
    P = np.diag((0.01, 0.01, 0.01))
    estimated = estimates((0, (0.3, 0.0, 0.0), P), (100, (1.3, 0.0, 0.0), P))
    for none in (np.zeros((3, 3)), np.full((3, 3), np.nan), np.diag((-1.0, 0.0, 0.0))):
        errors = errors_against(estimated, path((0, 100), (0, 0, 0), (1, 0, 0)), np.array((none, none)))
        assert errors.nees == pytest.approx(9.0)


def test_nees_of_a_consistent_estimate_against_a_reference_with_noise_is_3() -> None:
    rng, n = np.random.default_rng(1), 4000
    P, R = np.diag((0.01, 0.02, 0.001)), np.array(((0.03, 0.01, 0.0), (0.01, 0.04, 0.0), (0.0, 0.0, 0.002)))
    e, e_ref = (rng.multivariate_normal(np.zeros(3), one, n) for one in (P, R))
    estimated = estimates(*((100 * k, tuple(e[k]), P) for k in range(n)))
    reference = Path(estimated["stamp_ns"].copy(), e_ref)
    errors = errors_against(estimated, reference, np.broadcast_to(R, (n, 3, 3)))
    assert errors.nees == pytest.approx(3.0, abs=0.15)
    assert errors.nees_position == pytest.approx(2.0, abs=0.12)
    exact = mean_nees(estimated, reference)
    assert exact is not None
    assert exact > 6.0


# Singular covariances

SINGULAR = {
    "zero": np.zeros((3, 3)),
    "one variance zero": np.diag((0.01, 0.01, 0.0)),
    "fully correlated": np.array(((1.0, 1.0, 0.0), (1.0, 1.0, 0.0), (0.0, 0.0, 0.01))),
    "rounded away": np.full((3, 3), 1e20) + np.eye(3) * 1e-4,
    "not finite": np.diag((np.inf, 0.01, 0.01)),
}


@pytest.mark.parametrize("name", SINGULAR)
def test_a_singular_covariance_has_no_nees_and_spoils_none(name: str) -> None:
    P = np.diag((0.01, 0.01, 0.01))
    estimated = estimates((0, (0.2, 0.0, 0.0), SINGULAR[name]), (100, (1.2, 0.0, 0.0), P))
    errors = errors_against(estimated, path((0, 100), (0, 0, 0), (1, 0, 0)))
    assert errors.nees == pytest.approx(4.0)
    assert errors.score == Score(2, pytest.approx(0.2), pytest.approx(0.0))
    alone = errors_against(estimated[:1], path((0,), (0, 0, 0)))
    assert alone.nees is None


def test_the_position_has_a_nees_where_only_the_heading_has_no_variance() -> None:
    estimated = estimates((0, (0.2, 0.0, 0.0), SINGULAR["one variance zero"]))
    errors = errors_against(estimated, path((0,), (0, 0, 0)))
    assert (errors.nees, errors.nees_position) == (None, pytest.approx(4.0))


def test_nees_of_variances_ten_decades_apart_is_exact() -> None:
    P = np.diag((1e8, 1e-2, 1e-8))
    estimated = estimates((0, (1e4, 0.1, 1e-4), P))
    assert mean_nees(estimated, path((0,), (0, 0, 0))) == pytest.approx(3.0)
