# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Effects of the weight: pull along a slope, and uneven track loads by slope and swing; compiled.

    θ, ϕ         pitch (nose down > 0), roll (left side up > 0)                 rad
    σ, s         angle of the upper structure, its standard deviation           rad
    x_0, y_0, h  centre of gravity in base_link, upper structure facing forward m
    g            its shift backwards at a swing of π/2, m_u c/m                 m
    x_g, y_g     x_0 + g (E[cos σ] - 1), y_0 + g E[sin σ]                       m
    G            m g sin θ, the weight along the tracks, forward                N
    N_j          m g cos θ cos ϕ (½ ± y_N/B): + left, y_N = y_g - h tan ϕ       N
    x_N          x_g + h tan θ/cos ϕ: centre of pressure                        m
    γ            share of friction in F_max on level ground                     1
    g_j          ratio of a track's F_max to that on level ground: 1 + γ (2 N_j/W - 1)  1
    ratio of the soil strength at x ahead of C to its mean: 1 + x γ 12 x_N/l², not below 0

σ is Gaussian: E[cos σ] = k cos σ̂, E[sin σ] = k sin σ̂ with k = e^(-s²/2), and their variances are
½ (1 - k²) (1 ∓ k² cos 2σ̂). For an unknown swing angle, s = ∞, x_g and y_g lie at the swing axis.
γ = W tan ϕ_s/(A c + W tan ϕ_s). Only the sum A c + W tan ϕ_s is observable: the variance of g_j includes that
of γ. Load transfer by acceleration is transient and neglected in N_j and x_N.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, NamedTuple

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record, Table, dtype_of, make_table
from trackslip_common.units import GRAVITY
from trackslip_common.vehicle import Vehicle, VehicleParameters
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.interpolation import Sample

if TYPE_CHECKING:
    from trackslip_estimation.soil.soil_parameters import SoilConfig

_STANDING, _STRAIGHT, _TURNING = int(Motion.STANDING), int(Motion.STRAIGHT), int(Motion.TURNING)


class GravityCentre(Record):
    """Centre of gravity in base_link, with the upper structure facing forward."""

    x: float  # x_0, m
    y: float
    height: float
    height_variance: float  # m²
    balance: float  # g, m


class GroundLoad(Record):
    """Effects of the weight at one sample."""

    pull: float  # G, N
    pull_variance: float  # N², of the tilt error, which is time-correlated
    normal: Annotated[FloatArray, 2]  # N_j, N
    strength: Annotated[FloatArray, 2]  # g_j
    strength_variance: Annotated[FloatArray, 2]
    swing_variance: float  # part of strength_variance due to the swing angle
    lean: float  # γ 12 x_N/l², 1/m
    lean_stddev: float  # 1/m, due to the swing angle
    stretch: float  # distance along the ground over the horizontal one, 1/cos θ
    stretch_stddev: float  # relative


class BucketLoad(Record):
    """State for detecting that the load of the bucket may have changed."""

    has_bucket: int
    standstill_time: float  # s
    has_driven: int  # whether the machine has driven since the start
    may_differ: int  # whether the mass may differ from the initial one


CENTRE, GROUND_LOAD, BUCKET_LOAD = dtype_of(GravityCentre), dtype_of(GroundLoad), dtype_of(BucketLoad)


@dataclass(frozen=True, kw_only=True)
class LoadParameters(Parameters):
    """Assumptions about soil and machine on slopes."""

    friction_share: float = parameter("share of friction in F_max, γ", ge=0.0, le=1.0)
    friction_share_stddev: float = parameter("standard deviation of γ", ge=0.0, le=1.0)
    unknown_slope: float = parameter(
        "standard deviation of the ground's slope along each axis where no IMU measures the tilt", ge=0.0
    )
    level_share: float = parameter(
        "ratio of pull to weight up to which pressures at standstill are offsets", gt=0.0, le=1.0
    )
    bucket_share: float = parameter(
        "standard deviation of the bucket load taken up at a standstill, as share of the weight",
        ge=0.0,
        lt=1.0,
    )
    filling_time: float = parameter(
        "standstill after which the bucket load may have changed", unit="s", ge=0.0
    )
    least_strength: float = parameter(
        "least ratio of F_max to that on level ground, of a track that hardly touches it", gt=0.0, lt=1.0
    )


class SwungCentre(NamedTuple):
    """Expected centre of gravity at the present swing angle, with its variances."""

    x: float  # x_g, m
    y: float  # y_g, m
    x_variance: float  # m²
    y_variance: float  # m²


