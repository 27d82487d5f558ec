# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Slip distance of straights: (3.3) on fresh soil, none on sheared soil; and K from slip distances alone."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fixtures.soil_samples import Sample, Strength
from scipy.optimize import brentq

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.records import PoseWithCovariance
from trackslip_estimation.soil.shear_field import Contact, Rolling
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_estimation.soil.straight import Hypotheses, StraightSegment
from trackslip_estimation.terramechanics.elements import element_positions
from trackslip_estimation.terramechanics.traction import thrust

P = load_soil_parameters()
VEHICLE, LENGTH = P.vehicle.whole(), P.vehicle.whole().contact_length
CERTAIN = replace(P.strength, slip_bias_stddev=0.0, thrust_scale_stddev=0.0, change_distance=1e6)
MODULI, LIMITS = np.geomspace(0.002, 0.06, 24), np.geomspace(2000.0, 8000.0, 16)
CONTACT = Contact(element_positions(LENGTH, 16), 0.5 * VEHICLE.tread)
SOILS = Hypotheses(CONTACT, MODULI, LIMITS)
FRESH = np.zeros((2, 16, 2))
SPEED, STEP = 0.35, 0.2
MODULUS, LIMIT, FORCE = 0.01, 3640.0, 1290.0


def pose_at(distance: float, stddev: float = 0.0) -> PoseWithCovariance:
    """A pose ``distance`` m along a line in the direction of the heading; ``stddev`` of its position, m."""
    pose = np.array((5.0 + distance, -3.0, 0.0))
    return PoseWithCovariance(pose, np.diag((stddev**2, stddev**2, 0.0)))


def slip_of(modulus: float, limit: float) -> float:
    """Slip of (3.3) at ``FORCE``."""
    return float(brentq(lambda slip: thrust(slip, limit, modulus, LENGTH) - FORCE, 1e-6, 0.99))


def slip_over(straight: StraightSegment, distance: float, sign: float = 1.0) -> FloatArray:
    """Drive ``distance`` m; its slip distance on each soil."""
    before = straight.slip_distance().expected if straight.track_distance else 0.0
    twist = np.array((sign * SPEED, 0.0, 0.0))  # v_x of the twist is not used
    for _ in range(round(distance / (SPEED * STEP))):
        straight.add(STEP, Rolling(twist, np.full(2, sign * SPEED)), sign * 2.0 * FORCE)
    return straight.slip_distance().expected - before


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_slip_of_a_straight_on_fresh_soil_is_that_of_equation_3_3(sign: float) -> None:
    straight = StraightSegment(SOILS, FRESH, pose_at(0.0))
    slip_over(straight, 2.0 * LENGTH, sign)
    slips = slip_over(straight, 7.0, sign) / 7.0
    for a in range(0, len(MODULI), 5):
        for b in range(3, len(LIMITS), 4):
            assert slips[a, b] == pytest.approx(slip_of(MODULI[a], LIMITS[b]), rel=0.06)


def test_soil_sheared_in_a_turn_gives_thrust_without_slip() -> None:
    sheared = FRESH.copy()
    sheared[:, :, 0] = -0.3  # as left by tracks that slip while driving forward
    straight = StraightSegment(SOILS, sheared, pose_at(0.0))
    enough = LIMITS > 3.0 * FORCE
    assert np.abs(slip_over(straight, 0.5 * LENGTH)[:, enough]).max() < 1e-3
    slip_over(straight, 3.0 * LENGTH)
    a, b = 8, -4
    assert slip_over(straight, 3.5)[a, b] / 3.5 == pytest.approx(slip_of(MODULI[a], LIMITS[b]), rel=0.06)


def test_tracks_spin_where_the_thrust_exceeds_the_soil_limit() -> None:
    straight = StraightSegment(SOILS, FRESH, pose_at(0.0))
    expected = slip_over(straight, 3.5)
    weak, strong = np.searchsorted(LIMITS, (1.02 * FORCE, 4.0 * FORCE))
    assert LIMITS[weak] > FORCE
    strongly = Hypotheses(CONTACT, MODULI, 0.5 * LIMITS)
    spinning = slip_over(StraightSegment(strongly, FRESH, pose_at(0.0)), 3.5)
    assert spinning[8, 0] == pytest.approx(0.4 * 3.5, rel=0.02)
    assert expected[8, strong] < 0.02 * 3.5


