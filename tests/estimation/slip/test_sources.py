# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of each source: lever arm, sign, use of the heading, noise floors, timeout."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fixtures.filter_steps import config_of

from trackslip_common.errors import InputError
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.observations.pose import is_heading_used
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import STATE, to_records
from trackslip_estimation.slip.update import observe

S = 1_000_000_000
LEVER = (0.8, -0.4)


FLOORS = {
    "sources.box_pose.position_floor": 0.001,
    "sources.box_pose.heading_floor": 0.001,
    "sources.box_pose.heading_ceiling": 0.3,
}


def displaced(found: list[Measurement], truth: dict[int, Any]) -> list[Measurement]:
    """The fixes as measured by an antenna at ``LEVER``, without heading."""
    moved: list[Measurement] = []
    for m in found:
        if isinstance(m, PoseFix):
            heading = truth[m.stamp_ns][2]
            c, s = np.cos(heading), np.sin(heading)
            arm = np.array((c * LEVER[0] - s * LEVER[1], s * LEVER[0] + c * LEVER[1], 0.0))
            covariance = m.covariance.copy()
            covariance[2, 2] = 0.0
            moved.append(replace(m, pose=(m.pose + arm) * (1.0, 1.0, 0.0), covariance=covariance))
        else:
            moved.append(m)
    return moved


def end_of(found: list[Measurement], **changes: Any) -> tuple[Any, list[Outcome]]:
    estimator = SlipEstimator(load_slip_parameters(changes))
    outcomes = [estimator.process(m)[0].outcome for m in found]
    return estimator.estimate(), outcomes


ANTENNA = {"sources.box_pose.lever_arm_x": LEVER[0], "sources.box_pose.lever_arm_y": LEVER[1]}


@pytest.mark.parametrize(("model", "filter_"), [("turning", "ekf"), ("icr", "daf")])
def test_antenna_off_centre_gives_the_pose_of_base_link(
    drive: Callable[..., Any], model: str, filter_: str
) -> None:
    driven = drive([(6.0, 2.0, 2.0, 0.05, 0.05, 0.0), (9.0, 1.0, 2.0, 0.0, 0.1, 0.0)])
    found = displaced(driven.measurements, driven.truth)
    chosen = {"model": model, "filter": filter_, "sources.box_pose.use_heading": False}
    chosen["initial_yaw_stddev"] = 0.02
    end, outcomes = end_of(found, **chosen, **ANTENNA)
    truth = driven.truth[end.stamp_ns]
    assert np.hypot(*(end.pose - truth[:3])[:2]) < 0.06
    assert abs(end.pose[2] - truth[2]) < 0.05
    assert outcomes.count(Outcome.GATED) < 3
    ignored = end_of(found, **chosen)[0]
    assert np.hypot(*(ignored.pose - truth[:3])[:2]) > 0.3


def test_positions_with_a_lever_arm_give_the_heading(drive: Callable[..., Any]) -> None:
    driven = drive([(15.0, 2.0, 2.0, 0.05, 0.05, 0.0)])
    found = displaced(driven.measurements, driven.truth)
    changes = {"sources.box_pose.use_heading": False, "initial_yaw": 0.3, "initial_yaw_stddev": 0.5}
    end, _ = end_of(found, **changes, **ANTENNA)
    assert abs(end.pose[2]) < 0.05
    assert np.sqrt(end.pose_covariance[2, 2]) < 0.05


@pytest.mark.parametrize("variance", [0.0, 1e6, -1.0, np.nan])
def test_a_heading_that_is_not_used_may_have_any_variance(drive: Callable[..., Any], variance: float) -> None:
    """GNSS drivers send 0 or 1e6; the heading at the start is that of the parameters then."""
    found = drive([(2.0, 2.0, 2.0, 0.05, 0.05, 0.0)]).measurements
    spoilt = []
    for m in found:
        if isinstance(m, PoseFix):
            covariance = m.covariance.copy()
            covariance[2, 2] = variance
            spoilt.append(replace(m, pose=m.pose + np.array((0.0, 0.0, 2.0)), covariance=covariance))
        else:
            spoilt.append(m)
    end, outcomes = end_of(
        spoilt, **{"sources.box_pose.use_heading": False}, initial_yaw=0.1, initial_yaw_stddev=0.01
    )
    assert Outcome.INVALID not in outcomes
    assert end.pose[2] == pytest.approx(0.1, abs=0.05)
    used = SlipEstimator(load_slip_parameters({}))
    first = used.process(next(m for m in spoilt if isinstance(m, PoseFix)))[0].outcome
    assert first is (Outcome.ACCEPTED if variance > 0.0 else Outcome.INVALID)


