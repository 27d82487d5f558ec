# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Encoders with few counts: proximity switches at the teeth of a sprocket, or hall sensors in its motor."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fixtures.drawn_machine import FIX, GYRO, RATE, Machine, Recording, drive, parameters
from fixtures.pose_errors import pose_errors

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import (
    Measurement,
    OdometryPose,
    Outcome,
    PoseFix,
    Sprockets,
    VelocityFix,
    YawRate,
)
from trackslip_estimation.slip.models.turning import EFFICIENCY

S = 1_000_000_000
END = 120.0  # s
COUNTS = (16, 1000)  # per turn of the sprocket
KINEMATICS = parameters().vehicle.kinematics


def counted(recording: Recording, resolution: float, *, has_positions: bool) -> list[Measurement]:
    """Measurements with positions in whole counts of ``resolution`` rad; speeds are their differences."""
    before, angles, found = np.zeros(2), np.zeros(2), []
    for m in recording.measurements:
        if isinstance(m, Sprockets):
            angles = angles + np.array((m.left_speed, m.right_speed)) / RATE
            now = resolution * np.floor(angles / resolution + (0.2, 0.7))
            left, right = (now - before) * RATE
            before = now
            positions = (now[0], now[1]) if has_positions else None
            m = replace(m, left_speed=left, right_speed=right, positions=positions)
        found.append(m)
    return found


def _odometry(recording: Recording) -> tuple[list[Measurement], dict[str, object]]:
    poses, noise = recording.poses[::2], np.random.default_rng(70)
    places = np.cumsum(noise.normal(0.0, 1e-3, (len(poses), 2)), axis=0) + poses[:, :2]
    turns = np.column_stack((np.zeros((len(poses), 2)), np.sin(poses[:, 2] / 2.0), np.cos(poses[:, 2] / 2.0)))
    stamps = (S + np.round(recording.t[::2] * S)).astype(np.int64)
    found: list[Measurement] = [
        OdometryPose("camera", int(at), np.append(place, 0.0), turn, 1, np.zeros((2, 3)))
        for at, place, turn in zip(stamps, places, turns, strict=True)
    ]
    return found, {"odometry_sources": ["camera"], "sources.camera.covariance": "declared"}


def _radar(recording: Recording) -> tuple[list[Measurement], dict[str, object]]:
    velocities = np.gradient(recording.poses[:, :2], recording.t, axis=0)[::2]
    yaw, noise = recording.poses[::2, 2], np.random.default_rng(70)
    ahead = (
        np.cos(yaw) * velocities[:, 0] + np.sin(yaw) * velocities[:, 1] + noise.normal(0.0, 0.03, len(yaw))
    )
    stamps = (S + np.round(recording.t[::2] * S)).astype(np.int64)
    R = np.diag((0.03**2, 1e6))
    found: list[Measurement] = [
        VelocityFix("radar", int(at), np.array((v, 0.0)), R) for at, v in zip(stamps, ahead, strict=True)
    ]
    return found, {"velocity_sources": ["radar"], "sources.radar.axes": "body"}


BESIDE: Mapping[str, Callable[[Recording], tuple[list[Measurement], dict[str, object]]]] = {
    "odometry": _odometry,
    "radar": _radar,
}


@cache
def run(
    counts: int,
    *,
    seed: int = 0,
    has_gyro: bool = True,
    fixes_until: float = END,
    beside: str = "",
    has_positions: bool = True,
) -> tuple[float, float, float, int]:
    """RMSE of position, m, and heading, rad, mean NEES of the pose, and number of rejected measurements."""
    recording = drive(Machine(duration=END, seed=seed))
    resolution = math.tau / counts
    more, chosen = BESIDE[beside](recording) if beside else ([], {})
    everything = [*counted(recording, resolution, has_positions=has_positions), *more]
    shown = [
        m
        for m in sorted(everything, key=lambda m: m.stamp_ns)
        if (has_gyro or m.source != GYRO)
        and not (isinstance(m, PoseFix) and fixes_until < m.stamp_ns / S - 1.0 < END)
    ]
    p = parameters(encoder_resolution=resolution, **chosen)
    steps = SlipEstimator(p).process_all(shown)
    found = pose_errors((e for _, e in steps), recording.t, recording.poses)
    rejected = sum(report.outcome in (Outcome.JUMPED, Outcome.GATED) for report, _ in steps)
    return found.rms, found.heading_rms, float(found.between(2.0).nees(3).mean()), rejected


