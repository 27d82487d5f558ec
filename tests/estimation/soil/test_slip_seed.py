# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Slip seeds from thrust and soil after a turn."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fixtures.soil_samples import Sample
from numpy.typing import ArrayLike

from trackslip_bags.messages import make
from trackslip_common.record_types import dtype_of
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.soil import conversions as soil_conversions
from trackslip_estimation.soil.records import SlipSeed
from trackslip_estimation.soil.slip_seed import (
    Seeder,
    SeedStrength,
    is_seed_due,
    make_seed,
    set_strength,
    straight_slips,
)
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import load_soil_parameters, make_config
from trackslip_estimation.soil.strength_summary import StrengthSummary
from trackslip_estimation.soil.thrust import THRUST
from trackslip_estimation.terramechanics.traction import thrust
from trackslip_sim.machine.hydraulics import InputErrors, soil_inputs
from trackslip_sim.scenarios.scenario import Scenario, Segment
from trackslip_sim.truth.simulate import simulate

P = load_soil_parameters()
LENGTH = P.vehicle.kinematics.contact_length
SOIL = StrengthSummary(0.02, (0.015, 0.0267), 3500.0, (3400.0, 3603.0), 30.0, True, "")
TRACKS = np.full(2, 0.3)


def thrust_of(force: ArrayLike) -> Any:
    measured = np.zeros(1, THRUST)[0]
    measured["is_known"], measured["force"], measured["variance"] = True, force, 100.0
    return measured


def thrust_at(slips: tuple[float, float]) -> Any:
    return thrust_of(thrust(slips, SOIL.thrust_limit, SOIL.shear_modulus, LENGTH))


def strength_of(soil: StrengthSummary) -> SeedStrength:
    seeder: Seeder = np.zeros(1, dtype_of(Seeder))[0]
    set_strength(seeder, soil)
    return seeder["newest"]


@pytest.mark.slow
def test_seed_is_the_slip_of_its_thrust_with_the_variance_of_soil_and_thrust() -> None:
    rng, count = np.random.default_rng(2), 4000
    measured = thrust_at((0.02, 0.03))
    estimate = straight_slips(measured, np.ones(2), strength_of(SOIL), P.seed, LENGTH)
    np.testing.assert_allclose(estimate[0], (0.02, 0.03), rtol=1e-9)
    samples = []
    stddev = np.sqrt(measured["variance"] + P.seed.thrust_stddev**2)
    for z in rng.standard_normal((count, 5)):
        modulus = SOIL.shear_modulus * (0.0267 / 0.015) ** (z[0] / 3.29)
        limit = SOIL.thrust_limit * (3603.0 / 3400.0) ** (z[1] / 3.29)
        soil = strength_of(replace(SOIL, shear_modulus=modulus, thrust_limit=limit))
        noisy = thrust_of(measured["force"] + stddev * z[2:4])
        one = straight_slips(noisy, np.ones(2), soil, P.seed, LENGTH)
        samples.append(one[0] * (1.0 + P.seed.share_stddev * z[4]))
    np.testing.assert_allclose(estimate[1], np.cov(np.array(samples).T), rtol=0.2)


def test_seed_has_the_sign_of_slip_in_reverse_and_when_braking() -> None:
    measured = thrust_at((0.02, -0.01))
    forward = straight_slips(measured, np.ones(2), strength_of(SOIL), P.seed, LENGTH)
    backward = thrust_of(-measured["force"])
    reverse = straight_slips(backward, -np.ones(2), strength_of(SOIL), P.seed, LENGTH)
    np.testing.assert_allclose(forward[0], (0.02, -0.01), rtol=1e-9)
    np.testing.assert_array_equal(forward[0], reverse[0])


def test_thrust_beyond_the_soil_limit_gives_no_seed() -> None:
    ride = Ride()
    ride.thrust = thrust_of((3450.0, 1000.0))
    ride.seeds(Motion.TURNING, 1.0)
    assert ride.seeds(Motion.STRAIGHT, 10.0) == []


