# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of the χ² gate, against scipy."""

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import chdtri

from trackslip_estimation.kalman import chi_square


@given(st.sampled_from((1, 2, 3)), st.floats(1e-12, 1.0 - 1e-6))
def test_limit_equals_that_of_scipy(dof, tail):
    assert chi_square.upper_limit(dof, tail) == pytest.approx(chdtri(dof, tail), rel=1e-6)


@pytest.mark.parametrize("tail", [0.05, 0.01, 0.001, 1e-4])
@pytest.mark.parametrize("dof", [1, 2, 3])
def test_gate_limit_equals_that_of_scipy_within_1e_13(dof, tail):
    assert chi_square.upper_limit(dof, tail) == pytest.approx(chdtri(dof, tail), rel=1e-13)


@given(st.integers(1, 100_000))
def test_interval_is_close_to_that_of_scipy(dof):
    assert chi_square.confidence_interval(dof) == pytest.approx(chdtri(dof, (0.975, 0.025)), abs=0.1)


def test_estimator_starts_without_the_special_functions_of_scipy():
    code = "import sys, trackslip_estimation.slip.estimator, trackslip_estimation.soil.soil_estimator; "
    code += "import trackslip_estimation.slip.source_watch; print('scipy.special' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
