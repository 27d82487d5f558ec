# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Attitude of a machine on the ground, and its pose from body velocities, compiled.

C moves on the ground, and the plane of the tracks is the ground's tangent plane at C (quasi-static attitude).

    ψ, θ, ϕ      heading, pitch (nose down > 0), roll (left side up > 0): ZYX, REP-103         rad
    g_f, g_l     slope of the ground ahead and to the left                                     1
    p, q, r      body rates; r = φ̇ of ``motion``, about the normal of the ground               rad/s
    u            horizontal velocity of C                                                      m/s
    H            second derivatives of the height; e_f, e_l horizontal, ahead and to the left  1/m

    tan θ = -g_f         tan ϕ = g_l cos θ
    ψ̇ = r cos ϕ/cos θ - cos θ sin ϕ cos ϕ e_fᵀ H u
"""

import math

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_sim.truth.terrain import TerrainMap, shape_at


@compiled
def attitude_of(shape: FloatArray, yaw: float) -> tuple[float, float]:
    """Pitch and roll, rad, on ground of this ``shape`` (6,)."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    pitch = -math.atan(cos * shape[1] + sin * shape[2])
    return pitch, math.atan((cos * shape[2] - sin * shape[1]) * math.cos(pitch))


@compiled
def pose_rates(
    shape: FloatArray, yaw: float, forward: float, left: float, turn: float
) -> tuple[float, float, float]:
    """ẋ, ẏ, ψ̇ from v_x, v_y, r; or the increments of the pose from increments in the body frame."""
    pitch, roll = attitude_of(shape, yaw)
    cos, sin = math.cos(yaw), math.sin(yaw)
    ahead = math.cos(pitch) * forward + math.sin(pitch) * math.sin(roll) * left
    beside = math.cos(roll) * left
    x, y = cos * ahead - sin * beside, sin * ahead + cos * beside
    twist = cos * (shape[3] * x + shape[4] * y) + sin * (shape[4] * x + shape[5] * y)
    yaw_change = (
        turn * math.cos(roll) / math.cos(pitch) - math.cos(pitch) * math.sin(roll) * math.cos(roll) * twist
    )
    return x, y, yaw_change


@compiled
def body_rates(
    shape: FloatArray, yaw: float, forward: float, left: float, turn: float
) -> tuple[float, float]:
    """p and q, rad/s, from v_x, v_y, r."""
    pitch, roll = attitude_of(shape, yaw)
    x, y, yaw_rate = pose_rates(shape, yaw, forward, left, turn)
    cos, sin = math.cos(yaw), math.sin(yaw)
    bend_x, bend_y = shape[3] * x + shape[4] * y, shape[4] * x + shape[5] * y
    ahead, beside = cos * shape[1] + sin * shape[2], cos * shape[2] - sin * shape[1]
    pitch_rate = -(math.cos(pitch) ** 2) * (cos * bend_x + sin * bend_y + beside * yaw_rate)
    steeper = cos * bend_y - sin * bend_x - ahead * yaw_rate
    roll_rate = math.cos(roll) ** 2 * (steeper * math.cos(pitch) - beside * math.sin(pitch) * pitch_rate)
    return (
        roll_rate - yaw_rate * math.sin(pitch),
        pitch_rate * math.cos(roll) + yaw_rate * math.cos(pitch) * math.sin(roll),
    )


@compiled
def advance_pose(
    pose: FloatArray, before: FloatArray, after: FloatArray, terrain: TerrainMap, step: float
) -> None:
    """Advance ``pose`` (x, y, yaw) by the mean of two velocities (v_x, v_y, r); ground at the midpoint."""
    forward = 0.5 * step * (before[0] + after[0])
    left = 0.5 * step * (before[1] + after[1])
    turn = 0.5 * step * (before[2] + after[2])
    shape = np.zeros(6)
    shape_at(pose[0], pose[1], terrain, shape)
    x, y, yaw = pose_rates(shape, pose[2], forward, left, turn)
    shape_at(pose[0] + 0.5 * x, pose[1] + 0.5 * y, terrain, shape)
    x, y, yaw = pose_rates(shape, pose[2] + 0.5 * yaw, forward, left, turn)
    pose[0] += x
    pose[1] += y
    pose[2] += yaw
