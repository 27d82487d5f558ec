# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the weight does: it pulls along a slope, and loads the tracks unevenly there and as it swings.

Compiled.

    θ, ϕ         pitch (nose down > 0), roll (left side up > 0)                 rad
    σ, s         angle of the upper structure, its standard deviation           rad
    x_0, y_0, h  centre of gravity in base_link, the upper structure forward    m
    g            how far it goes back as that turns by π/2, m_u c/m             m
    x_g, y_g     x_0 + g (E[cos σ] - 1), y_0 + g E[sin σ]                       m
    G            m g sin θ, the weight along the tracks, forward                N
    N_j          m g cos θ cos ϕ (½ ± y_N/B): + left, y_N = y_g - h tan ϕ       N
    x_N          x_g + h tan θ/cos ϕ: centre of pressure                        m
    γ            share of F_max that is friction on level ground                1
    g_j          F_max of a track over that on level ground: 1 + γ (2 N_j/W - 1)   1
    strength at x ahead of C over its mean: 1 + x γ 12 x_N/l², not below 0

σ is Gaussian: E[cos σ] = k cos σ̂, E[sin σ] = k sin σ̂ with k = e^(-s²/2), and their variances are
½ (1 - k²) (1 ∓ k² cos 2σ̂). So one that is not known at all, s = ∞, puts x_g and y_g at the swing axis.
γ = W tan ϕ_s/(A c + W tan ϕ_s); only the sum of both is known, so γ is not: its spread is in that of g_j.
What acceleration adds to N_j and x_N is left out, for it comes and goes.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.units import GRAVITY
from trackslip_common.vehicle import Vehicle, VehicleParameters
from trackslip_estimation.slip.motion import Motion

_STANDING, _STRAIGHT, _TURNING = int(Motion.STANDING), int(Motion.STRAIGHT), int(Motion.TURNING)

CENTRE = np.dtype(  # the upper structure forward
    [
        ("x", "f8"),  # x_0, m
        ("y", "f8"),
        ("height", "f8"),
        ("height_variance", "f8"),  # m²
        ("balance", "f8"),  # g, m
    ]
)
GROUND_LOAD = np.dtype(
    [
        ("pull", "f8"),  # G, N
        ("pull_variance", "f8"),  # N², of errors of the tilt, which last
        ("normal", "f8", 2),  # N_j, N
        ("strength", "f8", 2),  # g_j
        ("strength_variance", "f8", 2),
        ("swing_variance", "f8"),  # what of it the swing is not known to
        ("lean", "f8"),  # γ 12 x_N/l², 1/m
        ("lean_stddev", "f8"),  # of what the swing is not known to
        ("stretch", "f8"),  # way along the ground over the horizontal one, 1/cos θ
        ("stretch_stddev", "f8"),  # of it, relative
    ]
)


@dataclass(frozen=True, kw_only=True)
class LoadParameters(Parameters):
    """What is assumed of soil and machine on slopes."""

    friction_share: float = parameter("share of F_max that is friction γ", ge=0.0, le=1.0)
    friction_share_stddev: float = parameter("its standard deviation", ge=0.0, le=1.0)
    level_share: float = parameter(
        "pull over weight up to which pressures at rest are offsets", gt=0.0, le=1.0
    )
    bucket_share: float = parameter(
        "standard deviation of what a bucket may have taken up at a stand, of the weight", ge=0.0, lt=1.0
    )
    filling_time: float = parameter("of a stand in which it may", unit="s", ge=0.0)


BURDEN = np.dtype(  # what the bucket may hold
    [
        ("has_bucket", "i8"),
        ("stood", "f8"),  # s since the tracks stand
        ("has_driven", "i8"),  # before that
        ("may_differ", "i8"),  # the machine may weigh more or less than it did at first
    ]
)
_LEAST = 0.05  # of g_j: a track that hardly touches the ground


