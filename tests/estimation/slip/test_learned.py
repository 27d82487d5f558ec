# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Learned states: taken from a state, aged, used at a start, and described in words."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from fixtures.drawn_machine import Machine, drive, parameters
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.errors import InputError
from trackslip_estimation.slip.adaptation import FIX_FACTORS
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.learned import (
    Learned,
    LearnedContext,
    decay_to_prior,
    from_tree,
    learned_context,
    to_tree,
)
from trackslip_estimation.slip.learned_text import (
    NOT_OBSERVED,
    LearnedQuantity,
    learned_quantities,
    quantity_lines,
)
from trackslip_estimation.slip.measurements import FORGET, RESET, Command, Measurement, PoseFix
from trackslip_estimation.slip.models.model import GYRO_SCALE

P = parameters()
CONTEXT = learned_context(P)
HOUR, MONTH = 3600.0, 30 * 86400.0


@pytest.fixture(scope="module")
def driven() -> list[Measurement]:
    return drive(Machine(gyro_scale=0.97, fix_noise=0.04, duration=60.0)).measurements


@pytest.fixture(scope="module")
def learned(driven: list[Measurement]) -> Learned:
    estimator = SlipEstimator(P)
    estimator.process_all(driven)
    assert estimator.learned is not None
    return estimator.learned


def bits(learned_: Learned) -> str:
    return json.dumps(to_tree(learned_, CONTEXT))


def named(learned_: Learned | None, context: LearnedContext = CONTEXT) -> dict[str, LearnedQuantity]:
    return {quantity.name: quantity for quantity in learned_quantities(learned_, context)}


def random_learned(seed: int) -> Learned:
    """Random learned states."""
    random, n = np.random.default_rng(seed), len(CONTEXT.state_indices)
    root = random.standard_normal((n, n + 1))
    covariance = root @ root.T
    stddev = np.sqrt(np.diag(covariance))
    below = np.tril(covariance / np.outer(stddev, stddev), -1)
    prior = CONTEXT.prior
    return Learned(
        CONTEXT.machine,
        random.standard_normal(n),
        prior.stddev * random.uniform(0.0, 1.0, n),
        below + below.T + np.eye(n),
        -50.0 * random.random(prior.track_weights.shape),
        {"box_pose": -50.0 * random.random(FIX_FACTORS)} if seed % 2 else {},
    )


@given(st.integers(0, 2**32 - 1))
def test_learned_states_survive_the_text_bit_for_bit(seed: int) -> None:
    one = random_learned(seed)
    back = from_tree(json.loads(bits(one)), CONTEXT)
    assert bits(back) == bits(one)
    for mine, its in ((one.covariance, back.covariance), (one.track_weights, back.track_weights)):
        np.testing.assert_array_equal(mine, its)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1e9), st.floats(0.0, 1e9))
def test_age_widens_towards_the_prior_and_never_beyond(seed: int, first: float, then: float) -> None:
    one, prior = random_learned(seed), CONTEXT.prior
    younger, older = decay_to_prior(one, first, CONTEXT), decay_to_prior(one, first + then, CONTEXT)
    assert np.all(younger.stddev <= prior.stddev * (1.0 + 1e-9))
    assert np.all(older.stddev >= younger.stddev * (1.0 - 1e-9))
    assert np.all(np.abs(older.mean - prior.mean) <= np.abs(younger.mean - prior.mean) + 1e-12)
    assert np.linalg.eigvalsh(older.correlations)[0] > -1e-9
    twice = decay_to_prior(younger, then, CONTEXT)
    np.testing.assert_allclose(twice.covariance, older.covariance, atol=1e-12)
    np.testing.assert_allclose(twice.track_weights, older.track_weights, atol=1e-9)


def test_soil_states_age_within_hours_and_machine_states_within_months(learned: Learned) -> None:
    deviations = {
        age: dict(zip(CONTEXT.state_indices, decay_to_prior(learned, age, CONTEXT).stddev, strict=True))
        for age in (0.0, 12 * HOUR, 12 * MONTH)
    }
    prior = dict(zip(CONTEXT.state_indices, CONTEXT.prior.stddev, strict=True))
    for name in ("efficiency", "loss", "common_slip", "rotation_offset", "gyro_bias"):
        assert deviations[12 * HOUR][name] > 0.9 * prior[name]
    for name in ("gyro_scale", "asymmetry"):
        assert deviations[12 * HOUR][name] == pytest.approx(deviations[0.0][name], rel=0.25)
        assert deviations[12 * MONTH][name] > 0.9 * prior[name]


