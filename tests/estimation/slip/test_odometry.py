# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Odometry of a camera as increments: motion on slippery ground; jumps, gaps, stated covariances."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.changes import changed
from fixtures.drawn_machine import GNSS, Machine, Recording, drive, parameters
from fixtures.pose_errors import PoseErrors, pose_errors
from fixtures.records import assert_order_does_not_matter
from fixtures.visual_odometry import product, turned_by

from trackslip_common.errors import InputError
from trackslip_common.make import header
from trackslip_common.nodes.messages import make
from trackslip_estimation.slip.conversions import odometry_pose
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.events import Event
from trackslip_estimation.slip.measurements import (
    Measurement,
    OdometryPose,
    Outcome,
    PoseFix,
    Report,
    Sprockets,
)
from trackslip_estimation.slip.mounting import quaternion_from_angles
from trackslip_estimation.slip.observations.increments import POSE_GROWTH, TWIST, increment, stated_variances
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.sources import Rejection

S = 1_000_000_000
SOURCE, LEVER, MOUNTING = "camera", (0.8, -0.3, 1.5), (0.1, 0.3, 0.7)
ODOM_ORIENTATION = np.array(quaternion_from_angles(0.2, -0.4, 1.0))  # orientation of its odom frame
ALONE = 40.0  # s, end of the fixes


def with_odometry(**values: object) -> SlipEstimatorParameters:
    levers = {f"sources.{SOURCE}.lever_arm_{axis}": value for axis, value in zip("xyz", LEVER, strict=True)}
    names = ("roll", "pitch", "yaw")
    mounted = {f"sources.{SOURCE}.mounting_{n}": v for n, v in zip(names, MOUNTING, strict=True)}
    noise = {f"sources.{SOURCE}.covariance": "declared"}
    return parameters(**{"odometry_sources": [SOURCE], **levers, **mounted, **noise, **values})


def pose_of(stamp_ns: int, pose: np.ndarray) -> OdometryPose:
    """Pose that the source publishes with base_link at (3,) x, y, heading of its odom frame, if level."""
    base, camera = (
        np.array(quaternion_from_angles(0.0, 0.0, pose[2])),
        np.array(quaternion_from_angles(*MOUNTING)),
    )
    at = turned_by(ODOM_ORIENTATION, np.append(pose[:2], 0.0) + turned_by(base, np.array(LEVER)))
    turn = product(product(ODOM_ORIENTATION, base), camera)
    return OdometryPose(SOURCE, stamp_ns, at, turn, 7, np.zeros((2, 3)))


def seen(
    recorded: Recording, scale: float = 1.0, seed: int = 0, during: tuple[float, float] = (0.0, math.inf)
) -> list[Measurement]:
    """The odometry of a drive: 10 Hz, a millimetre of noise between two poses.

    Distances are multiplied by ``scale`` between the two times ``during``, s.
    """
    noise, place = np.random.default_rng(seed), recorded.poses[0, :2]
    found: list[Measurement] = []
    for k in range(0, len(recorded.t), 2):
        if k:
            moved = recorded.poses[k, :2] - recorded.poses[k - 2, :2]
            times = scale if during[0] <= recorded.t[k] < during[1] else 1.0
            place = place + times * moved + 0.001 * noise.standard_normal(2)
        pose = np.append(place, recorded.poses[k, 2])
        found.append(pose_of(S + round(recorded.t[k] * S), pose))
    return found


def slipping(recorded: Recording, slip: float) -> list[Measurement]:
    """The measurements without fixes after ``ALONE``, when both tracks begin to slip."""
    more, begin = 1.0 / (1.0 - slip), 1.001 + ALONE
    kept = changed(recorded.measurements, PoseFix, lambda _: None, begin)
    return changed(
        kept,
        Sprockets,
        lambda m: replace(m, left_speed=m.left_speed * more, right_speed=m.right_speed * more),
        begin,
    )


