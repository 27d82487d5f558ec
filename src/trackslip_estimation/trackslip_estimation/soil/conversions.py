# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Conversions between messages and the records of the soil estimator, without logic."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.make import MessageFactory, header
from trackslip_common.message_fields import ABSENT, HydraulicsFields, MachineStateFields
from trackslip_common.message_reading import read
from trackslip_estimation.slip.measurements import UNOBSERVED
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.records import (
    Hydraulics,
    MachineState,
    PoseWithCovariance,
    SlipSeed,
    TrackForces,
)
from trackslip_estimation.soil.soil_estimator import SoilOutput, SoilState

# Fields of the message, each left and right, and of the record
_PAIRS = (
    ("thrust", "thrust"),
    ("resistance", "resistance"),
    ("thrust_variance", "thrust_variance"),
    ("resistance_variance", "resistance_variance"),
    ("thrust_reserve", "reserve"),
)
_SIDES = ((0, "left"), (1, "right"))
_MOTIONS = {int(state): state for state in Motion}
FORCES, SOIL, SEED = "track_forces", "soil", "slip_seed"  # topics of the outputs


def hydraulics(message: Any) -> Hydraulics:
    """Return the record of a trackslip_msgs/TrackHydraulics."""
    return Hydraulics(*read(HydraulicsFields, message))


def machine_state(message: Any) -> MachineState:
    """Return the record of a trackslip_msgs/MachineState; undefined states of motion become UNKNOWN."""
    m = read(MachineStateFields, message)
    pose = PoseWithCovariance(np.array((m.x, m.y, m.heading)), m.pose_covariance)
    has_attitude, has_swing = m.attitude_covariance[0, 0] != ABSENT, m.swing_covariance[0, 0] != ABSENT
    return MachineState(
        m.stamp_ns,
        np.array((m.v_x, m.v_y, m.yaw_rate)),
        m.twist_covariance,
        pose,
        np.array((m.left_slip, m.right_slip, m.slip_angle)),
        _MOTIONS.get(m.motion_state, Motion.UNKNOWN),
        (m.roll, m.pitch) if has_attitude else (0.0, 0.0),
        (float(m.attitude_covariance[0, 0]), float(m.attitude_covariance[1, 1]))
        if has_attitude
        else (math.inf, math.inf),
        m.swing if has_swing else 0.0,
        float(m.swing_covariance[0, 0]) if has_swing else math.inf,
    )


def message_of(make: MessageFactory, output: SoilOutput, base_frame: str) -> Any:
    """Return the message for an output: trackslip_msgs/TrackForces, SoilEstimate or TrackSlip."""
    if isinstance(output, TrackForces):
        return track_forces(make, output, base_frame)
    if isinstance(output, SlipSeed):
        return slip_seed(make, output, base_frame)
    return soil_estimate(make, output, base_frame)


def track_forces(make: MessageFactory, forces: TrackForces, base_frame: str) -> Any:
    """Return a trackslip_msgs/TrackForces."""
    fields = {f"{side}_{name}": getattr(forces, of)[k] for name, of in _PAIRS for k, side in _SIDES}
    return make("trackslip_msgs/msg/TrackForces", header=header(make, forces.stamp_ns, base_frame), **fields)


def force_columns(forces: NDArray[np.void]) -> dict[str, NDArray[np.float64]]:
    """Return the fields of trackslip_msgs/TrackForces but its header, from (n,) of ``FORCES``."""
    return {f"{side}_{name}": forces[of][:, k] for name, of in _PAIRS for k, side in _SIDES}


def topic_of(output: SoilOutput) -> str:
    """Return the topic of an output."""
    if isinstance(output, TrackForces):
        return FORCES
    return SEED if isinstance(output, SlipSeed) else SOIL


def slip_seed(make: MessageFactory, seed: SlipSeed, base_frame: str) -> Any:
    """Return a trackslip_msgs/TrackSlip with an unobserved slip angle."""
    covariance = np.diag((0.0, 0.0, UNOBSERVED))
    covariance[:2, :2] = seed.covariance
    left, right = (float(slip) for slip in seed.slips)
    return make(
        "trackslip_msgs/msg/TrackSlip",
        header=header(make, seed.stamp_ns, base_frame),
        left_slip=left,
        right_slip=right,
        slip_angle=0.0,
        covariance=covariance.flatten(),
        motion_state=int(Motion.STRAIGHT),
    )


def soil_estimate(make: MessageFactory, state: SoilState, base_frame: str) -> Any:
    """Return a trackslip_msgs/SoilEstimate."""
    strength = state.strength
    (k_low, k_high), (f_low, f_high) = strength.shear_modulus_interval, strength.thrust_limit_interval
    return make(
        "trackslip_msgs/msg/SoilEstimate",
        header=header(make, state.stamp_ns, base_frame),
        mu_r=state.mu_r,
        mu_r_variance=state.mu_r_variance,
        mu_l=state.mu_l,
        mu_l_variance=state.mu_l_variance,
        shear_modulus=strength.shear_modulus,
        shear_modulus_lower=k_low,
        shear_modulus_upper=k_high,
        max_tractive_effort=strength.thrust_limit,
        max_tractive_effort_lower=f_low,
        max_tractive_effort_upper=f_high,
        identifiable=strength.identifiable,
        reason=strength.reason,
        class_names=list(state.classes),
        class_probabilities=list(state.classes.values()),
    )
