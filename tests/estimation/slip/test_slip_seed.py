# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Slips as a measurement, and the seed that thrust and soil give after a turn."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from fixtures.filter_steps import (
    Gaussian,
    config_of,
    filter_step,
    outputs_of,
    slips_measured,
    start_of,
    state_of,
)
from fixtures.soil_samples import Sample
from numpy.typing import NDArray

from trackslip_bags.messages import make
from trackslip_common.errors import InputError
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.log import make_log, run_log
from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, SlipFix
from trackslip_estimation.slip.models.model import SIZE
from trackslip_estimation.slip.models.speed import COMMON_SLIP, FIRST, SECOND
from trackslip_estimation.slip.motion import Motion, MotionState, Speeds
from trackslip_estimation.slip.observation import add_rounding, expected, jacobian
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import SLIPS, to_records
from trackslip_estimation.soil import conversions as soil_conversions
from trackslip_estimation.soil.parameter_record import record_of
from trackslip_estimation.soil.records import SlipSeed, SoilInput
from trackslip_estimation.soil.slip_seed import SEEDER, Thrust, is_seed_due, seed_of, set_strength, slips_of
from trackslip_estimation.soil.soil_estimator import SoilEstimator
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_estimation.soil.strength_summary import StrengthSummary
from trackslip_estimation.terramechanics.traction import thrust
from trackslip_sim.machine.hydraulics import Sensing, soil_inputs
from trackslip_sim.scenarios.scenario import Scenario, Segment
from trackslip_sim.truth.simulate import simulate

FloatArray = NDArray[np.float64]

MODELS = ("free_slips", "turning", "icr")
EDGE = 1e-6  # of the central differences
LIMIT = 18.5  # of the gate with two degrees of freedom, while it is no wider than χ² has it
SOURCE = {"slip_sources": ["slip_seed"]}
P = load_soil_parameters()
LENGTH = P.vehicle.kinematics.contact_length
SOIL = StrengthSummary(0.02, (0.015, 0.0267), 3500.0, (3400.0, 3603.0), 30.0, True, "")
TRACKS = np.full(2, 0.3)


def seed_at(stamp_ns: int, slip: float, deviation: float = 0.003, source: str = "slip_seed") -> SlipFix:
    """Both tracks slip alike, and mostly wrong alike."""
    return SlipFix(source, stamp_ns, np.full(2, slip), deviation**2 * (np.ones((2, 2)) + 0.01 * np.eye(2)))


# Slips as a measurement


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("left", "right"), [(2.0, 2.1), (-1.5, -1.4), (0.0, 1.0), (1.0, 2.2)])
def test_what_is_expected_are_the_slips_and_its_derivative_is_theirs(
    model: str, left: float, right: float
) -> None:
    config, speeds = config_of(model=model), (left, right)
    x, c = start_of(config, np.zeros(3), np.eye(3)).mean, config[0]
    x[4 : c["active"]] += np.linspace(0.01, 0.05, c["active"] - 4)
    known = Gaussian(x, np.zeros((SIZE, SIZE)))
    slips = outputs_of(config, known, Speeds(left, right, 0.0, differenced=False))["slips"][:2]
    np.testing.assert_array_equal(expected(SLIPS, x, 2, speeds, c), slips)
    steps = EDGE * np.eye(x.size)
    ends = [[expected(SLIPS, x + sign * d, 2, speeds, c) for sign in (1.0, -1.0)] for d in steps]
    differences = np.array([(plus - minus) / (2.0 * EDGE) for plus, minus in ends]).T
    np.testing.assert_allclose(jacobian(SLIPS, x, 2, speeds, c), differences, atol=1e-7)


