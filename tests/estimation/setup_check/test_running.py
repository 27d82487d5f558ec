# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The setup check of a running estimator: causes appear within two minutes and vanish once corrected."""

import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fixtures.setup_drives import make_drive
from fixtures.setup_mistakes import change_headings

from trackslip_common.errors import InputError
from trackslip_common.nodes.health import OK, WARN
from trackslip_estimation.nodes.setup_monitor import setup_health
from trackslip_estimation.setup_check.finding import OpenQuestion, Result
from trackslip_estimation.setup_check.log import Log
from trackslip_estimation.setup_check.running import BackgroundCheck, RunningCheck
from trackslip_estimation.slip.measurements import Measurement, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters

NAMED_S, END_S = 100.0, 60.0


@pytest.fixture(scope="module")
def parameters() -> SlipEstimatorParameters:
    values: dict[str, Any] = {
        "vehicle.kinematics.rolling_radius": 0.35,
        "vehicle.kinematics.tread": 2.0,
        "vehicle.kinematics.contact_length": 2.5,
        "pose_sources": ["gnss_pose"],
        "sources.gnss_pose.lever_arm_x": 0.5,
        "sources.gnss_pose.lever_arm_y": 0.2,
    }
    return load_slip_parameters(values)


def measurements(log: Log, begin_s: float, signs: tuple[float, float], gyro: float) -> Iterator[Measurement]:
    """Measurements of a drive in the order of stamps."""
    unsorted: list[Measurement] = []
    for t, (left, right) in zip(log.tracks.t, log.tracks.speeds, strict=True):
        unsorted.append(Sprockets("sprockets", _ns(begin_s + t), signs[0] * left, signs[1] * right))
    for t, rate in zip(log.gyros[0].t, log.gyros[0].rates[:, 2], strict=True):
        unsorted.append(YawRate("imu/data_raw", _ns(begin_s + t), gyro * rate, 2e-5))
    covariance = np.diag((4e-4, 4e-4, 1e-4))
    places, headings = log.fixes[0].places, log.compasses[0].headings
    for t, place, heading in zip(log.fixes[0].t, places, headings, strict=True):
        pose = np.array((*place, heading))
        unsorted.append(PoseFix("gnss_pose", _ns(begin_s + t), pose, covariance))
    return iter(sorted(unsorted, key=lambda m: m.stamp_ns))


def _ns(t: float) -> int:
    return 1_700_000_000_000_000_000 + round(t * 1e9)


def causes_after(check: RunningCheck, stream: Iterator[Measurement], stop_s: float) -> set[str]:
    for m in stream:
        if m.stamp_ns > _ns(stop_s):
            break
        check.add(m)
    return {cause.cause for cause in check.evaluate().causes}


@pytest.mark.parametrize(
    ("signs", "gyro", "cause"),
    [((-1.0, 1.0), 1.0, "left_track_sign"), ((1.0, 1.0), -1.0, "gyro_sign")],
)
def test_setup_mistake_is_reported_and_cleared_once_corrected(
    parameters: SlipEstimatorParameters, signs: tuple[float, float], gyro: float, cause: str
) -> None:
    check, drive = RunningCheck(parameters), make_drive()
    assert causes_after(check, measurements(drive, 0.0, signs, gyro), NAMED_S) == {cause}
    corrected = measurements(drive, NAMED_S + 0.5, (1.0, 1.0), 1.0)
    assert causes_after(check, corrected, NAMED_S + END_S) == set()


def test_stamps_without_fractions_are_reported(parameters: SlipEstimatorParameters) -> None:
    check = RunningCheck(parameters)
    for m in measurements(make_drive(), 0.0, (1.0, 1.0), 1.0):
        check.add(replace(m, stamp_ns=m.stamp_ns // 10**9 * 10**9))
    assert "time_unit" in {cause.cause for cause in check.evaluate().causes}


def test_mistake_that_is_one_of_several_is_reported_from_the_second_check(
    parameters: SlipEstimatorParameters,
) -> None:
    check = RunningCheck(parameters)
    frozen = change_headings(lambda headings: 0.0 * headings)(make_drive())
    stream = measurements(frozen, 0.0, (1.0, 1.0), 1.0)
    assert causes_after(check, stream, NAMED_S) == set()
    assert check.result.is_plausible
    assert causes_after(check, stream, NAMED_S + 15.0) == set()
    assert any("headings of" in question.what for question in check.result.open_questions)


def test_before_anything_is_measured_there_is_no_cause(parameters: SlipEstimatorParameters) -> None:
    assert RunningCheck(parameters).evaluate().causes == ()


@pytest.mark.parametrize(("is_wrong", "level"), [(True, WARN), (False, OK)])
def test_a_mistake_that_is_certain_but_one_of_several_is_a_warning(is_wrong: bool, level: bytes) -> None:
    question = OpenQuestion("encoders without a direction, or a cab that swung", "drive in reverse", is_wrong)
    health = setup_health(Result(undetermined=(question,)))
    assert health.level == level
    assert (
        health.message == "encoders without a direction, or a cab that swung: drive in reverse"
    ) == is_wrong


def test_a_failure_of_an_evaluation_is_reported(parameters: SlipEstimatorParameters) -> None:
    failures: list[Exception] = []
    check = RunningCheck(parameters)

    def fail() -> Any:
        raise InputError("no")

    check.evaluate = fail  # type: ignore[method-assign]
    background = BackgroundCheck(check, failures.append)
    background.start()
    background.join()
    assert [str(failure) for failure in failures] == ["no"]


def open_result(_: object = None) -> Result:
    """A result with a certain mistake that is one of several."""
    return Result(undetermined=(OpenQuestion("two sources contradict", "drive in reverse", is_wrong=True),))


def test_measurement_of_a_new_source_waits_for_the_copy_of_an_evaluation(
    parameters: SlipEstimatorParameters,
) -> None:
    check = RunningCheck(parameters)
    with check._lock:
        adding = threading.Thread(target=check.add, args=(Sprockets("sprockets", 0, 0.1, 0.1),))
        adding.start()
        adding.join(0.1)
        assert not check._rows
    adding.join()
    assert len(check._rows) == 1


def test_restart_drops_the_result_of_a_running_evaluation(
    parameters: SlipEstimatorParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    check = RunningCheck(parameters)

    def restart_meanwhile(_: object) -> Result:
        check.restart(parameters)
        return open_result()

    monkeypatch.setattr(check, "_check_latest", restart_meanwhile)
    assert check.evaluate() == check.result == Result()
    monkeypatch.setattr(check, "_check_latest", open_result)
    assert not check.evaluate().open_questions


def test_restart_forgets_the_open_question_of_the_previous_evaluation(
    parameters: SlipEstimatorParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    check = RunningCheck(parameters)
    monkeypatch.setattr(check, "_check_latest", open_result)
    check.evaluate()
    check.restart(parameters)
    assert not check.evaluate().open_questions
    assert check.evaluate().open_questions
