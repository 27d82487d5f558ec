# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Observations of each kind of measurement: derivatives against differences; which modules update a state."""

import ast
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixtures.filter_steps import Gaussian, config_of, state_of

from trackslip_common.arrays import FloatArray
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.kalman.update import correct
from trackslip_estimation.slip.levers import lever, to_sensor, turn_about_sensor
from trackslip_estimation.slip.models.model import FIX_DELAY, SIZE, SWING, YAW, X, Y
from trackslip_estimation.slip.motion import Motion, MotionState, Speeds
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import HEADING, MEASUREMENT, ON_SWING, POSE, SLIPS, VELOCITY, YAW_RATE
from trackslip_estimation.slip.source_faults import IS_OFFSET
from trackslip_estimation.slip.update import observe

ESTIMATION = Path(__file__).resolve().parents[3] / "src/trackslip_estimation/trackslip_estimation"
ALL: dict[str, Any] = {
    "vehicle": "pc05_cab",
    "pose_sources": ["gnss", "mast"],
    "yaw_rate_sources": ["imu/data_raw", "imu_top"],
    "heading_sources": ["compass"],
    "slip_sources": ["slip_seed"],
    "velocity_sources": ["doppler_top", "radar", "radar_top"],
    "sources.imu_data_raw.use_orientation": True,
    "sources.gnss.lever_arm_x": 0.8,
    "sources.gnss.lever_arm_y": -0.3,
    "sources.gnss.lever_arm_z": 2.0,
    "sources.mast.mount": "upper",
    "sources.mast.lever_arm_x": -1.0,
    "sources.mast.lever_arm_z": 2.5,
    "sources.imu_top.mount": "upper",
    "sources.compass.mount": "upper",
    **{
        f"sources.{name}.{key}": value
        for name in ("doppler_top", "radar", "radar_top")
        for key, value in (("lever_arm_x", 0.8), ("lever_arm_y", -0.3), ("lever_arm_z", 2.0))
    },
    **{f"sources.{name}.mount": "upper" for name in ("doppler_top", "radar_top")},
    **{f"sources.{name}.axes": "body" for name in ("radar", "radar_top")},
    **{f"sources.{name}.mounting_yaw": 3.0 for name in ("radar", "radar_top")},
}
KINDS = [
    (POSE, "gnss", 3),
    (POSE, "mast", 3),
    (HEADING, "compass", 1),
    (ON_SWING, "swing", 1),
    (YAW_RATE, "imu/data_raw", 1),
    (YAW_RATE, "imu_top", 1),
    (SLIPS, "slip_seed", 2),
    (VELOCITY, "doppler_top", 2),
    (VELOCITY, "radar", 2),
    (VELOCITY, "radar_top", 2),
]


def machine(seed: int, tilted: bool, measures_tilt: bool = True) -> tuple[Any, Any, dict[str, int]]:
    """A state with all optional states in use, its configuration record, and the indices of its sources."""
    values, rng = ALL | {"use_attitude": measures_tilt}, np.random.default_rng(seed)
    p, config, root = load_slip_parameters(values), config_of(values), rng.normal(size=(SIZE, SIZE))
    gaussian = Gaussian(rng.normal(size=SIZE) * 0.3, root @ root.T * 0.01)
    gaussian.mean[FIX_DELAY] = 0.0
    motion = MotionState(Motion.TURNING, departure=1.0)
    state = state_of(gaussian, Speeds(1.0, 1.7), motion)
    level = state["attitude"]["level"]
    if tilted:
        roll, pitch = 0.02, -0.03
        level["known"], level["forward"], level["sideways"] = 1, math.cos(pitch) - 1.0, math.cos(roll) - 1.0
        level["across"], level["lean_x"] = math.sin(roll) * math.sin(pitch), math.cos(roll) * math.sin(pitch)
        level["lean_y"] = -math.sin(roll)
    state["offsets"]["variance"], state["offsets"]["errors"]["f"] = 0.5, 1.0
    numbers = {name: number for number, name in enumerate(p.timeouts_ns())}
    state["fault"][0, numbers["compass"]] = IS_OFFSET
    return state, config[0], numbers


