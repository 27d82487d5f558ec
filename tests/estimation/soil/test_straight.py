# SPDX-License-Identifier: Apache-2.0
"""What a straight costs: (3.3) once the soil is fresh, nothing on sheared soil; and K from the way alone."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.records import Place
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_estimation.soil.straight import Hypotheses, Straight
from trackslip_estimation.soil.strength_posterior import StrengthPosterior, StrengthSample, Use
from trackslip_estimation.terramechanics.traction import thrust

FloatArray = NDArray[np.float64]

P = load_soil_parameters()
VEHICLE, LENGTH = P.vehicle, P.vehicle.contact_length
SURE = replace(P.strength, slip_bias_stddev=0.0, thrust_scale_stddev=0.0, change_distance=1e6)
MODULI, LIMITS = np.geomspace(0.002, 0.06, 24), np.geomspace(2000.0, 8000.0, 16)
SOILS = Hypotheses(VEHICLE, 16, MODULI, LIMITS)
FRESH = np.zeros((2, 16, 2))
SPEED, STEP = 0.35, 0.2
MODULUS, LIMIT, FORCE = 0.01, 3640.0, 1290.0


def place(way: float, yaw: float = 0.0, stddev: float = 0.0) -> Place:
    """So far along a line in the direction of the heading; ``stddev`` is that of the position."""
    pose = np.array((5.0 + way * np.cos(yaw), -3.0 + way * np.sin(yaw), yaw))
    return Place(pose, np.diag((stddev**2, stddev**2, 0.0)))


def slip_of(modulus: float, limit: float, force: float = FORCE) -> float:
    """That (3.3) asks for."""
    return float(brentq(lambda slip: thrust(slip, limit, modulus, LENGTH) - force, 1e-6, 0.99))


def rolled(straight: Straight, way: float, sign: float = 1.0) -> FloatArray:
    """What ``way`` costs on each soil."""
    before = straight.lost().expected if straight.rolled else 0.0
    twist = np.array((sign * SPEED, 0.0, 0.0))  # its v_x does not count
    for _ in range(round(way / (SPEED * STEP))):
        straight.roll(STEP, np.full(2, sign * SPEED), twist, sign * 2.0 * FORCE, place(0.0))
    return straight.lost().expected - before


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_on_fresh_soil_a_straight_costs_what_3_3_says(sign: float) -> None:
    straight = Straight(SOILS, FRESH, place(0.0))
    rolled(straight, 2.0 * LENGTH, sign)
    slips = rolled(straight, 7.0, sign) / 7.0
    for a in range(0, len(MODULI), 5):
        for b in range(3, len(LIMITS), 4):
            assert slips[a, b] == pytest.approx(slip_of(MODULI[a], LIMITS[b]), rel=0.06)


def test_soil_that_a_turn_has_sheared_pulls_without_slip() -> None:
    sheared = FRESH.copy()
    sheared[:, :, 0] = -0.3  # as tracks leave it that slip while they drive forward
    straight = Straight(SOILS, sheared, place(0.0))
    enough = LIMITS > 3.0 * FORCE
    assert np.abs(rolled(straight, 0.5 * LENGTH)[:, enough]).max() < 1e-3
    rolled(straight, 3.0 * LENGTH)
    a, b = 8, -4
    assert rolled(straight, 3.5)[a, b] / 3.5 == pytest.approx(slip_of(MODULI[a], LIMITS[b]), rel=0.06)


def test_a_soil_that_cannot_give_the_thrust_lets_the_tracks_spin() -> None:
    straight = Straight(SOILS, FRESH, place(0.0))
    expected = rolled(straight, 3.5)
    weak, strong = np.searchsorted(LIMITS, (1.02 * FORCE, 4.0 * FORCE))
    assert LIMITS[weak] > FORCE
    strongly = Hypotheses(VEHICLE, 16, MODULI, 0.5 * LIMITS)
    spinning = rolled(Straight(strongly, FRESH, place(0.0)), 3.5)
    assert spinning[8, 0] == pytest.approx(0.4 * 3.5, rel=0.02)
    assert expected[8, strong] < 0.02 * 3.5


@pytest.mark.parametrize("yaw", [0.0, 2.5, np.pi - 0.05])
def test_the_way_follows_the_heading(yaw: float) -> None:
    """Around a gentle bend: as long as the arc; and no matter where the angle wraps."""
    radius, bend = 20.0, np.linspace(0.0, 0.2, 21)
    straight = Straight(SOILS, FRESH, _on_arc(radius, yaw, 0.0))
    for angle in bend[1:]:
        straight.arrive(_on_arc(radius, yaw, angle))
    lost = straight.lost()
    assert -lost.measured == pytest.approx(radius * bend[-1], rel=1e-5)
    assert lost.variance == pytest.approx(2.0 * 0.01**2)


def _on_arc(radius: float, yaw: float, angle: float) -> Place:
    heading = yaw + angle
    pose = np.array((radius * np.sin(heading), -radius * np.cos(heading), np.angle(np.exp(1j * heading))))
    along, across = 0.01**2, 0.5**2
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array(((c, -s), (s, c)))
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = turn @ np.diag((along, across)) @ turn.T
    return Place(pose, covariance)


def sample(
    slip: float, force: float, motion: Motion, here: Place, dt: float = STEP, sign: float = 1.0
) -> StrengthSample:
    tracks, twist = np.full(2, sign * SPEED), np.array((sign * SPEED * (1.0 - slip), 0.0, 0.0))
    if motion is Motion.STANDING:
        tracks, twist = np.zeros(2), np.zeros(3)
    covariance = np.diag(np.square((0.002, 1e-4, 1e-4)))
    return StrengthSample(
        dt, tracks, twist, covariance, np.full(2, sign * force), np.full(2, 25.0), motion, here
    )


def new_posterior(**changes: float) -> StrengthPosterior:
    """That knows F_max already, from spinning tracks."""
    posterior = StrengthPosterior(replace(SURE, modulus_cells=48, limit_cells=96, **changes), VEHICLE)
    for _ in range(100):
        posterior.update(sample(0.5, LIMIT * 0.984, Motion.TURNING, place(0.0)))
    return posterior


def go_straight(
    posterior: StrengthPosterior,
    errors: tuple[float, float] = (0.0, 0.0),
    stddev: float = 0.002,
    sign: float = 1.0,
) -> None:
    """A while on soil of MODULUS and LIMIT, until the tracks stand on what they have sheared, then 3.5 m, and
    a stop; ``errors`` of the positions at both ends, m.
    """
    slip = slip_of(MODULUS, LIMIT)
    there = place(errors[0], stddev=stddev)
    for _ in range(4):
        posterior.update(sample(slip, np.nan, Motion.STRAIGHT, there, 1.0, sign))
    for k in range(1, 51):
        way = sign * k * STEP * SPEED * (1.0 - slip)
        posterior.update(
            sample(slip, FORCE, Motion.STRAIGHT, place(way + errors[1], stddev=stddev), sign=sign)
        )
    posterior.update(sample(0.0, 0.0, Motion.STANDING, place(way + errors[1], stddev=stddev)))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_way_gives_the_modulus(sign: float) -> None:
    posterior = new_posterior(way_stddev=0.0005)
    for _ in range(6):
        go_straight(posterior, stddev=0.0005, sign=sign)
    posterior.update(sample(0.5, LIMIT * 0.984, Motion.TURNING, place(0.0)))  # ends the last one
    found = posterior.summary()
    assert found.identifiable, found.reason
    assert found.shear_modulus == pytest.approx(MODULUS, rel=0.06)
    assert found.thrust_limit == pytest.approx(LIMIT, rel=0.02)


def test_intervals_from_ways_cover_as_often_as_they_say() -> None:
    random = np.random.default_rng(7)
    runs, stddev, covered = 60, 0.006, 0
    for _ in range(runs):
        posterior = new_posterior(way_stddev=0.0)
        for _ in range(3):
            go_straight(posterior, tuple(stddev * random.standard_normal(2)), stddev)
        posterior.update(sample(0.5, LIMIT * 0.984, Motion.TURNING, place(0.0)))
        low, high = posterior.summary().shear_modulus_interval
        covered += low <= MODULUS <= high
    assert 0.8 * runs <= covered <= 0.99 * runs


def test_a_straight_counts_once_it_is_over() -> None:
    posterior = new_posterior()
    before = posterior.effective_samples
    go_straight(posterior)
    assert posterior.effective_samples == pytest.approx(before, abs=1e-3)
    assert posterior.update(sample(0.0072, FORCE, Motion.STRAIGHT, place(0.0))) is Use.USED
    assert posterior.effective_samples == pytest.approx(before + 1.0, abs=0.01)


def test_a_machine_that_stands_is_seen_better() -> None:
    """The straight ends where it is known to be by the end of the stop, not where it was thought to be."""
    posteriors = [new_posterior(way_stddev=0.0005) for _ in range(2)]
    way = 50 * STEP * SPEED * (1.0 - slip_of(MODULUS, LIMIT))
    for posterior, off in zip(posteriors, (0.0, 0.05), strict=True):
        go_straight(posterior, (0.0, off), 0.0005)
        posterior.update(sample(0.0, 0.0, Motion.STANDING, place(way, stddev=0.0005)))
        posterior.update(sample(0.5, LIMIT * 0.984, Motion.TURNING, place(way)))
    plain, late = (posterior.summary().shear_modulus for posterior in posteriors)
    assert late == pytest.approx(plain, rel=1e-6)


@pytest.mark.parametrize("spoil", ["thrust", "twist"])
def test_a_straight_with_a_hole_tells_nothing_of_what_was_not_seen(spoil: str) -> None:
    """Without the thrusts the way so far counts; a sample that is none ends it without a word."""
    posterior = new_posterior()
    before = posterior.effective_samples
    for _ in range(10):
        posterior.update(sample(0.0072, FORCE, Motion.STRAIGHT, place(0.0)))
    broken = sample(0.0072, FORCE, Motion.STRAIGHT, place(0.0))
    none = np.full(2, np.nan)
    broken = replace(broken, thrusts=none) if spoil == "thrust" else replace(broken, tracks=none)
    assert posterior.update(broken) is (Use.USED if spoil == "thrust" else Use.INVALID)
    expected = before + (1.0 if spoil == "thrust" else 0.0)
    assert posterior.effective_samples == pytest.approx(expected, abs=0.01)
