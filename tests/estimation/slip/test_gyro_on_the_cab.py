# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A gyro on the upper structure fails while that swings, beside an encoder of the swing and one antenna."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import pytest
from fixtures.changes import changed
from fixtures.drawn_machine import GNSS
from fixtures.pose_errors import THREE_SIGMA, errors_over
from fixtures.swinging_cab import Cab, Part, dig, record

from trackslip_estimation.slip.measurements import YawRate
from trackslip_estimation.slip.parameters import load_slip_parameters

P = load_slip_parameters(
    {"vehicle": "pc05_cab"}, GNSS, {"sources.box_pose.use_heading": False, "initial_yaw_stddev": 0.02}
)
FAULTS: Mapping[str, Callable[[float], float]] = {
    "biased": lambda rate: rate + 0.1,
    "zero": lambda _: 0.0,
    "reversed": lambda rate: -rate,
}
WORK = [*dig(), Part(3.0, -1.5, 1.5), *dig(1.5), Part(10.0), *dig(-1.0), Part(3.0, 1.5, -1.5), *dig(2.0)]


@pytest.mark.parametrize("begin", [42.0, 60.0, 78.0])
@pytest.mark.parametrize("fault", FAULTS)
def test_failed_gyro_on_the_cab_leaves_the_estimate_consistent(fault: str, begin: float) -> None:
    drive = record(WORK, Cab(fix_hertz=5.0))
    faulty = changed(
        drive.measurements, YawRate, lambda m: replace(m, rate=FAULTS[fault](m.rate)), begin, begin + 30.0
    )
    errors, _ = errors_over(faulty, drive, P)
    moved = errors.between(5.0)
    assert (moved.nees(2) > THREE_SIGMA).mean() < 0.05
    assert moved.heading_nees < 8.0
