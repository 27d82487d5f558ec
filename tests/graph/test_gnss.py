# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Receiver, driver and localizer live: bytes in, map poses out, under faults of the receiver."""

import math

import numpy as np
import pytest

from trackslip_common.make import stamp_ns_of

pytestmark = pytest.mark.xdist_group("graph")

ORIGIN = {"latitude": -33.889, "longitude": 151.193, "altitude": 60.0}
ANTENNA = (0.8, -0.3)  # m in base_link


def seconds(message):
    return stamp_ns_of(message) * 1e-9


@pytest.fixture
def machine(programs, observer, can):
    """Emulated excavator with a receiver, the receiver's driver, and a localizer that has the datum."""
    devices = programs.folder / "devices"
    programs.node(
        "emulator",
        **{"gnss.device.rate": 10.0, "gnss.antenna_x": ANTENNA[0], "gnss.antenna_y": ANTENNA[1]},
        device_directory=str(devices),
        lead_in=1.0,
        scenario="turn_left",
        mode="thesis",
        duration=600.0,
        **can,
    )
    programs.node("nmea_gnss", serial_port=str(devices / "gnss"))
    return programs.node("gnss_localizer", **{f"datum_{name}": value for name, value in ORIGIN.items()})


def test_antenna_position_and_heading_match_the_truth(real_time, machine, observer):
    fixes, poses, headings, truth, datum = map(
        observer.subscribe, ("fix", "gnss_pose", "heading", "truth/odometry", "gnss_localizer/datum")
    )
    observer.wait(lambda: len(poses) > 60 and len(headings) > 60 and len(truth) > 600, "six seconds")
    assert fixes[0].status.status == 2
    assert fixes[-1].position_covariance[0] == pytest.approx(0.01**2)
    assert (datum[0].latitude, datum[0].longitude) == (ORIGIN["latitude"], ORIGIN["longitude"])
    assert poses[0].header.frame_id == "map"
    times = np.array([seconds(m) for m in truth])
    yaw = np.unwrap([2 * math.atan2(m.pose.pose.orientation.z, m.pose.pose.orientation.w) for m in truth])
    x, y = (np.array([getattr(m.pose.pose.position, axis) for m in truth]) for axis in "xy")
    for message in poses:
        if not times[0] < seconds(message) < times[-1]:
            continue
        at_x, at_y, at_yaw = (np.interp(seconds(message), times, column) for column in (x, y, yaw))
        expected = (
            at_x + math.cos(at_yaw) * ANTENNA[0] - math.sin(at_yaw) * ANTENNA[1],
            at_y + math.sin(at_yaw) * ANTENNA[0] + math.cos(at_yaw) * ANTENNA[1],
        )
        measured = message.pose.pose.position
        assert (measured.x, measured.y) == pytest.approx(expected, abs=0.06)
    for message in headings:
        if times[0] < seconds(message) < times[-1]:
            heading = 2 * math.atan2(message.orientation.z, message.orientation.w)
            error = heading - np.interp(seconds(message), times, yaw)
            assert math.remainder(error, math.tau) == pytest.approx(0.0, abs=0.03)
