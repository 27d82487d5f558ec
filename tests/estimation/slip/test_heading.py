# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Headings as a source: at the start, in the gate, in any order; and fixes with time-correlated errors."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fixtures.drawn_machine import Machine, Recording, drive, parameters
from fixtures.pose_errors import PoseErrors, pose_errors
from fixtures.records import assert_order_does_not_matter
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.errors import InputError
from trackslip_common.make import header
from trackslip_common.nodes.messages import make
from trackslip_estimation.slip.adaptation import correlated_inflation
from trackslip_estimation.slip.conversions import heading_fix
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import (
    FREEZE,
    Command,
    HeadingFix,
    Measurement,
    Outcome,
    PoseFix,
)
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.sources import Rejection

S = 1_000_000_000
OFFSET, STDDEV = 0.7, 0.004
LEVER = (-1.2, 0.6)
SOURCE = "heading"


def with_headings(**changed: object) -> SlipEstimatorParameters:
    values = {
        "heading_sources": [SOURCE],
        "sources.heading.offset": OFFSET,
        "sources.heading.stamp_error": 0.0,
        "sources.heading.yaw_offset_stddev": 0.02,  # of a pair of antennas
        "sources.box_pose.lever_arm_x": LEVER[0],
        "sources.box_pose.lever_arm_y": LEVER[1],
    }
    return parameters(**{**values, **changed})


