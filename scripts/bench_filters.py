# SPDX-License-Identifier: Apache-2.0
"""Speed of the filters beside filterpy's EKF, in one run on one thread: ``make bench`` prints the rows.

All run the same measurements through the same model. filterpy is given its compiled functions, so that its
own algebra is what is timed; it is compared where it is installed (``requirements/bench.txt``).
"""

import importlib
import importlib.util
import math
import time
from typing import Any

import numpy as np
from trackslip_estimation.slip.batch import Row, make_log, run
from trackslip_estimation.slip.filter import Filter

from trackslip_estimation.slip.models import dispatch as equations
from trackslip_estimation.slip.models.model import DRIVEN, SPROCKETS, Gaussian, rate_measured
from trackslip_estimation.slip.motion import Motion, MotionState, Speeds
from trackslip_estimation.slip.parameters import load_slip_parameters, make_filter

ROWS = 20_000
STRETCH = 0.01  # s
REPEATS = 3  # of which the fastest counts


def rows() -> list[tuple[str, str, str, str]]:
    """What, here, beside, bar: µs of a row; half of them sprockets that predict, half a gyro, updated."""
    drive = _drive()
    log, start = make_log(drive), _filter("turning", "ekf").initial(np.zeros(3), np.eye(3) * 1e-3)
    found = {}
    for model in ("turning", "icr", "free_slips"):
        for kind in ("ekf", "daf"):
            filter_ = _filter(model, kind)
            begin = filter_.initial(np.zeros(3), np.eye(3) * 1e-3)
            run(log, filter_, begin)  # compiles, the first time
            found[model, kind] = min(_timed(run, log, filter_, begin) for _ in range(REPEATS)) / ROWS
    beside = _beside(drive, start, found["turning", "ekf"])
    table = [
        (
            f"{kind.upper()} of model {model}, batch",
            f"{1e6 * seconds:.1f} µs",
            beside if (model, kind) == ("turning", "ekf") else "",
            "≤ 4 µs, ≥ 8 ×" if (model, kind) == ("turning", "ekf") else "",
        )
        for (model, kind), seconds in found.items()
    ]
    seconds = min(_timed(_step, _filter("turning", "ekf"), start, drive) for _ in range(REPEATS)) / ROWS
    return [*table, ("EKF of model turning, a call from Python", f"{1e6 * seconds:.1f} µs", "", "")]


def _filter(model: str, kind: str) -> Filter:
    return make_filter(load_slip_parameters({"model": model, "filter": kind}))


def _drive() -> list[Row]:
    """A slalom; every other row a reading of the gyro at the stamp of the sprockets before it."""
    drive = []
    for k in range(ROWS):
        sway = math.sin(k * STRETCH / 4.0)
        speeds = Speeds(2.0 - sway, 2.0 + sway, STRETCH, differenced=True)
        measured = DRIVEN if k % 2 == 0 else rate_measured(0.2 * sway, 1e-4)
        drive.append(Row(STRETCH / 2.0, speeds, MotionState(Motion.TURNING, changing=False), 0, measured))
    return drive


def _step(filter_: Filter, state: Gaussian, drive: list[Row]) -> None:
    for row in drive:
        state = filter_.step(state, row.speeds, row.dt, row.motion, row.measured).updated


def _beside(drive: list[Row], start: Gaussian, ours: float) -> str:
    if importlib.util.find_spec("filterpy") is None:
        return "filterpy is not installed"
    kalman = importlib.import_module("filterpy.kalman")
    some = drive[: ROWS // 10]
    seconds = min(_timed(_filterpy, kalman, start, some) for _ in range(REPEATS)) / len(some)
    return f"filterpy {1e6 * seconds:.0f} µs, {seconds / ours:.0f} ×"


def _filterpy(kalman: Any, start: Gaussian, drive: list[Row]) -> None:
    """The same rows through ``filterpy.kalman.ExtendedKalmanFilter``."""
    c = _filter("turning", "ekf").constants[0]
    their = kalman.ExtendedKalmanFilter(start.mean.size, 1)
    their.x, their.P = start.mean.copy(), start.covariance.copy()
    for row in drive:
        left, right, stretch, counted = row.speeds
        kind, z, R = row.measured
        motion, changing, departure = int(row.motion.motion), int(row.motion.changing), row.motion.departure
        moved = equations.move(their.x, left, right, row.dt, motion, c)
        their.F = equations.transition(their.x, left, right, row.dt, motion, c)
        their.Q = equations.process_noise(
            their.x, their.P, left, right, row.dt, motion, changing, departure, c
        )
        their.predict()
        their.x = moved
        if kind == SPROCKETS:  # they drive, and measure nothing
            continue
        R = equations.noise(kind, their.x, R, left, right, stretch, counted, c)
        arguments = (left, right, c)
        their.update(
            z,
            lambda x, *a, kind=kind: equations.jacobian(kind, x, *a),
            lambda x, *a, kind=kind: equations.expected(kind, x, *a),
            R,
            arguments,
            arguments,
        )


def _timed(function: Any, *arguments: Any) -> float:
    began = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - began
