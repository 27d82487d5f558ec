# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes of drives that leave the laser's view and return: errors match the covariance, by beam count."""

import dataclasses

import numpy as np
import pytest
from fixtures.box_site import AT_ORIGIN, BARE_AT_ORIGIN, BOX, PERIOD, Scored, hidden, locate

from trackslip_estimation.box.localizer import BoxFix, BoxLocalizer
from trackslip_sim.machine.scan_model import SiteScanner

STEP = 0.02  # s
CLASSES = {"few": (0, 6), "some": (6, 12), "many": (12, 400)}
LEAST = 100  # fixes for a mean


def random_drive(seed, duration, initial_yaw, farthest):
    """Times and poses (N, 3) of a drive to random places, at least 2.5 m away, some behind the laser."""
    random = np.random.default_rng(seed)
    count = int(duration / STEP)
    path = np.empty((count, 3))
    pose = np.array([random.uniform(4.0, 20.0), 0.0, initial_yaw])
    remaining = 0.0
    for k in range(count):
        if remaining <= 0.0:
            distance, azimuth = random.uniform(2.5, farthest), random.uniform(-1.75, 1.75)
            goal = distance * np.array([np.cos(azimuth), np.sin(azimuth)])
            speed, rate = random.choice((-0.4, 0.0, 0.3, 0.5)), random.uniform(0.1, 0.6)
            remaining = random.uniform(3.0, 60.0) if speed else random.uniform(1.0, 8.0)
        remaining -= STEP
        path[k] = pose
        offset = goal - pose[:2]
        bearing = np.arctan2(offset[1], offset[0]) + (np.pi if speed < 0.0 else 0.0) - pose[2]
        turn = np.clip(np.arctan2(np.sin(bearing), np.cos(bearing)), -rate, rate)
        approaches = np.hypot(*pose[:2]) < 2.0 and pose[:2] @ [np.cos(pose[2]), np.sin(pose[2])] * speed < 0.0
        ahead = 0.0 if approaches or np.hypot(*offset) < 0.5 else speed
        pose = pose + STEP * np.array([ahead * np.cos(pose[2]), ahead * np.sin(pose[2]), turn])
    return STEP * np.arange(count), path


def scored_drive(seed, duration, initial_yaw, *, farthest, hides):
    """Beams and score of each fix; with ``hides``, the box is occluded for some seconds at times."""
    times, path = random_drive(seed, duration, initial_yaw, farthest)
    random = np.random.default_rng(seed + 1_000_000)
    scanner = SiteScanner(BARE_AT_ORIGIN, BOX, seed)
    start = {"initial_x": float(path[0, 0]), "initial_y": 0.0, "initial_yaw": float(initial_yaw)}
    localizer = BoxLocalizer(dataclasses.replace(AT_ORIGIN, **start), BOX)

    def pose_at(t):
        return tuple(np.interp(t, times, path[:, k]) for k in range(3))

    fixes, hidden_until, hides_at = [], 0.0, 20.0
    for stamp in np.arange(0.0, duration - 1.0, PERIOD):
        if hides and stamp > hides_at:
            hidden_until = stamp + random.exponential(5.0)
            hides_at = hidden_until + random.exponential(30.0)
        ranges = scanner.scan(stamp, pose_at)
        beams = int(np.isfinite(ranges).sum())
        fix = locate(localizer, stamp, hidden(ranges, 0, 361) if stamp < hidden_until else ranges)
        if isinstance(fix, BoxFix):
            fixes.append((beams, Scored.from_fix(fix, pose_at)))
    return fixes


@pytest.fixture(scope="module")
def fixes():
    """About 2500 fixes, from four headings; half of the drives stay in view and keep their heading."""
    kinds = ({"farthest": 36.0, "hides": True}, {"farthest": 26.0, "hides": False})
    drives = [scored_drive(seed, 70.0, seed % 4 * np.pi / 2.0, **kinds[seed // 4]) for seed in range(8)]
    return [fix for scored in drives for fix in scored]


@pytest.mark.slow
@pytest.mark.parametrize("name", CLASSES)
def test_errors_of_position_and_heading_agree_with_their_covariance(fixes, name):
    low, high = CLASSES[name]
    chosen = [fix for beams, fix in fixes if low <= beams < high]
    headings = [fix.heading for fix in chosen if fix.claims_heading]
    assert len(headings) > LEAST
    assert 0.7 < np.mean([fix.position for fix in chosen]) / 2.0 < 1.5
    assert 0.7 < np.mean(headings) < 1.5


@pytest.mark.slow
def test_certain_headings_are_never_a_quarter_turn_off(fixes):
    claimed = [fix for _, fix in fixes if fix.claims_heading]
    assert max(fix.heading for fix in claimed) < 4.0**2
    assert max(abs(fix.error[2]) for fix in claimed) < 0.5
