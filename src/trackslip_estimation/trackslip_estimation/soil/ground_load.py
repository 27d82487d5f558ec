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


class Centre(Record):
    """Of gravity, the upper structure forward."""

    x: float  # x_0, m
    y: float
    height: float
    height_variance: float  # m²
    balance: float  # g, m


class GroundLoad(Record):
    """What the weight does at a sample."""

    pull: float  # G, N
    pull_variance: float  # N², of errors of the tilt, which last
    normal: Annotated[FloatArray, 2]  # N_j, N
    strength: Annotated[FloatArray, 2]  # g_j
    strength_variance: Annotated[FloatArray, 2]
    swing_variance: float  # what of it the swing is not known to
    lean: float  # γ 12 x_N/l², 1/m
    lean_stddev: float  # of what the swing is not known to
    stretch: float  # way along the ground over the horizontal one, 1/cos θ
    stretch_stddev: float  # of it, relative


class Burden(Record):
    """What the bucket may hold."""

    has_bucket: int
    stood: float  # s since the tracks stand
    has_driven: int  # before that
    may_differ: int  # the machine may weigh more or less than it did at first


CENTRE, GROUND_LOAD, BURDEN = dtype_of(Centre), dtype_of(GroundLoad), dtype_of(Burden)


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
    least_strength: float = parameter(
        "F_max at the least over that on level ground, of a track that hardly touches it", gt=0.0, lt=1.0
    )


class SwungCentre(NamedTuple):
    """Where the centre of gravity is as the upper structure has swung."""

    x: float  # x_g, m
    y: float  # y_g, m
    x_variance: float  # m²
    y_variance: float  # m²


def centre_of(vehicle: VehicleParameters) -> Table[Centre]:
    """(1,); where it is not given, on the ground below C, give or take half the tread."""
    whole, centre = vehicle.whole(), make_table(Centre, CENTRE, 1)
    centre["balance"] = vehicle.swing_balance
    given = whole.centre_of_gravity
    if given is None:
        centre["height_variance"] = (0.5 * whole.tread) ** 2
    else:
        centre["x"], centre["y"], centre["height"] = given.x, given.y, given.z
    return centre


def burden_of(vehicle: Vehicle) -> Table[Burden]:
    """(1,) at the start."""
    burden = make_table(Burden, BURDEN, 1)
    burden["has_bucket"] = vehicle.bucket is not None
    return burden


@compiled
def follow_burden(burden: Burden, sample: Sample, p: LoadParameters) -> None:
    """Whether a bucket may have been filled by now: only while the tracks stand."""
    if sample.motion == _STRAIGHT or sample.motion == _TURNING:
        burden.has_driven = 1
    burden.stood = burden.stood + sample.dt if sample.motion == _STANDING else 0.0
    if burden.has_bucket == 1 and burden.has_driven == 1 and burden.stood >= p.filling_time:
        burden.may_differ = 1


@compiled
def burden_variance(burden: Burden, needed: float, p: LoadParameters) -> float:
    """Of the thrust that the weight ``needed``, N²: resistance and the pull of a slope grow with it alike."""
    return float((p.bucket_share * needed) ** 2 if burden.may_differ == 1 else 0.0)


@compiled
def _swung(centre: Centre, sample: Sample) -> SwungCentre:
    """Of a sample."""
    g, k = centre.balance, math.exp(-0.5 * sample.swing_variance)
    cos, sin = k * math.cos(sample.swing), k * math.sin(sample.swing)
    half, twofold = 0.5 * g * g * (1.0 - k * k), cos * cos - sin * sin
    return SwungCentre(
        centre.x + g * (cos - 1.0), centre.y + g * sin, half * (1.0 - twofold), half * (1.0 + twofold)
    )


@compiled
def set_load(load: GroundLoad, centre: Centre, sample: Sample, p: SoilConfig) -> None:
    """Fill the load at a sample."""
    vehicle, friction, spread = p.vehicle, p.load.friction_share, p.load.friction_share_stddev
    roll, pitch = sample.tilt[0], sample.tilt[1]
    weight, down = vehicle.mass * GRAVITY, math.cos(pitch) * math.cos(roll)
    load.pull = weight * math.sin(pitch)
    load.pull_variance = (weight * math.cos(pitch)) ** 2 * sample.tilt_variance[1]
    swung = _swung(centre, sample)
    x_N = swung.x + centre.height * math.tan(pitch) / math.cos(roll)
    y_N = swung.y - centre.height * math.tan(roll)
    uncertain = centre.height_variance * math.tan(roll) ** 2 + centre.height**2 * sample.tilt_variance[0]
    load.stretch = 1.0 / math.cos(pitch)
    load.stretch_stddev = abs(math.tan(pitch)) * math.sqrt(sample.tilt_variance[1])
    load.lean = friction * 12.0 * x_N / vehicle.contact_length**2
    load.lean_stddev = friction * 12.0 * math.sqrt(swung.x_variance) / vehicle.contact_length**2
    per_offset = (2.0 * down * friction / vehicle.tread) ** 2
    load.swing_variance = per_offset * swung.y_variance
    for k in range(2):
        share = 0.5 + (1.0 - 2.0 * k) * y_N / vehicle.tread
        load.normal[k] = weight * down * min(max(share, 0.0), 1.0)
        more = 2.0 * load.normal[k] / weight - 1.0
        load.strength[k] = max(1.0 + friction * more, p.load.least_strength)
        load.strength_variance[k] = (spread * more) ** 2 + per_offset * uncertain + load.swing_variance