def test_slips_know_of_the_rounding_of_the_counts() -> None:
    config, x = config_of(), np.zeros(SIZE)
    x[FIRST], x[SECOND], x[COMMON_SLIP] = 0.5, 0.4, 0.02
    known, changing = Gaussian(x, np.zeros((SIZE, SIZE))), MotionState(Motion.STRAIGHT, departure=1.0)
    for differenced in (True, False):
        R, speeds = 1e-12 * np.eye(2), Speeds(2.0, 2.0, 0.01, differenced)
        add_rounding(SLIPS, x, R, state_of(known, speeds, changing)[0], config[0])
        found = outputs_of(config, known, speeds, changing)["slip_covariance"][:2, :2]
        np.testing.assert_allclose(R, 1e-12 * np.eye(2) + found, rtol=1e-9)
        assert (np.diag(R) > 1e-9).all() == differenced


@pytest.mark.parametrize("filter_", ["ekf", "daf"])
@pytest.mark.parametrize("model", MODELS)
def test_both_slips_move_together_where_the_gyro_holds_their_difference(model: str, filter_: str) -> None:
    config = config_of(model=model, filter=filter_)
    state = start_of(config, np.zeros(3), 1e-4 * np.eye(3))
    measured = slips_measured(np.full(2, 0.03), 1e-6 * (np.ones((2, 2)) + 0.01 * np.eye(2)))
    straight = Speeds(2.0, 2.0, 0.0, differenced=False)
    step = filter_step(config, state, straight, 0.0, MotionState(Motion.STRAIGHT, changing=False), measured)
    before, after = (outputs_of(config, known, straight) for known in (step.predicted, step.updated))
    np.testing.assert_allclose(after["slips"][:2], 0.03, atol=1e-3)
    together = np.ones(2)
    wide, narrow = (together @ o["slip_covariance"][:2, :2] @ together / 4.0 for o in (before, after))
    assert wide > 100.0 * narrow
    np.testing.assert_array_equal(step.updated.mean[:3], 0.0)  # it says nothing of the pose


@pytest.mark.parametrize("model", MODELS)
def test_a_seed_mends_what_the_gyro_cannot_see(drive: Callable[..., Any], model: str) -> None:
    """No fixes after the start: equal slips of 4 % show in nothing but the seed, which comes 0.5 s late."""
    driven = drive([(12.0, 2.0, 2.0, 0.04, 0.04, 0.0)])
    given = [m for m in driven.measurements if not (isinstance(m, PoseFix) and m.stamp_ns > 0)]
    at = next(k for k, m in enumerate(given) if m.stamp_ns > 5_500_000_000)
    blind, mended = (SlipEstimator(load_slip_parameters(SOURCE | {"model": model})) for _ in range(2))
    for k, m in enumerate(given):
        if k == at:
            report = mended.process(seed_at(5_000_000_000, 0.04))[0]
            assert (report.outcome, report.dof, report.source) == (Outcome.ACCEPTED, 2, "slip_seed")
            assert report.nis < report.gate
        blind.process(m)
        mended.process(m)
    true = driven.truth[given[-1].stamp_ns]
    errors = [np.abs(e.estimate().outputs.slips[:2].mean() - 0.04) for e in (blind, mended)]
    assert errors[0] > 0.02
    assert errors[1] < 0.014  # some of it the model takes for a velocity error, as real tracks have
    ways = [abs(e.estimate().pose[0] - true[0]) for e in (blind, mended)]
    assert ways[1] < 0.6 * ways[0]


@pytest.mark.parametrize("model", MODELS)
def test_a_seed_far_off_is_gated_until_it_has_not_agreed_for_long(
    drive: Callable[..., Any], model: str
) -> None:
    given = drive([(8.0, 2.0, 2.0, 0.0, 0.0, 0.0)]).measurements
    for timeout, outcome in ((3600.0, Outcome.GATED), (0.5, Outcome.ACCEPTED)):
        p = load_slip_parameters(SOURCE | {"model": model, "sources.slip_seed.timeout": timeout})
        estimator = SlipEstimator(p)
        for m in given:
            estimator.process(m)
        before = estimator.estimate().outputs
        report = estimator.process(seed_at(given[-1].stamp_ns, 0.9, 0.001))[0]
        after = estimator.estimate().outputs
        assert report.outcome is outcome
        assert report.nis > LIMIT
        assert (report.gate > LIMIT) == (outcome is Outcome.ACCEPTED)
        if outcome is Outcome.GATED:
            np.testing.assert_array_equal(after.slips, before.slips)
        else:  # admitted, and its surprise widens what it measures
            assert after.slips[:2].mean() > 0.5


