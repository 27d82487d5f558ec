# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Several gyros on one machine: each has its own bias, independent of the others."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.drawn_machine import GYRO, Machine, drive, parameters

from trackslip_common.errors import InputError
from trackslip_estimation.slip.config import make_config
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, YawRate
from trackslip_estimation.slip.models.model import GYRO_BIAS

SECOND = "imu/second"
BIASES = {GYRO: 0.006, SECOND: -0.008}  # rad/s


def shown(seed: int) -> tuple[list[Measurement], np.ndarray]:
    recorded, noise = drive(Machine(duration=60.0, seed=seed)), np.random.default_rng(seed + 50)
    found: list[Measurement] = []
    for m in recorded.measurements:
        if isinstance(m, YawRate):
            rate = m.rate + 0.003 * noise.standard_normal() + BIASES[SECOND]
            found.append(replace(m, source=SECOND, stamp_ns=m.stamp_ns + 7, rate=rate))
            m = replace(m, rate=m.rate + BIASES[GYRO])
        found.append(m)
    return sorted(found, key=lambda m: m.stamp_ns), recorded.poses[-1]


@pytest.mark.parametrize(("model", "filter_"), [("turning", "ekf"), ("icr", "daf")])
def test_each_finds_its_bias(model: str, filter_: str) -> None:
    p = parameters(yaw_rate_sources=[GYRO, SECOND], model=model, filter=filter_)
    given, end = shown(1)
    estimator = SlipEstimator(p)
    estimator.process_all(given)
    state = estimator.window.best[estimator.window.count - 1]
    places = {GYRO: GYRO_BIAS, SECOND: int(make_config(p)[0]["source_states"][estimator.sources[SECOND]])}
    for source, place in places.items():
        deviation = np.sqrt(state["covariance"][place, place])
        assert state["mean"][place] == pytest.approx(BIASES[source], abs=max(3.0 * deviation, 1e-4))
        assert deviation < 0.002
    assert abs(estimator.estimate().pose[2] - end[2]) < 0.02
    assert np.linalg.eigvalsh(state["covariance"]).min() > -1e-12


def test_one_more_than_the_state_has_room_for_is_refused() -> None:
    with pytest.raises(
        InputError,
        match=r"2 gyros .*, 1 odometries, 5 sources of headings .*; 6 .* twice; accepted: at most 18",
    ):
        parameters(
            yaw_rate_sources=list("abc"),
            odometry_sources=["e"],
            pose_sources=["box_pose", "gnss_pose", *"fghi"],
            **{"sources.box_pose.lever_arm_z": 2.0},
        )