@pytest.mark.parametrize(("kind", "name", "rows"), KINDS)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("tilted", "measures_tilt"), [(False, True), (True, True), (False, False)])
def test_h_is_the_derivative_of_what_is_measured(
    kind: int, name: str, rows: int, seed: int, tilted: bool, measures_tilt: bool
) -> None:
    """With lever arms, swing, delay, offsets, sensor errors, and a slope that no IMU measures."""
    state, c, numbers = machine(seed, tilted, measures_tilt)
    measurement = np.zeros(1, MEASUREMENT)[0]
    measurement["kind"], measurement["source"] = kind, numbers[name]
    measurement["noise"] = 1e-3 * np.eye(3)
    start, n = state["mean"][0].copy(), int(c["size"])

    def innovation(x: FloatArray) -> FloatArray:
        state["mean"][0] = x
        found: FloatArray = observe(state[0], measurement, c).innovation
        return found

    H = observe(state[0], measurement, c).jacobian
    assert H.shape == (rows, n)
    step = 1e-6
    for k in range(n):
        unit = np.zeros(SIZE)
        unit[k] = step
        apart = innovation(start - unit) - innovation(start + unit)
        if rows != 2:
            apart[-1] = wrap(float(apart[-1])) if kind != YAW_RATE else apart[-1]
        loose = 3e-3 if tilted and kind in (POSE, HEADING, VELOCITY) and k == SWING else 1e-6
        np.testing.assert_allclose(H[:, k], apart / (2.0 * step), atol=loose, err_msg=f"state {k}")


@pytest.mark.parametrize("source", ["gnss", "mast"])
def test_position_correction_rotates_the_machine_about_its_sensor(source: str) -> None:
    """Equals an update in sensor coordinates, for any size of the heading correction."""
    state, c, numbers = machine(4, False)
    number, n, level = numbers[source], int(c["size"]), state["attitude"]["level"][0]
    measurement = np.zeros(1, MEASUREMENT)[0]
    measurement["kind"], measurement["source"] = POSE, number
    measurement["value"], measurement["noise"] = (1.0, 2.0, 1.5), 1e-3 * np.eye(3)
    o = observe(state[0], measurement, c)
    x, P = state["mean"][0, :n].copy(), state["covariance"][0].copy()
    before, arm = x.copy(), lever(x, level, number, c)
    correct(x, P, o)
    turn_about_sensor(x, P, before, arm, level, number, c)
    assert abs(x[YAW] - before[YAW]) > 0.2
    at, Q = before.copy(), state["covariance"][0].copy()
    to_sensor(at, Q, level, number, 1.0, c)
    H = o.jacobian.copy()
    H[:, [YAW, SWING]], H[X, X], H[Y, Y], H[YAW, YAW] = 0.0, 1.0, 1.0, 1.0
    H[:YAW, list(range(int(c["lean_errors"]), int(c["lean_errors"]) + 2))] = 0.0
    correct(at, Q, o._replace(jacobian=H))
    to_sensor(at, Q, level, number, -1.0, c)
    np.testing.assert_allclose(x[:YAW], at[:YAW], atol=1e-9)
    np.testing.assert_allclose(wrap(float(x[YAW] - at[YAW])), 0.0, atol=1e-9)
    np.testing.assert_allclose(P, Q, atol=1e-8)


def test_only_observations_and_weighing_update_a_state() -> None:
    """Only ``step.py`` and the attitude filter propagate."""
    users: dict[str, set[str]] = {}
    for file in ESTIMATION.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(
                "trackslip_estimation.kalman"
            ):
                for name in node.names:
                    users.setdefault(name.name, set()).add(str(file.relative_to(ESTIMATION)))
    corrects = {"observations/altitude.py", "observations/gyro.py", "observations/odometry.py"}
    corrects |= {"observations/slips.py", "tilt.py", "weighing.py"}
    attitude = {"attitude/filter.py", "attitude/orientation.py"}
    assert users["correct"] == {f"slip/{name}" for name in corrects} | attitude
    assert users["propagate_covariance"] == {"slip/step.py", "attitude/filter.py"}
    assert users["inflate_noise_to_gate"] <= users["correct"]