def new_gravity_centre(vehicle: VehicleParameters) -> Table[GravityCentre]:
    """Return the centre of gravity (1,); by default at C on the ground, height stddev half the tread."""
    machine, centre = vehicle.whole(), make_table(GravityCentre, CENTRE, 1)
    centre["balance"] = vehicle.swing_balance
    stated = machine.centre_of_gravity
    if stated is None:
        centre["height_variance"] = (0.5 * machine.tread) ** 2
    else:
        centre["x"], centre["y"], centre["height"] = stated.x, stated.y, stated.z
    return centre


def new_bucket_load(vehicle: Vehicle) -> Table[BucketLoad]:
    """Return the initial state (1,)."""
    bucket_load = make_table(BucketLoad, BUCKET_LOAD, 1)
    bucket_load["has_bucket"] = vehicle.bucket is not None
    return bucket_load


@compiled
def update_bucket_load(bucket_load: BucketLoad, sample: Sample, p: LoadParameters) -> None:
    """Update whether the bucket load may differ: it changes at a standstill of ``filling_time`` or longer."""
    if sample.motion == _STRAIGHT or sample.motion == _TURNING:
        bucket_load.has_driven = 1
    bucket_load.standstill_time = (
        bucket_load.standstill_time + sample.dt if sample.motion == _STANDING else 0.0
    )
    if (
        bucket_load.has_bucket == 1
        and bucket_load.has_driven == 1
        and bucket_load.standstill_time >= p.filling_time
    ):
        bucket_load.may_differ = 1


@compiled
def bucket_load_variance(bucket_load: BucketLoad, needed: float, p: LoadParameters) -> float:
    """Return the variance, N², of ``needed``, a thrust proportional to the weight, by the bucket load."""
    return float((p.bucket_share * needed) ** 2 if bucket_load.may_differ == 1 else 0.0)


@compiled
def _swing_centre(centre: GravityCentre, sample: Sample) -> SwungCentre:
    """Return the centre of gravity at the swing angle of a sample."""
    g, k = centre.balance, math.exp(-0.5 * sample.swing_variance)
    cos, sin = k * math.cos(sample.swing), k * math.sin(sample.swing)
    half, twofold = 0.5 * g * g * (1.0 - k * k), cos * cos - sin * sin
    return SwungCentre(
        centre.x + g * (cos - 1.0), centre.y + g * sin, half * (1.0 - twofold), half * (1.0 + twofold)
    )


@compiled
def set_ground_load(load: GroundLoad, centre: GravityCentre, sample: Sample, p: SoilConfig) -> None:
    """Fill the load at a sample."""
    vehicle, friction, friction_stddev = p.vehicle, p.load.friction_share, p.load.friction_share_stddev
    roll, pitch = sample.tilt[0], sample.tilt[1]
    weight, down = vehicle.mass * GRAVITY, math.cos(pitch) * math.cos(roll)
    load.pull = weight * math.sin(pitch)
    roll_variance = min(sample.tilt_variance[0], p.load.unknown_slope**2)
    pitch_variance = min(sample.tilt_variance[1], p.load.unknown_slope**2)
    load.pull_variance = (weight * math.cos(pitch)) ** 2 * pitch_variance
    swung = _swing_centre(centre, sample)
    x_N = swung.x + centre.height * math.tan(pitch) / math.cos(roll)
    y_N = swung.y - centre.height * math.tan(roll)
    offset_variance = centre.height_variance * math.tan(roll) ** 2 + centre.height**2 * roll_variance
    load.stretch = 1.0 / math.cos(pitch)
    load.stretch_stddev = abs(math.tan(pitch)) * math.sqrt(pitch_variance)
    load.lean = friction * 12.0 * x_N / vehicle.contact_length**2
    load.lean_stddev = friction * 12.0 * math.sqrt(swung.x_variance) / vehicle.contact_length**2
    per_offset = (2.0 * down * friction / vehicle.tread) ** 2
    load.swing_variance = per_offset * swung.y_variance
    for k in range(2):
        share = 0.5 + (1.0 - 2.0 * k) * y_N / vehicle.tread
        load.normal[k] = weight * down * min(max(share, 0.0), 1.0)
        excess_load = 2.0 * load.normal[k] / weight - 1.0
        load.strength[k] = max(1.0 + friction * excess_load, p.load.least_strength)
        load.strength_variance[k] = (
            (friction_stddev * excess_load) ** 2 + per_offset * offset_variance + load.swing_variance
        )
