# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Insensitivity to stamps that are 1 µs off and to the order of sources at equal stamps."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from fixtures.drawn_machine import FIX, GYRO, Machine, drive, parameters
from numpy.typing import NDArray

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, PoseFix, Sprockets, YawRate

SHIFT_NS = 1000
MACHINES = (
    Machine(duration=40.0),
    Machine(duration=40.0, gyro_scale=0.98, gyro_noise=0.02, track_error=0.08, fix_noise=0.04, seed=1),
)


def final_pose(measurements: Sequence[Measurement]) -> NDArray[np.float64]:
    """(3,) pose at the end."""
    estimator = SlipEstimator(parameters())
    estimator.process_all(measurements)
    return estimator.estimate().pose


def shifted(measurements: Sequence[Measurement], k: int, by_ns: int) -> list[Measurement]:
    """The measurements in the same order, with one stamp moved."""
    found = list(measurements)
    found[k] = replace(found[k], stamp_ns=found[k].stamp_ns + by_ns)
    return found


@pytest.mark.parametrize("machine", MACHINES, ids=("nominal", "real"))
@pytest.mark.parametrize("kind", [Sprockets, YawRate, PoseFix])
def test_a_stamp_that_is_a_microsecond_off_moves_the_final_pose_by_less_than_a_millimetre(
    machine: Machine, kind: type[Measurement]
) -> None:
    measurements = drive(machine).measurements
    pose = final_pose(measurements)
    of_kind = [k for k, m in enumerate(measurements) if isinstance(m, kind)]
    for k, by_ns in ((of_kind[len(of_kind) // 4], -SHIFT_NS), (of_kind[len(of_kind) // 2], SHIFT_NS)):
        moved = final_pose(shifted(measurements, k, by_ns)) - pose
        assert np.hypot(*moved[:2]) < 1e-3
        assert abs(moved[2]) < 1e-3


@pytest.mark.parametrize("machine", MACHINES, ids=("nominal", "real"))
def test_the_order_of_sources_at_equal_stamps_does_not_matter(machine: Machine) -> None:
    measurements = drive(machine).measurements
    assert {m.source for m in measurements} == {"sprockets", GYRO, FIX}
    pose = final_pose(measurements)
    start = measurements[0].stamp_ns  # its fix starts the estimate; others with this stamp keep their order
    order = {source: -k for k, source in enumerate(("sprockets", GYRO, FIX))}
    backwards = sorted(measurements, key=lambda m: (m.stamp_ns, order[m.source] * (m.stamp_ns > start)))
    assert [m.source for m in backwards] != [m.source for m in measurements]
    assert np.array_equal(final_pose(backwards), pose)