def test_uneven_load_changes_the_slip_distance_by_the_stated_amount() -> None:
    """The load of a cab with unknown swing angle."""
    lean = 0.2  # 1/m
    slip_distances = []
    for sign in (0.0, 1.0):
        straight = StraightSegment(SOILS, FRESH, pose_at(0.0))
        for _ in range(200):
            rolling = Rolling(np.array((SPEED, 0.0, 0.0)), np.full(2, SPEED), sign * lean)
            straight.add(STEP, rolling, 2.0 * FORCE, lean)
        straight.set_end(pose_at(0.99 * straight.track_distance))
        slip_distances.append(straight.slip_distance())
    a, b = 10, -1
    change = slip_distances[1].expected[a, b] / slip_distances[0].expected[a, b] - 1.0
    assert slip_distances[0].of_lean / slip_distances[0].measured == pytest.approx(change, rel=0.1)


@pytest.mark.parametrize("yaw", [0.0, 2.5, np.pi - 0.05])
def test_distance_follows_the_arc_at_any_heading(yaw: float) -> None:
    """In a gentle bend, also where the angle wraps."""
    radius, bend = 20.0, np.linspace(0.0, 0.2, 21)
    straight = StraightSegment(SOILS, FRESH, _on_arc(radius, yaw, 0.0))
    for angle in bend[1:]:
        straight.set_end(_on_arc(radius, yaw, angle))
    slip_distance = straight.slip_distance()
    assert -slip_distance.measured == pytest.approx(radius * bend[-1], rel=1e-5)
    assert slip_distance.variance == pytest.approx(2.0 * 0.01**2)


def _on_arc(radius: float, yaw: float, angle: float) -> PoseWithCovariance:
    heading = yaw + angle
    pose = np.array((radius * np.sin(heading), -radius * np.cos(heading), np.angle(np.exp(1j * heading))))
    along, across = 0.01**2, 0.5**2
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array(((c, -s), (s, c)))
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = turn @ np.diag((along, across)) @ turn.T
    return PoseWithCovariance(pose, covariance)


def sample(
    slip: float,
    force: float | None,
    motion: Motion,
    here: PoseWithCovariance,
    dt: float = STEP,
    sign: float = 1.0,
) -> Sample:
    tracks, twist = np.full(2, sign * SPEED), np.array((sign * SPEED * (1.0 - slip), 0.0, 0.0))
    if motion is Motion.STANDING:
        tracks, twist = np.zeros(2), np.zeros(3)
    covariance = np.diag(np.square((0.002, 1e-4, 1e-4)))
    thrusts = None if force is None else np.full(2, sign * force)
    return Sample(dt, tracks, twist, covariance, thrusts, np.full(2, 25.0), motion, here)


def new_strength(**changes: float) -> Strength:
    """A strength with F_max known from spinning tracks."""
    strength = Strength(replace(CERTAIN, modulus_cells=48, limit_cells=96, **changes), VEHICLE)
    for _ in range(100):
        strength.update(sample(0.5, LIMIT * 0.984, Motion.TURNING, pose_at(0.0)))
    return strength


def go_straight(
    strength: Strength, errors: tuple[float, float] = (0.0, 0.0), stddev: float = 0.002, sign: float = 1.0
) -> None:
    """Drive on soil of MODULUS and LIMIT until the tracks stand on sheared soil, then 3.5 m, and stop.

    ``errors``: of the positions at both ends, m.
    """
    slip = slip_of(MODULUS, LIMIT)
    there = pose_at(errors[0], stddev=stddev)
    for _ in range(4):
        strength.update(sample(slip, None, Motion.STRAIGHT, there, 1.0, sign))
    for k in range(1, 51):
        distance = sign * k * STEP * SPEED * (1.0 - slip)
        strength.update(
            sample(slip, FORCE, Motion.STRAIGHT, pose_at(distance + errors[1], stddev=stddev), sign=sign)
        )
    strength.update(sample(0.0, 0.0, Motion.STANDING, pose_at(distance + errors[1], stddev=stddev)))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_slip_distance_gives_the_shear_modulus(sign: float) -> None:
    strength = new_strength(distance_stddev=0.0005)
    for _ in range(6):
        go_straight(strength, stddev=0.0005, sign=sign)
    strength.update(sample(0.5, LIMIT * 0.984, Motion.TURNING, pose_at(0.0)))  # ends the last straight
    summary = strength.posterior.summary()
    assert summary.identifiable, summary.reason
    assert summary.shear_modulus == pytest.approx(MODULUS, rel=0.06)
    assert summary.thrust_limit == pytest.approx(LIMIT, rel=0.02)


