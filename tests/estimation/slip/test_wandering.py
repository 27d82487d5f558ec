# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes that wander: their total evidence is their joint density by the model."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.arrays import FloatArray
from trackslip_estimation.kalman.update import Observation
from trackslip_estimation.slip.config import make_config
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import OFFSET, UPDATE
from trackslip_estimation.slip.wandering import begin_wander, weigh_wander

PLACE, FIX = 0.02, 0.03  # m, standard deviations of the position at the start, and of fixes
NOTHING = 1e-12


def evidence_of(residuals: FloatArray, t: FloatArray, most: float) -> float:
    """Sum of the log evidence of fixes with residuals (n, 2) m at n times since the start, s."""
    p = load_slip_parameters({"events.wander_speed": most, "events.wander_walk": NOTHING})
    config, wander = make_config(p)[0], np.zeros(1, OFFSET)[0]["wander"]
    update = np.zeros(1, UPDATE)[0]
    predicted = np.diag((PLACE**2, PLACE**2))
    begin_wander(wander, predicted, config)
    total = 0.0
    for r, dt in zip(residuals, np.diff(t, prepend=0.0), strict=True):
        o = Observation(r, np.zeros((2, 3)), FIX**2 * np.eye(2), 0, 0, np.zeros((0, 3)))
        weigh_wander(wander, o, predicted, float(dt), config, update)
        total += float(update["evidence"])
    return total


@given(st.lists(st.floats(0.05, 3.0), min_size=1, max_size=12), st.integers(0, 2**32 - 1))
def test_evidence_of_fixes_that_wander_is_their_common_density(steps: list[float], seed: int) -> None:
    """Their offset and its speed are constant and unknown at the start."""
    random, t, most = np.random.default_rng(seed), np.cumsum(steps), 0.2
    speed = 0.02 * random.standard_normal(2)
    residuals = t[:, None] * speed + 0.03 * random.standard_normal((t.size, 2))
    C = PLACE**2 + (most / 2.0) ** 2 * np.outer(t, t) + FIX**2 * np.eye(t.size)
    density = -np.linalg.slogdet(2.0 * math.pi * C)[1]
    density -= sum(r @ np.linalg.solve(C, r) for r in residuals.T) / 2.0
    assert evidence_of(residuals, t, most) == pytest.approx(density, rel=1e-6, abs=1e-6)


def test_drift_faster_than_any_receiver_is_no_evidence_of_wandering() -> None:
    t = np.arange(1.0, 11.0)
    slow, fast = (np.column_stack((v * t, np.zeros_like(t))) for v in (0.15, 0.45))
    assert evidence_of(slow, t, 0.25) - evidence_of(fast, t, 0.25) > 100.0