def test_nobody_listens_unless_asked(drive: Callable[..., Any]) -> None:
    p = load_slip_parameters()
    assert p.slip_sources == ("",)
    assert "slip_seed" not in p.timeouts_ns()
    assert list(load_slip_parameters(SOURCE).timeouts_ns()) == ["box_pose", "imu/data_raw", "slip_seed"]
    with pytest.raises(InputError, match=r"sources\.slip_seed\.timeout: \[1\.0\]"):
        load_slip_parameters(SOURCE | {"sources.slip_seed.timeout": [1.0]})


BAD: tuple[tuple[tuple[float, float], Any], ...] = (
    ((math.nan, 0.0), np.eye(2)),
    ((0.0, math.inf), np.eye(2)),
    ((0.0, 0.0), np.full((2, 2), math.nan)),
    ((0.0, 0.0), np.zeros((2, 2))),
    ((0.0, 0.0), -np.eye(2)),
    ((0.0, 0.0), np.array(((1.0, 2.0), (2.0, 1.0)))),
)


@pytest.mark.parametrize(("slips", "covariance"), BAD)
def test_nonsense_is_invalid(
    drive: Callable[..., Any], slips: tuple[float, float], covariance: FloatArray
) -> None:
    given = drive([(1.0, 2.0, 2.0, 0.0, 0.0, 0.0)]).measurements
    estimator = SlipEstimator(load_slip_parameters(SOURCE))
    assert estimator.process(seed_at(0, 0.0))[0].outcome is Outcome.WAITING
    for m in given:
        estimator.process(m)
    bad = SlipFix("slip_seed", given[-1].stamp_ns, np.array(slips), covariance)
    assert estimator.process(bad)[0].outcome is Outcome.INVALID


def with_seeds(measurements: list[Measurement]) -> list[Measurement]:
    """Two seeds, each half a second late."""
    seeds = {5_000_000_000: 0.03, 9_000_000_000: 0.9}
    given = list(measurements)
    for stamp_ns, slip in seeds.items():
        at = next(k for k, m in enumerate(given) if m.stamp_ns > stamp_ns + 500_000_000)
        given.insert(at, seed_at(stamp_ns, slip))
    return given


@pytest.mark.parametrize("model", MODELS)
def test_order_of_arrival_and_log_do_not_matter(drive: Callable[..., Any], model: str) -> None:
    given = with_seeds(drive([(10.0, 2.0, 2.0, 0.03, 0.03, 0.0)]).measurements)
    p = load_slip_parameters(SOURCE | {"model": model})
    late, in_order = SlipEstimator(p), SlipEstimator(p)
    late.process_all(given)
    in_order.process_all(sorted(given, key=lambda m: m.stamp_ns))
    end, other = (e.window.states[e.window.count - 1] for e in (late, in_order))
    np.testing.assert_array_equal(end["mean"], other["mean"])
    blocks = run_log(make_log(to_records(given, late.sources), p), p)
    seeds = []
    for block in blocks:
        seeds += block.updates["outcome"][block.measurements["kind"] == SLIPS].tolist()
        last = block.states[-1].copy()
    np.testing.assert_array_equal(last["mean"], end["mean"])
    assert seeds == [Outcome.ACCEPTED, Outcome.GATED]


# Seeds of the soil estimator


def thrust_at(slips: tuple[float, float]) -> Thrust:
    return Thrust(np.asarray(thrust(slips, SOIL.thrust_limit, SOIL.shear_modulus, LENGTH)), np.full(2, 100.0))


