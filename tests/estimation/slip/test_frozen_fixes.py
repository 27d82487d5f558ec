# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes that do not move while the tracks turn: a frozen receiver, or a machine that is stuck."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from fixtures.drawn_machine import Machine, drive
from fixtures.fault_cases.case import GNSS, FaultCase, Truth, fix_parameters, seconds, stamp
from fixtures.fault_cases.injections import change_fixes
from fixtures.fault_cases.robot_logs import merged
from fixtures.fault_cases.scoring import score

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import HeadingFix, Measurement, PoseFix, YawRate

BEGIN, END = 20.0, 28.0  # s
STATED = 0.05  # m
STAYS = "gnss_pose is frozen"


def of_receiver(machine: Machine, frozen: float | None = None) -> FaultCase:
    """A drive with fixes of a receiver, which scatter by ``frozen`` m about one place from BEGIN to END."""
    recording, held, random = drive(machine), np.zeros(3), np.random.default_rng(3)

    def change(fix: PoseFix, t: float) -> PoseFix:
        nonlocal held
        if frozen is None or not BEGIN <= t < END:
            held = fix.pose
            return replace(fix, source=GNSS)
        jitter = random.normal(0.0, frozen, 2) if frozen > 0.0 else np.zeros(2)
        return replace(fix, source=GNSS, pose=held + np.array((*jitter, 0.0)))

    given: list[Measurement] = change_fixes(recording.measurements, change)
    truth = Truth(recording.t, recording.poses)
    return FaultCase(fix_parameters(GNSS, initial_yaw_stddev=0.02), given, truth, (BEGIN, END + 4.0))


def probabilities(case: FaultCase, text: str) -> Iterator[float]:
    """Total probability of explanations that begin with ``text``, at each fix from BEGIN + 2 s to END."""
    estimator = SlipEstimator(case.parameters)
    for m in case.measurements:
        estimator.process(m)
        if isinstance(m, PoseFix) and BEGIN + 2.0 <= seconds(m) < END:
            found = estimator.competing_explanations.explanations
            yield sum(e.probability for e in found if e.text.startswith(text))


@pytest.mark.parametrize("rate", [1, 5])
@pytest.mark.parametrize("difference", [0.0, 1e-5])
def test_frozen_receiver_does_not_stop_the_estimate(difference: float, rate: int) -> None:
    machine = Machine(duration=45.0, fix_noise=STATED, fix_stated=STATED, fix_rate=rate, track_error=0.03)
    found = score(of_receiver(machine, frozen=difference))
    assert found.nees <= 5.0
    assert found.inconsistent <= 0.06
    assert found.live_equals_replay


@pytest.mark.parametrize(("jitter", "rate"), [(0.003, 5), (0.01, 1)])
def test_jittering_frozen_receiver_keeps_a_probability_of_three_percent(jitter: float, rate: int) -> None:
    machine = Machine(duration=45.0, fix_noise=STATED, fix_stated=STATED, fix_rate=rate, track_error=0.03)
    assert min(probabilities(of_receiver(machine, frozen=jitter), STAYS)) >= 0.03
    assert score(of_receiver(machine, frozen=jitter)).live_equals_replay


@pytest.mark.parametrize(("noise", "stated", "rate"), [(0.05, 0.05, 1), (0.05, 0.05, 10), (0.005, 0.05, 5)])
def test_estimate_of_a_stuck_machine_follows_its_fixes(noise: float, stated: float, rate: int) -> None:
    machine = Machine(
        duration=45.0,
        fix_noise=noise,
        fix_stated=stated,
        fix_rate=rate,
        track_error=0.05,
        stuck=(BEGIN, 40.0),
    )
    early = score(replace(of_receiver(machine), window=(BEGIN + 2.0, END)))
    assert early.nees <= 5.0  # a frozen receiver is as likely until the gyro shows no turn
    late = score(replace(of_receiver(machine), window=(BEGIN + 6.0, 40.0)))
    assert late.rmse <= 2.0 * stated
    assert late.nees <= 5.0


