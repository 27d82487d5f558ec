# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""For any input the strength posterior stays a distribution, and is not overconfident."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.soil_samples import Sample, Strength
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.records import PoseWithCovariance
from trackslip_estimation.soil.soil_parameters import load_soil_parameters

P = load_soil_parameters()
SMALL = replace(P.strength, modulus_cells=12, limit_cells=16, elements=6)  # quick
ANY = st.floats(allow_nan=True, allow_infinity=True)
LIKELY = st.floats(-2.0, 2.0)
NUMBERS = ANY | LIKELY


@st.composite
def samples(draw: st.DrawFn) -> Sample:
    root = draw(arrays(np.float64, (3, 3), elements=st.floats(-0.1, 0.1)))
    covariance = root @ root.T  # others are rejected as inputs
    return Sample(
        dt=draw(st.just(P.strength.interval) | ANY),
        tracks=draw(arrays(np.float64, 2, elements=NUMBERS)),
        twist=draw(arrays(np.float64, 3, elements=LIKELY)),
        twist_covariance=covariance,
        thrusts=draw(st.none() | arrays(np.float64, 2, elements=ANY | st.floats(-1e4, 1e4))),
        thrust_variances=draw(arrays(np.float64, 2, elements=ANY | st.floats(0.0, 1e6))),
        motion=draw(st.sampled_from(Motion)),
        pose=PoseWithCovariance(draw(arrays(np.float64, 3, elements=NUMBERS)), covariance),
    )


@pytest.mark.slow
@settings(deadline=None, max_examples=150)
@given(st.lists(samples(), min_size=1, max_size=4))
def test_posterior_stays_a_distribution_for_any_input(given_samples: list[Sample]) -> None:
    strength = Strength(SMALL, P.vehicle.whole())
    for sample in given_samples:
        strength.update(sample)
        cells = strength.posterior.cells
        assert np.isfinite(cells).all()
        assert (cells >= 0.0).all()
        assert abs(cells.sum() - 1.0) < 1e-9
        found = strength.posterior.summary()
        for value, (low, high) in (
            (found.shear_modulus, found.shear_modulus_interval),
            (found.thrust_limit, found.thrust_limit_interval),
        ):
            assert 0.0 < low < value < high


@settings(deadline=None, max_examples=30)
@given(st.floats(0.02, 0.3), st.floats(0.05, 0.5), st.floats(-0.02, 0.02), st.floats(0.0, 0.1), st.booleans())
def test_mirrored_drives_give_the_same_posterior(
    slip: float, slower: float, v_y: float, rate: float, reverse: bool
) -> None:
    """Mirrored left to right, and front to back."""
    tracks = np.array((slower * 0.35, 0.35))
    twist = np.array((0.35 * (1.0 - slip) - 0.5 * P.vehicle.whole().tread * rate, v_y, rate))
    thrusts = np.array((-600.0, 3000.0))
    grids = []
    for mirrored in (False, True):
        strength = Strength(SMALL, P.vehicle.whole())
        direction = np.array((-1.0, 1.0, -1.0)) if reverse else np.array((1.0, -1.0, -1.0))
        order = slice(None) if reverse else slice(None, None, -1)
        sign = -1.0 if reverse else 1.0
        sample = Sample(
            P.strength.interval,
            sign * tracks[order] if mirrored else tracks,
            direction * twist if mirrored else twist,
            np.diag((1e-5, 1e-5, 1e-5)),
            sign * thrusts[order] if mirrored else thrusts,
            np.full(2, 100.0),
            Motion.TURNING,
            PoseWithCovariance(np.zeros(3), np.eye(3)),
        )
        for _ in range(5):
            strength.update(sample)
        grids.append(strength.posterior.cells)
    np.testing.assert_allclose(grids[1], grids[0], rtol=1e-6, atol=1e-12)
