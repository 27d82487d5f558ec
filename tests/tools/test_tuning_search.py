# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The tuner's search over the unit cube."""

from typing import Any

import numpy as np
import pytest

from trackslip_common.errors import InputError
from trackslip_tools.tuning.search import search


def test_error_of_a_worker_ends_the_search() -> None:
    """scipy must not replace the error by its own."""

    def costs(_: Any) -> Any:
        raise InputError("its workers ended")

    with pytest.raises(InputError, match="its workers ended"):
        search(costs, np.array((0.1, 0.9)), 300, seed=1)


def test_the_search_finds_the_bottom_of_a_bent_valley() -> None:
    points_tried: list[np.ndarray[Any, Any]] = []

    def costs(points: Any) -> Any:
        points_tried.extend(points)
        x, y = points.T
        return (x - 0.7) ** 2 + 30.0 * (y - x**2) ** 2

    best = search(costs, np.array((0.1, 0.9)), 300, seed=1)
    np.testing.assert_allclose(best, (0.7, 0.49), atol=0.02)
    assert len(points_tried) <= 305
    assert any(np.allclose(point, (0.1, 0.9)) for point in points_tried)
    assert (np.array(points_tried) >= 0.0).all()
    assert (np.array(points_tried) <= 1.0).all()
    first = list(points_tried)
    points_tried.clear()
    search(costs, np.array((0.1, 0.9)), 300, seed=1)
    np.testing.assert_array_equal(first, points_tried)


def test_a_search_that_has_not_converged_keeps_to_its_points() -> None:
    batch_sizes: list[int] = []

    def costs(points: Any) -> Any:
        batch_sizes.append(len(points))
        return np.sum(np.sin(20.0 * points) + np.abs(points - 0.3) ** 0.2, axis=1)

    search(costs, np.full(9, 0.9), 300, seed=1)
    assert 290 <= sum(batch_sizes) <= 301
