# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""For any input, NaN is published only where it means 'unknown', and no variance is negative."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.records import (
    Hydraulics,
    MachineState,
    PoseWithCovariance,
    SoilInput,
    TrackForces,
)
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import load_soil_parameters

MS = 1_000_000
P = load_soil_parameters({"forces_period": 0.01, "soil_period": 0.05, "moments.patience": 0.02})

numbers = st.one_of(
    st.floats(-3.0, 3.0), st.floats(-1e8, 1e8), st.sampled_from((math.nan, math.inf, 0.0, 1.0, 1e300))
)
stamps = st.one_of(st.integers(0, 50), st.integers(-(10**6), 10**6)).map(lambda k: 10 * k * MS)
variances = st.one_of(st.floats(0.0, 1e-2), st.floats(-1.0, 1e6))
triples = st.tuples(numbers, numbers, numbers).map(np.array)
covariances = st.tuples(variances, variances, variances).map(np.diag)
poses = st.builds(PoseWithCovariance, triples, covariances)
pairs, motions = st.tuples(numbers, numbers), st.sampled_from(Motion)
variance_pairs = st.tuples(variances, variances)
contents = (triples, covariances, poses, triples, motions, pairs, variance_pairs, numbers, variances)
inputs = st.one_of(
    st.builds(Hydraulics, stamps, numbers, numbers, numbers, numbers),
    st.builds(MachineState, stamps, *contents),
)


@st.composite
def drives(draw: st.DrawFn) -> list[SoilInput]:
    """Samples in order with any content, among inputs with any stamps."""
    chosen: list[SoilInput] = []
    for k in range(draw(st.integers(1, 25))):
        stamp_ns = 1_000_000_000 + 10 * k * MS
        chosen += [
            Hydraulics(stamp_ns - 3 * MS, *(draw(numbers) for _ in range(4))),
            MachineState(stamp_ns, *map(draw, contents)),
            *draw(st.lists(inputs, max_size=1)),
        ]
    return chosen


def numbers_in(value: Any, name: str = "") -> Iterator[tuple[str, float]]:
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from numbers_in(getattr(value, field.name), field.name)
    elif isinstance(value, (tuple, dict)):
        for item in value.values() if isinstance(value, dict) else value:
            yield from numbers_in(item, name)
    elif isinstance(value, float):
        yield name, value


@settings(max_examples=60)
@given(drives())
def test_outputs_are_numbers_and_variances_are_not_negative(drive: list[SoilInput]) -> None:
    estimator = SoilEstimator(P)
    newest_ns = -1
    for one in drive:
        for output in estimator.advance(one):
            for name, value in numbers_in(output):
                assert math.isfinite(value) or (isinstance(output, TrackForces) and name == "reserve"), name
                assert "variance" not in name or value >= 0.0
            restarted = estimator.restarts > 0
            assert restarted or output.stamp_ns >= newest_ns
            newest_ns = output.stamp_ns
