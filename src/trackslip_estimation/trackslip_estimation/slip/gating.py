# SPDX-License-Identifier: Apache-2.0
"""Which measurements are taken: a χ² gate that widens while source and state have not agreed, compiled.

    ν, S    innovation and its covariance
    d²      νᵀ S⁻¹ ν, taken where d² ≤ w g
    g       χ² quantile; source and state agree where d² ≤ g
    w       1 until they have not agreed for the source's timeout, then ``relaxation`` per further timeout
    l       place of the sensor in base_link; a pose is held against that of the sensor   (2,), m

So a spike stays out, and a source that insists, or comes back after an outage, is believed in the end: the
time that takes grows with the logarithm of how far off it is. What passes only because the gate is wide says
that the state was wrong: its covariance is widened by what the innovation shows before the update, that of
the pose or the slips by ν νᵀ, or that of the gyro's bias by ν². For poses the gate stays wide until they
agree again: a state that goes wrong all the time is put right all the time. A gyro agrees at once, for now
its bias explains what it says.

In a turn a gyro may say what the machine would do on other ground: a yaw rate from none to that without slip.
Then the ground has changed, and what was learned of turning and slip counts for no more than at the start.
What it would do on no ground, to turn against its tracks, is never taken: a gyro upside down says so.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import root, sandwich, wrap
from trackslip_estimation.slip.filter import Filter, RecordArray, predict, update
from trackslip_estimation.slip.models import dispatch as equations
from trackslip_estimation.slip.models.free_slips import LEFT_SLIP
from trackslip_estimation.slip.models.model import (
    FREE_SLIPS,
    FULL_POSE,
    SLIPS,
    YAW,
    YAW_RATE,
    Gaussian,
    Measured,
    X,
    Y,
    rate_measured,
)
from trackslip_estimation.slip.models.speed import COMMON_SLIP, FIRST, SECOND
from trackslip_estimation.slip.motion import STANDSTILL, MotionState, Speeds

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_WIDEST = 100.0  # timeouts: beyond, the gate is open to anything finite
_DOUBT = 4.0  # standard deviations
_LAG = 0.1  # of the yaw rate without slip, by which the machine may still turn the other way


class Gates(NamedTuple):
    """Which measurements are taken; sources are numbered."""

    limits: FloatArray  # (4,) g by degrees of freedom 0 … 3; infinite where all are taken
    relaxation: float
    timeouts_ns: IntArray  # (s,) of each source
    levers: FloatArray  # (s, 2) l of each source, m


class Taken(NamedTuple):
    """What was made of a measurement."""

    before: Gaussian  # the state that it met, widened where it surprised
    after: Gaussian
    nis: float  # d²
    gate: float  # w g
    accepted: bool
    agreed: bool


def take(
    filter_: Filter,
    state: Gaussian,
    speeds: Speeds,
    dt: float,
    motion: MotionState,
    measured: Measured,
    source: int,
    apart_ns: int,
    gates: Gates,
) -> Taken:
    """The state ``dt`` s later with a gyro's or a pose's measurement taken or not.

    ``apart_ns``: since when source and state have not agreed.
    """
    x, P, x_after, P_after, nis, gate, accepted, agreed = _take(
        *measured,
        *state,
        speeds.left,
        speeds.right,
        speeds.stretch,
        speeds.differenced,
        dt,
        int(motion.motion),
        int(motion.changing),
        motion.departure,
        gates.levers[source],
        apart_ns,
        int(gates.timeouts_ns[source]),
        gates.limits,
        gates.relaxation,
        filter_.constants,
    )
    return Taken(Gaussian(x, P), Gaussian(x_after, P_after), nis, gate, accepted, agreed)


def compile_for(filter_: Filter) -> None:
    """``take`` compiled now, not at the first measurement."""
    start = filter_.initial(np.zeros(3), np.eye(3))
    gates = Gates(np.full(4, np.inf), 1.0, np.ones(1, np.int64), np.zeros((1, 2)))
    take(filter_, start, STANDSTILL, 0.0, MotionState(), rate_measured(0.0, 1.0), 0, 0, gates)


@compiled
def measure(
    kind: int,
    z: FloatArray,
    R: FloatArray,
    x: FloatArray,
    P: FloatArray,
    left: float,
    right: float,
    stretch: float,
    counted: bool,
    lever: FloatArray,
    apart_ns: int,
    timeout_ns: int,
    limits: FloatArray,
    relaxation: float,
    c: Any,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float, float, bool, bool]:
    """The fields of ``Taken``, for a state at the stamp of the measurement."""
    x, P = shifted(x, P, lever, 1.0)
    x_after, P_after, nis = update(kind, x, P, z, R, left, right, stretch, counted, c)
    limit = limits[z.size]
    if kind == YAW_RATE and nis > limit and _other_ground(z[0] - x[-1], left, right, c):
        P = P.copy()
        P[FIRST, FIRST] += c.first_variance
        P[SECOND, SECOND] += c.second_variance
        P[COMMON_SLIP, COMMON_SLIP] += c.slip_variance
        x_after, P_after, nis = update(kind, x, P, z, R, left, right, stretch, counted, c)
    gate = limit * width(apart_ns, timeout_ns, relaxation)
    surprising = nis > limit
    accepted = nis <= gate
    if kind == YAW_RATE and np.isfinite(limit) and _on_no_ground(z[0] - x[-1], R, P, left, right, c):
        accepted = False
    if not accepted:
        x_after, P_after = x, P
    elif surprising:
        P = admitted(kind, z, x, P, left, right, c)
        x_after, P_after, _ = update(kind, x, P, z, R, left, right, stretch, counted, c)
    x, P = shifted(x, P, lever, -1.0)
    x_after, P_after = shifted(x_after, P_after, lever, -1.0)
    return x, P, x_after, P_after, nis, gate, accepted, accepted and (kind == YAW_RATE or not surprising)


@compiled
def _on_no_ground(rate: float, R: FloatArray, P: FloatArray, left: float, right: float, c: Any) -> bool:
    """Whether the machine would turn against its tracks, beyond what noise and bias explain."""
    without_slip: float = c.rolling_radius * (right - left) / c.tread
    allowed = _DOUBT * np.sqrt(R[0, 0] + P[-1, -1]) + _LAG * abs(without_slip)
    return bool(c.model != FREE_SLIPS) and rate * np.sign(without_slip) < -allowed


@compiled
def _other_ground(rate: float, left: float, right: float, c: Any) -> bool:
    """Whether some ground lets the machine turn so."""
    without_slip: float = c.rolling_radius * (right - left) / c.tread
    turns = rate * without_slip > 0.0 and abs(rate) < abs(without_slip)
    return turns and bool(c.model != FREE_SLIPS)


@compiled
def width(apart_ns: int, timeout_ns: int, relaxation: float) -> float:
    """w."""
    if apart_ns <= timeout_ns:
        return 1.0
    widened: float = relaxation ** min(apart_ns / timeout_ns - 1.0, _WIDEST)
    return widened


@compiled
def admitted(
    kind: int, z: FloatArray, x: FloatArray, P: FloatArray, left: float, right: float, c: Any
) -> FloatArray:
    """P, widened by what an innovation shows; what else was learned stays."""
    innovation = z - equations.expected(kind, x, left, right, c)
    wide = P.copy()
    if kind == YAW_RATE:
        wide[-1, -1] += innovation[0] ** 2
        return wide
    if kind == SLIPS and c.model != FREE_SLIPS:
        wide[COMMON_SLIP, COMMON_SLIP] += innovation.mean() ** 2
        return wide
    if kind == FULL_POSE:
        innovation[YAW] = wrap(innovation[YAW])
    first = LEFT_SLIP if kind == SLIPS else X
    for i in range(innovation.size):
        for j in range(innovation.size):
            wide[first + i, first + j] += innovation[i] * innovation[j]
    return wide


@compiled
def shifted(x: FloatArray, P: FloatArray, lever: FloatArray, sign: float) -> tuple[FloatArray, FloatArray]:
    """The state with the place of a sensor for that of base_link (``sign`` 1), or back again (−1)."""
    if lever[0] == 0.0 and lever[1] == 0.0:
        return x, P
    cos, sin = np.cos(x[YAW]), np.sin(x[YAW])
    east = sign * (cos * lever[0] - sin * lever[1])
    north = sign * (sin * lever[0] + cos * lever[1])
    moved, T = x.copy(), np.eye(x.size)
    moved[X] += east
    moved[Y] += north
    T[X, YAW], T[Y, YAW] = -north, east
    return moved, sandwich(T, P)


@compiled
def log_det(
    kind: int,
    R: FloatArray,
    x: FloatArray,
    P: FloatArray,
    left: float,
    right: float,
    stretch: float,
    counted: bool,
    lever: FloatArray,
    c: Any,
) -> float:
    """ln |S| of a measurement, linearised, for a state at its stamp."""
    x, P = shifted(x, P, lever, 1.0)
    H = equations.jacobian(kind, x, left, right, c)
    S = sandwich(H, P) + equations.noise(kind, x, R, left, right, stretch, counted, c)
    total: float = 2.0 * np.sum(np.log(np.diag(root(S))))
    return total


@compiled
def _take(
    kind: int,
    z: FloatArray,
    R: FloatArray,
    x: FloatArray,
    P: FloatArray,
    left: float,
    right: float,
    stretch: float,
    counted: bool,
    dt: float,
    motion: int,
    changing: int,
    departure: float,
    lever: FloatArray,
    apart_ns: int,
    timeout_ns: int,
    limits: FloatArray,
    relaxation: float,
    constants: RecordArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float, float, bool, bool]:
    """Prediction and ``measure`` as called from Python."""
    c = constants[0]
    x, P = predict(x, P, left, right, dt, motion, changing, departure, c)
    return measure(
        kind, z, R, x, P, left, right, stretch, counted, lever, apart_ns, timeout_ns, limits, relaxation, c
    )
