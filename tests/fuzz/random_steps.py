# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Random steps of the slip estimator: measurements of every kind, variances from 1e-12 to 1e12.

``make fuzz`` takes ten million, ``make test`` a hundred thousand. An episode is one machine with its own
sensors, driven at random. Measurements are consistent with their stated noise, as a rule; sometimes they
are outliers, singular or late. After each part of an episode all states are finite, their covariances
positive semidefinite and all published values finite; and a replay of the whole ends with the same bits.
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.records import (
    HEADING,
    MEASUREMENT,
    ODOMETRY,
    ON_SWING,
    POSE,
    SLIPS,
    SPROCKETS,
    VELOCITY,
    YAW_RATE,
)

Records = NDArray[np.void]

STEPS = 2000  # per episode
_REPORTED = 100_000  # steps between two lines of progress
_SHOWN = 20  # faults that are printed
_PART = 50  # arrivals between two checks of the states
_TOLERANCE = 1e-12  # relative to the largest eigenvalue
_UPPER = {f"sources.{name}.mount": "upper" for name in ("mast", "imu_top", "compass")}  # on the cab
_LEVER = {"sources.gnss.lever_arm_x": 0.8, "sources.gnss.lever_arm_y": -0.3, "sources.gnss.lever_arm_z": 2.0}
_ALL: dict[str, Any] = {
    "pose_sources": ["box_pose", "gnss", "mast"],
    "yaw_rate_sources": ["imu/data_raw", "imu_top"],
    "heading_sources": ["compass"],
    "odometry_sources": ["camera"],
    "slip_sources": ["slip_seed"],
    "velocity_sources": ["fix_velocity"],
    "sources.imu_data_raw.use_orientation": True,
    "sources.gnss.use_heading": False,
    "sources.gnss.use_altitude": True,
    "sources.mast.lever_arm_x": -1.0,
    "sources.mast.lever_arm_z": 2.5,
    **_LEVER,
}
MACHINES: tuple[dict[str, Any], ...] = (
    {},
    {"model": "icr"},
    {"model": "free_slips", "start": "initial_pose"},
    {"filter": "daf"},
    _ALL,
    {**_ALL, **_UPPER, "vehicle": "pc05_cab"},
    {**_ALL, "model": "icr"},
    {"pose_sources": ["gnss"], "sources.gnss.use_heading": False, **_LEVER},
)


class Findings(NamedTuple):
    """Results of an episode."""

    steps: int
    outcomes: NDArray[np.int64]  # (n,) count of each ``Outcome``
    least: float  # least eigenvalue of a covariance, over its largest
    faults: list[str]  # violations


def episode(number: int, steps: int = STEPS) -> Findings:
    """Run one episode, repeatable by its number."""
    rng = np.random.default_rng(number)
    p = load_slip_parameters(MACHINES[number % len(MACHINES)])
    live, replay = SlipEstimator(p), SlipEstimator(p)
    arrivals = random_arrivals(rng, p, live, steps)
    outcomes, least = np.zeros(len(Outcome), np.int64), 0.0
    faults, results = list[str](), list[Records]()
    for first in range(0, len(arrivals), _PART):
        part = arrivals[first : first + _PART]
        result = live.process_records(part)
        results.append(result)
        outcomes += np.bincount(result["outcome"], minlength=len(Outcome))
        where = f"episode {number}, arrivals {first} to {first + len(part)}"
        states = live.window.best[max(live.window.count - _PART, 0) : live.window.count]
        if live.started and len(states):
            least = min(least, _least_eigenvalue(states, int(live.config["size"][0]), where, faults))
        if not _all_finite(result["estimate"][result["published"]]):
            faults.append(f"{where}: published numbers are not finite")
        if live.divergences:
            faults.append(f"{where}: the estimate diverged")
            break
    whole = replay.process_records(arrivals[: sum(map(len, results))])
    if not _same(whole, np.concatenate(results)):
        faults.append(f"episode {number}: replay and live differ")
    if least < -_TOLERANCE:
        faults.append(f"episode {number}: least eigenvalue {least:.1e} of the largest")
    return Findings(len(arrivals), outcomes, least, faults)