def run(
    given: list[Measurement], recorded: Recording, p: SlipEstimatorParameters
) -> tuple[list[Report], PoseErrors, SlipEstimator]:
    """Reports on the odometry, errors of the estimates, and the estimator at the end."""
    estimator = SlipEstimator(p)
    steps = estimator.process_all(sorted(given, key=lambda m: m.stamp_ns))
    reports = [r for r, _ in steps if r.source == SOURCE]
    return reports, pose_errors((e for _, e in steps), recorded.t, recorded.poses), estimator


def alone(found: PoseErrors) -> tuple[float, float]:
    """Position error at the end, m, and mean NEES without fixes."""
    without_fixes = found.between(ALONE)
    return float(without_fixes.distances[-1]), float(without_fixes.nees(2).mean())


@pytest.mark.parametrize("slip", [0.1, 0.3])
def test_odometry_bridges_new_ground_without_fixes(slip: float) -> None:
    """The sprockets include the slip in the distance; a camera with 1 % error corrects the slip."""
    recorded = drive(Machine(duration=70.0, seed=1, track_error=0.05))
    given = slipping(recorded, slip)
    blind, _ = alone(run(given, recorded, with_odometry())[1])
    reports, found, _ = run([*given, *seen(recorded, 1.01)], recorded, with_odometry())
    error, nees = alone(found)
    assert blind > 10.0 * slip
    assert error < 0.4
    assert nees < 25.0
    assert {r.outcome for r in reports[1:]} == {Outcome.ACCEPTED}


def test_odometry_scale_is_estimated_from_fixes_and_kept() -> None:
    """Without the scale, 3 % of the following 12 m would be 0.36 m."""
    recorded = drive(Machine(duration=70.0, seed=2))
    p = with_odometry(**{f"sources.{SOURCE}.drift": 0.03})
    error, nees = alone(run([*slipping(recorded, 0.1), *seen(recorded, 1.03)], recorded, p)[1])
    assert error < 0.25
    assert nees < 12.0


@pytest.mark.parametrize("scale", [0.0, 1.3])
def test_wrong_odometry_does_not_degrade_fixes(scale: float) -> None:
    """The scale of the odometry is wrong for 15 s; fixes have 5 cm."""
    nees = []
    for seed in range(2):
        recorded = drive(Machine(duration=80.0, seed=seed, fix_noise=0.05, fix_stated=0.05, track_error=0.05))
        given = [*recorded.measurements, *seen(recorded, scale, seed, (30.0, 45.0))]
        _, found, estimator = run(given, recorded, with_odometry(**GNSS))
        assert found.between(30.0, 55.0).rms < 0.15
        nees.append(found.between(34.0, 55.0).nees(2).mean())  # five fixes, 2 s, detect the scale
        happened = [e.event for e in estimator.read_events() if e.source == SOURCE]
        assert happened[0] is Event.FAILED
        assert happened[-1] is Event.RECOVERED
    assert np.mean(nees) < 5.0  # 2 if consistent


def test_correct_odometry_causes_no_event() -> None:
    recorded = drive(Machine(duration=60.0, fix_noise=0.05, fix_stated=0.05, track_error=0.05))
    *_, estimator = run([*recorded.measurements, *seen(recorded)], recorded, with_odometry(**GNSS))
    assert not {e.event for e in estimator.read_events()} - {Event.OUTLIER}


def test_order_of_arrival_does_not_matter() -> None:
    recorded = drive(Machine(duration=12.0))
    in_order = sorted([*recorded.measurements, *seen(recorded)], key=lambda m: m.stamp_ns)
    assert_order_does_not_matter(with_odometry(), in_order)


def test_gap_and_other_frame_restart_and_a_jump_is_rejected_once() -> None:
    recorded = drive(Machine(duration=20.0))
    odometry = seen(recorded)
    stamps = [m.stamp_ns for m in odometry]
    far = np.array((100.0, 50.0, 3.0))
    moved = [
        replace(
            m, position=m.position + far * (m.stamp_ns >= stamps[60]), frame=7 + (m.stamp_ns >= stamps[100])
        )
        for m in odometry
        if not stamps[140] <= m.stamp_ns < stamps[150]
    ]
    reports, _, _ = run([*recorded.measurements, *moved], recorded, with_odometry())
    outcomes = {r.stamp_ns: r.outcome for r in reports if r.outcome is not Outcome.ACCEPTED}
    expected = {stamps[60]: Outcome.GATED, stamps[100]: Outcome.BEGUN, stamps[150]: Outcome.BEGUN}
    assert {stamp: outcome for stamp, outcome in outcomes.items() if stamp > stamps[10]} == expected


