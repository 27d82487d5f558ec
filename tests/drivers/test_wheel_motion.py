# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sprocket motion from any number of joints of either sign, and from speeds of a base controller."""

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from trackslip_common.config_files import load_parameters
from trackslip_common.errors import InputError
from trackslip_drivers.protocols.wheel_motion import JointMotion, Rejection, sample_of_speeds
from trackslip_drivers.records import SprocketSample
from trackslip_drivers.wheel_parameters import NODE, WheelParameters

NAMES = ["rear_right_wheel", "arm", "front_left_wheel", "rear_left_wheel", "front_right_wheel"]
S = 1_000_000_000


def parameters(**changes):
    return load_parameters(WheelParameters, NODE, (f"{NODE}.yaml",), changes)


def test_sides_are_means_of_their_joints_by_name():
    sample = JointMotion(parameters()).sample(S, NAMES, [4.0, 9.0, 1.0, 3.0, 6.0], [0.4, 9.0, 0.1, 0.3, 0.6])
    assert sample == SprocketSample(S, *map(pytest.approx, (2.0, 5.0, 0.2, 0.5)))


def test_sign_and_ratio():
    motion = JointMotion(parameters(right_sign=-1, joint_ratio=25.0))
    sample = motion.sample(S, NAMES, [-50.0, 0.0, 25.0, 25.0, -50.0], [-5.0, 0.0, 5.0, 5.0, -5.0])
    assert sample == SprocketSample(S, *map(pytest.approx, (1.0, 2.0, 0.2, 0.2)))


def test_positions_alone_are_differenced():
    motion = JointMotion(parameters())
    first = motion.sample(S, NAMES, [0.0] * 5, [])
    second = motion.sample(S + S // 10, NAMES, [0.2] * 5, [])
    assert (first.left_velocity, first.right_velocity) == (0.0, 0.0)
    assert second == SprocketSample(S + S // 10, *map(pytest.approx, (0.2, 0.2, 2.0, 2.0)))
    motion.restart()
    assert motion.sample(2 * S, NAMES, [7.0] * 5, []).left_velocity == 0.0


def test_speed_after_a_position_that_is_not_a_number_is_that_since_the_last_valid_one():
    motion = JointMotion(parameters())
    motion.sample(S, NAMES, [0.0] * 5, [])
    assert motion.sample(S + S // 10, NAMES, [math.nan] * 5, []) is Rejection.NOT_A_NUMBER
    assert motion.sample(S + S // 5, NAMES, [0.2] * 5, []).left_velocity == pytest.approx(1.0)


@pytest.mark.parametrize("first", [-math.pi, 0.0])
@pytest.mark.parametrize("velocities", [[], [5.0] * 5], ids=["positions", "both"])
def test_wrapping_positions_give_a_steady_speed(first, velocities):
    """Each joint wraps at a different time; 50 Hz, 5 rad/s."""
    motion = JointMotion(parameters())
    turned = [0.3, 0.0, 2.0, 1.0, 5.9]
    samples = []
    for k in range(200):
        positions = [(angle + 0.1 * k - first) % math.tau + first for angle in turned]
        samples.append(motion.sample(S + k * S // 50, NAMES, positions, velocities))
    assert [one.left_velocity for one in samples[1:]] == pytest.approx([5.0] * 199)
    assert [one.right_velocity for one in samples[1:]] == pytest.approx([5.0] * 199)
    assert samples[-1].left_position - samples[0].left_position == pytest.approx(19.9)
    motion.restart()
    assert motion.sample(9 * S, NAMES, [1.0] * 5, velocities).left_position == 1.0


def test_velocities_alone_leave_positions_unknown():
    sample = JointMotion(parameters()).sample(S, NAMES, [], [1.0] * 5)
    assert math.isnan(sample.left_position)
    assert math.isnan(sample.right_position)
    assert (sample.left_velocity, sample.right_velocity) == (1.0, 1.0)


def test_field_filled_with_nan_is_ignored():
    of_speed = JointMotion(parameters(uses="velocities")).sample(S, NAMES, [math.nan] * 5, [1.0] * 5)
    of_place = JointMotion(parameters(uses="positions")).sample(S, NAMES, [1.0] * 5, [math.nan] * 5)
    assert of_speed.left_velocity == of_place.left_position == 1.0


@pytest.mark.parametrize(
    ("names", "positions", "velocities", "reason"),
    [
        (NAMES[:3], [0.0] * 3, [0.0] * 3, Rejection.MISSING_JOINT),
        (NAMES, [0.0] * 4, [0.0] * 5, Rejection.LENGTH_MISMATCH),
        (NAMES, [], [], Rejection.NO_VALUES),
        (NAMES, [math.nan] * 5, [0.0] * 5, Rejection.NOT_A_NUMBER),
        (NAMES, [0.0] * 5, [math.inf] * 5, Rejection.NOT_A_NUMBER),
    ],
)
def test_message_is_refused(names, positions, velocities, reason):
    assert JointMotion(parameters()).sample(S, names, positions, velocities) is reason


@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(0.3, 3.0), st.floats(0.05, 0.6))
def test_speeds_are_those_of_the_tracks(v, rate, separation, radius):
    p = parameters(wheel_separation=separation, **{"vehicle.kinematics.rolling_radius": radius})
    sample = sample_of_speeds(S, v, rate, p)
    assert radius * (sample.left_velocity + sample.right_velocity) / 2.0 == pytest.approx(v)
    turning = radius * (sample.right_velocity - sample.left_velocity) / separation
    assert turning == pytest.approx(rate, abs=1e-9)
    assert math.isnan(sample.left_position)
    for impossible in (math.nan, 1.7e308):
        assert sample_of_speeds(S, impossible, rate, p) is Rejection.NOT_A_NUMBER


@pytest.mark.parametrize("names", [[], [""], ["front_right_wheel"], ["a", "a"]])
def test_impossible_joint_settings_are_refused(names):
    with pytest.raises(InputError, match="one or more on each side, each once"):
        parameters(left_joints=names)


@example([1e308] * 5, [1e308] * 5, NAMES)
@example([1e308] * 5, [], NAMES)
@given(st.lists(st.floats(), max_size=5), st.lists(st.floats(), max_size=5), st.lists(st.sampled_from(NAMES)))
def test_any_message_gives_finite_speeds_or_a_rejection(positions, velocities, names):
    sample = JointMotion(parameters()).sample(S, names, positions, velocities)
    if not isinstance(sample, Rejection):
        assert all(map(math.isfinite, (sample.left_velocity, sample.right_velocity)))
