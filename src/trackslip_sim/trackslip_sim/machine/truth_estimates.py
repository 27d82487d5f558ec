# SPDX-License-Identifier: Apache-2.0
"""The truth in the shape of what the estimators publish."""

import array
from typing import Any

import numpy as np

from trackslip_common.make import Make, header
from trackslip_common.soils import soil
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.slip.estimator import Estimate, Outputs
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.classes import limit_of
from trackslip_estimation.soil.conversions import track_forces
from trackslip_estimation.soil.records import TrackForces
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


def forces_message(make: Make, at: Truth, stamp_ns: int, vehicle: Vehicle, frame_id: str) -> Any:
    """trackslip_msgs/TrackForces of one sample of the truth."""
    limit = limit_of(soil(at.soil_name()), vehicle)
    left, right = float(at.left_thrust[0]), float(at.right_thrust[0])
    forces = TrackForces(
        stamp_ns,
        thrust=(left, right),
        thrust_variance=(0.0, 0.0),
        resistance=(float(at.left_resistance[0]), float(at.right_resistance[0])),
        resistance_variance=(0.0, 0.0),
        reserve=(1.0 - abs(left) / limit, 1.0 - abs(right) / limit),
    )
    return track_forces(make, forces, frame_id)


def soil_message(make: Make, at: Truth, stamp_ns: int, vehicle: Vehicle, frame_id: str) -> Any:
    """trackslip_msgs/SoilEstimate of the ground under C: intervals of no width, one class for certain."""
    ground = soil(at.soil_name())
    limit = limit_of(ground, vehicle)
    mobilised = float(at.turning_moment[0]) * 3.0 / (vehicle.weight * vehicle.contact_length)  # (3.8)
    modulus = ground.value("shear_modulus")
    return make(
        "trackslip_msgs/msg/SoilEstimate",
        header=header(make, stamp_ns, frame_id),
        mu_r=ground.value("mu_r"),
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
        class_names=[ground.name],
        class_probabilities=array.array("d", (1.0,)),
    )
