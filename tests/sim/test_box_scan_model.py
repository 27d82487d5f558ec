# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The emulated laser scanner."""

import dataclasses

import numpy as np
import pytest
from fixtures.box_site import standing

from trackslip_common.errors import InputError
from trackslip_common.vehicle_files import load_vehicle
from trackslip_sim.machine.scan_model import TIME_INCREMENT, SiteParameters, SiteScanner


@pytest.fixture(scope="module")
def box():
    return load_vehicle().box


def site(**changes):
    values = {
        "laser_x": 0.0,
        "laser_y": 0.0,
        "laser_yaw": 0.0,
        "range_stddev": 0.0,
        "range_resolution": 0.0,
        "range_max": 50.0,
        "walls": (),
        "posts": (),
    }
    return SiteParameters(**(values | changes))


def test_box_ahead_and_nothing_else(box):
    ranges = SiteScanner(site(), box, seed=0).scan(0.0, standing(6.0, 0.0, 0.0))
    assert ranges[180] == pytest.approx(6.0 - box.length / 2.0)
    hit = np.flatnonzero(np.isfinite(ranges))
    half_width = np.arctan2(box.width / 2.0, 6.0 - box.length / 2.0)
    assert hit[-1] - 180 == int(np.rad2deg(half_width) / 0.5) == 180 - hit[0]


def test_box_offset_and_laser_pose(box):
    ahead = dataclasses.replace(box, x=0.5, y=0.2)
    scanner = SiteScanner(site(laser_x=2.0, laser_y=-7.0, laser_yaw=np.pi / 2.0), ahead, seed=0)
    ranges = scanner.scan(0.0, standing(2.2, 0.0, np.pi / 2.0))
    assert ranges[180] == pytest.approx(7.0 + 0.5 - 0.35)


def test_walls_and_posts_hide_what_is_behind(box):
    scanner = SiteScanner(site(walls=(8.0, -1.0, 8.0, 1.0), posts=(3.0, 0.0, 0.1)), box, seed=0)
    ranges = scanner.scan(0.0, standing(6.0, 0.0, 0.0))
    assert ranges[180] == pytest.approx(2.9)
    assert ranges[185] == pytest.approx(5.65 / np.cos(np.deg2rad(2.5)))
    assert ranges[190] == pytest.approx(8.0 / np.cos(np.deg2rad(5.0)))
    assert np.isinf(ranges[196])


def test_each_beam_sees_the_box_at_its_own_time(box):
    speed = 50.0  # m/s, for a visible effect

    def pose_at(times):
        return 6.0 + speed * times, np.zeros_like(times), np.zeros_like(times)

    ranges = SiteScanner(site(), box, seed=0).scan(0.0, pose_at)
    assert ranges[180] == pytest.approx(5.65 + speed * 180 * TIME_INCREMENT)
    assert pytest.approx(720) == 0.040 / TIME_INCREMENT  # beams per turn of the mirror


def test_noise_has_its_size_and_ranges_are_whole_centimetres(box):
    scanner = SiteScanner(
        site(range_stddev=0.03, range_resolution=0.01, walls=(5.0, -90.0, 5.0, 90.0)), box, seed=1
    )
    away = standing(-20.0, 0.0, 0.0)
    truth = scanner.true_ranges(0.0, away)
    near = truth < 40.0
    errors = np.concatenate([scanner.scan(0.0, away)[near] - truth[near] for _ in range(30)])
    assert errors.std() == pytest.approx(np.hypot(0.03, 0.01 / np.sqrt(12.0)), rel=0.03)
    ranges = scanner.scan(0.0, away)[near]
    assert ranges * 100.0 == pytest.approx(np.round(ranges * 100.0), abs=1e-6)


def test_beyond_the_farthest_return_is_infinite(box):
    scanner = SiteScanner(site(range_max=10.0, walls=(12.0, -1.0, 12.0, 1.0)), box, seed=0)
    assert np.all(np.isposinf(scanner.scan(0.0, standing(-20.0, 0.0, 0.0))))


def test_incomplete_wall_is_refused_in_one_line():
    with pytest.raises(InputError, match=r"walls: 3 numbers; accepted: 4 for each"):
        site(walls=(1.0, 2.0, 3.0))