def test_each_source_has_its_own_settings(drive: Callable[..., Any]) -> None:
    """Fixes of the laser's box have a heading; those of the antenna need its lever arm and have none."""
    driven = drive([(6.0, 2.0, 2.0, 0.05, 0.05, 0.0), (9.0, 1.0, 2.0, 0.0, 0.1, 0.0)])
    gnss = [
        replace(m, source="gnss", stamp_ns=m.stamp_ns + 1)
        for m in displaced(driven.measurements, driven.truth)
        if isinstance(m, PoseFix)
    ]
    both = sorted([*driven.measurements, *gnss], key=lambda m: m.stamp_ns)
    changes: dict[str, Any] = {
        "pose_sources": ["box_pose", "gnss"],
        "sources.gnss.use_heading": False,
        "sources.gnss.lever_arm_x": LEVER[0],
        "sources.gnss.lever_arm_y": LEVER[1],
    }
    estimator = SlipEstimator(load_slip_parameters(changes))
    reports = [estimator.process(m)[0] for m in both]
    degrees = {
        source: {r.dof for r in reports if r.source == source and r.dof} for source in changes["pose_sources"]
    }
    assert degrees == {"box_pose": {3}, "gnss": {2}}
    assert sum(r.outcome is Outcome.GATED for r in reports) < 3


