# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The pose in the frame ``odom`` (REP-105): the integral of the estimated twist, which never jumps; compiled.

    x, y, ψ        pose in odom, from the first estimate on                m, m, rad
    v_x, v_y, ω    mean of the horizontal twists at both ends of an interval Δt   m/s, m/s, rad/s
    x += (v_x cos ψ' − v_y sin ψ') Δt,  y += (v_x sin ψ' + v_y cos ψ') Δt,  ψ += ω Δt,  ψ' = ψ + ω Δt/2
    P = F P Fᵀ + T Σ Tᵀ τ Δt    Σ covariance of the twist, correlation time τ of its errors
    z += ż Δt,  σ_z += σ_ż Δt   height, with constant errors of pitch and slips             m

A fix changes the twist at most. Where time goes back, or jumps by more than the longest interval, the pose is
held.
"""

import math
from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.record_types import Record, Table, dtype_of, make_table
from trackslip_estimation.attitude.records import HEIGHT
from trackslip_estimation.slip.estimator import Estimate, Tilt

Records = NDArray[np.void]

_LONGEST = 1.0  # s, longest interval that is integrated
_CORRELATION = 1.0  # s, τ


class TwistRecord(Record):
    """Twist of an estimate."""

    stamp_ns: int
    horizontal: Annotated[FloatArray, 3]
    twist_covariance: Annotated[FloatArray, (3, 3)]
    rise: float  # ż, m/s
    rise_variance: float


class LocalRecord(Record):
    """The pose in ``odom``, and its twist."""

    stamp_ns: int
    pose: Annotated[FloatArray, 3]
    pose_covariance: Annotated[FloatArray, (3, 3)]
    horizontal: Annotated[FloatArray, 3]
    height: float
    height_stddev: float
    rise: float  # ż, m/s
    begun: int  # 0 or 1


TWIST, LOCAL = dtype_of(TwistRecord), dtype_of(LocalRecord)


class LocalOdometry:
    """Integrates the estimates in the order of publication."""

    def __init__(self) -> None:
        self._local = make_table(LocalRecord, LOCAL, 1)
        self.advance(np.zeros(0, TWIST))  # compiles now

    def advance(self, estimates: Records) -> Records:
        """(n,) of ``LOCAL`` after each of (n,) records that have the fields of ``TWIST``."""
        twists = make_table(TwistRecord, TWIST, len(estimates))
        for name in TWIST.names or ():
            twists[name] = estimates[name]
        poses = make_table(LocalRecord, LOCAL, len(estimates))
        integrate(self._local, twists, poses)
        return poses

    def estimate_in_odom(self, estimate: Estimate) -> Estimate:
        """The estimate with its pose in ``odom``."""
        twist, outputs = np.zeros(1, TWIST), estimate.outputs
        twist["stamp_ns"], twist["horizontal"] = estimate.stamp_ns, outputs.horizontal
        twist["twist_covariance"] = outputs.twist_covariance
        twist["rise"], twist["rise_variance"] = outputs.rise, outputs.rise_variance
        local = self.advance(twist)[0]
        if outputs.tilt is not None:
            tilt = _replace_height(outputs.tilt, local["height"], local["height_stddev"])
            outputs = replace(outputs, tilt=tilt)
        return replace(
            estimate, pose=local["pose"], pose_covariance=local["pose_covariance"], outputs=outputs
        )


def _replace_height(tilt: Tilt, height: float, stddev: float) -> Tilt:
    """The tilt with the height in ``odom``."""
    mean, covariance = tilt.tilt.copy(), tilt.covariance.copy()
    mean[HEIGHT], covariance[HEIGHT], covariance[:, HEIGHT] = height, 0.0, 0.0
    covariance[HEIGHT, HEIGHT] = stddev**2
    return replace(tilt, tilt=mean, covariance=covariance)


@compiled
def integrate(last: Table[LocalRecord], twists: Table[TwistRecord], poses: Table[LocalRecord]) -> None:
    """Integrate (n,) of ``TWIST`` from ``last`` (1,) into (n,) of ``LOCAL``; update ``last``."""
    local = last[0]
    for k in range(len(twists)):
        twist = twists[k]
        dt = (twist.stamp_ns - local.stamp_ns) * 1e-9
        if local.begun == 1 and 0.0 < dt <= _LONGEST:
            _integrate_interval(local, twist, dt)
        local.begun, local.stamp_ns = 1, twist.stamp_ns
        local.horizontal[:], local.rise = twist.horizontal, twist.rise
        poses[k].begun, poses[k].stamp_ns = 1, twist.stamp_ns
        poses[k].horizontal[:], poses[k].pose[:] = local.horizontal, local.pose
        poses[k].pose_covariance[:] = local.pose_covariance
        poses[k].height, poses[k].height_stddev, poses[k].rise = local.height, local.height_stddev, local.rise


@compiled
def _integrate_interval(local: LocalRecord, twist: TwistRecord, dt: float) -> None:
    """Integrate one interval."""
    v_x = 0.5 * (local.horizontal[0] + twist.horizontal[0])
    v_y = 0.5 * (local.horizontal[1] + twist.horizontal[1])
    rate = 0.5 * (local.horizontal[2] + twist.horizontal[2])
    middle = local.pose[2] + 0.5 * rate * dt
    c, s = math.cos(middle), math.sin(middle)
    dx, dy = (v_x * c - v_y * s) * dt, (v_x * s + v_y * c) * dt
    local.pose[0] += dx
    local.pose[1] += dy
    local.pose[2] += rate * dt
    local.height += 0.5 * (local.rise + twist.rise) * dt
    local.height_stddev += math.sqrt(twist.rise_variance) * dt
    P, F, T = local.pose_covariance, np.eye(3), np.eye(3)
    F[0, 2], F[1, 2] = -dy, dx
    T[0, 0], T[0, 1], T[1, 0], T[1, 1] = c, -s, s, c
    propagated = F @ P @ F.T + T @ twist.twist_covariance @ T.T * (_CORRELATION * dt)
    P[:] = 0.5 * (propagated + propagated.T)