@pytest.mark.parametrize("rate", [0.0, 0.8, -2.5])
def test_increment_is_the_twist_of_a_circle(rate: float) -> None:
    """Exact for arcs of up to half a turn, with a camera that is rotated and off the centre."""
    v, T = 0.4, 1.2
    turn = rate * T
    x, y = (v / rate * np.sin(turn), v / rate * (1.0 - np.cos(turn))) if rate else (v * T, 0.0)
    first, second = pose_of(S, np.zeros(3)), pose_of(2 * S, np.array((x, y, turn)))
    c = SimpleNamespace(levers=np.array([LEVER]), mountings=np.array([quaternion_from_angles(*MOUNTING)]))
    measured = SimpleNamespace(source=0, value=second.position, orientation=second.orientation)
    found = increment.py_func(  # type: ignore[attr-defined]  # numba's
        first, measured, T, c
    )
    np.testing.assert_allclose(found, (v, 0.0, rate), atol=1e-12)


def test_covariance_is_the_twists_or_the_growth_of_the_poses_or_declared() -> None:
    def stated(kind: int, before: np.ndarray, now: np.ndarray) -> np.ndarray:
        c = SimpleNamespace(
            levers=np.array([(1.0, 2.0, 0.0)]),
            mountings=np.array([quaternion_from_angles(0.0, 0.0, np.pi / 2.0)]),
            odometry_noise=[kind],
            odometry_variances=np.array([(0.09, 0.01)]),
        )
        measured = SimpleNamespace(source=0, noise=now)
        return stated_variances.py_func(  # type: ignore[attr-defined]  # numba's
            SimpleNamespace(noise=before), measured, 0.5, c
        )

    nothing, twist = np.zeros((2, 3)), np.array(((1e-4, 4e-4, 0.0), (0.0, 0.0, 1e-6)))
    by_turn, twist_there = np.array((4e-6, 1e-6, 0.0)), np.array((4e-4, 1e-4, 1e-6))
    np.testing.assert_allclose(stated(TWIST, nothing, twist), by_turn + twist_there, rtol=1e-9)
    grown = twist + np.array(((2e-4, 4e-4, 0.0), (0.0, 0.0, 1e-6)))
    np.testing.assert_allclose(
        stated(POSE_GROWTH, twist, grown), (1.2e-3, 1.2e-3, 4e-6) + 4.0 * by_turn, rtol=1e-9
    )
    for kind, now in ((TWIST, nothing), (POSE_GROWTH, twist)):  # none is stated, or it does not grow
        np.testing.assert_allclose(stated(kind, now, now), (0.09 + 0.04, 0.09 + 0.01, 0.01))


@pytest.mark.parametrize(
    ("covariance", "rejection"),
    [("twist", Rejection.NO_VELOCITY), ("pose", Rejection.NO_POSE), ("declared", None)],
)
def test_a_covariance_that_is_absent_is_refused_by_name(covariance: str, rejection: Rejection | None) -> None:
    absent = np.zeros(36)
    absent[0] = -1.0
    pose = make("geometry_msgs/msg/Pose", orientation=make("geometry_msgs/msg/Quaternion", w=1.0))
    message = make(
        "nav_msgs/msg/Odometry",
        header=header(make, 5 * S, "odom"),
        pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=absent),
        twist=make("geometry_msgs/msg/TwistWithCovariance", covariance=absent),
    )
    stated = with_odometry(**{f"sources.{SOURCE}.covariance": covariance}).odometries()[SOURCE]
    found = odometry_pose(message, SOURCE, stated)
    assert found is rejection if rejection else found.stamp_ns == 5 * S


def test_too_many_are_refused_in_a_line() -> None:
    with pytest.raises(InputError, match=r"odometry_sources: 3 sources; accepted: at most 2"):
        parameters(odometry_sources=["a", "b", "c"])