def _least_eigenvalue(states: Records, size: int, where: str, faults: list[str]) -> float:
    """Least eigenvalue of the covariances and correlations of (n,) states, over the largest of each.

    ``size``: number of states in use.
    """
    P = states["covariance"][:, :size, :size]
    if not (
        np.isfinite(P).all() and np.isfinite(states["mean"]).all() and _all_finite(states["attitude"]["mean"])
    ):
        faults.append(f"{where}: a state is not finite")
        return 0.0
    deviations = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    divisors = np.where(deviations > 0.0, deviations, 1.0)
    least = 0.0
    for covariance in (P, P / (divisors[:, :, None] * divisors[:, None, :])):
        values = np.linalg.eigvalsh(covariance)
        least = min(least, float((values[:, 0] / values[:, -1]).min()))
    return least


def _all_finite(records: Any) -> bool:
    """Whether all numbers of records, nested ones too, are finite."""
    if records.dtype.names is None:
        return records.dtype.kind != "f" or bool(np.isfinite(records).all())
    return all(_all_finite(records[name]) for name in records.dtype.names)


def _same(one: Any, other: Any) -> bool:
    """Whether records agree bit for bit, except for padding between their fields."""
    if one.dtype.names is None:
        return bool(one.tobytes() == other.tobytes())
    return all(_same(one[name], other[name]) for name in one.dtype.names)


def random_arrivals(
    rng: np.random.Generator, p: SlipEstimatorParameters, estimator: SlipEstimator, steps: int
) -> Records:
    """(steps,) records of ``MEASUREMENT`` in order of arrival, some of them late."""
    named = {
        POSE: list(p.poses()),
        YAW_RATE: list(p.gyros()),
        HEADING: list(p.compasses()),
        ODOMETRY: list(p.odometries()),
        ON_SWING: list(p.swing_encoders()),
        VELOCITY: list(p.velocities()),
        SLIPS: [name for name in p.slip_sources if name],
    }
    sources = [(kind, estimator.sources[name]) for kind, names in named.items() for name in names]
    chosen = rng.integers(-len(sources), len(sources), steps)  # half are sprockets
    kinds = np.array([SPROCKETS if k < 0 else sources[k][0] for k in chosen])
    kinds[0] = SPROCKETS
    m = np.zeros(steps, MEASUREMENT)
    m["kind"], m["source"] = kinds, [0 if k < 0 else sources[k][1] for k in chosen]
    dt = np.where(
        rng.random(steps) < 0.995, 10.0 ** rng.uniform(-3.0, -1.5, steps), rng.uniform(0.1, 4.0, steps)
    )
    m["stamp_ns"] = np.cumsum(np.round(dt * 1e9)).astype(np.int64)
    speeds = _walk(rng, steps, 2)
    angles = np.cumsum(speeds * dt[:, None], axis=0)
    m["left_speed"], m["right_speed"] = speeds.T
    m["left_angle"], m["right_angle"] = angles.T
    truth = _poses(speeds, dt, p)
    variance = 10.0 ** rng.uniform(-12.0, 12.0, (steps, 3))
    tame = rng.random(steps) < 0.5
    variance[tame] = 10.0 ** rng.uniform(-4.0, 0.0, (int(tame.sum()), 3))
    noise = rng.normal(size=(steps, 3)) * np.minimum(np.sqrt(variance), 10.0)
    noise[rng.random(steps) < 0.005] *= 1e3
    deviations = np.sqrt(variance)
    m["noise"] = _correlations(rng, steps) * deviations[:, :, None] * deviations[:, None, :]
    m["value"] = truth + noise
    _set_others(rng, m, truth, speeds, p)
    wild = rng.random(steps) < 0.01
    m["value"][wild] = rng.choice((np.nan, np.inf, 1e300, -1e12, 1e7, 0.0), (int(wild.sum()), 3))
    late = m["stamp_ns"] + np.where(rng.random(steps) < 0.02, rng.integers(0, 3 * 10**8, steps), 0)
    return m[np.argsort(late, kind="stable")]


def _walk(rng: np.random.Generator, steps: int, size: int) -> FloatArray:
    """(steps, size) sprocket speeds that are constant for some time."""
    changes = rng.random(steps) < 0.02
    levels = rng.uniform(-3.0, 3.0, (steps, size)) * (rng.random((steps, 1)) < 0.8)
    last = np.maximum.accumulate(np.where(changes, np.arange(steps), 0))
    return np.asarray(levels[last])