def seen(machine: Machine, angle: float = 0.0, hertz: int = 10) -> tuple[Recording, list[Measurement]]:
    """A drive in a site frame turned by ``angle``: fixes of an antenna at LEVER, and mounted headings."""
    recorded, noise = drive(machine), np.random.default_rng(machine.seed + 100)
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array(((cos, -sin), (sin, cos)))
    poses = np.column_stack((recorded.poses[:, :2] @ turn.T, recorded.poses[:, 2] + angle))
    stamps = (S + np.round(recorded.t * S)).astype(np.int64)
    measurements: list[Measurement] = []
    for m in recorded.measurements:
        if isinstance(m, PoseFix):
            x, y, yaw = poses[np.searchsorted(stamps, m.stamp_ns)]
            cos, sin = math.cos(yaw), math.sin(yaw)
            error = turn @ (m.pose[:2] - recorded.poses[np.searchsorted(stamps, m.stamp_ns), :2])
            at = (x + cos * LEVER[0] - sin * LEVER[1], y + sin * LEVER[0] + cos * LEVER[1])
            measurements.append(PoseFix(m.source, m.stamp_ns, np.array((*(at + error), 0.0)), m.covariance))
        else:
            measurements.append(m)
    for k in range(0, len(stamps), 20 // hertz):
        shown = math.remainder(poses[k, 2] + OFFSET + STDDEV * noise.standard_normal(), math.tau)
        measurements.append(HeadingFix(SOURCE, int(stamps[k]), shown, STDDEV**2))
    measurements.sort(key=lambda m: m.stamp_ns)
    return Recording(measurements, recorded.t, poses), measurements


def run(
    measurements: list[Measurement], truth: Recording, p: SlipEstimatorParameters
) -> tuple[PoseErrors, dict[int, Outcome]]:
    """Errors of the estimates; outcomes of the headings by stamp."""
    steps = SlipEstimator(p).process_all(measurements)
    outcomes = {r.stamp_ns: r.outcome for r, _ in steps if r.source == SOURCE}
    return pose_errors((e for _, e in steps), truth.t, truth.poses), outcomes


@pytest.mark.parametrize("filter_", ["ekf", "daf"])
@pytest.mark.parametrize("angle", [2.0, math.pi])
def test_start_heading_is_that_of_the_heading_source(angle: float, filter_: str) -> None:
    truth, measurements = seen(Machine(duration=20.0, seed=2), angle)
    errors, outcomes = run(measurements, truth, with_headings(filter=filter_))
    found = errors.between(0.5)  # still at standstill
    assert np.abs(found.off[:, 2]).max() < 0.015
    assert found.distances.max() < 0.12
    assert Outcome.GATED not in list(outcomes.values())[3:]
    assert found.nees(3).mean() < 6.0


def test_heading_is_better_with_the_source_than_without() -> None:
    machine = Machine(duration=60.0, gyro_scale=1.03, track_error=0.03)
    truth, measurements = seen(machine)
    with_source, _ = run(measurements, truth, with_headings())
    fixes_only = [m for m in measurements if not isinstance(m, HeadingFix)]
    lever = {f"sources.box_pose.lever_arm_{axis}": LEVER[k] for k, axis in enumerate("xy")}
    without, _ = run(fixes_only, truth, parameters(**lever))
    scatter, before = (np.std(found.between(10.0).off[:, 2]) for found in (with_source, without))
    assert scatter < 0.004
    assert scatter < 0.5 * before


def test_a_spike_is_rejected_and_a_persistent_heading_is_accepted() -> None:
    truth, measurements = seen(Machine(duration=60.0, seed=3))
    headings = [k for k, m in enumerate(measurements) if isinstance(m, HeadingFix)]
    spoilt = [*measurements]
    m = spoilt[headings[150]]
    assert isinstance(m, HeadingFix)
    spoilt[headings[150]] = HeadingFix(SOURCE, m.stamp_ns, m.heading + 0.3, m.variance)
    found, outcomes = run(spoilt, truth, with_headings())
    assert [stamp for stamp, outcome in outcomes.items() if outcome is Outcome.GATED] == [m.stamp_ns]
    assert np.abs(found.between(10.0).off[:, 2]).max() < 0.025

    turned = [
        HeadingFix(SOURCE, m.stamp_ns, math.remainder(m.heading + 0.3, math.tau), m.variance)
        if isinstance(m, HeadingFix) and m.stamp_ns > 11 * S
        else m
        for m in measurements
        if not (isinstance(m, PoseFix) and m.stamp_ns > 11 * S)  # fixes would contradict the headings
    ]
    found, outcomes = run(turned, truth, with_headings(**{"sources.heading.timeout": 2.0}))
    assert np.abs(found.between(-1.0, 12.0).off[:, 2]).max() < 0.02
    assert found.off[-1, 2] == pytest.approx(0.3, abs=0.02)
    rejected = [stamp for stamp, outcome in outcomes.items() if outcome is Outcome.GATED]
    assert 2.0 < (rejected[-1] - rejected[0]) / S < 25.0


def test_order_of_arrival_does_not_matter() -> None:
    assert_order_does_not_matter(with_headings(), seen(Machine(duration=15.0), 1.0)[1])


def test_frozen_estimate_ignores_headings() -> None:
    _, measurements = seen(Machine(duration=5.0))
    estimator = SlipEstimator(with_headings())
    estimator.process_all(measurements[:-20])
    estimator.apply_command(Command(FREEZE))
    steps = estimator.process_all(measurements[-20:])
    outcomes = {r.outcome for r, _ in steps if r.source == SOURCE}
    assert outcomes == {Outcome.FROZEN}


def quaternion(yaw: float) -> object:
    return make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))


@pytest.mark.parametrize("yaw", [0.0, 1.0, -3.0])
def test_messages_of_both_kinds(yaw: float) -> None:
    stamped = {"header": header(make, 5 * S, "antenna")}
    plain = make("geometry_msgs/msg/QuaternionStamped", **stamped, quaternion=quaternion(yaw))
    compass = with_headings(**{"sources.heading.stddev": 0.01}).compasses()[SOURCE]
    found = heading_fix(plain, SOURCE, compass)
    assert (found.stamp_ns, found.heading, found.variance) == (5 * S, pytest.approx(yaw), 1e-4)
    for first, stated, expected in ((0.0, 0.0, 1e-4), (1e6, 4e-6, 4e-6), (-1.0, 0.0, 0.0)):
        covariance = np.diag((first, first, stated)).ravel()
        covariance[0] = first
        imu = make(
            "sensor_msgs/msg/Imu", **stamped, orientation=quaternion(yaw), orientation_covariance=covariance
        )
        found = heading_fix(imu, SOURCE, compass)
        if first == -1.0:
            assert found is Rejection.NO_ORIENTATION
        else:
            assert (found.heading, found.variance) == (pytest.approx(yaw), expected)


