# SPDX-License-Identifier: Apache-2.0
"""The filter over measurements in the order in which they came, compiled: what ``timeline`` does, at once.

Each is put in its place by stamp, and what follows it there is done again, as is what was extrapolated from
the last sprocket sample when the next one comes. It holds for logs in which the sprockets are never silent
and nothing comes too late; the caller sees to that.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled_upon
from trackslip_estimation.slip import motion as _motion
from trackslip_estimation.slip.filter import Filter, RecordArray, predict
from trackslip_estimation.slip.gating import Gates, measure
from trackslip_estimation.slip.models import dispatch as equations
from trackslip_estimation.slip.models.model import POSE, SPROCKETS, YAW_RATE, Gaussian
from trackslip_estimation.slip.motion import classified, steadied

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Arrivals(NamedTuple):
    """Measurements in the order of their arrival, after the one that the estimate starts from."""

    places: IntArray  # (k,) of each in the order of all of them by stamp
    stamps_ns: IntArray  # (k,) since the start
    sources: IntArray  # (k, 2) kind, source's number
    values: FloatArray  # (k, 3) z, padded
    noises: FloatArray  # (k, 3, 3) R, padded


class Stretches(NamedTuple):
    """What the sprockets did between their samples, of which each after the first closes a stretch."""

    stamps_ns: IntArray  # (s,) of the samples, since the start
    speeds: FloatArray  # (s, 3) left, right, rad/s, length of the stretch, s; of the first nothing
    known: int  # samples that came before the arrivals


class Passed(NamedTuple):
    """What is told right after each arrival."""

    poses: FloatArray  # (k, 3)
    pose_covariances: FloatArray  # (k, 3, 3)
    motions: IntArray  # (k,)
    twists: FloatArray  # (k, 3) fields of ``Outputs``; of sprocket samples only, as all below
    twist_covariances: FloatArray  # (k, 3, 3)
    slips: FloatArray  # (k, 3)
    slip_covariances: FloatArray  # (k, 3, 3)
    nis: FloatArray  # (k,) of all others only, as all below
    gates: FloatArray  # (k,) limit of the NIS
    accepted: BoolArray  # (k,)


def run_arrivals(
    arrivals: Arrivals,
    stretches: Stretches,
    filter_: Filter,
    start: Gaussian,
    limits: FloatArray,
    gates: Gates,
) -> Passed:
    """From ``start``; ``limits`` (6,) are those of ``MotionParameters``."""
    count = arrivals.places.size
    passed = Passed(
        np.empty((count, 3)),
        np.empty((count, 3, 3)),
        np.empty(count, np.int64),
        np.empty((count, 3)),
        np.empty((count, 3, 3)),
        np.empty((count, 3)),
        np.empty((count, 3, 3)),
        np.empty(count),
        np.empty(count),
        np.empty(count, np.bool_),
    )
    arguments: tuple[Any, ...] = (*arrivals, *stretches, *start, limits, *gates, filter_.constants, *passed)
    _loop(*arguments)
    return passed


@compiled_upon(_motion)
def _moved(
    before: FloatArray,
    left: float,
    right: float,
    stretch: float,
    dt: float,
    resolution: float,
    limits: FloatArray,
) -> tuple[int, bool, float, float, float, float, float]:
    """The next state of motion."""
    return classified(
        int(before[0]),
        before[1] > 0.0,
        before[2],
        before[3],
        before[4],
        before[5],
        before[6],
        left,
        right,
        stretch,
        True,
        dt,
        resolution,
        limits[0],
        limits[1],
        limits[2],
        limits[3],
        limits[4],
        limits[5],
    )


@compiled_upon(_motion)
def _loop(
    places: IntArray,
    stamps_ns: IntArray,
    sources: IntArray,
    values: FloatArray,
    noises: FloatArray,
    sample_ns: IntArray,
    stretches: FloatArray,
    samples: int,
    x: FloatArray,
    P: FloatArray,
    limits: FloatArray,
    gate_limits: FloatArray,
    relaxation: float,
    timeouts_ns: IntArray,
    levers: FloatArray,
    constants: RecordArray,
    poses: FloatArray,
    pose_covariances: FloatArray,
    motions: IntArray,
    twists: FloatArray,
    twist_covariances: FloatArray,
    slips: FloatArray,
    slip_covariances: FloatArray,
    nis: FloatArray,
    gates: FloatArray,
    accepted: BoolArray,
) -> None:
    """Fill the fields of ``Passed``."""
    c = constants[0]
    count, n = places.size, x.size
    line = np.empty(count, np.int64)  # arrivals so far, by stamp
    now_x, now_P = np.empty((count + 1, n)), np.empty((count + 1, n, n))  # by arrival, as it is now
    now_motion = np.zeros((count + 1, 7))  # fields of ``MotionState``
    now_ns, now_agreed = np.zeros(count + 1, np.int64), np.zeros((count + 1, timeouts_ns.size), np.int64)
    now_x[count], now_P[count], now_motion[count, 1] = x, P, 1.0
    for arrival in range(count):
        at = arrival
        while at > 0 and places[line[at - 1]] > places[arrival]:
            line[at] = line[at - 1]
            at -= 1
        line[at] = arrival
        first = at
        if sources[arrival, 0] == SPROCKETS:
            samples += 1
            while first > 0 and stamps_ns[line[first - 1]] > sample_ns[samples - 2]:
                first -= 1
        for k in range(first, arrival + 1):
            i = line[k]
            before = line[k - 1] if k > 0 else count  # where the start is
            kind, source = sources[i]
            closing = samples
            while sample_ns[closing - 1] >= stamps_ns[i]:
                closing -= 1
            left, right, stretch = stretches[min(closing, samples - 1)]
            dt = (stamps_ns[i] - now_ns[before]) * 1e-9
            m = _moved(now_motion[before], left, right, stretch, dt, c.encoder_resolution, limits)
            now_motion[i] = (float(m[0]), 1.0 if m[1] else 0.0, m[2], m[3], m[4], m[5], m[6])
            now_agreed[i], now_ns[i] = now_agreed[before], stamps_ns[i]
            if kind == YAW_RATE or (kind == SPROCKETS and i == arrival):
                steady = steadied(
                    left, right, stretch, True, m[2], m[3], m[6], c.encoder_resolution, limits[4]
                )
            if kind == YAW_RATE:
                left, right, stretch = steady
            x, P = predict(now_x[before], now_P[before], left, right, dt, m[0], int(m[1]), m[6], c)
            if kind != SPROCKETS:
                z, R = values[i, :kind].copy(), noises[i, :kind, :kind].copy()  # the kinds are numbered so
                apart_ns, timeout_ns = stamps_ns[i] - now_agreed[i, source], timeouts_ns[source]
                _, _, x, P, found, gate, taken, agreed = measure(
                    kind,
                    z,
                    R,
                    x,
                    P,
                    left,
                    right,
                    stretch,
                    True,
                    levers[source],
                    apart_ns,
                    timeout_ns,
                    gate_limits,
                    relaxation,
                    c,
                )
                if agreed:
                    now_agreed[i, source] = stamps_ns[i]
                if i == arrival:
                    nis[i], gates[i], accepted[i] = found, gate, taken
            elif i == arrival:
                twists[i], twist_covariances[i], slips[i], slip_covariances[i] = equations.outputs(
                    x, P, steady[0], steady[1], steady[2], True, c
                )
            now_x[i], now_P[i] = x, P
        poses[arrival], pose_covariances[arrival] = now_x[arrival, POSE], now_P[arrival, POSE, POSE]
        motions[arrival] = int(now_motion[arrival, 0])
