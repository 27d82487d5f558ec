# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Encoders or gyros fail for a while on a site, where a machine turns on the spot and reverses, with fixes.

Wrong encoders may fit a machine with a reversed heading. The gyro measured no such turn.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from fixtures.drawn_machine import GNSS, Recording, parameters, with_coarse_fixes
from fixtures.fault_cases.case import seconds
from fixtures.pose_errors import errors_over
from fixtures.short_moves import FIX_RATE, RATE, work
from fixtures.swinging_cab import Cab, dig, record

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import (
    SET_POSE,
    Measurement,
    PoseFix,
    Sprockets,
    VelocityFix,
    YawRate,
)
from trackslip_estimation.slip.parameters import load_slip_parameters

FAULT = 30.0  # s
P = parameters(**GNSS)
WITH_VELOCITIES = parameters(**GNSS, velocity_sources=["fix_velocity"])
SIDES = {"left": (0.0, 1.0), "right": (1.0, 0.0)}  # factors of the encoders' counts
ONE_ANTENNA = {"sources.box_pose.use_heading": False, "initial_yaw_stddev": 0.02}


def with_wrong_encoders(
    measurements: Iterable[Measurement], left: float, right: float, begin: float
) -> list[Measurement]:
    """The drive with encoders that measure ``left`` and ``right`` times the true motion for ``FAULT`` s."""
    changed: list[Measurement] = []
    shift, before = np.zeros(2), np.zeros(2)
    for m in measurements:
        if not isinstance(m, Sprockets):
            changed.append(m)
            continue
        is_wrong = begin <= seconds(m) < begin + FAULT
        factors = np.array((left, right) if is_wrong else (1.0, 1.0))
        now = np.array(m.positions)
        shift += (factors - 1.0) * (now - before)
        before = now
        angle_left, angle_right = (now + shift).tolist()
        speed_left, speed_right = float(factors[0]) * m.left_speed, float(factors[1]) * m.right_speed
        changed.append(Sprockets(m.source, m.stamp_ns, speed_left, speed_right, (angle_left, angle_right)))
    return changed


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("left", "right"),
    [(-1.0, -1.0), (0.0, 1.0), (1.0, 0.0), (0.5, 0.5)],
    ids=["reversed", "left stuck", "right stuck", "half"],
)
def test_wrong_encoders_turn_neither_heading_nor_position(left: float, right: float, seed: int) -> None:
    recording = work(seed)
    errors, _ = errors_over(with_wrong_encoders(recording.measurements, left, right, 40.0), recording, P)
    moved = errors.between(10.0)
    assert moved.heading_nees < 5.0
    assert np.abs(moved.between(110.0).off[:, 2]).max() < 0.15
    assert moved.rms < 0.06
    assert moved.inconsistent < 0.06


@pytest.mark.parametrize("seed", range(4))
def test_gyro_that_measures_twice_the_rate_does_not_reverse_the_heading_for_good(seed: int) -> None:
    recording = work(seed)
    measurements = [
        replace(m, rate=2.0 * m.rate) if isinstance(m, YawRate) and 40.0 <= seconds(m) < 40.0 + FAULT else m
        for m in recording.measurements
    ]
    errors, _ = errors_over(measurements, recording, P)
    assert np.abs(errors.between(115.0).off[:, 2]).max() < 0.2
    assert errors.between(10.0).rms < 0.06


@pytest.mark.parametrize("seed", [0, 2, 4, 6])
def test_a_bias_that_changes_at_a_standstill_does_not_turn_the_heading(seed: int) -> None:
    recording = work(seed)
    measurements = [
        replace(m, rate=m.rate + 0.03) if isinstance(m, YawRate) and 40.0 <= seconds(m) < 40.0 + FAULT else m
        for m in recording.measurements
    ]
    errors, _ = errors_over(measurements, recording, P)
    assert np.abs(errors.between(40.0 + FAULT).off[:, 2]).max() < 0.2