def test_no_variance_is_below_the_floors() -> None:
    tiny = PoseFix("box_pose", S, np.zeros(3), np.diag((1e-12, 1e-12, 1e-12)))
    estimator = SlipEstimator(
        load_slip_parameters(
            {"sources.box_pose.position_floor": 0.02, "sources.box_pose.heading_floor": 0.01}
        )
    )
    assert estimator.process(tiny)[0].outcome is Outcome.ACCEPTED
    end = estimator.estimate()
    np.testing.assert_allclose(np.sqrt(np.diag(end.pose_covariance)), (0.02, 0.02, 0.01))
    c, names = config_of(FLOORS)[0], estimator.sources
    wide, narrow = np.diag((1.0, 2.0, 0.05)), np.diag((1e-12, 2.0, 1e-12))
    for R, used in ((wide, wide), (narrow, np.diag((1e-6, 2.0, 1e-6)))):
        fix = to_records((PoseFix("box_pose", S, np.ones(3), R),), names)[0]
        o = observe(np.zeros(1, STATE)[0], fix, c)
        np.testing.assert_array_equal(o.innovation, 1.0)
        np.testing.assert_allclose(o.noise, used)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"sources.box_pose.timeouts": 1.0},
            "unknown parameter 'sources.box_pose.timeouts', did you mean 'sources.box_pose.timeout'?",
        ),
        ({"sources.boxpose.timeout": 1.0}, "did you mean 'sources.box_pose'?"),
        (
            {"sources.rtk.lever_arm_x": 1.0},
            "unknown parameter 'sources.rtk.lever_arm_x'; accepted: sources.box_pose, sources.imu_data_raw",
        ),
        ({"sources.imu_data_raw.use_heading": True}, "unknown parameter 'sources.imu_data_raw.use_heading'"),
        (
            {"sources.box_pose": 1.0},
            "unknown parameter 'sources.box_pose'; accepted: sources.box_pose.timeout",
        ),
        ({"sources.box_pose.lever_arm_x": []}, "sources.box_pose.lever_arm_x: [] is not a number"),
        ({"sources.box_pose.lever_arm_x": 1e3}, "lever_arm_x: 1000.0 is out of range; accepted: >= -100 and"),
        (
            {"sources.imu_data_raw.sign": 0},
            "sources.imu_data_raw.sign: 0 is out of range; accepted: one of 1, -1",
        ),
        ({"pose_sources": ["a", "a"]}, "pose_sources: 'a': one is named twice; accepted: each once"),
        ({"pose_sources": ["imu/data_raw"]}, "yaw_rate_sources: 'imu/data_raw': one is named twice"),
        ({"pose_sources": ["a/b", "a_b"]}, "pose_sources: 'a_b': 'a/b' has the same name"),
        ({"pose_sources": "box_pose"}, "pose_sources: 'box_pose' is not a list of text"),
        ({"sources.box_pose.timeout": 0.0}, "sources.box_pose.timeout: 0.0 is out of range"),
        ({"sources.box_pose.position_floor": 0.0}, "sources.box_pose.position_floor: 0.0 is out of range"),
    ],
)
def test_inconsistent_source_settings_are_refused_in_one_line(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as refused:
        load_slip_parameters(changes)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_sign_of_a_gyro_upside_down_is_inverted(drive: Callable[..., Any]) -> None:
    driven = drive([(10.0, 1.0, 2.0, 0.0, 0.1, 0.0)])
    flipped = [replace(m, rate=-m.rate) if isinstance(m, YawRate) else m for m in driven.measurements]
    right, outcomes = end_of(flipped, **{"sources.imu_data_raw.sign": -1})
    np.testing.assert_array_equal(right.pose, end_of(driven.measurements)[0].pose)
    assert Outcome.GATED not in outcomes


def test_a_source_may_be_bound_to_a_frame() -> None:
    p = load_slip_parameters({"sources.box_pose.frame_id": "map"})
    assert p.frames_of_sources() == {"box_pose": "map"}
    assert load_slip_parameters().frames_of_sources() == {}


def test_no_sources_at_all_are_allowed() -> None:
    p = load_slip_parameters({"pose_sources": [""], "yaw_rate_sources": [""], "start": "initial_pose"})
    assert p.timeouts_ns() == {}
    assert SlipEstimator(p).process(Sprockets("sprockets", S, 0.0, 0.0))[0].outcome is Outcome.ACCEPTED


def test_uncertain_heading_is_not_a_measurement() -> None:
    """The box localizer states a large variance where the orientation is ambiguous."""
    c = config_of(FLOORS)[0]
    fixes = [
        PoseFix("box_pose", 0, np.zeros(3), np.diag((1e-4, 1e-4, stddev**2)))
        for stddev in (0.05, 0.29, 0.31, 0.6)
    ]
    records, state = to_records(fixes, {"box_pose": 0}), np.zeros(1, STATE)[0]
    assert [is_heading_used(record, state, c) for record in records] == [True, True, False, False]
    assert [len(observe(state, record, c).innovation) for record in records] == [3, 3, 2, 2]


def test_settings_of_a_source_that_another_layer_removes_are_accepted() -> None:
    reported = {"pose_sources": ["rtk"], "sources.rtk.lever_arm_x": 0.3}
    p = load_slip_parameters(reported)
    assert list(p.sources) == ["rtk", "imu_data_raw"]
    assert (p.poses()["rtk"].lever, p.poses()["rtk"].stamp_error) == ((0.3, 0.0, 0.0), 0.03)
    assert list(load_slip_parameters(reported, {"pose_sources": [""]}).sources) == ["imu_data_raw"]
    assert list(p.changed({"pose_sources": ["box_pose"]}).sources) == ["box_pose", "imu_data_raw"]


def test_stamp_error_of_the_box_is_below_that_of_an_unknown_source() -> None:
    assert load_slip_parameters().poses()["box_pose"].stamp_error == 0.003
    assert load_slip_parameters({"pose_sources": ["fix"]}).poses()["fix"].stamp_error == 0.03


def test_the_antenna_is_where_the_vehicle_has_it_unless_the_source_states_otherwise() -> None:
    given = {"vehicle": "excavator_20t", "pose_sources": ["box_pose", "gnss_pose"]}
    p = load_slip_parameters(given)
    assert p.vehicle.sensors is not None
    assert p.vehicle.sensors.antenna is not None
    antenna = p.vehicle.sensors.antenna
    assert p.poses()["gnss_pose"].lever == (antenna.x, antenna.y, antenna.z)
    assert p.poses()["box_pose"].lever == (0.0, 0.0, 0.0)
    own = load_slip_parameters(given, {"sources.gnss_pose.lever_arm_x": 0.5}).poses()["gnss_pose"]
    assert own.lever == (0.5, antenna.y, antenna.z)