@pytest.mark.parametrize(
    ("convention", "sign", "shown"),
    [
        ("enu", 1, 0.3),
        ("enu", -1, -0.3),
        ("compass", 1, math.pi / 2 - 0.3),
        ("compass", -1, 0.3 - math.pi / 2),
    ],
)
def test_angles_of_any_convention_become_headings_from_east(convention: str, sign: int, shown: float) -> None:
    stated = {"sources.heading.convention": convention, "sources.heading.sign": sign}
    compass = with_headings(**stated).compasses()[SOURCE]
    plain = make(
        "geometry_msgs/msg/QuaternionStamped", header=header(make, 5 * S, "a"), quaternion=quaternion(shown)
    )
    found = heading_fix(plain, SOURCE, compass)
    assert math.remainder(found.heading - 0.3, math.tau) == pytest.approx(0.0, abs=1e-12)


def test_source_of_an_unknown_kind_of_message_is_refused() -> None:
    with pytest.raises(InputError, match=r"message: .pose. is out of range; accepted: one of imu, quat"):
        with_headings(**{"sources.heading.message": "pose"})


@given(st.floats(0.001, 100.0), st.floats(0.001, 100.0))
def test_time_correlated_errors_count_as_their_mean_varies(elapsed: float, time: float) -> None:
    """Inflation: variance of the mean of many readings of a first-order process over that of white ones."""
    rho = math.exp(-elapsed / time)
    if rho < 1.0 - 1e-9:
        assert correlated_inflation(round(elapsed * S), time) == pytest.approx(
            (1.0 + rho) / (1.0 - rho), rel=1e-6
        )
    assert correlated_inflation(round(elapsed * S), 0.0) == 1.0


def test_mounting_angle_of_a_pose_source_is_estimated_from_the_path() -> None:
    """With a prior for the mounting angle the heading is consistent; without one it is not."""
    recorded = drive(Machine(duration=120.0, heading_noise=0.01))
    given_ = [
        replace(m, pose=m.pose + np.array((0.0, 0.0, 0.035))) if isinstance(m, PoseFix) else m
        for m in recorded.measurements
    ]
    nees = {}
    for stddev in (0.0, 0.02):
        p = parameters(**{"sources.box_pose.use_heading": True, "sources.box_pose.yaw_offset_stddev": stddev})
        found = run(given_, recorded, p)[0].between(60.0)
        nees[stddev] = found.heading_nees
    assert nees[0.0] > 5.0
    assert nees[0.02] < 3.0
    assert found.heading_rms < 0.015


def test_one_wrong_heading_after_an_outage_is_refused() -> None:
    """The heading is off by a quarter turn; the gate must not widen with the silence."""
    truth, measurements = seen(Machine(duration=100.0))
    outage = [m for m in measurements if not isinstance(m, HeadingFix) or not 31 * S < m.stamp_ns < 91 * S]
    back = next(k for k, m in enumerate(outage) if isinstance(m, HeadingFix) and m.stamp_ns > 90 * S)
    wrong = replace(outage[back], heading=math.remainder(outage[back].heading + math.pi / 2.0, math.tau))
    found, outcomes = run([*outage[:back], wrong, *outage[back + 1 :]], truth, with_headings())
    assert outcomes[wrong.stamp_ns] is Outcome.GATED
    assert np.abs(found.off[:, 2]).max() < 0.1