def test_a_seed_is_the_slip_of_its_thrust_and_as_uncertain_as_soil_and_thrust() -> None:
    rng, count = np.random.default_rng(2), 4000
    known = thrust_at((0.02, 0.03))
    found = slips_of(known, np.ones(2), SOIL, P.seed, LENGTH)
    np.testing.assert_allclose(found[0], (0.02, 0.03), rtol=1e-9)
    samples = []
    stddev = np.sqrt(known.variance + P.seed.thrust_stddev**2)
    for z in rng.standard_normal((count, 5)):
        modulus = SOIL.shear_modulus * (0.0267 / 0.015) ** (z[0] / 3.29)
        limit = SOIL.thrust_limit * (3603.0 / 3400.0) ** (z[1] / 3.29)
        soil = replace(SOIL, shear_modulus=modulus, thrust_limit=limit)
        one = slips_of(
            Thrust(known.force + stddev * z[2:4], known.variance), np.ones(2), soil, P.seed, LENGTH
        )
        samples.append(one[0] * (1.0 + P.seed.share_stddev * z[4]))
    np.testing.assert_allclose(found[1], np.cov(np.array(samples).T), rtol=0.2)


def test_in_reverse_and_where_a_track_brakes_slips_have_their_sign() -> None:
    known = thrust_at((0.02, -0.01))
    forward = slips_of(known, np.ones(2), SOIL, P.seed, LENGTH)
    reverse = slips_of(Thrust(-known.force, known.variance), -np.ones(2), SOIL, P.seed, LENGTH)
    np.testing.assert_allclose(forward[0], (0.02, -0.01), rtol=1e-9)
    np.testing.assert_array_equal(forward[0], reverse[0])


def test_a_thrust_that_the_soil_may_not_give_tells_no_slip() -> None:
    ride = Ride()
    ride.known = Thrust(np.array((3450.0, 1000.0)), np.full(2, 100.0))
    ride.seeds(Motion.TURNING, 1.0)
    assert ride.seeds(Motion.STRAIGHT, 10.0) == []


class Ride:
    """Moments of 0.1 s for a seeder."""

    def __init__(self) -> None:
        self._seeder, self._numbers, self._now_ns = np.zeros(1, SEEDER)[0], record_of(P)[0], 0
        self.known: Thrust | None = thrust_at((0.02, 0.02))
        self.soil: StrengthSummary | None = SOIL

    def seeds(self, motion: Motion, lengths: float) -> list[SlipSeed]:
        """While it drives so many contact lengths in this state of motion."""
        found = []
        for _ in range(math.ceil(lengths * LENGTH / (TRACKS[0] * 0.1))):
            self._now_ns += 100_000_000
            thrusts = (None, np.ones(2)) if self.known is None else self.known
            moment = Sample(0.1, TRACKS, thrusts=thrusts[0], thrust_variances=thrusts[1], motion=motion)
            sample, thrust = moment.records()
            sample["stamp_ns"] = self._now_ns
            if self.soil is not None:
                set_strength(self._seeder, self.soil)
            if is_seed_due(self._seeder, sample[0], thrust[0], self._numbers):
                found.append(seed_of(self._seeder, sample[0], thrust[0], P.seed, LENGTH))
        return found


def test_one_seed_for_each_turn_once_the_way_after_it_is_long_enough() -> None:
    ride, enough = Ride(), P.seed.settling_lengths + 0.1
    assert ride.seeds(Motion.STRAIGHT, 20.0) == []  # there was no turn
    ride.seeds(Motion.TURNING, 1.0)
    assert ride.seeds(Motion.STRAIGHT, enough - 0.5) == []
    assert ride.seeds(Motion.TURNING, 1.0) == []  # and the way begins anew
    assert ride.seeds(Motion.STRAIGHT, enough - 0.5) == []
    assert len(ride.seeds(Motion.STRAIGHT, 20.0)) == 1
    ride.seeds(Motion.STANDING, 1.0)
    assert ride.seeds(Motion.STRAIGHT, 20.0) == []


