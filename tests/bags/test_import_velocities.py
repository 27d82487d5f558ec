# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Velocities of receivers and radars, imported from bags and CSV logs."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.imports import import_csv, import_messages

from trackslip_bags.messages import header, make
from trackslip_estimation.slip.conversions import velocity_fix
from trackslip_estimation.slip.measurements import UNOBSERVED, VelocityFix
from trackslip_estimation.slip.parameters import load_slip_parameters

RECEIVER = load_slip_parameters({"velocity_sources": ["fix_velocity"]}).velocities()["fix_velocity"]


VELOCITIES: dict[str, dict[str, Any]] = {
    "t,e,n,s\n0,1,0,0.1\n1,0,-2,0.2\n": {
        "east": {"column": "e", "unit": "m/s"},
        "north": {"column": "n", "unit": "m/s"},
        "stddev": {axis: {"column": "s", "unit": "m/s"} for axis in "xy"},
    },
    "t,v,c\n0,3.6,90\n1,7.2,180\n": {
        "speed": {"column": "v", "unit": "km/h"},
        "course": {"column": "c", "unit": "deg"},
    },
}


@pytest.mark.parametrize("log", VELOCITIES)
def test_columns_of_a_receiver_are_velocities(log: str, tmp_path: Path) -> None:
    _, messages = import_csv(tmp_path, log, {"fix_velocity": VELOCITIES[log]})
    fixes = [velocity_fix(m, "fix_velocity", RECEIVER) for m in messages]
    assert [list(one.velocity) for one in fixes] == [pytest.approx((1.0, 0.0)), pytest.approx((0.0, -2.0))]
    stated = (0.1, 0.2) if "stddev" in VELOCITIES[log] else (RECEIVER.stddev,) * 2
    assert [one.covariance[1, 1] for one in fixes] == [pytest.approx(s**2) for s in stated]


def test_column_of_a_radar_is_a_velocity_along_one_axis(tmp_path: Path) -> None:
    topics = {"radar": {"role": "velocity", "forward": {"column": "v", "unit": "m/s"}}}
    _, (message,) = import_csv(tmp_path, "t,v\n0,0.5\n", topics)
    velocity = velocity_fix(message, "radar", RECEIVER)
    assert isinstance(velocity, VelocityFix)
    assert (velocity.velocity[0], velocity.covariance[1, 1]) == (0.5, UNOBSERVED)


def test_twists_of_a_bag_are_velocities(tmp_path: Path) -> None:
    def twist(t: float, speed: float, variance: float) -> Any:
        covariance = np.zeros(36)
        covariance[[0, 7]] = variance
        linear = make("geometry_msgs/msg/Vector3", x=speed, y=0.0, z=0.0)
        both = make("geometry_msgs/msg/TwistWithCovariance", covariance=covariance)
        both.twist.linear = linear
        kind = "geometry_msgs/msg/TwistWithCovarianceStamped"
        return make(kind, header=header(round(t * 1e9), "gps"), twist=both)

    twists = [twist(0.0, 1.0, 0.04), twist(0.2, 2.0, -1.0), twist(0.4, math.nan, 0.04), twist(0.6, 3.0, 0.0)]
    sent = (("/gps/vel", one) for one in twists)
    result, messages = import_messages(tmp_path, sent, {"fix_velocity": {"from": "/gps/vel"}})
    assert [m.twist.twist.linear.x for m in messages] == [1.0, 3.0]
    assert [m.twist.covariance[0] for m in messages] == [0.04, 0.0]
    refused = {"states that it has no velocity": 1, "has no finite values": 1}
    assert result.left_out["/fix_velocity"] == refused
