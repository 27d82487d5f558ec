# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Encoders fail for a while on a site, where a machine turns on the spot and reverses, with a gyro and fixes.

Wrong encoders may fit a machine that faces the other way. The gyro measured no such turn.
"""

from collections.abc import Iterable

import numpy as np
import pytest
from fixtures.drawn_machine import GNSS, parameters
from fixtures.fault_cases.case import seconds
from fixtures.pose_errors import errors_over
from fixtures.short_moves import work
from fixtures.swinging_cab import Cab, dig, record

from trackslip_estimation.slip.measurements import Measurement, Sprockets
from trackslip_estimation.slip.parameters import load_slip_parameters

FAULT = 30.0  # s
P = parameters(**GNSS)
ONE_ANTENNA = {"sources.box_pose.use_heading": False, "initial_yaw_stddev": 0.02}


def with_wrong_encoders(
    measurements: Iterable[Measurement], left: float, right: float, begin: float
) -> list[Measurement]:
    """The drive with encoders that measure ``left`` and ``right`` times the true motion for ``FAULT`` s."""
    changed: list[Measurement] = []
    shift, before = np.zeros(2), np.zeros(2)
    for m in measurements:
        if not isinstance(m, Sprockets):
            changed.append(m)
            continue
        is_wrong = begin <= seconds(m) < begin + FAULT
        factors = np.array((left, right) if is_wrong else (1.0, 1.0))
        now = np.array(m.positions)
        shift += (factors - 1.0) * (now - before)
        before = now
        angle_left, angle_right = (now + shift).tolist()
        speed_left, speed_right = float(factors[0]) * m.left_speed, float(factors[1]) * m.right_speed
        changed.append(Sprockets(m.source, m.stamp_ns, speed_left, speed_right, (angle_left, angle_right)))
    return changed


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("left", "right"), [(-1.0, -1.0), (0.0, 1.0), (0.5, 1.0)], ids=["reversed", "left stuck", "left half"]
)
def test_wrong_encoders_do_not_turn_the_heading(left: float, right: float, seed: int) -> None:
    recording = work(seed)
    errors, _ = errors_over(with_wrong_encoders(recording.measurements, left, right, 40.0), recording, P)
    moved = errors.between(10.0)
    assert moved.heading_nees < 5.0
    assert np.abs(moved.between(110.0).off[:, 2]).max() < 0.15
    assert moved.rms < 0.2


@pytest.mark.parametrize("begin", [40.0, 60.0, 80.0])
def test_reversed_encoders_do_not_turn_the_heading_below_a_cab_with_the_gyro(begin: float) -> None:
    drive = record([*dig(), *dig(1.5), *dig(-1.0), *dig(2.0)], Cab(fix_hertz=5.0))
    wrong = with_wrong_encoders(drive.measurements, -1.0, -1.0, begin)
    errors, _ = errors_over(wrong, drive, load_slip_parameters({"vehicle": "pc05_cab"}, GNSS, ONE_ANTENNA))
    assert errors.between(10.0).heading_nees < 5.0


@pytest.mark.parametrize("seed", range(4))
def test_estimate_is_consistent_at_work(seed: int) -> None:
    recording = work(seed)
    errors, _ = errors_over(recording.measurements, recording, P)
    assert errors.nees(2).mean() < 4.0
    assert errors.between(10.0).heading_nees < 4.0
