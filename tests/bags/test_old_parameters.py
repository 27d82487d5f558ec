# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of earlier versions replay with the meaning that their parameters had."""

from typing import Any

import pytest

from trackslip_bags.old_parameters import RENAMED, current_names
from trackslip_common.errors import InputError
from trackslip_common.parameters import flat_fields
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.soil.soil_parameters import SoilEstimatorParameters


def test_lists_become_groups() -> None:
    stated = {
        "pose_sources": ["box_pose", "gnss/pose"],
        "position_only": ["gnss/pose"],
        "use_heading": True,
        "pose_lever_arms_x": [0.0, 0.4],
        "pose_timeouts": [2.0],
        "yaw_rate_sources": ["imu/data_raw"],
        "yaw_rate_signs": [-1],
        "yaw_rate_stddev": 0.01,
        "slip_sources": [""],
        "slip_timeouts": [3600.0],
    }
    p = load_slip_parameters(current_names(stated))
    assert [source.use_heading for source in p.poses().values()] == [True, False]
    assert [source.lever for source in p.poses().values()] == [(0.0, 0.0, 0.0), (0.4, 0.0, 0.0)]
    assert [source.timeout for source in p.poses().values()] == [2.0, 2.0]
    gyro = p.gyros()["imu/data_raw"]
    assert (gyro.sign, gyro.stddev) == (-1, 0.01)


def test_a_renamed_parameter_keeps_its_value() -> None:
    p = load_slip_parameters(current_names({"events.stray_rate": 1e-4, "receivers.way_error": 0.05}))
    assert (p.events.failure_rate, p.receivers.distance_error) == (1e-4, 0.05)


def test_each_renamed_parameter_exists() -> None:
    slip = {name for name, _, _ in flat_fields(SlipEstimatorParameters)}
    soil = {name for name, _, _ in flat_fields(SoilEstimatorParameters)}
    assert set(RENAMED.values()) <= slip | soil


@pytest.mark.parametrize("stated", [{}, {"pose_sources": ["rtk"], "sources.rtk.lever_arm_x": 0.3}])
def test_current_names_are_kept(stated: dict[str, Any]) -> None:
    assert current_names(stated) == stated


def test_old_mapping_without_sources_applies_to_the_default_sources() -> None:
    assert current_names({"use_heading": False}) == {"sources.box_pose.use_heading": False}


@pytest.mark.parametrize("wrong", [True, None, 3, {"a": 1}, [None, ["box_pose"]]])
@pytest.mark.parametrize("name", ["pose_sources", "slip_sources", "position_only", "pose_timeouts"])
def test_malformed_list_of_sources_is_refused(name: str, wrong: Any) -> None:
    """Old lists are converted without a check; the loader rejects malformed values."""
    stated = current_names({"pose_timeouts": [1.0], "use_heading": True, name: wrong})
    if name.endswith("_sources"):
        with pytest.raises(InputError, match=name):
            load_slip_parameters(stated)