@pytest.mark.parametrize("rate", [1, 10])
@pytest.mark.parametrize("track_error", [pytest.param(0.03, marks=pytest.mark.slow), 0.1])
def test_machine_that_is_stuck_for_long_follows_its_fixes_without_a_gyro(
    rate: int, track_error: float
) -> None:
    """Beside a pair of antennas; its tracks go on at changing speeds."""
    noise, errors, inconsistent = 0.02, list[float](), list[float]()
    for seed in range(3):
        machine = Machine(
            duration=70.0,
            fix_noise=noise,
            fix_stated=noise,
            fix_rate=rate,
            track_error=track_error,
            stuck=(BEGIN, 60.0),
            seed=seed,
        )
        case, random = of_receiver(machine), np.random.default_rng(seed)
        times = np.arange(0.0, machine.duration, 0.1)
        headings = case.truth.at(times)[:, 2] + random.normal(0.0, noise, times.size)
        antennas: list[Measurement] = [
            HeadingFix("heading", stamp(t), heading, noise**2)
            for t, heading in zip(times.tolist(), headings.tolist(), strict=True)
        ]
        without_gyro = [m for m in case.measurements if not isinstance(m, YawRate)]
        p = fix_parameters(GNSS, heading_sources=["heading"])
        found = score(FaultCase(p, merged(without_gyro, antennas), case.truth, (BEGIN + 6.0, 70.0)))
        errors.append(found.rmse)
        inconsistent.append(found.inconsistent)
    assert max(errors) <= 0.2
    assert max(inconsistent) <= 0.1  # in its first second of motion again


@pytest.mark.parametrize("rate", [1, 10])
def test_chance_repetition_of_a_fix_does_not_move_a_stuck_machine(rate: int) -> None:
    """Ten fixes per second with centimetre noise repeat within minutes."""
    noise = 0.02
    machine = Machine(
        duration=45.0, fix_noise=noise, fix_stated=noise, fix_rate=rate, track_error=0.03, stuck=(BEGIN, 40.0)
    )
    case = of_receiver(machine)
    begin = BEGIN + 4.0
    first = next(m for m in case.measurements if isinstance(m, PoseFix) and seconds(m) > begin)

    def again(fix: PoseFix, t: float) -> PoseFix:
        return replace(fix, pose=first.pose) if 0.0 < t - seconds(first) < 1.5 / rate else fix

    given = change_fixes(case.measurements, again)
    found = score(replace(case, measurements=given, window=(begin + 2.0 / rate + 1.0, 40.0)))
    assert found.rmse <= 0.1
    assert found.nees <= 5.0


@pytest.mark.parametrize("rate", [1, 5])
@pytest.mark.parametrize("has_gyro", [False, True], ids=["tracks", "gyro"])
def test_machine_that_grips_again_is_followed(has_gyro: bool, rate: int) -> None:
    """Its receiver is not taken for a frozen one, nor its encoders for failed ones, while it drives on."""
    errors = list[float]()
    for begin in (30.0, 44.0):
        machine = Machine(
            duration=80.0,
            fix_noise=STATED,
            fix_stated=STATED,
            fix_rate=rate,
            track_error=0.03,
            stuck=(begin, begin + 10.0),
            seed=1,
        )
        case = of_receiver(machine)
        given = (
            case.measurements if has_gyro else [m for m in case.measurements if not isinstance(m, YawRate)]
        )
        grips = begin + 10.0
        found = score(FaultCase(fix_parameters(GNSS), given, case.truth, (grips + 3.0, grips + 15.0)))
        errors.append(found.largest)
    assert max(errors) <= 0.4


@pytest.mark.parametrize("rate", [1, 5])
def test_gyro_that_shows_turns_speaks_against_a_stuck_machine(rate: int) -> None:
    """Tracks that spin do not turn the machine: jittering fixes that stay are those of a frozen receiver."""
    machine = Machine(duration=45.0, fix_noise=STATED, fix_stated=STATED, fix_rate=rate, track_error=0.03)
    found = score(of_receiver(machine, frozen=STATED))
    assert found.nees <= 5.0
    assert found.inconsistent <= 0.06


def test_machine_is_named_stuck_until_it_grips_again() -> None:
    """Longer than other events are named: for 40 s."""
    machine = Machine(
        duration=75.0, fix_noise=STATED, fix_stated=STATED, fix_rate=5, track_error=0.03, stuck=(BEGIN, 60.0)
    )
    case = of_receiver(machine)
    estimator, named = SlipEstimator(case.parameters), dict[int, str]()
    for m in case.measurements:
        estimator.process(m)
        for best in estimator.competing_explanations.explanations[:1]:
            named[int(seconds(m))] = best.text
    assert all(named[t].startswith("the machine is stuck: both tracks slip ") for t in range(28, 60))
    assert not any(named[t].startswith("the machine is stuck") for t in range(64, 75))