def test_estimator_starts_from_learned_states(driven: list[Measurement], learned: Learned) -> None:
    estimator = SlipEstimator(P, learned=learned)
    assert bits(estimator.learned or random_learned(0)) == bits(learned)
    first = next(k for k, m in enumerate(driven) if isinstance(m, PoseFix))
    estimator.process_all(driven[: first + 1])
    state = estimator.window.best[0]
    places = list(CONTEXT.state_indices.values())
    np.testing.assert_array_equal(state["mean"][places], learned.mean)
    np.testing.assert_array_equal(state["covariance"][np.ix_(places, places)], learned.covariance)
    np.testing.assert_array_equal(state["adaptation"]["log_weights"], learned.track_weights)
    np.testing.assert_array_equal(state["adaptation"]["fix_log_weights"][0], learned.fix_weights["box_pose"])
    assert state["adaptation"]["fix_factors"][0] > 1.5  # true factor 4


def test_learned_states_reduce_the_error_of_the_next_start(learned: Learned) -> None:
    """After its first metres the gyro scale is more accurate than after a start from the prior."""
    again = drive(Machine(gyro_scale=0.97, fix_noise=0.04, duration=8.0, seed=1)).measurements
    errors = []
    for start in (None, learned):
        estimator = SlipEstimator(P, learned=start)
        estimator.process_all(again)
        state = estimator.window.best[estimator.window.count - 1]
        errors.append(abs(1.0 + state["mean"][GYRO_SCALE] - 0.97))
    assert errors[1] < 0.6 * errors[0]


def test_reset_keeps_learned_states_and_forget_drops_them(driven: list[Measurement]) -> None:
    estimator = SlipEstimator(P)
    estimator.process_all(driven)
    before = estimator.learned
    assert before is not None
    estimator.process(Command(RESET))
    assert not estimator.started
    assert bits(estimator.learned or random_learned(0)) == bits(before)
    shift = 60_050_000_000
    fresh, other = SlipEstimator(P), SlipEstimator(P, learned=before)
    estimator.process(Command(FORGET))
    assert estimator.learned is None
    later = [type(m)(**{**vars(m), "stamp_ns": m.stamp_ns + shift}) for m in driven[:200]]
    for one in (estimator, fresh, other):
        one.process_all(later)
    np.testing.assert_array_equal(estimator.estimate().pose, fresh.estimate().pose)
    assert bits(estimator.learned or random_learned(0)) == bits(fresh.learned or random_learned(1))
    assert bits(estimator.learned or random_learned(0)) != bits(other.learned or random_learned(1))


@pytest.mark.parametrize("model", ["turning", "icr", "free_slips"])
def test_every_model_learns_and_reports(model: str, driven: list[Measurement]) -> None:
    p = parameters(model=model, **{"sources.box_pose.use_heading": model == "free_slips"})  # which needs it
    context, estimator = learned_context(p), SlipEstimator(p)
    estimator.process_all(driven)
    found = estimator.learned
    assert found is not None
    assert all(
        np.isfinite((quantity.value, quantity.stddev)).all()
        for quantity in learned_quantities(found, context)
    )
    assert to_tree(from_tree(to_tree(found, context), context), context) == to_tree(found, context)
    SlipEstimator(p, learned=decay_to_prior(found, HOUR, context)).process_all(driven)


@pytest.mark.parametrize(
    "changes",
    [
        {"vehicle.kinematics.tread": 0.74},
        {"model": "icr"},
        {"sources.imu_data_raw.sign": -1},
        {"sources.imu_data_raw.scale": 0.98},
        {"sources.box_pose.stamp_error": 0.03},
        {"pose_sources": ("box_pose", "gnss_pose")},
    ],
)
def test_parameters_of_another_machine_are_detected(learned: Learned, changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="another vehicle, or of other sources"):
        from_tree(to_tree(learned, CONTEXT), learned_context(parameters(**changes)))


