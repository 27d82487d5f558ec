# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""State transformed to sensors on a cab, and motion of the swing: derivatives against differences."""

import math

import numpy as np
import pytest
from fixtures.filter_steps import Drive, Gaussian, config_of, differences, moved, state_of, transition
from fixtures.swinging_cab import CAB, upper_pose

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.levers import horizontal_lever_arm, stamp_shift, to_sensor
from trackslip_estimation.slip.models.model import (
    SIZE,
    SWING,
    SWING_RATE,
    YAW,
)
from trackslip_estimation.slip.motion import Motion

WITH = {"vehicle": "pc05_cab"}
ANTENNA = {**WITH, "pose_sources": ["gnss_pose"]}


def random_state(seed: int = 1) -> Gaussian:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(SIZE, SIZE))
    return Gaussian(rng.normal(size=SIZE) * 0.3, root @ root.T * 0.01)


@pytest.mark.parametrize("tilted", [False, True])
def test_lever_arm_on_the_cab_is_transformed_and_inverted(tilted: bool) -> None:
    """Pose of the antenna on the cab, its derivative, and the inverse."""
    c, known = config_of(ANTENNA)[0], random_state()
    state = state_of(known)[0]
    level = state["attitude"]["level"]
    if tilted:
        roll, pitch = 0.1, -0.2
        level["known"], level["forward"], level["sideways"] = 1, math.cos(pitch) - 1.0, math.cos(roll) - 1.0
        level["across"], level["lean_x"] = math.sin(roll) * math.sin(pitch), math.cos(roll) * math.sin(pitch)
        level["lean_y"] = -math.sin(roll)

    def at_sensor(x: FloatArray) -> FloatArray:
        there = x.copy()
        to_sensor(there, np.zeros((SIZE, SIZE)), level, 0, 1.0, c)
        return there

    x, P = known.mean.copy(), known.covariance.copy()
    to_sensor(x, P, level, 0, 1.0, c)
    T = differences(at_sensor, known.mean)
    np.testing.assert_allclose(P, T @ known.covariance @ T.T, atol=2e-2 if tilted else 1e-8)
    to_sensor(x, P, level, 0, -1.0, c)
    np.testing.assert_allclose(x, known.mean, atol=1e-12)
    np.testing.assert_allclose(P, known.covariance, atol=1e-12)
    if not tilted:
        antenna = CAB.sensors.antenna
        swing, axis = known.mean[SWING], np.array(CAB.swing_axis)
        arm = np.array((antenna.x, antenna.y)) - axis
        turned = axis + np.array(((np.cos(swing), -np.sin(swing)), (np.sin(swing), np.cos(swing)))) @ arm
        np.testing.assert_allclose(horizontal_lever_arm(level, swing, 0, c)[:2], turned, atol=1e-12)


def test_box_on_the_cab_turns_with_it() -> None:
    c, x = config_of(WITH)[0], np.zeros(SIZE)
    x[: YAW + 1], x[SWING] = (1.0, 2.0, 0.7), 2.5
    level = state_of(Gaussian(x, np.zeros((SIZE, SIZE))))[0]["attitude"]["level"]
    expected_ = upper_pose(x[:3], 2.5)
    to_sensor(x, np.zeros((SIZE, SIZE)), level, 0, 1.0, c)
    np.testing.assert_allclose(x[:3], expected_, atol=1e-12)


def test_swing_moves_a_sensor_on_the_cab_by_its_lever_arm() -> None:
    """At standstill."""
    c, known = config_of(ANTENNA)[0], Gaussian(np.zeros(SIZE), np.zeros((SIZE, SIZE)))
    known.mean[SWING], known.mean[SWING_RATE] = 1.0, 0.5
    state = state_of(known)[0]
    later, now = known.mean.copy(), known.mean.copy()
    later[SWING] += 0.5e-6
    P = np.zeros((SIZE, SIZE))
    to_sensor(now, P, state["attitude"]["level"], 0, 1.0, c)
    to_sensor(later, P, state["attitude"]["level"], 0, 1.0, c)
    found = np.array(stamp_shift(state, 0, c)) / c["stamp_errors"][0]
    np.testing.assert_allclose(found, (later - now)[:3] * 1e6, atol=1e-6)


@pytest.mark.parametrize("motion", [Motion.STANDING, Motion.STRAIGHT, Motion.UNKNOWN])
@pytest.mark.parametrize("rate", [0.0, 0.3])
def test_transition_of_the_swing(motion: Motion, rate: float) -> None:
    config, x = config_of(WITH), random_state(3).mean
    x[SWING_RATE] = rate
    drive = Drive(1.0, 1.2, motion)
    F = differences(lambda at: moved(at, drive, 0.05, config), x)
    rows = (SWING, SWING_RATE, 9)
    found = transition(x, drive, 0.05, config)
    np.testing.assert_allclose(found[rows, :], F[rows, :], atol=2e-3 if motion is Motion.STRAIGHT else 1e-7)
