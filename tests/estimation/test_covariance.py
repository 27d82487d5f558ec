# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Covariances are accepted but for rounding; anything else is refused."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from trackslip_estimation.covariance import is_covariance


@given(st.integers(1, 4), st.data(), st.integers(-6, 6))
def test_products_with_their_transpose_are_covariances(n, data, exponent):
    root = data.draw(arrays(np.float64, (n, n), elements=st.integers(-9, 9)))
    scale = np.diag(10.0 ** (exponent * np.arange(n)))
    assert is_covariance(scale @ (root @ root.T) @ scale)


@pytest.mark.parametrize(
    "matrix", [np.zeros((3, 3)), [[1.0, 1.0], [1.0, 1.0]], [[1.0, 0.5], [0.5 + 1e-12, 1.0]]]
)
def test_singular_matrices_and_rounding_are_accepted(matrix):
    assert is_covariance(np.array(matrix))


@pytest.mark.parametrize(
    "matrix",
    [
        [[-1.0, 0.0], [0.0, 1.0]],
        [[1.0, 2.0], [2.0, 1.0]],
        [[1.0, 0.5], [0.4, 1.0]],
        [[0.0, 0.1], [0.1, 1.0]],
        [[1.0, 0.1], [0.1, 0.0]],
        [[1e-8, 2e-8], [2e-8, 1e-8]],
        [[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]],
        [[math.inf, 0.0], [0.0, 1.0]],
        [[1.0, math.nan], [math.nan, 1.0]],
        [[1.0, math.inf], [math.inf, 1.0]],
    ],
)
def test_other_matrices_are_refused(matrix):
    assert not is_covariance(np.array(matrix))