def test_other_gates_keep_the_machine_identity(learned: Learned) -> None:
    context = learned_context(parameters(**{"gate_probability": 0.5, "sources.box_pose.timeout": 9.0}))
    assert to_tree(from_tree(to_tree(learned, CONTEXT), context), context) == to_tree(learned, CONTEXT)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("states", {}),
        ("states", None),
        ("correlations", [[2.0]]),
        ("correlations", "none"),
        ("track_error_ln_weights", [[0.0]]),
        ("track_error_ln_weights", [[float("nan")] * 3] * 6),
        ("fix_noise_ln_weights", {"box_pose": [10**400] * FIX_FACTORS}),
        ("fix_noise_ln_weights", 3),
    ],
)
def test_invalid_learned_states_are_refused(learned: Learned, name: str, value: object) -> None:
    with pytest.raises(InputError, match="do not fit"):
        from_tree({**to_tree(learned, CONTEXT), name: value}, CONTEXT)


# Descriptions


def test_nothing_is_observed_before_the_first_metre() -> None:
    assert {f.sentence for f in learned_quantities(None, CONTEXT)} == {NOT_OBSERVED}
    (line,) = quantity_lines(learned_quantities(None, CONTEXT))
    assert line.startswith(f"{NOT_OBSERVED}: gyro scale, ")


def test_state_far_from_its_prior_counts_as_observed() -> None:
    """The slip of spinning tracks has a standard deviation of 0.1; its prior is 0 ± 0.02."""
    start, k = CONTEXT.prior, list(CONTEXT.state_indices).index("common_slip")
    mean, stddev = start.mean.copy(), start.stddev.copy()
    mean[k], stddev[k] = 1.0, 0.1
    spinning = dataclasses.replace(start, mean=mean, stddev=stddev)
    assert named(spinning)["common_slip"].observed


def test_observed_states_are_reported_in_sentences(learned: Learned) -> None:
    found = named(learned)
    gyro = found["gyro_scale"]
    assert gyro.observed
    assert abs(gyro.value - 0.97) < 3.0 * gyro.stddev
    assert gyro.sentence.startswith("gyro reads ")
    assert " % low ± " in gyro.sentence
    assert found["fix_noise_factor.box_pose"].value == pytest.approx(4.0, rel=0.5)
    assert found["fix_delay.box_pose"].sentence == NOT_OBSERVED  # stamp errors of at most 3 ms
    assert found["track_error"].value < 0.02


@pytest.mark.parametrize(
    ("name", "value", "stddev", "sentence"),
    [
        ("gyro_scale", 0.981, 0.005, "gyro reads 1.9 % low ± 0.5"),
        ("gyro_scale", 1.0123, 0.0013, "gyro reads 1.23 % high ± 0.13"),
        ("fix_delay.gnss_pose", 0.2512, 0.021, "gnss_pose fixes 0.25 s late ± 0.02"),
        ("fix_delay.gnss_pose", -0.1, 0.03, "gnss_pose fixes 0.10 s early ± 0.03"),
        ("asymmetry", -0.0112, 0.002, "turns 0.011 rad/m to the right ± 0.002"),
        ("track_error", 0.05, 0.016, "tracks err by 5.0 % of their speed ± 1.6"),
        ("common_slip", -0.0001, 0.013, "both tracks slip 0.0 % ± 1.3"),
        ("efficiency", 0.451, 0.03, "turning efficiency κ 0.45 ± 0.03"),
        ("centres_1", 0.73, 0.1, "centres 1 0.73 ± 0.10"),
        ("gyro_scale", 1.0, 0.0, "gyro reads 0.000000000 % high ± 0.000000000"),
    ],
)
def test_a_sentence_has_the_digits_of_its_standard_deviation(
    name: str, value: float, stddev: float, sentence: str
) -> None:
    assert LearnedQuantity(name, value, stddev, observed=True).sentence == sentence


def test_each_source_has_its_own_delay() -> None:
    changes = {"sources.box_pose.stamp_error": 0.0, "sources.gnss_pose.stamp_error": 0.03}
    found = named(None, learned_context(parameters(pose_sources=("box_pose", "gnss_pose"), **changes)))
    assert "fix_delay.box_pose" not in found  # configured without a delay
    assert found["fix_delay.gnss_pose"].stddev == pytest.approx(0.03)
    assert {"fix_noise_factor.box_pose", "fix_noise_factor.gnss_pose"} <= found.keys()