def _poses(speeds: FloatArray, dt: FloatArray, p: SlipEstimatorParameters) -> FloatArray:
    """(steps, 3) x, y, heading of a machine with a slip of a twentieth."""
    vehicle = p.vehicle.kinematics
    v = 0.95 * vehicle.rolling_radius * speeds.mean(axis=1)
    heading = np.cumsum(0.6 * vehicle.rolling_radius * (speeds[:, 1] - speeds[:, 0]) / vehicle.tread * dt)
    x, y = np.cumsum(v * np.cos(heading) * dt), np.cumsum(v * np.sin(heading) * dt)
    return np.column_stack((x, y, (heading + np.pi) % (2 * np.pi) - np.pi))


def _correlations(rng: np.random.Generator, steps: int) -> FloatArray:
    """(steps, 3, 3) correlation matrices: none, some, nearly singular or singular."""
    directions = rng.normal(size=(steps, 3, 3))
    directions[:, :, 1:] *= (10.0 ** rng.uniform(-9.0, 0.0, steps))[:, None, None]
    directions[rng.random(steps) < 0.1, :, 1:] = 0.0
    C = directions @ directions.transpose(0, 2, 1)
    size = np.sqrt(np.diagonal(C, axis1=1, axis2=2))
    C /= size[:, :, None] * size[:, None, :]
    C[rng.random(steps) < 0.5] = np.eye(3)
    return (C + C.transpose(0, 2, 1)) / 2.0


def _set_others(
    rng: np.random.Generator, m: Records, truth: FloatArray, speeds: FloatArray, p: SlipEstimatorParameters
) -> None:
    """Set the values of all measurements that are no pose."""
    steps, vehicle = len(m), p.vehicle.kinematics
    rates = 0.6 * vehicle.rolling_radius * (speeds[:, 1] - speeds[:, 0]) / vehicle.tread
    kind = m["kind"]
    error = np.minimum(np.sqrt(m["noise"][:, 0, 0]), 1.0) * rng.normal(size=steps)
    m["value"][kind == YAW_RATE] = 0.0
    m["value"][kind == YAW_RATE, 0] = (rates + error)[kind == YAW_RATE]
    m["value"][kind == HEADING, 0] = (truth[:, 2] + error)[kind == HEADING]
    m["value"][kind == ON_SWING, 0] = error[kind == ON_SWING]
    v = 0.95 * vehicle.rolling_radius * speeds.mean(axis=1)
    velocities = np.column_stack((v * np.cos(truth[:, 2]) + error, v * np.sin(truth[:, 2]) - error))
    m["value"][kind == VELOCITY, :2] = velocities[kind == VELOCITY]
    m["value"][kind == SLIPS] = (0.05 + error)[kind == SLIPS, None]
    odometry = kind == ODOMETRY
    m["value"][odometry, :2], m["value"][odometry, 2] = truth[odometry, :2], 0.0
    m["orientation"][:, 2], m["orientation"][:, 3] = np.sin(truth[:, 2] / 2.0), np.cos(truth[:, 2] / 2.0)
    m["noise"][odometry, :2] = np.abs(m["noise"][odometry, :2])
    m["altitude"], m["altitude_variance"] = error, m["noise"][:, 2, 2]
    m["acceleration"], m["acceleration_variance"] = rng.normal(size=(steps, 3)), m["noise"][:, 1, 1]
    m["acceleration"][:, 2] += 9.81
    m["up"] = rng.normal(size=(steps, 3)) * 0.05
    m["up"][:, 2] = 1.0
    m["up_variances"] = m["noise"][:, (1, 2), (1, 2)]


def main() -> int:
    """Run random steps on all cores; return the exit code, 1 where anything was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("steps", type=int, nargs="?", default=10_000_000, help="(default: %(default)s)")
    requested = parser.parse_args().steps
    steps, least = 0, 0.0
    outcomes, faults = np.zeros(len(Outcome), np.int64), 0
    with ProcessPoolExecutor() as pool:
        for new in pool.map(episode, range(-(-requested // STEPS)), chunksize=8):
            steps, outcomes, least = steps + new.steps, outcomes + new.outcomes, min(least, new.least)
            for fault in new.faults[: max(_SHOWN - faults, 0)]:
                print(f"FOUND {fault}", flush=True)
            faults += len(new.faults)
            if steps % _REPORTED < new.steps:
                print(f"{steps} steps, {faults} faults", file=sys.stderr, flush=True)
    counts = ", ".join(f"{o.name.lower()} {n}" for o, n in zip(Outcome, outcomes, strict=True) if n)
    print(f"{steps} random steps, least eigenvalue {least:.1e} of the largest: {counts}")
    print(f"{faults} faults" if faults else "nothing found")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
