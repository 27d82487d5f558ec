# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Converts parameters of earlier versions, in bags and files, to the current names."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from trackslip_common.vehicle import Hydraulics
from trackslip_estimation.slip.sources import group_name, nonempty_names

# Until November 2026 each number of the sources was a list: one value per source, or one for all.
SOURCE_LISTS = {
    "pose_sources": {
        "pose_lever_arms_x": "lever_arm_x",
        "pose_lever_arms_y": "lever_arm_y",
        "pose_position_floors": "position_floor",
        "pose_heading_floors": "heading_floor",
        "pose_heading_ceilings": "heading_ceiling",
        "pose_stamp_errors": "stamp_error",
        "pose_timeouts": "timeout",
    },
    "yaw_rate_sources": {
        "yaw_rate_signs": "sign",
        "yaw_rate_scales": "scale",
        "yaw_rate_timeouts": "timeout",
    },
    "slip_sources": {"slip_timeouts": "timeout"},
}
# Until then a vehicle was a flat list of numbers without a name.
_VEHICLE = {
    **{name: f"kinematics.{name}" for name in ("rolling_radius", "tread", "contact_length")},
    **{name: f"mass.{name}" for name in ("mass", "yaw_inertia", "track_width")},
    **{f.name: f"hydraulics.{f.name}" for f in fields(Hydraulics)},
    **{f"box_{name}": f"sensors.box.{name}" for name in ("length", "width", "x", "y")},
}
# Until 28 November 2026 these had other names.
RENAMED = {
    "adaptation.rate_doubt": "adaptation.rate_odds",
    "events.stray_rate": "events.failure_rate",
    "events.stray_heading": "events.failure_heading",
    "bank.least_sound": "bank.least_healthy",
    "bank.alike": "bank.merge_distance",
    "bank.least_driven": "bank.least_distance",
    "bank.sound_share": "bank.healthy_share",
    "bank.longest_way": "bank.longest_interval",
    "receivers.way_error": "receivers.distance_error",
    "receivers.way_rate": "receivers.displacement_walk",
    "receivers.most_lasting": "receivers.most_correlated",
    "receivers.surprised": "receivers.largest_inflation",
    "ground.alike": "ground.agreement",
    "dynamics.unseen_walk": "dynamics.unmeasured_walk",
    "thrust.unseen_walk": "thrust.unmeasured_walk",
    "watch.naming_time": "watch.report_time",
    "watch.telling_difference": "watch.least_swap_difference",
    "strength.lasting_samples": "strength.correlated_samples",
    "strength.way_stddev": "strength.distance_stddev",
}
_DEFAULTS = {"pose_sources": ["box_pose"], "yaw_rate_sources": ["imu/data_raw"]}  # if none are named


def current_names(stated: Mapping[str, Any]) -> dict[str, Any]:
    """The same parameters under the current names."""
    values = {RENAMED.get(name, name): value for name, value in stated.items()}
    for kind, keys in SOURCE_LISTS.items():
        topics = _sources_of_kind(stated, kind)
        for old, key in keys.items():
            if old in values:
                values |= _parameter_per_source(topics, key, values.pop(old))
    vehicle = {name: f"vehicle.{new}" for name, new in _VEHICLE.items() if f"vehicle.{name}" in values}
    values |= {new: values.pop(f"vehicle.{name}") for name, new in vehicle.items()}
    if len(vehicle) == len(_VEHICLE):
        values["vehicle.name"] = "unnamed"
    poses, gyros = (_sources_of_kind(stated, kind) for kind in _DEFAULTS)
    if {"use_heading", "position_only"} & values.keys():
        used, without = values.pop("use_heading", True), _as_list(values.pop("position_only", ()))
        values |= _parameter_per_source(
            poses, "use_heading", [used and topic not in without for topic in poses]
        )
    if "yaw_rate_stddev" in values:
        values |= _parameter_per_source(gyros, "stddev", [values.pop("yaw_rate_stddev")])
    return values


def _sources_of_kind(stated: Mapping[str, Any], kind: str) -> list[str]:
    """The sources of a kind; items other than texts are ignored here, and rejected by the later check."""
    value = stated.get(kind, _DEFAULTS.get(kind, ()))
    return nonempty_names([topic for topic in _as_list(value) if isinstance(topic, str)])


def _as_list(value: Any) -> Sequence[Any]:
    return value if isinstance(value, (list, tuple)) else [value]


def _parameter_per_source(topics: Sequence[str], key: str, value: Any) -> dict[str, Any]:
    """One parameter per source from a list, or one value for all; excess sources or values are ignored."""
    values = _as_list(value)
    values = list(values) * len(topics) if len(values) == 1 else values
    return {f"sources.{group_name(topic)}.{key}": item for topic, item in zip(topics, values, strict=False)}
