# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Speed of the filters beside filterpy's EKF, in one run on one thread: ``make bench`` prints the rows.

All filters process the same measurements with the same model. filterpy receives the compiled functions of
Trackslip, so that only its algebra differs. It needs ``requirements/bench.txt``.
"""

import importlib
import importlib.util
import math
import time
from typing import Any

import numpy as np

from trackslip_estimation.attitude.records import SIZE as ATTITUDE_SIZE
from trackslip_estimation.kalman.positive import make_positive
from trackslip_estimation.kalman.propagate import propagate_covariance
from trackslip_estimation.kalman.update import correct, independent_observation
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.log import make_log, run_in_one_block, run_log
from trackslip_estimation.slip.measurements import Measurement, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.models.dispatch import COUPLED, linearize
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.records import SPROCKETS, to_records
from trackslip_estimation.slip.update import observe

ROWS = 20_000
STEP_NS = 5_000_000  # between measurements
REPEATS = 3  # the fastest counts
ALGEBRA = 5000  # steps
TILT_ROWS = 2  # specific force along and across the machine


def rows() -> list[tuple[str, str, str, str]]:
    """Rows (quantity, here, beside, bar): CPU per measurement; half are sprockets (predict), half gyro."""
    drive = _drive()
    seconds_of = {}
    for model in ("turning", "icr", "free_slips"):
        for kind in ("ekf", "daf"):
            p = load_slip_parameters({"model": model, "filter": kind})
            log = make_log(to_records(drive, SlipEstimator(p).sources), p)
            _run(log, p)  # compiles at the first call
            seconds_of[model, kind] = min(_timed(_run, log, p) for _ in range(REPEATS)) / ROWS
    beside = _beside(drive, seconds_of["turning", "ekf"])
    table = [
        (
            f"{kind.upper()} of model {model}, batch",
            f"{1e6 * seconds:.1f} µs",
            beside if (model, kind) == ("turning", "ekf") else "",
            "≤ 2.5 µs, ≥ 8 ×" if (model, kind) == ("turning", "ekf") else "",
        )
        for (model, kind), seconds in seconds_of.items()
    ]
    estimator = SlipEstimator(load_slip_parameters())
    seconds = _timed(_one_by_one, estimator, drive) / ROWS
    return [
        *table,
        ("a live measurement in order, with all adaptations", f"{1e6 * seconds:.1f} µs", "", "≤ 30 µs"),
        _joint_state(),
    ]


def _joint_state() -> tuple[str, str, str, str]:
    """Cost of one joint state of pose, slip and attitude against the two separate states."""
    planar = int(SlipEstimator(load_slip_parameters()).config["size"][0])
    separate = _algebra(planar, COUPLED, 1) + _algebra(ATTITUDE_SIZE, ATTITUDE_SIZE, TILT_ROWS)
    both, coupled = planar + ATTITUDE_SIZE, COUPLED + ATTITUDE_SIZE
    joint = _algebra(both, coupled, 1) + _algebra(both, coupled, TILT_ROWS)
    return (
        f"algebra of a gyro and a tilt, states of {planar} and {ATTITUDE_SIZE}",
        f"{1e6 * separate:.1f} µs",
        f"one of {both}: {1e6 * joint:.1f} µs, {joint / separate:.1f} ×",
        "",
    )


def _algebra(n: int, coupled: int, m: int) -> float:
    """Seconds of one propagation and one update of n states by m measurements with dense matrices."""
    rng = np.random.default_rng(n)
    P, F, Q = np.eye(n), np.eye(n), np.eye(n) * 1e-3
    F[:coupled] += rng.normal(0.0, 1e-2, (coupled, n))
    o = independent_observation(rng.normal(0.0, 1.0, m), rng.normal(0.0, 1.0, (m, n)), np.eye(m))
    x = np.zeros(n)

    def steps(count: int) -> None:
        for _ in range(count):
            propagate_covariance(P, F, Q, coupled)
            correct(x, P, o)
            make_positive(P, P, n)

    steps(1)
    return min(_timed(steps, ALGEBRA) for _ in range(REPEATS)) / ALGEBRA


def _drive() -> list[Measurement]:
    """A slalom; a gyro sample lies halfway between each two samples of the sprockets."""
    drive: list[Measurement] = [PoseFix("box_pose", 0, np.zeros(3), np.eye(3) * 1e-3)]
    left = right = 0.0
    for k in range(ROWS):
        sway = math.sin(k * STEP_NS * 1e-9 / 4.0)
        left += (2.0 - sway) * STEP_NS * 1e-9
        right += (2.0 + sway) * STEP_NS * 1e-9
        if k % 2:
            drive.append(YawRate("imu/data_raw", (k + 1) * STEP_NS, 0.2 * sway, 1e-4))
        else:
            drive.append(Sprockets("sprockets", (k + 1) * STEP_NS, 2.0 - sway, 2.0 + sway, (left, right)))
    return drive


def _run(log: Any, p: SlipEstimatorParameters) -> int:
    return sum(len(block.states) for block in run_log(log, p))


def _one_by_one(estimator: SlipEstimator, drive: list[Measurement]) -> None:
    for measurement in drive:
        estimator.process(measurement)


def _beside(drive: list[Measurement], ours: float) -> str:
    if importlib.util.find_spec("filterpy") is None:
        return "filterpy is not installed"
    kalman = importlib.import_module("filterpy.kalman")
    part = drive[: ROWS // 10]
    seconds = min(_filterpy(kalman, part) for _ in range(REPEATS)) / len(part)
    return f"filterpy {1e6 * seconds:.0f} µs, {seconds / ours:.0f} ×"


def _filterpy(kalman: Any, drive: list[Measurement]) -> float:
    """Seconds of the same measurements through ``filterpy.kalman.ExtendedKalmanFilter``."""
    p = load_slip_parameters()
    estimator = SlipEstimator(p)
    log = make_log(to_records(drive, estimator.sources), p)
    estimator.process_records(log.begin)
    window = run_in_one_block(log.rest, estimator.window, estimator.config)
    states = window.best[1 : window.count]  # sprocket states
    c, start = estimator.config[0], estimator.window.best[0]
    size = int(c["size"])
    peer = kalman.ExtendedKalmanFilter(size, 1)
    peer.x, peer.P = start["mean"][:size].copy(), start["covariance"][:size, :size].copy()
    scratch = states[:1].copy()
    began = time.process_time()
    for measurement, state in zip(log.rest, states, strict=True):
        propagated, peer.F, peer.Q = linearize(peer.x, peer.P, state, STEP_NS * 1e-9, c)
        peer.predict()
        peer.x = propagated
        if measurement["kind"] == SPROCKETS:  # sprockets are inputs, not measurements
            continue
        scratch[0] = state
        scratch["mean"][0, :size] = peer.x
        o = observe(scratch[0], measurement, c)
        peer.update(o.innovation, lambda x, o=o: o.jacobian, lambda x, o=o: 0.0 * o.innovation, o.noise)
    return time.process_time() - began


def _timed(function: Any, *arguments: Any) -> float:
    """CPU time, s; excludes other processes."""
    began = time.process_time()
    function(*arguments)
    return time.process_time() - began