@pytest.mark.parametrize("counts", COUNTS)
def test_single_count_is_never_taken_for_a_jump(counts: int) -> None:
    """One count between two samples at 20 Hz may exceed the maximum sprocket speed."""
    assert run(counts)[3] == 0


@pytest.mark.parametrize("counts", COUNTS)
def test_gyro_keeps_the_heading_beside_a_coarse_encoder(counts: int) -> None:
    """Rounding of counts must not inflate the noise of the gyro."""
    fine, coarse = (np.mean([run(n, seed=seed)[:3] for seed in range(2)], axis=0) for n in (100_000, counts))
    half_a_count = KINEMATICS.rolling_radius * math.pi / counts
    assert coarse[0] < 1.5 * fine[0] + half_a_count
    assert coarse[1] < 1.5 * fine[1] + half_a_count / KINEMATICS.tread + 0.01
    assert coarse[2] < 5.0


@pytest.mark.parametrize("counts", COUNTS)
def test_fixes_alone_place_a_machine_of_coarse_encoders(counts: int) -> None:
    place, _, nees, _ = run(counts, has_gyro=False)
    assert place < 0.08
    assert nees < 5.0


@pytest.mark.parametrize("counts", COUNTS)
def test_coarse_counts_give_the_distance_without_fixes(counts: int) -> None:
    place, _, nees, _ = run(counts, fixes_until=80.0)
    assert place < 0.5
    assert nees < 5.0


@pytest.mark.parametrize("beside", BESIDE)
def test_velocity_and_odometry_improve_coarse_encoders_beside_a_gyro(beside: str) -> None:
    """Gyro readings stay accepted beside either source."""
    counts = 16
    half_a_count = KINEMATICS.rolling_radius * math.pi / counts
    for until in (END, 60.0):
        alone, both = (
            np.mean([run(counts, seed=k, fixes_until=until, beside=b) for k in range(2)], axis=0)
            for b in ("", beside)
        )
        assert both[0] < 1.5 * alone[0] + half_a_count
        assert both[1] < 1.1 * alone[1] + 0.003
        assert both[2] < 5.0
        assert both[3] == 0


@pytest.mark.parametrize(("counts", "beside"), [*((16, beside) for beside in ("", *BESIDE)), (1000, "")])
def test_speeds_from_count_differences_equal_the_counts(counts: int, beside: str) -> None:
    """Such a driver publishes no positions."""
    of_counts, of_speeds = (
        run(counts, fixes_until=60.0, beside=beside, has_positions=given) for given in (True, False)
    )
    assert of_speeds == pytest.approx(of_counts, rel=0.02, abs=2e-4)


@pytest.mark.parametrize("counts", [100, 12_288])
def test_rounding_on_a_straight_leaves_the_turning_efficiency(counts: int) -> None:
    """The track speeds differ only by rounding; κ stays at its prior."""
    p = parameters(encoder_resolution=math.tau / counts)
    estimator, random = SlipEstimator(p), np.random.default_rng(1)
    shown: list[Measurement] = []
    for k in range(6000):
        t, stamp_ns = k / 100.0, S + k * 10_000_000
        left, right = np.floor(1.4 * t / math.tau * counts + np.array((0.2, 0.7))) * math.tau / counts
        shown.append(Sprockets("sprockets", stamp_ns, 1.4, 1.4, positions=(left, right)))
        if k % 8 == 0:
            shown.append(YawRate(GYRO, stamp_ns, 0.005 * random.standard_normal(), 2.5e-5))
        if k % 50 == 0:
            place = 0.02 * random.standard_normal(3)
            place[0] += KINEMATICS.rolling_radius * 1.4 * t
            shown.append(PoseFix(FIX, stamp_ns, place, np.diag((4e-4, 4e-4, 100.0))))
    for _ in estimator.process_all(shown):
        pass
    found = estimator.window.best[estimator.window.count - 1]
    stddev = math.sqrt(found["covariance"][EFFICIENCY, EFFICIENCY])
    assert found["mean"][EFFICIENCY] == pytest.approx(p.turning.initial_efficiency, abs=stddev)
    assert stddev > 0.5 * p.turning.initial_efficiency_stddev