def centre_of(vehicle: VehicleParameters) -> NDArray[Any]:
    """(1,) CENTRE; where it is not given, on the ground below C, give or take half the tread."""
    whole, balance = vehicle.whole(), vehicle.swing_balance
    centre = whole.centre_of_gravity
    if centre is None:
        return np.array([(0.0, 0.0, 0.0, (0.5 * whole.tread) ** 2, balance)], CENTRE)
    return np.array([(centre.x, centre.y, centre.z, 0.0, balance)], CENTRE)


def burden_of(vehicle: Vehicle) -> NDArray[Any]:
    """(1,) BURDEN at the start."""
    return np.array([(vehicle.bucket is not None, 0.0, 0, 0)], BURDEN)


@compiled
def follow_burden(burden: Any, sample: Any, p: Any) -> None:
    """Whether a bucket may have been filled by now: only while the tracks stand; ``p``: of LoadParameters."""
    if sample.motion == _STRAIGHT or sample.motion == _TURNING:
        burden.has_driven = 1
    burden.stood = burden.stood + sample.dt if sample.motion == _STANDING else 0.0
    if burden.has_bucket == 1 and burden.has_driven == 1 and burden.stood >= p.filling_time:
        burden.may_differ = 1


@compiled
def burden_variance(burden: Any, needed: float, p: Any) -> float:
    """Of the thrust that the weight ``needed``, N²: resistance and the pull of a slope grow with it alike."""
    return float((p.bucket_share * needed) ** 2 if burden.may_differ == 1 else 0.0)


@compiled
def _swung(centre: Any, sample: Any) -> tuple[float, float, float, float]:
    """x_g and y_g at a SAMPLE, m, and their variances, m²."""
    g, k = centre.balance, math.exp(-0.5 * sample.swing_variance)
    cos, sin = k * math.cos(sample.swing), k * math.sin(sample.swing)
    half, twofold = 0.5 * g * g * (1.0 - k * k), cos * cos - sin * sin
    return centre.x + g * (cos - 1.0), centre.y + g * sin, half * (1.0 - twofold), half * (1.0 + twofold)


@compiled
def set_load(load: Any, centre: Any, sample: Any, p: Any) -> None:
    """Fill a GROUND_LOAD at a SAMPLE; ``p``: record of SoilEstimatorParameters."""
    vehicle, friction, spread = p.vehicle, p.load.friction_share, p.load.friction_share_stddev
    roll, pitch = sample.tilt[0], sample.tilt[1]
    weight, down = vehicle.mass * GRAVITY, math.cos(pitch) * math.cos(roll)
    load.pull = weight * math.sin(pitch)
    load.pull_variance = (weight * math.cos(pitch)) ** 2 * sample.tilt_variance[1]
    x_g, y_g, of_x, of_y = _swung(centre, sample)
    x_N = x_g + centre.height * math.tan(pitch) / math.cos(roll)
    y_N = y_g - centre.height * math.tan(roll)
    uncertain = centre.height_variance * math.tan(roll) ** 2 + centre.height**2 * sample.tilt_variance[0]
    load.stretch = 1.0 / math.cos(pitch)
    load.stretch_stddev = abs(math.tan(pitch)) * math.sqrt(sample.tilt_variance[1])
    load.lean = friction * 12.0 * x_N / vehicle.contact_length**2
    load.lean_stddev = friction * 12.0 * math.sqrt(of_x) / vehicle.contact_length**2
    per_offset = (2.0 * down * friction / vehicle.tread) ** 2
    load.swing_variance = per_offset * of_y
    for k in range(2):
        share = 0.5 + (1.0 - 2.0 * k) * y_N / vehicle.tread
        load.normal[k] = weight * down * min(max(share, 0.0), 1.0)
        more = 2.0 * load.normal[k] / weight - 1.0
        load.strength[k] = max(1.0 + friction * more, _LEAST)
        load.strength_variance[k] = (spread * more) ** 2 + per_offset * uncertain + load.swing_variance