def test_no_seed_while_the_thrust_is_not_known() -> None:
    ride = Ride()
    ride.seeds(Motion.TURNING, 1.0)
    known, ride.known = ride.known, None
    assert ride.seeds(Motion.STRAIGHT, 10.0) == []
    ride.known = known
    assert len(ride.seeds(Motion.STRAIGHT, 10.0)) == 1


@pytest.mark.parametrize("soil", [None, replace(SOIL, identifiable=False, reason="no")])
def test_the_soil_counts_as_it_was_when_the_turn_ended(soil: StrengthSummary | None) -> None:
    ride = Ride()
    ride.soil = soil
    ride.seeds(Motion.TURNING, 1.0)
    ride.soil = SOIL
    assert ride.seeds(Motion.STRAIGHT, 10.0) == []
    ride.seeds(Motion.TURNING, 1.0)
    ride.soil = soil  # what the slips of this straight leg make of it is not asked
    assert len(ride.seeds(Motion.STRAIGHT, 10.0)) == 1


LEGS = (
    (3.0, 0.0, 0.0),
    (15.0, 2.0, 2.0),
    (6.0, 1.2, 2.2),
    (17.0, 2.0, 2.0),
    (6.0, 2.2, 1.2),
    (17.0, 2.0, 2.0),
)


@cache
def ride_on(soil: str) -> tuple[SoilInput, ...]:
    truth = simulate(Scenario(name="test", soil=soil, segments=tuple(Segment(*leg) for leg in LEGS)))
    sensing = Sensing(speed_stddev=0.0003, yaw_rate_stddev=0.0003)
    return tuple(soil_inputs(truth, P.vehicle.whole(), load_slip_parameters().motion, sensing))


def seeds_on(soil: str, **changes: Any) -> tuple[list[SlipSeed], SoilEstimator]:
    estimator = SoilEstimator(load_soil_parameters({k.replace("__", "."): v for k, v in changes.items()}))
    outputs = [output for given in ride_on(soil) for output in estimator.advance(given)]
    return [output for output in outputs if isinstance(output, SlipSeed)], estimator


def test_the_soil_estimator_gives_one_seed_after_each_turn() -> None:
    seeds, estimator = seeds_on("sandy_loam")
    assert estimator.strength.identifiable
    after = [(seed.stamp_ns - seeds[0].stamp_ns) * 1e-9 for seed in seeds]
    assert after == pytest.approx([0.0, 23.0], abs=1.0)
    for seed in seeds:
        sigma = math.sqrt(np.ones(2) @ seed.covariance @ np.ones(2)) / 2.0
        assert abs(seed.slips.mean() - 0.016) < 2.0 * sigma < 0.016


def test_the_soil_estimator_gives_none_where_the_soil_is_not_identifiable() -> None:
    seeds, estimator = seeds_on("sandy_loam", strength__widest_ratio=1.01)
    assert not estimator.strength.identifiable
    assert seeds == []


def test_a_seed_passes_its_message() -> None:
    covariance = np.array(((4e-6, 1e-6), (1e-6, 3e-6)))
    seed = SlipSeed(1_234_567_890, np.array((0.01, 0.02)), covariance)
    message = soil_conversions.message_of(make, seed, "base_link")
    assert soil_conversions.topic_of(seed) == "slip_seed"
    assert (message.header.frame_id, message.motion_state) == ("base_link", int(Motion.STRAIGHT))
    fix = conversions.slip_fix(message, "slip_seed")
    assert (fix.source, fix.stamp_ns) == ("slip_seed", seed.stamp_ns)
    np.testing.assert_array_equal(fix.slips, seed.slips)
    np.testing.assert_array_equal(fix.covariance, covariance)