def with_velocities(recording: Recording, seed: int) -> list[Measurement]:
    """The drive with the fixes of an ordinary receiver, which states Doppler velocities too."""
    noise, stddev = np.random.default_rng(seed), 0.03
    velocities = [
        VelocityFix(
            "fix_velocity",
            10**9 + round(recording.t[k] * 1e9),
            (recording.poses[k + 1, :2] - recording.poses[k - 1, :2]) * RATE / 2.0
            + stddev * noise.normal(size=2),
            stddev**2 * np.eye(2),
        )
        for k in range(RATE, recording.t.size - 1, RATE // FIX_RATE)
    ]
    return sorted([*with_coarse_fixes(recording, 0.8, 25.0, seed), *velocities], key=lambda m: m.stamp_ns)


@pytest.mark.parametrize("seed", range(4))
def test_reversed_encoders_beside_velocities_do_not_turn_the_heading(seed: int) -> None:
    recording = work(seed)
    measurements = with_wrong_encoders(with_velocities(recording, seed), -1.0, -1.0, 40.0)
    errors, _ = errors_over(measurements, recording, WITH_VELOCITIES)
    assert errors.between(10.0).heading_nees < 5.0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("side", SIDES)
def test_one_stuck_encoder_beside_velocities_does_not_move_the_machine(seed: int, side: str) -> None:
    recording = work(seed)
    measurements = with_wrong_encoders(with_velocities(recording, seed), *SIDES[side], 40.0)
    errors, _ = errors_over(measurements, recording, WITH_VELOCITIES)
    fault = errors.between(40.0, 40.0 + FAULT)
    assert fault.distances.max() < 3.0
    assert fault.nees(2).mean() < 5.0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("side", SIDES)
def test_one_stuck_encoder_beside_an_ordinary_receiver_does_not_move_the_machine(
    seed: int, side: str
) -> None:
    recording = work(seed)
    measurements = with_wrong_encoders(with_coarse_fixes(recording, 0.8, 25.0, seed), *SIDES[side], 40.0)
    errors, _ = errors_over(measurements, recording, P)
    assert errors.between(40.0, 40.0 + FAULT).nees(2).mean() < 5.0


@pytest.mark.parametrize("side", SIDES)
def test_the_encoder_that_fails_is_named_and_the_slip_of_its_track_is_unknown(side: str) -> None:
    recording, estimator, named, index = work(0), SlipEstimator(P), 0, list(SIDES).index(side)
    for m in with_wrong_encoders(recording.measurements, *SIDES[side], 40.0):
        estimator.process(m)
        if seconds(m) > 40.0:
            best = estimator.competing_explanations.explanations[0].text
            is_unknown = estimator.estimate().outputs.slip_covariance[index, index] > 0.3
            named += best == f"the {side} sprocket and motion disagree" and is_unknown
    assert named > RATE


def test_encoders_that_count_backwards_are_named() -> None:
    recording, estimator, named = work(1), SlipEstimator(P), set[str]()
    for m in with_wrong_encoders(recording.measurements, -1.0, -1.0, 40.0):
        estimator.process(m)
        if seconds(m) > 40.0:
            named.add(estimator.competing_explanations.explanations[0].text)
    assert "sprockets count backwards" in named


@pytest.mark.parametrize("begin", [40.0, 60.0, 80.0])
def test_reversed_encoders_do_not_turn_the_heading_below_a_cab_with_the_gyro(begin: float) -> None:
    drive = record([*dig(), *dig(1.5), *dig(-1.0), *dig(2.0)], Cab(fix_hertz=5.0))
    wrong = with_wrong_encoders(drive.measurements, -1.0, -1.0, begin)
    errors, _ = errors_over(wrong, drive, load_slip_parameters({"vehicle": "pc05_cab"}, GNSS, ONE_ANTENNA))
    assert errors.between(10.0).heading_nees < 5.0


@pytest.mark.parametrize("seed", range(4))
def test_a_manual_pose_with_a_reversed_heading_is_corrected_by_fixes(seed: int) -> None:
    recording, at = work(seed), 60.0
    true = recording.poses[round(at * RATE)] + (0.0, 0.0, np.pi)
    pose = PoseFix(SET_POSE, 10**9 + round(at * 1e9), true, np.diag((0.01, 0.01, 0.01)))
    measurements = sorted([*recording.measurements, pose], key=lambda m: m.stamp_ns)
    errors, _ = errors_over(measurements, recording, P)
    assert np.abs(errors.between(at, at + 1.0).off[:, 2]).max() > 3.0
    assert np.abs(errors.between(at + 50.0).off[:, 2]).max() < 0.15


@pytest.mark.parametrize("seed", range(4))
def test_heading_in_a_site_frame_that_is_turned_is_found_within_two_minutes(seed: int) -> None:
    """The fixes are turned about the machine, as after a change of the datum."""
    recording, at, end = work(seed, 240.0), 60.0, 240.0
    centre, angle = recording.poses[round(at * RATE), :2], 2.5
    turn = np.array(((np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))))
    true = recording.poses.copy()
    true[recording.t >= at, :2] = centre + (true[recording.t >= at, :2] - centre) @ turn.T
    true[recording.t >= at, 2] += angle
    measurements = [
        replace(m, pose=np.append(centre + turn @ (m.pose[:2] - centre), 0.0))
        if isinstance(m, PoseFix) and seconds(m) >= at
        else m
        for m in recording.measurements
    ]
    errors, _ = errors_over(measurements, recording._replace(poses=true), P)
    assert np.abs(errors.between(at + 120.0, end).off[:, 2]).max() < 0.15


@pytest.mark.parametrize("seed", range(4))
def test_estimate_is_consistent_at_work(seed: int) -> None:
    recording = work(seed)
    errors, _ = errors_over(recording.measurements, recording, P)
    assert errors.nees(2).mean() < 4.0
    assert errors.between(10.0).heading_nees < 4.0