@pytest.mark.slow
def test_intervals_from_slip_distances_have_their_stated_coverage() -> None:
    random = np.random.default_rng(7)
    runs, stddev, covered = 60, 0.006, 0
    for _ in range(runs):
        strength = new_strength(distance_stddev=0.0)
        for _ in range(3):
            go_straight(strength, tuple(stddev * random.standard_normal(2)), stddev)
        strength.update(sample(0.5, LIMIT * 0.984, Motion.TURNING, pose_at(0.0)))
        low, high = strength.posterior.summary().shear_modulus_interval
        covered += low <= MODULUS <= high
    assert 0.8 * runs <= covered <= 0.99 * runs


def test_straight_is_used_once_it_has_ended() -> None:
    strength = new_strength()
    before = strength.posterior.effective_samples
    go_straight(strength)
    assert strength.posterior.effective_samples == pytest.approx(before, abs=1e-3)
    strength.update(sample(0.0072, FORCE, Motion.STRAIGHT, pose_at(0.0)))
    assert strength.posterior.effective_samples == pytest.approx(before + 1.0, abs=0.01)


def test_straight_ends_at_the_pose_of_the_stop() -> None:
    """The pose at the end of the stop is more precise than the one before."""
    strengths = [new_strength(distance_stddev=0.0005) for _ in range(2)]
    distance = 50 * STEP * SPEED * (1.0 - slip_of(MODULUS, LIMIT))
    for strength, off in zip(strengths, (0.0, 0.05), strict=True):
        go_straight(strength, (0.0, off), 0.0005)
        strength.update(sample(0.0, 0.0, Motion.STANDING, pose_at(distance, stddev=0.0005)))
        strength.update(sample(0.5, LIMIT * 0.984, Motion.TURNING, pose_at(distance)))
    plain, late = (strength.posterior.summary().shear_modulus for strength in strengths)
    assert late == pytest.approx(plain, rel=1e-6)


@pytest.mark.parametrize("spoil", ["thrust", "twist"])
def test_straight_with_a_gap_does_not_use_the_gap(spoil: str) -> None:
    """Without thrusts the distance so far is used; an unusable sample ends the straight without use.

    0.8 m of driving discard some information.
    """
    strength = new_strength()
    before = strength.posterior.effective_samples
    distance = STEP * SPEED * (1.0 - 0.0072)
    for k in range(10):
        strength.update(sample(0.0072, FORCE, Motion.STRAIGHT, pose_at(k * distance)))
    broken = sample(0.0072, FORCE, Motion.STRAIGHT, pose_at(10 * distance))
    none = np.full(2, np.nan)
    broken = replace(broken, thrusts=none) if spoil == "thrust" else replace(broken, tracks=none)
    strength.update(broken)
    expected = before + (1.0 if spoil == "thrust" else 0.0)
    assert strength.posterior.effective_samples == pytest.approx(expected, abs=0.05)


def test_shear_modulus_is_not_observable_from_spinning_tracks() -> None:
    """At the limit of the soil the slip distance depends on F_max only."""
    strength = new_strength()
    before = strength.posterior.effective_samples
    for k in range(70):
        strength.update(sample(0.5, FORCE, Motion.STRAIGHT, pose_at(0.5 * k * STEP * SPEED)))
    assert strength.posterior.effective_samples == pytest.approx(before, abs=0.01)


def test_distance_along_a_slope_is_longer_than_its_horizontal_part() -> None:
    straight = StraightSegment(SOILS, FRESH, pose_at(0.0))
    slip_over(straight, 4.0)
    straight.set_end(pose_at(4.0 * math.cos(0.25)), 1.0 / math.cos(0.25), 0.001)
    slip_distance = straight.slip_distance()
    assert slip_distance.measured == pytest.approx(straight.track_distance - 4.0, abs=1e-9)
    assert slip_distance.variance == pytest.approx((0.001 * 4.0) ** 2)