class Ride:
    """Samples of 0.1 s for a seeder."""

    def __init__(self) -> None:
        self._seeder, self._numbers, self._now_ns = np.zeros(1, dtype_of(Seeder))[0], make_config(P)[0], 0
        self.thrust = thrust_at((0.02, 0.02))
        self.soil: StrengthSummary | None = SOIL

    def seeds(self, motion: Motion, lengths: float) -> list[SlipSeed]:
        """Seeds while the machine drives ``lengths`` contact lengths in one motion state."""
        seeds = []
        for _ in range(math.ceil(lengths * LENGTH / (TRACKS[0] * 0.1))):
            self._now_ns += 100_000_000
            sample, _ = Sample(0.1, TRACKS, motion=motion).records()
            sample["stamp_ns"] = self._now_ns
            if self.soil is not None:
                set_strength(self._seeder, self.soil)
            if is_seed_due(self._seeder, sample[0], self.thrust, self._numbers):
                seeds.append(make_seed(self._seeder, sample[0], self.thrust, P.seed, LENGTH))
        return seeds


def test_each_turn_gives_one_seed_after_the_settling_distance() -> None:
    ride, enough = Ride(), P.seed.settling_lengths + 0.1
    assert ride.seeds(Motion.STRAIGHT, 20.0) == []  # no turn yet
    ride.seeds(Motion.TURNING, 1.0)
    assert ride.seeds(Motion.STRAIGHT, enough - 0.5) == []
    assert ride.seeds(Motion.TURNING, 1.0) == []  # the distance restarts
    assert ride.seeds(Motion.STRAIGHT, enough - 0.5) == []
    assert len(ride.seeds(Motion.STRAIGHT, 20.0)) == 1
    ride.seeds(Motion.STANDING, 1.0)
    assert ride.seeds(Motion.STRAIGHT, 20.0) == []


def test_unknown_thrust_gives_no_seed() -> None:
    ride = Ride()
    ride.seeds(Motion.TURNING, 1.0)
    ride.thrust["is_known"] = False
    assert ride.seeds(Motion.STRAIGHT, 10.0) == []
    ride.thrust["is_known"] = True
    assert len(ride.seeds(Motion.STRAIGHT, 10.0)) == 1


@pytest.mark.parametrize("soil", [None, replace(SOIL, identifiable=False, reason="no")])
def test_seed_uses_the_soil_at_the_end_of_the_turn(soil: StrengthSummary | None) -> None:
    ride = Ride()
    ride.soil = soil
    ride.seeds(Motion.TURNING, 1.0)
    ride.soil = SOIL
    assert ride.seeds(Motion.STRAIGHT, 10.0) == []
    ride.seeds(Motion.TURNING, 1.0)
    ride.soil = soil  # the seed does not use slips of this straight
    assert len(ride.seeds(Motion.STRAIGHT, 10.0)) == 1


LEGS = (
    *((3.0, 0.0, 0.0), (15.0, 2.0, 2.0), (6.0, 1.2, 2.2)),
    *((17.0, 2.0, 2.0), (6.0, 2.2, 1.2), (17.0, 2.0, 2.0)),
)


def test_soil_estimator_publishes_one_seed_after_each_turn() -> None:
    truth = simulate(Scenario(name="test", soil="sandy_loam", segments=tuple(Segment(*leg) for leg in LEGS)))
    sensing = InputErrors(speed_stddev=0.0003, yaw_rate_stddev=0.0003)
    inputs = soil_inputs(truth, P.vehicle.whole(), load_slip_parameters().motion, sensing)
    estimator = SoilEstimator(P)
    outputs = [output for soil_input in inputs for output in estimator.advance(soil_input)]
    seeds = [output for output in outputs if isinstance(output, SlipSeed)]
    assert estimator.strength.identifiable
    after = [(seed.stamp_ns - seeds[0].stamp_ns) * 1e-9 for seed in seeds]
    assert after == pytest.approx([0.0, 23.0], abs=1.0)
    for seed in seeds:
        sigma = math.sqrt(np.ones(2) @ seed.covariance @ np.ones(2)) / 2.0
        assert abs(seed.slips.mean() - 0.016) < 2.0 * sigma < 0.016


def test_seed_is_unchanged_by_its_message() -> None:
    covariance = np.array(((4e-6, 1e-6), (1e-6, 3e-6)))
    seed = SlipSeed(1_234_567_890, np.array((0.01, 0.02)), covariance)
    message = soil_conversions.message_of(make, seed, "base_link")
    assert soil_conversions.topic_of(seed) == "slip_seed"
    assert (message.header.frame_id, message.motion_state) == ("base_link", int(Motion.STRAIGHT))
    fix = conversions.slip_fix(message, "slip_seed")
    assert (fix.source, fix.stamp_ns) == ("slip_seed", seed.stamp_ns)
    np.testing.assert_array_equal(fix.slips, seed.slips)
    np.testing.assert_array_equal(fix.covariance, covariance)
