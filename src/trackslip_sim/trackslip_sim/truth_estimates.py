# SPDX-License-Identifier: Apache-2.0
"""The truth in the shape of what the estimators publish."""

import array
from typing import Any

import numpy as np

from trackslip_common.make import Make, header
from trackslip_estimation.filters.model import Outputs
from trackslip_estimation.motion import Motion
from trackslip_estimation.slip_estimator import Estimate
from trackslip_estimation.soils import load_soils
from trackslip_estimation.terramechanics.strength import thrust_limit
from trackslip_estimation.vehicle import Vehicle
from trackslip_sim.truth.record import Truth

_STANDING = 1e-3  # rad/s, both sprockets
_STRAIGHT = 0.02  # of the faster sprocket


def as_estimate(at: Truth, stamp_ns: int) -> Estimate:
    """One sample of the truth, certain of itself."""
    pose, twist, slips = (
        np.array([float(column[0]) for column in columns])
        for columns in (
            (at.x, at.y, at.yaw),
            (at.v_x, at.v_y, at.yaw_rate),
            (at.left_slip, at.right_slip, at.slip_angle),
        )
    )
    none = np.zeros((3, 3))
    return Estimate(stamp_ns, pose, none, Outputs(twist, none, slips, none), _motion(at))


def _motion(at: Truth) -> Motion:
    left, right = float(at.left_speed[0]), float(at.right_speed[0])
    fastest = max(abs(left), abs(right))
    if fastest < _STANDING:
        return Motion.STANDING
    return Motion.STRAIGHT if abs(right - left) < _STRAIGHT * fastest else Motion.TURNING


def soil_message(make: Make, at: Truth, stamp_ns: int, vehicle: Vehicle, frame_id: str) -> Any:
    """trackslip_msgs/SoilEstimate of the ground under C: intervals of no width, one class for certain."""
    soil = load_soils()[at.soil_name()]
    area = 2.0 * vehicle.track_width * vehicle.contact_length
    limit = float(thrust_limit(soil.cohesion, soil.friction_angle, area, vehicle.weight))
    mobilised = float(at.turning_moment[0]) * 3.0 / (vehicle.weight * vehicle.contact_length)  # (3.8)
    modulus = soil.value("shear_modulus")
    return make(
        "trackslip_msgs/msg/SoilEstimate",
        header=header(make, stamp_ns, frame_id),
        mu_r=soil.value("mu_r"),
        mu_r_variance=0.0,
        mu_l=mobilised,
        mu_l_variance=0.0,
        shear_modulus=modulus,
        shear_modulus_lower=modulus,
        shear_modulus_upper=modulus,
        max_tractive_effort=limit,
        max_tractive_effort_lower=limit,
        max_tractive_effort_upper=limit,
        identifiable=True,
        reason="",
        class_names=[soil.name],
        class_probabilities=array.array("d", (1.0,)),
    )
